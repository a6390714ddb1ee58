"""What the reduced step must keep: momentum, energy, symmetry, convergence, and the full FEM's motion."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from kernel_cases import (
    EVERY_FORCE,
    VACUUM,
    in_medium,
    matrix,
    product,
    random_quaternion,
    random_state,
)

from defplan_mj.body.model import Body, Medium
from defplan_mj.dynamics.full_fem import FullFem
from defplan_mj.dynamics.reduced import ReducedDynamics

WATER_WITHOUT_RIGHTING = Medium(righting_height=0.0)
HEAVY = Medium(name="heavy", density=0.0, gravity=-3.0)


def turned(x: np.ndarray, quat: np.ndarray, r: int) -> np.ndarray:
    """The state x seen in a world turned by `quat`."""
    rotation, out = matrix(quat), x.copy()
    out[:3] = rotation @ x[:3]
    out[3:7] = product(quat, x[3:7])
    out[7 + r : 10 + r] = rotation @ x[7 + r : 10 + r]
    return out


def test_linear_momentum_is_kept_without_drag(small_fish):
    dynamics = ReducedDynamics(in_medium(small_fish, VACUUM))
    rng = np.random.default_rng(0)
    for _ in range(5):
        u = rng.uniform(-1.5, 1.5, (250, dynamics.nu))
        states = dynamics.rollout(random_state(dynamics, rng, spin=5.0), u)
        momentum = np.array([dynamics.energy(x)["momentum"] for x in states])
        drift = np.abs(momentum - momentum[0]).max() / np.linalg.norm(momentum[0])
        assert drift <= 1e-12


@pytest.mark.parametrize(
    "medium",
    [VACUUM, Medium(), EVERY_FORCE, HEAVY],
    ids=["vacuum", "water", "every force", "heavy"],
)
def test_energy_never_grows_without_input(small_fish, medium):
    body = in_medium(small_fish, medium)
    control = (
        body.material.control_stiffness
    )  # holds the body at u = 0: a spring like the elastic one
    rng = np.random.default_rng(1)
    for timestep in (0.01, 0.04, 0.1):
        for spin in (1.0, 10.0, 30.0):
            dynamics = ReducedDynamics(body, timestep)
            x0 = random_state(dynamics, rng, spin, speed=2.0, vibration=5.0)
            states = dynamics.rollout(x0, np.zeros((150, dynamics.nu)))
            parts = [dynamics.energy(x) for x in states]
            total = np.array(
                [e["kinetic"] + (1 + control) * e["elastic"] + e["potential"] for e in parts]
            )
            largest = np.abs([[e["kinetic"], e["elastic"], e["potential"]] for e in parts]).max()
            assert np.diff(total).max() <= 1e-9 * largest


def test_angular_momentum_converges_with_the_time_step(small_fish):
    """Implicit Euler loses it at first order: half the step, half the loss."""
    body = in_medium(small_fish, VACUUM)
    body = replace(body, material=replace(body.material, damping=0.0))
    losses = []
    for timestep in (0.02, 0.01, 0.005, 0.0025):
        dynamics = ReducedDynamics(body, timestep)
        x0 = dynamics.rest_state()
        x0[-dynamics.nu - 3 : -dynamics.nu] = [0.5, -0.8, 0.6]  # rad/s
        states = dynamics.rollout(x0, np.zeros((round(1 / timestep), dynamics.nu)))
        first, last = (dynamics.energy(x)["angular_momentum"] for x in (states[0], states[-1]))
        losses.append(np.linalg.norm(last - first) / np.linalg.norm(first))
    ratios = np.array(losses[:-1]) / losses[1:]
    assert losses[-1] < 5e-3
    np.testing.assert_allclose(ratios, 2.0, atol=0.05)


def released(
    body: Body, shape: np.ndarray, steps: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Return surface paths of f reduced and f, (steps, n_s, 3), their masses, the bend's size."""
    full = FullFem(body, drag=body.medium.density > 0, integrator="implicit-euler", substeps=1)
    dynamics = ReducedDynamics(body)
    x0 = dynamics.rest_state()
    x0[7 : 7 + dynamics.nu] = shape
    target = np.zeros((steps, dynamics.nu))
    reduced = [dynamics.surface(x) for x in dynamics.rollout(x0, target)[1:]]
    start = full.at(shape, target=target[0])
    bent = start.now
    truth = np.array([state.now[body.surface] for state in full.rollout(start, target)[1:]])
    mass = body.vertex_mass[body.surface, None]
    bend = np.sqrt((mass * (bent - body.vertices)[body.surface] ** 2).sum())
    return np.array(reduced), truth, mass, float(bend)


