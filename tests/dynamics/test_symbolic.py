"""CasADi's expressions of rotations and tangent coordinates, against MuJoCo, the arrays' own and differences."""

import casadi as ca
import mujoco
import numpy as np
import pytest

from defplan_mj.dynamics import symbolic, tangent

NX = 13 + 3 * 2


def _state(rng):
    x = rng.normal(size=NX)
    x[3:7] /= np.linalg.norm(x[3:7])
    return x


def test_products_and_matrices_are_mujocos():
    rng = np.random.default_rng(0)
    for _ in range(20):
        p, q = (_state(rng)[3:7] for _ in range(2))
        product, matrix = np.empty(4), np.empty(9)
        mujoco.mju_mulQuat(product, p, q)
        mujoco.mju_quat2Mat(matrix, p)
        assert np.array(symbolic.quaternion_product(ca.DM(p), ca.DM(q))).ravel() == pytest.approx(
            product, abs=1e-15
        )
        assert np.array(symbolic.quaternion_matrix(ca.DM(p))).ravel() == pytest.approx(
            matrix, abs=1e-15
        )
        forward = symbolic.forward_axis(ca.DM(np.concatenate([np.zeros(3), p])))
        assert np.array(forward).ravel() == pytest.approx(matrix[[0, 3, 6]], abs=1e-15)


def test_a_difference_is_that_of_the_arrays():
    rng = np.random.default_rng(1)
    for _ in range(20):
        x, origin = _state(rng), _state(rng)
        got = np.array(symbolic.difference(ca.DM(x), ca.DM(origin))).ravel()
        assert got == pytest.approx(tangent.difference(x, origin), abs=1e-14)


def test_a_small_change_is_that_of_the_arrays_to_second_order():
    rng = np.random.default_rng(2)
    x, change = _state(rng), rng.normal(size=NX - 1)
    for size in (1e-2, 1e-3):
        got = np.array(symbolic.retract(ca.DM(x), ca.DM(size * change))).ravel()
        error = np.abs(got - tangent.retract(x, size * change)).max()
        assert error < 5 * size**3


def test_derivatives_are_those_of_finite_differences():
    rng = np.random.default_rng(3)
    x, origin, scale, e = _state(rng), _state(rng), rng.uniform(1, 2, NX - 1), 1e-6
    value, by_x, by_origin = (
        np.array(v) for v in symbolic.difference_function(NX, scale)(x, origin)
    )
    assert value.ravel() == pytest.approx(scale * tangent.difference(x, origin), abs=1e-14)
    by_change = np.array(symbolic.tangent_function(NX)(x))
    for i, z in enumerate(e * np.eye(NX - 1)):
        ends = [tangent.retract(x, s * z) for s in (1, -1)]
        up, down = (scale * tangent.difference(end, origin) for end in ends)
        np.testing.assert_allclose(by_x[:, i], (up - down) / (2 * e), atol=1e-8)
        np.testing.assert_allclose(by_change[:, i], (ends[0] - ends[1]) / (2 * e), atol=1e-8)
    for i, z in enumerate(e * np.eye(NX)):
        up, down = (scale * tangent.difference(x, origin + s * z) for s in (1, -1))
        np.testing.assert_allclose(by_origin[:, i], (up - down) / (2 * e), atol=1e-8)
