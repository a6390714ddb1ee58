"""The reduced dynamics in CasADi: the kernel's numbers to the bit, exact derivatives, threads, lifetime."""

from __future__ import annotations

import gc

import casadi as ca
import numpy as np
import pytest

from defplan_mj.base.errors import DefplanError
from defplan_mj.body.model import Body
from defplan_mj.dynamics.external import CasadiDynamics
from defplan_mj.dynamics.reduced import ReducedDynamics
from tests.samples.examples import example as example_named
from tests.samples.kernel_cases import random_state


@pytest.fixture(scope="module")
def dynamics(small_fish: Body) -> ReducedDynamics:
    return ReducedDynamics(small_fish)


@pytest.fixture(scope="module")
def symbolic(dynamics: ReducedDynamics) -> CasadiDynamics:
    return CasadiDynamics(dynamics)


def flat(value: ca.DM) -> np.ndarray:
    return np.array(value).ravel()


def sample(dynamics: ReducedDynamics, seed: int, n: int | None = None):
    rng = np.random.default_rng(seed)
    shape = (dynamics.nu,) if n is None else (n, dynamics.nu)
    return random_state(dynamics, rng), rng.uniform(-1, 1, shape)


def test_a_step_and_its_derivatives_are_the_kernels_to_the_bit(dynamics, symbolic):
    x, u = sample(dynamics, 0)
    x_next = dynamics.step(x, u)
    np.testing.assert_array_equal(flat(symbolic.step(x, u)), x_next)
    jacobian = symbolic.step.jacobian()(x, u, x_next)
    for value, wanted in zip(jacobian, dynamics.step_jacobian(x, u, x_next), strict=True):
        np.testing.assert_array_equal(np.array(value), wanted)
    g = np.random.default_rng(1).normal(size=dynamics.nx)
    adjoint = symbolic.step.reverse(1)(x, u, x_next, g)
    for value, wanted in zip(adjoint, dynamics.step_adjoint(x, u, x_next, g), strict=True):
        np.testing.assert_array_equal(flat(value), wanted)


def test_a_rollout_and_its_adjoint_are_the_kernels_to_the_bit(dynamics, symbolic):
    n = 12
    x0, u = sample(dynamics, 2, n)
    states = dynamics.rollout(x0, u)
    rollout = symbolic.rollout(n)
    np.testing.assert_array_equal(np.array(rollout(x0, u.T)).T, states[1:])
    g = np.random.default_rng(3).normal(size=states.shape)
    g[0] = 0
    value = rollout.reverse(1)(x0, u.T, states[1:].T, g[1:].T)
    g0, gu = dynamics.rollout_adjoint(u, states, g)
    np.testing.assert_array_equal(flat(value[0]), g0)
    np.testing.assert_array_equal(np.array(value[1]).T, gu)


def test_the_gradient_through_casadis_own_chain_of_steps_is_the_rollouts(dynamics, symbolic):
    n = 8
    x0, u = sample(dynamics, 4, n)
    symbols = ca.MX.sym("u", dynamics.nu, n)
    gradients = []
    for rollout in (symbolic.rollout(n), symbolic.step.mapaccum(n)):
        cost = ca.sumsqr(rollout(x0, symbols))
        gradients.append(ca.Function("g", [symbols], [ca.gradient(cost, symbols)])(u.T))
    one, other = (np.array(g) for g in gradients)
    np.testing.assert_allclose(one, other, rtol=1e-10)


@pytest.mark.parametrize("threads", [1, 2])
def test_rollouts_side_by_side_are_single_rollouts_to_the_bit(dynamics, symbolic, threads):
    n, count = 6, 5
    starts, shapes = zip(*(sample(dynamics, 10 + i, n) for i in range(count)), strict=True)
    rollouts = symbolic.rollouts(n, count, threads)
    x0, u = np.array(starts).T, np.concatenate(shapes).T
    value = np.array(rollouts(x0, u)).T.reshape(count, n, -1)
    for i in range(count):
        np.testing.assert_array_equal(value[i], dynamics.rollout(starts[i], shapes[i])[1:])
    symbols = ca.MX.sym("u", dynamics.nu, n * count)
    weights = np.random.default_rng(5).normal(size=(dynamics.nx, n * count))
    cost = ca.dot(weights, rollouts(x0, symbols))
    gradient = np.array(ca.Function("g", [symbols], [ca.gradient(cost, symbols)])(u)).T
    for i in range(count):
        states = dynamics.rollout(starts[i], shapes[i])
        g = np.zeros_like(states)
        g[1:] = weights.T[i * n : (i + 1) * n]
        _, wanted = dynamics.rollout_adjoint(shapes[i], states, g)
        np.testing.assert_array_equal(gradient[i * n : (i + 1) * n], wanted)


def test_the_jacobian_of_mapped_steps_is_block_diagonal(dynamics, symbolic):
    n = 4
    x, u = ca.MX.sym("x", dynamics.nx, n), ca.MX.sym("u", dynamics.nu, n)
    mapped = symbolic.step.map(n)(x, u)
    jacobian = ca.jacobian(ca.vec(mapped), ca.vec(u))
    assert jacobian.nnz() == n * dynamics.nx * dynamics.nu
    states, shapes = zip(*(sample(dynamics, 20 + i) for i in range(n)), strict=True)
    value = ca.Function("j", [x, u], [jacobian])(np.array(states).T, np.array(shapes).T)
    for i in range(n):
        _, b = dynamics.step_jacobian(states[i], shapes[i], dynamics.step(states[i], shapes[i]))
        rows, columns = (slice(i * size, (i + 1) * size) for size in (dynamics.nx, dynamics.nu))
        np.testing.assert_allclose(np.array(value)[rows, columns], b, rtol=1e-12, atol=1e-14)