SHAPES = np.array([[1.0, 0.0, 0.0, 0.0, 0.0], [0.6, -0.4, 0.5, 0.2, -0.3]])


@pytest.mark.parametrize("shape", SHAPES, ids=["bend", "mixed"])
def test_a_released_bent_fish_follows_the_full_fem(small_fish, shape):
    free = replace(small_fish.material, control_stiffness=0.0)
    reduced, truth, mass, bend = released(in_medium(small_fish, VACUUM, free), shape, 25)
    error = np.sqrt((mass * (reduced - truth) ** 2).sum((1, 2))) / bend
    assert error.max() <= 0.03


@pytest.mark.parametrize("shape", SHAPES, ids=["bend", "mixed"])
def test_a_fish_released_in_water_has_the_shape_and_path_of_the_full_fem(small_fish, shape):
    """Attitude is left out: nothing but friction resists slow turning, so small torques add up."""
    reduced, truth, mass, bend = released(in_medium(small_fish, WATER_WITHOUT_RIGHTING), shape, 25)
    for value, wanted in zip(reduced, truth, strict=True):
        centre, wanted_centre = ((mass * p).sum(0) / mass.sum() for p in (value, wanted))
        value, wanted = value - centre, wanted - wanted_centre
        left, _, right = np.linalg.svd((mass * value).T @ wanted)
        aligned = value @ (left @ right)
        assert np.sqrt((mass * (aligned - wanted) ** 2).sum()) <= 0.03 * bend
        assert np.linalg.norm(centre - wanted_centre) <= 0.01 * small_fish.length


@pytest.mark.slow
@pytest.mark.parametrize("shape", SHAPES, ids=["bend", "mixed"])
def test_the_released_fish_of_full_size_follows_the_full_fem(fish, shape):
    free = replace(fish.material, control_stiffness=0.0)
    reduced, truth, mass, bend = released(in_medium(fish, VACUUM, free), shape, 12)
    error = np.sqrt((mass * (reduced - truth) ** 2).sum((1, 2))) / bend
    assert error.max() <= 0.01


