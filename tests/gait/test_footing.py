"""Measures of a walker's feet, on motions whose measures are known."""

from __future__ import annotations

import numpy as np
import pytest

from defplan_mj.dynamics.reduced import ReducedDynamics
from defplan_mj.gait.footing import footing
from defplan_tasks import quadruped
from tests.samples import host as samples


@pytest.fixture(scope="module")
def dynamics() -> ReducedDynamics:
    return ReducedDynamics(samples.walker(), quadruped.WALK.timestep, quadruped.WALK.terrain)


def _slid(dynamics: ReducedDynamics, step: float, steps: int) -> np.ndarray:
    """Return states (1, steps + 1, nx) of the standing body that is drawn along x."""
    states = np.tile(dynamics.rest_state(), (1, steps + 1, 1))
    states[0, :, 0] = step * np.arange(steps + 1)
    states[0, :, 7 + dynamics.body.n_modes] = step / dynamics.timestep
    return states


def test_a_body_that_stands_does_not_slip_and_carries_all_on_its_soles(dynamics):
    found = footing(dynamics, _slid(dynamics, 0.0, 5))
    assert found["slip_m"] == 0.0 and found["belly_load"] == 0.0
    deepest = dynamics.contacts(dynamics.rest_state()).depths.max()
    assert found["penetration_mm"] == pytest.approx(1e3 * max(deepest, 0.0))
    height = np.ptp(dynamics.body.vertices[:, 2])
    assert 0.25 * height < found["torso_clearance_m"] < 0.35 * height


def test_a_body_that_is_drawn_along_slips_all_its_way(dynamics):
    found = footing(dynamics, _slid(dynamics, 0.02, 5))
    assert found["slip_m"] == pytest.approx(0.1)
    assert found["slip_share"] == pytest.approx(1.0)


def test_a_body_that_lies_on_its_back_has_its_load_there(dynamics):
    states = _slid(dynamics, 0.0, 1)
    states[0, :, 3:7] = [0, 1, 0, 0]
    low = min(dynamics.surface(states[0, 0])[:, 2])
    states[0, :, 2] -= low - 0.002
    found = footing(dynamics, states)
    assert found["belly_load"] == 1.0
    assert found["torso_clearance_m"] == pytest.approx(0.002)
