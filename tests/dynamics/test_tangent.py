"""Tangent coordinates and frames: inverse to each other, derivatives by finite differences, symmetry."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy.spatial.transform import Rotation

from defplan_mj.body.model import Body, Medium
from defplan_mj.dynamics import tangent
from defplan_mj.dynamics.reduced import ReducedDynamics
from defplan_mj.dynamics.tangent import Frame
from tests.samples.kernel_cases import in_medium, random_state


@pytest.fixture(scope="module")
def dynamics(small_fish: Body) -> ReducedDynamics:
    return ReducedDynamics(in_medium(small_fish, Medium()), tolerance=1e-10)


NX = 13 + 3 * 2
NUMBERS = st.floats(-10, 10)
ATTITUDES = hnp.arrays(float, 4, elements=st.floats(-1, 1)).filter(
    lambda q: np.linalg.norm(q) > 1e-3
)


def _state(numbers: np.ndarray, attitude: np.ndarray) -> np.ndarray:
    x = numbers.copy()
    x[3:7] = attitude / np.linalg.norm(attitude)
    return x


@given(
    hnp.arrays(float, NX, elements=NUMBERS), ATTITUDES, hnp.arrays(float, NX - 1, elements=NUMBERS)
)
def test_any_change_up_to_nearly_half_a_turn_is_found_again(numbers, attitude, z):
    x = _state(numbers, attitude)
    z[3:6] *= 1.9 / max(1.9, float(np.linalg.norm(z[3:6])))
    there = tangent.retract(x, z)
    assert np.linalg.norm(there[3:7]) == pytest.approx(1, abs=1e-14)
    np.testing.assert_allclose(tangent.difference(there, x), z, atol=1e-11)


@given(hnp.arrays(float, (2, NX), elements=NUMBERS), ATTITUDES, ATTITUDES)
def test_any_two_states_are_a_change_apart_that_leads_from_one_to_the_other(numbers, one, other):
    x, origin = _state(numbers[0], one), _state(numbers[1], other)
    assume(abs(x[3:7] @ origin[3:7]) > 0.05)  # not half a turn apart
    there = tangent.retract(origin, tangent.difference(x, origin))
    there[3:7] *= np.sign(there[3:7] @ x[3:7])
    np.testing.assert_allclose(there, x, atol=1e-11)


@given(
    hnp.arrays(float, (2, NX), elements=NUMBERS), ATTITUDES, ATTITUDES, st.booleans(), st.booleans()
)
def test_a_frame_leads_there_and_back(numbers, one, other, level, depth):
    x, place = _state(numbers[0], one), _state(numbers[1], other)
    frame = Frame.of(place, level, depth)
    there = frame.outside(frame.inside(x))
    np.testing.assert_allclose(there, x, atol=1e-11)


def test_the_rotation_part_is_the_rotation_vector_whatever_the_quaternions_sign(dynamics):
    rng = np.random.default_rng(1)
    x, turn = random_state(dynamics, rng), 1e-3 * rng.normal(size=3)
    y = x.copy()
    turned = Rotation.from_quat(x[3:7], scalar_first=True) * Rotation.from_rotvec(turn)
    for sign in (1, -1):
        y[3:7] = sign * turned.as_quat(scalar_first=True)
        np.testing.assert_allclose(tangent.difference(y, x)[3:6], turn, rtol=1e-6)


def test_the_derivative_of_a_difference_is_that_of_finite_differences(dynamics):
    rng = np.random.default_rng(2)
    x, origin = random_state(dynamics, rng), random_state(dynamics, rng)
    got, e = tangent.difference_jacobian(x, origin), 1e-6
    for i in range(3):
        z = np.zeros(27)
        z[3 + i] = e
        up, down = (tangent.difference(tangent.retract(x, s * z), origin) for s in (1, -1))
        np.testing.assert_allclose(got[:, i], (up - down)[3:6] / (2 * e), atol=1e-9)


def test_a_steps_jacobians_are_those_of_finite_differences(dynamics):
    rng = np.random.default_rng(3)
    x, u, e = random_state(dynamics, rng), rng.normal(size=5), 1e-5
    y = dynamics.step(x, u)
    a, b = tangent.step_jacobian(x, y, *dynamics.step_jacobian(x, u, y))
    for i in range(27):
        z = e * np.eye(27)[i]
        up, down = (dynamics.step(tangent.retract(x, s * z), u) for s in (1, -1))
        wanted = (tangent.difference(up, y) - tangent.difference(down, y)) / (2 * e)
        np.testing.assert_allclose(a[:, i], wanted, rtol=2e-4, atol=2e-4)
    for i in range(5):
        du = e * np.eye(5)[i]
        up, down = (dynamics.step(x, u + s * du) for s in (1, -1))
        wanted = (tangent.difference(up, y) - tangent.difference(down, y)) / (2 * e)
        np.testing.assert_allclose(b[:, i], wanted, rtol=2e-4, atol=2e-4)


def test_many_states_at_once_are_each_as_alone(dynamics):
    rng = np.random.default_rng(4)
    x = np.array([random_state(dynamics, rng) for _ in range(6)]).reshape(2, 3, -1)
    y = np.array([random_state(dynamics, rng) for _ in range(6)]).reshape(2, 3, -1)
    many, by = tangent.difference(x, y), tangent.difference_jacobian(x, y)
    assert by.shape == (2, 3, 3, 3)
    for i, j in np.ndindex(2, 3):
        assert (many[i, j] == tangent.difference(x[i, j], y[i, j])).all()
        assert (by[i, j] == tangent.difference_jacobian(x[i, j], y[i, j])).all()


@pytest.mark.parametrize(("level", "depth"), [(True, True), (True, False), (False, True)])
def test_a_state_told_from_its_own_frame_is_at_its_origin(dynamics, level, depth):
    x = random_state(dynamics, np.random.default_rng(5))
    y = Frame.of(x, level, depth).inside(x)
    np.testing.assert_allclose(y[:2], 0, atol=1e-15)
    assert y[2] == pytest.approx(0.0 if depth else x[2])
    ahead = Rotation.from_quat(y[3:7], scalar_first=True).as_matrix()[:, 0]
    assert ahead[1] == pytest.approx(0.0, abs=1e-14) and (level or ahead[0] == pytest.approx(1.0))


def test_the_body_moves_alike_wherever_its_frame_is(dynamics):
    rng = np.random.default_rng(6)
    frame = Frame(rng.normal(size=3), np.array([np.cos(0.4), 0, 0, np.sin(0.4)]))
    x, u = random_state(dynamics, rng), rng.normal(size=5)
    np.testing.assert_allclose(frame.inside(frame.outside(x)), x, atol=1e-12)
    there = frame.inside(dynamics.step(frame.outside(x), u))
    np.testing.assert_allclose(there, dynamics.step(x, u), atol=1e-8)


def test_frames_follow_one_another_as_rotations_do():
    rng = np.random.default_rng(7)
    turns = Rotation.random(2, rng)
    first, second = (Frame(rng.normal(size=3), q) for q in turns.as_quat(scalar_first=True))
    both = first.then(second)
    np.testing.assert_allclose(both.matrix, (turns[0] * turns[1]).as_matrix(), atol=1e-14)
    np.testing.assert_allclose(both.position, first.position + turns[0].apply(second.position))