def shake(dynamics: ReducedDynamics, steps: int, seed: int) -> None:
    """Run `steps` steps under random target shapes from random attitudes; every solve must succeed."""
    rng, run, r = np.random.default_rng(seed), 1000, dynamics.nu
    for k in range(steps // run):
        x0 = random_state(dynamics, rng, spin=5.0)
        noise, jumps = rng.uniform(-1, 1, (run, r)), rng.choice([-1.0, 1.0], (run, r))
        held = np.repeat(rng.choice([-1.0, 1.0], (run // 20, r)), 20, axis=0)
        u = (noise, jumps, held)[k % 3] * dynamics.body.amplitude
        states, failed = dynamics.rollout_count(x0, u)
        assert failed == 0
        assert np.isfinite(states).all()
        np.testing.assert_allclose(np.linalg.norm(states[:, 3:7], axis=1), 1.0, rtol=1e-12)


def test_no_solve_fails_under_random_target_shapes(small_fish):
    for seed, medium in enumerate((Medium(), EVERY_FORCE, VACUUM)):
        shake(ReducedDynamics(in_medium(small_fish, medium)), 7000, seed)


@pytest.mark.slow
def test_a_million_steps_under_random_target_shapes_never_fail(fish):
    shake(ReducedDynamics(fish), 1_000_000, 0)


@pytest.mark.parametrize("medium", [VACUUM, WATER_WITHOUT_RIGHTING], ids=["vacuum", "water"])
def test_turning_the_world_turns_the_motion(small_fish, medium):
    dynamics = ReducedDynamics(in_medium(small_fish, medium))
    rng = np.random.default_rng(2)
    for _ in range(5):
        x0, quat = random_state(dynamics, rng), random_quaternion(rng)
        u = rng.uniform(-1, 1, (25, dynamics.nu))
        wanted = [turned(x, quat, dynamics.nu) for x in dynamics.rollout(x0, u)]
        value = dynamics.rollout(turned(x0, quat, dynamics.nu), u)
        np.testing.assert_allclose(value, wanted, atol=1e-9)


def test_with_gravity_and_righting_only_turning_about_the_vertical_turns_the_motion(small_fish):
    dynamics = ReducedDynamics(in_medium(small_fish, EVERY_FORCE))
    rng = np.random.default_rng(3)
    x0, u = random_state(dynamics, rng), rng.uniform(-1, 1, (25, dynamics.nu))
    states = dynamics.rollout(x0, u)
    yaw, roll = (
        np.array([np.cos(1.0), 0, 0, np.sin(1.0)]),
        np.array([np.cos(1.0), np.sin(1.0), 0, 0]),
    )
    wanted = [turned(x, yaw, dynamics.nu) for x in states]
    np.testing.assert_allclose(dynamics.rollout(wanted[0], u), wanted, atol=1e-9)
    rolled = [turned(x, roll, dynamics.nu) for x in states]
    assert np.abs(dynamics.rollout(rolled[0], u)[-1] - rolled[-1]).max() > 1e-2


def test_the_righting_moment_brings_any_attitude_upright(small_fish):
    dynamics = ReducedDynamics(small_fish)
    rng = np.random.default_rng(4)
    for _ in range(4):
        x0 = dynamics.rest_state()
        x0[3:7] = random_quaternion(rng)
        last = dynamics.rollout(x0, np.zeros((1500, dynamics.nu)))[-1]
        assert matrix(last[3:7])[2, 2] > np.cos(np.radians(5))


def test_the_sign_and_size_of_the_quaternion_do_not_matter(small_fish):
    dynamics = ReducedDynamics(in_medium(small_fish, EVERY_FORCE))
    rng = np.random.default_rng(5)
    x, u = random_state(dynamics, rng), rng.uniform(-1, 1, dynamics.nu)
    wanted = dynamics.step(x, u)
    for factor in (2.5, -1.0):
        other = x.copy()
        other[3:7] *= factor
        value = dynamics.step(other, u)
        value[3:7] *= np.sign(factor)
        np.testing.assert_allclose(value, wanted, rtol=1e-12, atol=1e-12)


def test_rollouts_in_threads_are_those_of_one_thread_to_the_bit(small_fish):
    dynamics = ReducedDynamics(small_fish)
    rng = np.random.default_rng(6)
    jobs = [(random_state(dynamics, rng), rng.uniform(-1, 1, (60, dynamics.nu))) for _ in range(12)]
    alone = [dynamics.rollout(*job) for job in jobs]
    with ThreadPoolExecutor(3) as pool:
        together = list(pool.map(lambda job: dynamics.rollout(*job), jobs))
    for value, wanted in zip(together, alone, strict=True):
        np.testing.assert_array_equal(value, wanted)


def test_a_rollout_is_its_single_steps_to_the_bit_and_goes_on_from_any_saved_state(small_fish):
    dynamics = ReducedDynamics(small_fish)
    rng = np.random.default_rng(7)
    u = rng.uniform(-1, 1, (40, dynamics.nu))
    states = dynamics.rollout(random_state(dynamics, rng), u)
    for i in range(len(u)):
        np.testing.assert_array_equal(dynamics.step(states[i], u[i]), states[i + 1])
    np.testing.assert_array_equal(dynamics.rollout(states[17], u[17:]), states[17:])
