"""Orbits of gaits: what long open-loop play comes to, its growth by finite differences, in any frame."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from defplan_mj.body.model import Body
from defplan_mj.dynamics import tangent
from defplan_mj.dynamics.reduced import ReducedDynamics
from defplan_mj.dynamics.tangent import Frame
from defplan_mj.gait.gait import Gait
from defplan_mj.gait.orbit import find_orbit

ASSETS = Path(__file__).parents[1] / "tasks" / "assets"


@pytest.fixture(scope="module")
def gait() -> Gait:
    return Gait.load(ASSETS / "fish_gait.npz")


@pytest.fixture(scope="module")
def dynamics(gait: Gait) -> ReducedDynamics:
    return ReducedDynamics(Body.load(ASSETS / "fish_body.npz"), gait.timestep)


def test_the_orbit_is_where_playing_for_ever_leads(dynamics, gait):
    for shapes in gait.table():
        orbit = find_orbit(dynamics, shapes, warm=4)
        assert orbit.residual < 1e-9
        x = dynamics.rollout(dynamics.rest_state(), np.tile(shapes, (60, 1)))
        cycle = x[-len(shapes) - 1 :]
        frame = Frame.of(cycle[0], True, True)
        told = np.array([frame.inside(state) for state in cycle])
        np.testing.assert_allclose(tangent.difference(told, orbit.states), 0, atol=1e-7)


def test_newtons_method_finds_it_from_one_cycle_from_rest(dynamics, gait):
    near = find_orbit(dynamics, gait.table()[0], warm=1, rounds=0)
    found = find_orbit(dynamics, gait.table()[0], warm=1)
    assert near.residual > 0.1 and found.residual < 1e-9


def test_the_multiplier_is_that_of_the_return_map_by_finite_differences(dynamics, gait):
    orbit, e = find_orbit(dynamics, gait.table()[1]), 1e-5
    start, columns = orbit.states[0], []

    def around(z: np.ndarray) -> np.ndarray:
        end = dynamics.rollout(tangent.retract(start, z), orbit.shapes)[-1]
        return tangent.difference(Frame.of(end, True, True).inside(end), start)

    for z in e * np.eye(22):
        columns.append((around(z) - around(-z)) / (2 * e))
    growth = np.abs(np.linalg.eigvals(np.array(columns).T)).max()
    assert orbit.multiplier == pytest.approx(growth, rel=1e-3)
    assert 0.1 < orbit.multiplier < 1  # this gait swims in open loop


def test_unrolled_it_is_the_rollout_from_its_start(dynamics, gait):
    free = replace(dynamics.body.medium, righting_height=0.0)
    weightless = ReducedDynamics(replace(dynamics.body, medium=free), gait.timestep)
    for level, model in ((True, dynamics), (False, weightless)):
        orbit = find_orbit(model, gait.table()[2], level=level)
        assert orbit.residual < 1e-9
        steps = 2 * len(orbit.shapes) + 3
        wanted = model.rollout(orbit.states[0], np.tile(orbit.shapes, (3, 1))[:steps])
        np.testing.assert_allclose(tangent.difference(orbit.unrolled(steps), wanted), 0, atol=1e-6)
