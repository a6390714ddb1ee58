"""Packaged gaits are found for the body that another kind of processor builds, and for no other one."""

from dataclasses import replace

import pytest

from defplan_mj import registry
from defplan_mj.base.errors import DefplanError
from defplan_mj.body.model import Body
from defplan_mj.gait.gait import Gait
from defplan_mj.gait.problem import GaitProblem
from defplan_mj.pipeline.run import open_run
from solvers.gait.as_packaged import SOLVER


@pytest.fixture(scope="module")
def spec():
    return registry.get_task("fish-swim")


@pytest.fixture(scope="module")
def packaged(spec):
    return Body.load(spec.shipped[0])


def _problem(spec, body: Body) -> GaitProblem:
    return GaitProblem.of(spec, spec.dynamics(body))


def test_a_body_that_differs_in_its_last_digits_gets_the_gaits_as_its_own(spec, packaged):
    body = replace(packaged, basis=packaged.basis * (1 + 1e-11))
    assert body.hash != packaged.hash
    gait, made = SOLVER.solve(_problem(spec, body)), Gait.load(spec.shipped[1])
    assert gait.body_hash == body.hash
    assert (gait.alpha == made.alpha).all() and gait.task_names == made.task_names


def test_another_body_gets_none(spec, packaged):
    stiffer = replace(packaged, stiffness=packaged.stiffness * 1.01)
    with pytest.raises(DefplanError, match="no installed task comes with gaits"):
        SOLVER.solve(_problem(spec, stiffer))


def test_a_run_has_the_packaged_body_and_builds_none(packaged, tmp_path, monkeypatch):
    monkeypatch.setattr("defplan_mj.body.build.build_body", None)
    spec = registry.get_task("fish-swim")
    with open_run(spec, tmp_path, 0, {"gait_solver": "as-packaged"}) as run:
        run.do("gait")
        assert run.result("body").hash == packaged.hash == run.result("gait").body_hash


def test_nearly_looks_at_every_part_of_a_body(packaged):
    assert packaged.nearly(packaged)
    assert not packaged.nearly(replace(packaged, sampled=packaged.sampled + 1))
    assert not packaged.nearly(replace(packaged, mesh_softening=1.0))
    assert not packaged.nearly(replace(packaged, drag_areas=packaged.drag_areas[:-1]))
    assert not packaged.nearly(replace(packaged, medium=replace(packaged.medium, density=1.0)))
