"""The kernel's next state and derivatives against the symbolic twin and finite differences."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest

from defplan_mj.body.model import Body
from defplan_mj.dynamics.reduced import ReducedDynamics
from tests.samples.casadi_twin import CasadiTwin
from tests.samples.kernel_cases import (
    EVERY_FORCE,
    VACUUM,
    central_differences,
    in_medium,
    random_state,
    synthetic_body,
)

SIZES = [  # modes, basis, samples, patches: below, at and above the kernel's blocks of eight
    (1, 3, 2, 1),
    (8, 15, 8, 8),
    (9, 16, 9, 17),
    (3, 7, 16, 0),
]
STEPPINGS = [
    *(("variational", substeps) for substeps in (1, 2, 3)),
    *(("implicit-euler", substeps) for substeps in (1, 2)),
]


@pytest.fixture(scope="module")
def dynamics(small_fish: Body) -> ReducedDynamics:
    return ReducedDynamics(in_medium(small_fish, EVERY_FORCE))


@pytest.fixture(scope="module")
def twin(dynamics: ReducedDynamics) -> CasadiTwin:
    return CasadiTwin(dynamics)


def unusual_state(dynamics: ReducedDynamics, rng: np.random.Generator, kind: str) -> np.ndarray:
    x = random_state(dynamics, rng)
    if kind == "fast spin":
        spin = x[10 + dynamics.nu : 13 + dynamics.nu]
        spin *= 40.0 / np.linalg.norm(spin)  # 1.6 rad a step
    elif kind == "upside down":
        x[3:7] = [1e-3, 1.0, 2e-3, -1e-3]
    elif kind == "quaternion not normalised":
        x[3:7] *= rng.choice([-3.0, 0.2])
    elif kind == "nearly at rest":
        x[7:] *= 1e-3
    return x


def assert_close(value: np.ndarray, truth: np.ndarray, tolerance: float) -> None:
    """Each row (a component of the next state) relative to its largest entry, or a millionth of all."""
    scale = np.maximum(np.abs(truth).max(axis=1, keepdims=True), 1e-6 * np.abs(truth).max())
    assert (np.abs(value - truth) / scale).max() <= tolerance


def assert_equal_twin(dynamics: ReducedDynamics, twin: CasadiTwin, x, u, tolerance=1e-10) -> None:
    x_next, info = dynamics.step_info(x, u)
    assert not info.failed
    truth = twin.refine(x, u, x_next, info.division)
    np.testing.assert_allclose(x_next, truth, rtol=tolerance, atol=tolerance * np.abs(truth).max())
    for value, wanted in zip(
        dynamics.step_jacobian(x, u, x_next),
        twin.jacobians(x, u, x_next, info.division),
        strict=True,
    ):
        assert_close(value, wanted, tolerance)


KINDS = ["any", "fast spin", "upside down", "quaternion not normalised", "nearly at rest"]


@pytest.mark.parametrize("kind", KINDS)
def test_step_and_derivatives_equal_the_symbolic_twin(dynamics, twin, kind):
    rng = np.random.default_rng(KINDS.index(kind))
    for _ in range(2):
        x = unusual_state(dynamics, rng, kind)
        u = rng.uniform(-dynamics.body.amplitude, dynamics.body.amplitude)
        assert_equal_twin(dynamics, twin, x, u)


@pytest.mark.parametrize("stepping", STEPPINGS, ids=lambda s: f"{s[0]}-{s[1]}")
def test_both_integrators_with_any_substeps_equal_the_symbolic_twin(stepping):
    rng = np.random.default_rng(11)
    body = synthetic_body(rng, 3, 7, 5, 6, EVERY_FORCE)
    dynamics = ReducedDynamics(body, 0.04, substeps=stepping[1], integrator=stepping[0])
    twin = CasadiTwin(dynamics)
    for _ in range(4):
        x, u = random_state(dynamics, rng), rng.uniform(-1, 1, dynamics.nu)
        assert_equal_twin(dynamics, twin, x, u)


@pytest.mark.parametrize("sizes", SIZES, ids=str)
def test_bodies_of_any_size_equal_the_symbolic_twin(sizes):
    rng = np.random.default_rng(sizes)
    modes, basis, samples, patches = sizes
    body = synthetic_body(rng, modes, basis, samples, patches, EVERY_FORCE)
    dynamics = ReducedDynamics(body, timestep=0.02)
    twin = CasadiTwin(dynamics)
    for _ in range(3):
        x, u = random_state(dynamics, rng), rng.uniform(-1, 1, dynamics.nu)
        assert_equal_twin(dynamics, twin, x, u)


def test_a_divided_step_is_one_with_more_substeps_and_equals_the_twin(dynamics, twin):
    """Fast vibrations and targets that jump: steps without a solution near the free motion."""
    rng, divisions, compared = np.random.default_rng(12), set(), 0
    body, h, substeps = dynamics.body, dynamics.timestep, dynamics.substeps
    for i in range(100):
        x = random_state(dynamics, rng, spin=8.0, vibration=25.0 if i % 4 else 100.0)
        u = rng.choice([-1.0, 1.0], dynamics.nu) * body.amplitude
        x_next, info = dynamics.step_info(x, u)
        assert not info.failed
        if info.division == 1:
            continue
        divisions.add(info.division)
        finer = ReducedDynamics(body, h, substeps=substeps * info.division)
        again, whole = finer.step_info(x, u)
        assert whole.division == 1
        np.testing.assert_allclose(x_next, again, rtol=1e-12, atol=1e-12)
        a, b = dynamics.step_jacobian(x, u, x_next)
        for value, wanted in zip((a, b), finer.step_jacobian(x, u, again), strict=True):
            assert_close(value, wanted, 1e-9)
        g = rng.normal(size=dynamics.nx)
        gx, gu = dynamics.step_adjoint(x, u, x_next, g)
        np.testing.assert_allclose(gx, a.T @ g, rtol=0, atol=1e-12 * np.abs(a.T @ g).max())
        np.testing.assert_allclose(gu, b.T @ g, rtol=0, atol=1e-12 * np.abs(b.T @ g).max())
        if info.division == 2 and compared < 2:
            assert_equal_twin(dynamics, twin, x, u)
            compared += 1
    assert compared == 2 and len(divisions) > 1


def test_derivatives_of_a_divided_step_equal_finite_differences(small_fish):
    dynamics = ReducedDynamics(in_medium(small_fish, EVERY_FORCE), tolerance=1e-10)
    rng, compared = np.random.default_rng(13), 0
    while compared < 3:
        x = random_state(dynamics, rng, vibration=25.0)
        u = rng.choice([-1.0, 1.0], dynamics.nu) * dynamics.body.amplitude
        x_next, info = dynamics.step_info(x, u)
        # differences across a change of the division are none
        around = [*(x + 1e-4 * rng.normal(size=(20, len(x))))]
        if info.division == 1 or any(
            dynamics.step_info(y, u)[1].division != info.division for y in around
        ):
            continue
        a, b = dynamics.step_jacobian(x, u, x_next)
        assert_close(a, central_differences(partial(dynamics.step, u=u), x, 1e-5), 1e-6)
        assert_close(b, central_differences(partial(dynamics.step, x), u, 1e-5), 1e-6)
        compared += 1


@pytest.mark.parametrize("medium", [EVERY_FORCE, VACUUM], ids=lambda medium: medium.name)
def test_derivatives_equal_finite_differences(small_fish, medium):
    dynamics = ReducedDynamics(in_medium(small_fish, medium), tolerance=1e-10)
    rng = np.random.default_rng(0)
    for _ in range(3):
        x, u = random_state(dynamics, rng, spin=5.0), rng.uniform(-1, 1, dynamics.nu)
        a, b = dynamics.step_jacobian(x, u, dynamics.step(x, u))
        eps = 1e-5
        for jacobian, at, step in (
            (a, x, lambda value, u=u: dynamics.step(value, u)),
            (b, u, lambda value, x=x: dynamics.step(x, value)),
        ):
            assert_close(jacobian, central_differences(step, at, eps), 1e-6)


def test_derivatives_at_rest_equal_finite_differences(small_fish):
    dynamics = ReducedDynamics(small_fish, tolerance=1e-10)
    x, u = dynamics.rest_state(), np.zeros(dynamics.nu)
    a, _ = dynamics.step_jacobian(x, u, dynamics.step(x, u))
    # across zero speed the drag's second derivative has a kink: first order only
    wanted = central_differences(lambda value: dynamics.step(value, u), x, 1e-6)
    np.testing.assert_allclose(a, wanted, atol=1e-4 * np.abs(a).max())


def test_adjoint_is_the_transposed_jacobian(dynamics):
    rng = np.random.default_rng(3)
    for _ in range(20):
        x, u = random_state(dynamics, rng, spin=10.0), rng.uniform(-1, 1, dynamics.nu)
        x_next = dynamics.step(x, u)
        a, b = dynamics.step_jacobian(x, u, x_next)
        g = rng.normal(size=dynamics.nx)
        gx, gu = dynamics.step_adjoint(x, u, x_next, g)
        np.testing.assert_allclose(gx, a.T @ g, rtol=0, atol=1e-12 * np.abs(a.T @ g).max())
        np.testing.assert_allclose(gu, b.T @ g, rtol=0, atol=1e-12 * np.abs(b.T @ g).max())


def test_adjoint_of_a_rollout_chains_the_jacobians_of_its_steps(dynamics):
    rng = np.random.default_rng(4)
    n, r = 15, dynamics.nu
    x0, u = random_state(dynamics, rng), rng.uniform(-1, 1, (n, r))
    states = dynamics.rollout(x0, u)
    partial = rng.normal(size=states.shape)
    g, gu = partial[-1], np.empty((n, r))
    for i in reversed(range(n)):
        a, b = dynamics.step_jacobian(states[i], u[i], states[i + 1])
        gu[i], g = b.T @ g, partial[i] + a.T @ g
    g0, value = dynamics.rollout_adjoint(u, states, partial)
    np.testing.assert_allclose(g0, g, rtol=0, atol=1e-11 * np.abs(g).max())
    np.testing.assert_allclose(value, gu, rtol=0, atol=1e-11 * np.abs(gu).max())
