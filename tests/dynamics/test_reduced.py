"""ReducedDynamics: its measures against sums over vertices, its sizes, its errors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm

from defplan_mj.base.errors import DefplanError
from defplan_mj.body.model import Body
from defplan_mj.dynamics.reduced import ReducedDynamics
from defplan_mj.dynamics.terrain import Terrain
from tests.samples.kernel_cases import EVERY_FORCE, in_medium, matrix, random_state


@pytest.fixture(scope="module")
def dynamics(small_fish: Body) -> ReducedDynamics:
    return ReducedDynamics(in_medium(small_fish, EVERY_FORCE))


def skew(w: np.ndarray) -> np.ndarray:
    return np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]])


def displacement(body: Body, q: np.ndarray) -> np.ndarray:
    """The body's own definition, in numpy: basis C vec(exp([w]) (I + E) - I)."""
    features = []
    for x in body.feature_map @ q:
        strain = x[[3, 4, 5, 4, 6, 7, 5, 7, 8]].reshape(3, 3)
        features.append((expm(skew(x[:3])) @ (np.eye(3) + strain) - np.eye(3)).ravel())
    return body.basis @ (body.feature_weights @ np.concatenate(features))


def vertices(body: Body, c: np.ndarray, rotation: np.ndarray, q: np.ndarray) -> np.ndarray:
    return c + (body.vertices + displacement(body, q)) @ rotation.T


