"""E_obj's residuals: their squares are the cost that shooting sums, and each means what it says."""

import casadi as ca
import numpy as np
import pytest

from defplan_mj.base import rotations
from defplan_mj.gait import costs, residuals
from defplan_mj.task import Weights

WEIGHTS = Weights()
NX = 13 + 3 * 2


def _state(place, yaw, lean=0.0):
    x = np.zeros(NX)
    x[:3] = place
    tilted = np.array([np.cos(lean / 2), np.sin(lean / 2), 0, 0])
    x[3:7] = rotations.product(rotations.level_attitude(yaw), tilted)
    return x


def _value(expression) -> np.ndarray:
    return np.array(ca.DM(expression)).ravel()


def test_residuals_are_the_turn_and_the_displacement_in_the_yaw_frame_at_the_start():
    start, end = _state([1, 2, 0], np.pi / 2), _state([0.9, 2.4, 0.05], np.pi / 2 + 0.3)
    goal = [np.array(v) for v in ([0, 0, 0.2], [1.0, 0, 0], 0.5)]
    off = residuals.planar(*(ca.DM(v) for v in (start, end, *goal)))
    assert _value(off.turn) == pytest.approx([0.1])
    assert _value(off.shortfall) == pytest.approx([0.1])  # 0.4 m of 0.5 m ahead
    assert _value(off.drift) == pytest.approx([0, 0.1], abs=1e-12)  # to the left
    assert _value(off.rise) == pytest.approx([0.05])


def test_a_cycle_that_goes_farther_than_it_has_to_lacks_nothing():
    lacking, across = residuals.displacement(ca.DM([0.7, 0.2]), ca.DM([1.0, 0]), ca.DM(0.5))
    assert _value(lacking) == [0] and _value(across) == pytest.approx([0, 0.2])


@pytest.mark.parametrize("lean", [0.05, 0.2, 0.6])
def test_the_tilt_is_the_leaning_angle_to_second_order(lean):
    x = ca.DM(_state([0, 0, 0], 0.4, lean))
    assert (_value(residuals.tilt(x)) ** 2).sum() == pytest.approx(lean**2, rel=lean**2)
    beyond = 4 * np.sin(lean / 2) ** 2 - np.radians(15) ** 2
    assert _value(residuals.lean(x)) == pytest.approx([max(0, beyond)], abs=1e-12)


def test_the_cost_is_the_weighted_sum_of_their_squares():
    rng = np.random.default_rng(0)
    start = _state([0, 0, 0], 0.3)
    x = np.array([_state(rng.normal(size=3), rng.normal(), 0.3) for _ in range(4)]).T
    goal = [np.array([0, 0, 0.2]), np.array([0.6, 0.8, 0]), np.array(0.5)]
    cost = costs.planar(WEIGHTS, *(ca.DM(v) for v in (start, x, *goal)))
    off = residuals.planar(*(ca.DM(v) for v in (start, x[:, -1], *goal)))
    parts = {name: (_value(getattr(off, name)) ** 2).sum() for name in vars(off)}
    expected = (
        WEIGHTS.turn * parts["turn"]
        + WEIGHTS.move * parts["shortfall"]
        + WEIGHTS.drift * parts["drift"]
        + WEIGHTS.sink * parts["rise"]
    )
    for state in x.T:
        expected += WEIGHTS.tilt * (_value(residuals.tilt(state)) ** 2).sum() / 4
        expected += WEIGHTS.upright * (_value(residuals.lean(state)) ** 2).sum() / 4
    assert _value(cost) == pytest.approx([expected], rel=1e-12)