def test_omitted_target_shapes_are_zero(dynamics, symbolic):
    x, _ = sample(dynamics, 6)
    wanted = dynamics.step(x, np.zeros(dynamics.nu))
    np.testing.assert_array_equal(flat(symbolic.step(x=x)["x_next"]), wanted)


def test_functions_outlive_what_made_them_and_give_their_slots_back(small_fish):
    x, u = sample(ReducedDynamics(small_fish), 7)
    wanted = ReducedDynamics(small_fish).step(x, u)
    derivative = None
    for n in range(1, 101):  # more than there are slots
        made = CasadiDynamics(ReducedDynamics(small_fish))
        step, derivative = made.step, made.rollout(n).map(2).reverse(1)
        del made
        np.testing.assert_array_equal(flat(step(x, u)), wanted)
    assert derivative is not None
    assert derivative.size_out(1) == (5, 200)


def test_more_functions_at_once_than_there_are_slots_is_an_error(dynamics):
    many = CasadiDynamics(dynamics)
    with pytest.raises(DefplanError, match="64 slots are in use"):
        for n in range(1, 66):
            many.rollout(n)
    del many
    gc.collect()
    assert CasadiDynamics(dynamics).rollout(70).size_out(0) == (dynamics.nx, 70)


def test_a_step_that_does_not_converge_is_an_evaluation_error(small_fish):
    hurried = CasadiDynamics(ReducedDynamics(small_fish, max_newton=1, tolerance=1e-30))
    with pytest.raises(RuntimeError):
        hurried.step(hurried.dynamics.rest_state(), np.ones(5))


def test_ipopt_reaches_a_pose_through_a_rollout(dynamics, symbolic):
    """Single shooting: two target shapes, held in turn, that bend the fish as wanted."""
    n, r = 20, dynamics.nu
    wanted = np.array([0.5, -0.2, 0.0, 0.1, 0.0])
    held = ca.MX.sym("held", r)
    end = symbolic.rollout(n)(dynamics.rest_state(), ca.repmat(held, 1, n))[:, -1]
    problem = {"x": held, "f": ca.sumsqr(end[7 : 7 + r] - wanted)}
    options = {
        "ipopt": {"hessian_approximation": "limited-memory", "print_level": 0, "tol": 1e-10},
        "print_time": False,
    }
    solution = ca.nlpsol("solver", "ipopt", problem, options)(x0=np.zeros(r))
    states = dynamics.rollout(dynamics.rest_state(), np.tile(flat(solution["x"]), (n, 1)))
    np.testing.assert_allclose(states[-1][7 : 7 + r], wanted, atol=1e-4)


def test_the_step_without_second_derivatives_has_the_same_value_and_jacobian(dynamics, symbolic):
    x, u = sample(dynamics, 8)
    x_next = symbolic.step(x, u)
    np.testing.assert_array_equal(symbolic.step_gauss_newton(x, u), x_next)
    sx, su = ca.MX.sym("x", dynamics.nx), ca.MX.sym("u", dynamics.nu)
    y = symbolic.step_gauss_newton(sx, su)
    value = ca.Function("j", [sx, su], [ca.jacobian(y, sx), ca.jacobian(y, su)])(x, u)
    for block, wanted in zip(value, dynamics.step_jacobian(x, u, flat(x_next)), strict=True):
        np.testing.assert_allclose(np.array(block), wanted, rtol=1e-13, atol=1e-15)
    weights = np.random.default_rng(9).normal(size=dynamics.nx)
    hessian = ca.hessian(ca.dot(weights, y) + ca.sumsqr(su), su)[0]
    at = ca.Function("h", [sx, su], [hessian])(x, u)
    np.testing.assert_allclose(np.array(at), 2 * np.eye(dynamics.nu), atol=1e-15)


@pytest.fixture(scope="module")
def example():
    return example_named("multiple_shooting")


@pytest.mark.slow
def test_the_swimming_example_arrives_by_single_and_by_multiple_shooting(small_fish, tmp_path):
    small_fish.save(tmp_path / "body.npz")
    single, multiple = example_named("swimming").main(str(tmp_path / "body.npz"), 0.4, 0.8)
    assert single < 0.01 and multiple < 0.01  # m, simulated


@pytest.mark.parametrize("solver", ["ipopt", "fatrop"])
def test_the_worked_example_reaches_its_shape_when_simulated(dynamics, example, solver):
    if not ca.has_nlpsol(solver):
        pytest.skip(f"this CasADi has no {solver}")
    wanted = np.array([0.4, -0.1, 0.0, 0.1, 0.0])
    states, shapes, stats = example.reach(dynamics, wanted, 6, solver)
    assert stats["success"]
    simulated = dynamics.rollout(dynamics.rest_state(), shapes)
    np.testing.assert_allclose(states, simulated, atol=1e-5)
    np.testing.assert_allclose(simulated[-1][7:12], wanted, atol=5e-3)
    assert (np.abs(shapes) <= dynamics.body.amplitude + 1e-6).all()


def test_the_worked_example_runs_as_a_script(small_fish, example, tmp_path, capsys):
    small_fish.save(tmp_path / "body.npz")
    example.main(str(tmp_path / "body.npz"))
    assert "shape at the end: [ 0.4" in capsys.readouterr().out
