"""What finer steps and the full FEM change about gaits."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from defplan_mj import registry
from defplan_mj.base.errors import DefplanError
from defplan_mj.body.build import build_body
from defplan_mj.cli import main
from defplan_mj.gait.gait import Gait
from defplan_mj.planning.robot import Robot
from defplan_mj.studies import check, finer_bodies
from defplan_mj.task import BodyOptions


@pytest.fixture(scope="module")
def wag(small_fish) -> Gait:
    """Return a gait of the small fish: a wave of its first two modes, the second a quarter cycle late."""
    r = small_fish.n_modes
    alpha, mu = np.zeros((1, 2, r)), np.zeros((2, r))
    alpha[0, 0, 0], alpha[0, 1, 1] = 0.5, 0.3
    mu[1, 1] = np.pi / 2
    return Gait(
        body_hash=small_fish.hash,
        task_names=("forward",),
        timestep=0.02,
        steps_per_cycle=22,
        alpha=alpha,
        beta=np.ones((1, 2, r)),
        mu=mu,
        amplitude=small_fish.amplitude,
    )


def test_a_gait_moves_the_reduced_body_as_the_full_one(small_fish, wag):
    """The full FEM is the independent truth: other unknowns, all triangles, its own step."""
    spec = registry.get_task("fish-swim")
    data = check.check_gaits(spec, Robot(small_fish, wag, spec.world))
    (row,) = data["gaits"]
    assert row["shape_error"] < 0.1
    assert row["attitude_rad"] < 0.2
    distance = abs(row["advance_m"]["full"] - row["advance_m"]["reduced"])
    assert distance < 0.02 * small_fish.length
    assert abs(row["turn_rad"]["full"] - row["turn_rad"]["reduced"]) < 0.05
    assert data["falls_refined"] == 0
    assert data["drag_force_error"] == small_fish.source["drag"]["error"]


def test_a_body_reduced_less_is_asked_for_the_same_shapes(small_fish, wag):
    """More modes come with other signs; what they are asked for is the same place of every vertex."""
    options = BodyOptions(vertices=300, modes=5, basis=20, samples=16, drag_points=40)
    mesh = registry.get_task("fish-swim").mesh
    fine = build_body(mesh, finer_bodies.finer_options(options)["modes"])
    assert fine.n_modes == small_fish.n_modes + finer_bodies.MORE_MODES
    shapes = wag.table()[0]
    asked = finer_bodies.same_shapes(small_fish, fine, shapes)
    there = np.einsum("nik,mk->mni", small_fish.modes, shapes)
    again = np.einsum("nik,mk->mni", fine.modes, asked)
    assert np.abs(there - again).max() < 1e-6 * small_fish.length


def test_finer_steps_hardly_change_a_gait(small_fish, wag):
    spec = registry.get_task("fish-swim")
    data = check.check_gaits(spec, Robot(small_fish, wag, spec.world), full=False)
    (row,) = data["gaits"]
    assert "full" not in row["advance_m"]
    for kind in ("refined", "substeps"):
        assert abs(row["advance_m"][kind] - row["advance_m"]["reduced"]) < 0.005 * small_fish.length
        assert abs(row["turn_rad"][kind] - row["turn_rad"]["reduced"]) < 0.01


def test_a_gaits_answer_to_shifted_shapes_is_told_and_repeats(small_fish, wag):
    spec = registry.get_task("fish-swim")
    robot = Robot(small_fish, wag, spec.world)
    one, again, other = (
        check.check_gaits(spec, robot, full=False, seed=seed)["gaits"][0]["shifted"]
        for seed in (0, 0, 1)
    )
    assert one == again != other
    # 3% of a bend to the side turn a fish, by far less than a turn
    assert 0.0 < one["turn_sd_rad"] < 0.5 and 0.0 < one["advance_sd_m"] < 0.2 * small_fish.length


def test_refining_keeps_the_rhythm(wag):
    fine = check.refined(wag)
    np.testing.assert_allclose(fine.table()[:, 3::4], wag.table(), atol=1e-12)
    assert fine.cycle_seconds == pytest.approx(wag.cycle_seconds)


def test_gaits_of_another_body_are_refused(small_fish, wag):
    spec = registry.get_task("fish-swim")
    robot = Robot(small_fish, replace(wag, body_hash="0" * 64), spec.world)
    with pytest.raises(DefplanError, match="belong to another body"):
        check.check_gaits(spec, robot)


@pytest.mark.parametrize("task", ["fish-swim", "quadruped-swim"])
def test_the_packaged_gaits_do_not_depend_on_the_time_step(task):
    spec = registry.get_task(task)
    data = check.check_gaits(spec, check.packaged_robot(spec), full=False)
    assert json.loads(json.dumps(data, allow_nan=False)) == data
    for gait in data["gaits"]:
        advance, turn = gait["advance_m"], gait["turn_rad"]
        size = max(abs(advance["reduced"]), 0.1)  # a turn on the spot has no advance to speak of
        assert abs(advance["refined"] - advance["reduced"]) < 0.03 * size
        assert abs(turn["refined"] - turn["reduced"]) < 0.03 * max(abs(turn["reduced"]), 0.4)


def test_a_run_without_gaits_is_one_sentence(tmp_path: Path, capsys):
    assert main(["check", "fish-swim", "--run", str(tmp_path)]) != 0
    assert "body file" in capsys.readouterr().err