def two_configurations(dynamics: ReducedDynamics, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Vertices at x and one substep before, from the state's velocities."""
    body, h, r = dynamics.body, dynamics.timestep / dynamics.substeps, dynamics.nu
    c, q, v, rotation = x[:3], x[7 : 7 + r], x[7 + r :], matrix(x[3:7])
    before = rotation @ expm(-h * skew(v[3:6]))
    return vertices(body, c, rotation, q), vertices(
        body, c - h * v[:3], before, q - h * v[6 : 6 + r]
    )


def test_surface_is_the_reduced_displacement_placed_in_the_world(dynamics):
    rng = np.random.default_rng(0)
    for _ in range(5):
        x = random_state(dynamics, rng)
        wanted = two_configurations(dynamics, x)[0][dynamics.body.surface]
        np.testing.assert_allclose(dynamics.surface(x), wanted, atol=1e-12)


@pytest.mark.parametrize("integrator", ["variational", "implicit-euler"])
def test_energies_and_momenta_are_those_of_the_vertices(dynamics, integrator):
    """The variational step has its elastic energy at the middle of an interval, potentials at both ends."""
    dynamics = ReducedDynamics(dynamics.body, substeps=3, integrator=integrator)
    rng, body, r = np.random.default_rng(1), dynamics.body, dynamics.nu
    mass, h = body.vertex_mass, dynamics.timestep / 3
    for _ in range(5):
        x = random_state(dynamics, rng)
        now, before = two_configurations(dynamics, x)
        velocity = (now - before) / h
        value = dynamics.energy(x)
        q, z, tilt = x[7 : 7 + r], x[2], 1 - matrix(x[3:7])[2, 2]
        if integrator == "variational":
            q = q - 0.5 * h * x[13 + r : 13 + 2 * r]
            z -= 0.5 * h * x[9 + r]
            back = matrix(x[3:7]) @ expm(-h * skew(x[10 + r : 13 + r]))
            tilt = 0.5 * (tilt + 1 - back[2, 2])
        height = body.mass * (9.81 * body.medium.righting_height * tilt - body.medium.gravity * z)
        wanted = {
            "kinetic": 0.5 * mass @ (velocity**2).sum(1),
            "elastic": 0.5 * body.stiffness @ q**2,
            "potential": height,
            "momentum": mass @ velocity,
            "angular_momentum": mass @ np.cross(now, velocity),
        }
        for name, number in wanted.items():
            np.testing.assert_allclose(
                value[name], number, rtol=1e-9, atol=1e-9 * np.abs(number).max(), err_msg=name
            )


def test_the_first_step_from_rest_towards_a_shape_moves_towards_it(small_fish):
    dynamics = ReducedDynamics(small_fish)
    r = dynamics.nu
    for i in range(r):
        target = 0.5 * np.eye(r)[i]
        q = dynamics.step(dynamics.rest_state(), target)[7 : 7 + r]
        assert 0 < q[i] < 0.5
        assert abs(q[i]) == np.abs(q).max()


def test_a_held_target_shape_is_reached_up_to_the_bodys_own_stiffness(small_fish):
    """At rest K q + k_c K (q - u) = 0."""
    dynamics = ReducedDynamics(small_fish)
    u = np.array([0.4, -0.3, 0.2, 0.1, -0.2])
    x = dynamics.rollout(dynamics.rest_state(), np.tile(u, (1500, 1)))[-1]
    control = small_fish.material.control_stiffness
    np.testing.assert_allclose(x[7 : 7 + dynamics.nu], control / (1 + control) * u, atol=1e-3)


def test_the_rest_state_stays_at_rest(small_fish):
    dynamics = ReducedDynamics(small_fish)
    x = dynamics.rollout(dynamics.rest_state(), np.zeros((100, dynamics.nu)))[-1]
    np.testing.assert_allclose(x, dynamics.rest_state(), atol=1e-12)


def test_any_memory_layout_and_number_type_gives_the_same_rollout(dynamics):
    x0 = dynamics.rest_state()
    u = np.random.default_rng(2).integers(-1, 2, (6, dynamics.nu))
    wanted = dynamics.rollout(x0, u.astype(float))
    np.testing.assert_array_equal(dynamics.rollout(x0.astype(np.float32), u), wanted)
    np.testing.assert_array_equal(dynamics.rollout(x0, np.asfortranarray(u)), wanted)


@pytest.mark.parametrize(
    ("call", "sentence"),
    [
        (lambda d, x: d.step(x[:-1], np.zeros(5)), "the state has shape"),
        (lambda d, x: d.step(x, np.zeros(4)), "the input has shape"),
        (lambda d, x: d.rollout(x, np.zeros((3, 4))), "the inputs have shape"),
        (lambda d, x: d.rollout(x, np.zeros(5)), "the inputs have shape"),
        (lambda d, x: d.step_adjoint(x, np.zeros(5), x, np.zeros(3)), "the state has shape"),
    ],
)
def test_arrays_of_the_wrong_shape_are_refused(dynamics, call, sentence):
    with pytest.raises(DefplanError, match=sentence):
        call(dynamics, dynamics.rest_state())


@pytest.mark.parametrize("body", ["small_fish", "small_walker"])
def test_a_guess_of_the_next_state_saves_iterations_and_changes_nothing(body, request):
    """But the division of a step: from a guess a substep may be solved that has to be divided without."""
    body = request.getfixturevalue(body)
    walks = body.medium.gravity != 0
    dynamics = ReducedDynamics(body, 0.03, Terrain() if walks else None)
    rng = np.random.default_rng(0)
    shapes = 0.5 * body.amplitude * np.sin(np.arange(40)[:, None] / 3 + np.arange(dynamics.nu))
    states = dynamics.rollout(dynamics.rest_state(), shapes)
    plain = good = alike = 0
    for x, u, after in zip(states, shapes, states[1:], strict=False):
        without = dynamics.step_info(x, u)[1]
        if without.division > 1:
            continue
        plain += without.iterations
        found, info = dynamics.step_info(x, u, after)
        good += info.iterations
        np.testing.assert_allclose(found, after, atol=1e-6)
        for size in (1e-3, 0.1):  # good, bad
            guess = after + size * rng.normal(size=dynamics.nx)
            found, info = dynamics.step_info(x, u, guess)
            assert not info.failed and info.division == 1
            np.testing.assert_allclose(found, after, atol=1e-5)
            alike += 1
    assert good < 0.3 * plain
    assert alike > 60


def test_a_rollout_that_cannot_be_solved_is_an_error_and_stays_finite_where_it_was_asked_to(
    dynamics,
):
    hurried = ReducedDynamics(dynamics.body, max_newton=1, tolerance=1e-30)
    states, failed = hurried.rollout_count(hurried.rest_state(), np.ones((4, 5)))
    assert failed == 4
    assert np.isfinite(states).all()
    with pytest.raises(DefplanError, match="4 of 4 reduced steps did not converge"):
        hurried.rollout(hurried.rest_state(), np.ones((4, 5)))


def test_a_body_too_large_for_the_kernel_is_refused(small_fish):
    k = small_fish.n_basis
    many = replace(
        small_fish,
        drag_points=np.zeros((513, 3, k + 1)),
        drag_tangents=np.ones((2, 513, 3, k + 1)),
        drag_areas=np.ones(513),
    )
    with pytest.raises(DefplanError, match="513 drag points, the kernel takes at most 512"):
        ReducedDynamics(many)


def test_a_basis_that_is_not_mass_orthonormal_is_refused(small_fish):
    moments = small_fish.moments.copy()
    moments[1:, 1:] *= 1.01
    with pytest.raises(DefplanError, match="not mass-orthonormal"):
        ReducedDynamics(replace(small_fish, moments=moments))
