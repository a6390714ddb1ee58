"""Rotations: MuJoCo's convention, and angles that are exact near no turn and near half a turn."""

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from defplan_mj.base import rotations

QUATERNION = hnp.arrays(float, 4, elements=st.floats(-1, 1)).filter(
    lambda q: np.linalg.norm(q) > 1e-3
)


def _unit(q):
    return q / np.linalg.norm(q)


@given(QUATERNION)
def test_a_matrix_is_mujocos_and_leads_back_to_the_quaternion(q):
    truth = np.empty(9)
    mujoco.mju_quat2Mat(truth, _unit(q))
    matrix = rotations.matrix(q)
    np.testing.assert_allclose(matrix.ravel(), truth, atol=1e-15)
    again = rotations.quaternion(matrix)
    assert again[0] >= 0 and abs(again @ _unit(q)) == pytest.approx(1, abs=1e-14)


@given(QUATERNION, QUATERNION)
def test_a_product_is_mujocos_to_the_sign(p, q):
    truth = np.empty(4)
    mujoco.mju_mulQuat(truth, _unit(p), _unit(q))
    np.testing.assert_allclose(rotations.product(p, q), truth, atol=1e-15)
    back = rotations.product(p * [1.0, -1.0, -1.0, -1.0], p)
    np.testing.assert_allclose(back, [1, 0, 0, 0], atol=1e-15)


@given(hnp.arrays(float, 3, elements=st.floats(-1, 1)), st.floats(0, np.pi))
def test_an_angle_is_exact_for_small_and_for_half_turns(axis, angle):
    if np.linalg.norm(axis) < 1e-3:
        axis = np.array([0.0, 0.0, 1.0])
    axis = _unit(axis)
    cross = np.cross(np.eye(3), -axis)
    # Rodrigues' formula, 1 - cos by the half angle
    matrix = np.eye(3) + np.sin(angle) * cross + 2 * np.sin(angle / 2) ** 2 * cross @ cross
    assert rotations.angle(matrix) == pytest.approx(angle, abs=1e-12)


@given(st.floats(-3.14, 3.14))
def test_headings_of_all_forms_are_the_same(yaw):
    quaternion, matrix = rotations.level_attitude(yaw), rotations.level_matrix(yaw)
    np.testing.assert_allclose(rotations.matrix(quaternion), matrix, atol=1e-15)
    assert rotations.heading(matrix) == pytest.approx(yaw, abs=1e-14)
    assert rotations.quaternion_heading(quaternion) == pytest.approx(yaw, abs=1e-14)
    np.testing.assert_allclose(
        rotations.upright(np.array([yaw])).as_matrix()[0], matrix, atol=1e-15
    )


def test_any_number_of_leading_axes_is_kept():
    q = np.random.default_rng(0).normal(size=(2, 5, 4))
    assert rotations.matrix(q).shape == (2, 5, 3, 3)
    assert rotations.matrix(np.zeros((0, 4))).shape == (0, 3, 3)
    np.testing.assert_array_equal(rotations.matrix(q)[1, 3], rotations.matrix(q[1, 3]))


@given(QUATERNION)
def test_kabsch_finds_the_turn_of_points(q):
    points = np.random.default_rng(0).normal(size=(6, 3))
    matrix = rotations.matrix(q)
    found = rotations.kabsch((points @ matrix.T).T @ points)
    np.testing.assert_allclose(found, matrix, atol=1e-12)
