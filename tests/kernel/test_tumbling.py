"""Full turns about any axis, many of them: momentum, equivariance and derivatives at every attitude."""

from __future__ import annotations

import numpy as np
import pytest

from defplan_mj.dynamics.reduced import ReducedDynamics
from tests.samples.casadi_twin import CasadiTwin
from tests.samples.kernel_cases import VACUUM, in_medium, matrix, product, random_quaternion


@pytest.fixture(scope="module")
def dynamics(small_fish) -> ReducedDynamics:
    return ReducedDynamics(in_medium(small_fish, VACUUM), 0.02)


def tumble(dynamics: ReducedDynamics, rng: np.random.Generator, steps: int) -> np.ndarray:
    """A deforming body that spins about a random axis at 12 rad/s and flies."""
    x, r = np.zeros(dynamics.nx), dynamics.nu
    x[3:7], axis = random_quaternion(rng), rng.normal(size=3)
    x[7 + r : 10 + r], x[10 + r : 13 + r] = rng.normal(size=3), 12 * axis / np.linalg.norm(axis)
    return dynamics.rollout(x, 0.3 * rng.uniform(-1, 1, (steps, r)))


def turns(states: np.ndarray) -> float:
    """The angle that the body has turned through, step by step, in full turns."""
    dots = np.abs((states[1:, 3:7] * states[:-1, 3:7]).sum(1))
    return float(2 * np.arccos(np.minimum(dots, 1.0)).sum() / (2 * np.pi))


def test_many_full_turns_about_random_axes_keep_momentum_and_miss_no_attitude(dynamics):
    rng, directions, total = np.random.default_rng(0), [], 0.0
    for _ in range(12):
        states = tumble(dynamics, rng, 300)
        momentum = np.array([dynamics.energy(x)["momentum"] for x in states])
        drift = np.abs(momentum - momentum[0]).max()
        assert drift <= 1e-12 * np.linalg.norm(momentum[0]) * 10
        np.testing.assert_allclose(np.linalg.norm(states[:, 3:7], axis=1), 1.0, rtol=1e-12)
        # no jump: the quaternion goes on smoothly through every half turn
        assert (states[1:, 3:7] * states[:-1, 3:7]).sum(1).min() > 0.9
        directions += [matrix(x[3:7])[:, k] for x in states for k in range(3)]
        total += turns(states)
    assert total > 30
    octants = {tuple(np.sign(d) * (np.abs(d) > 0.4)) for d in np.array(directions)}
    assert len(octants) == 26  # every axis of the body has pointed everywhere


def test_tumbling_looks_the_same_from_any_attitude(dynamics):
    rng, r = np.random.default_rng(2), dynamics.nu
    for _ in range(6):
        states, quat = tumble(dynamics, rng, 60), random_quaternion(rng)
        rotation = matrix(quat)
        start = states[0].copy()
        start[3:7] = product(quat, start[3:7])
        start[7 + r : 10 + r] = rotation @ start[7 + r : 10 + r]
        again = dynamics.rollout(start, np.zeros((60, r)))
        plain = dynamics.rollout(states[0], np.zeros((60, r)))
        np.testing.assert_allclose(again[:, :3], plain[:, :3] @ rotation.T, atol=1e-9)
        np.testing.assert_allclose(again[:, 7 : 7 + r], plain[:, 7 : 7 + r], atol=1e-9)
        wanted = np.array([product(quat, x[3:7]) for x in plain])
        np.testing.assert_allclose(again[:, 3:7], wanted, atol=1e-9)


def test_derivatives_of_a_tumbling_body_equal_the_symbolic_twin_all_the_way_round(dynamics):
    twin, rng = CasadiTwin(dynamics), np.random.default_rng(3)
    for _ in range(3):
        states = tumble(dynamics, rng, 60)
        for x in states[::6]:
            u = 0.3 * rng.uniform(-1, 1, dynamics.nu)
            x_next = dynamics.step(x, u)
            for value, truth in zip(
                dynamics.step_jacobian(x, u, x_next), twin.jacobians(x, u, x_next), strict=True
            ):
                assert np.abs(value - truth).max() <= 1e-10 * np.abs(truth).max()
