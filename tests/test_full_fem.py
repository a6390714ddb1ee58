"""The full FEM: conservation, exact linear limits, drag by hand, and the pull towards a shape."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from body_meshes import FISH, bar, unreduced_body
from scipy.linalg import polar as scipy_polar
from scipy.optimize import brentq

from defplan_mj.body.model import Material, Medium
from defplan_mj.body.rotation_strain import exponential
from defplan_mj.dynamics.corotational import polar
from defplan_mj.dynamics.full_fem import FullFem, _Step
from defplan_mj.errors import DefplanError

LOOSE = Material(damping=0.0, control_stiffness=0.0)
H = 0.01


@pytest.fixture(scope="module")
def body():
    return unreduced_body(bar((8, 2, 2), (1.0, 0.2, 0.15)), modes=4, material=LOOSE)


def _bent(fem, rng):
    """A bent, turned and moving start."""
    x1 = fem.shape(np.array([0.8, -0.4, 0.3, 0.2])) @ exponential(np.array([0.3, 0.5, -0.2])).T
    return x1, x1 - H * (np.array([0.4, -0.2, 0.1]) + 0.02 * rng.normal(size=x1.shape))


def test_polar_decomposition_agrees_with_scipy():
    rng = np.random.default_rng(0)
    f = np.eye(3) + 0.3 * rng.normal(size=(30, 3, 3))
    f[0] = f[0][:, [1, 0, 2]]  # one turned inside out
    r, s = polar(f)
    np.testing.assert_allclose(r @ s, f, atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(r), 1.0)
    for i in np.flatnonzero(np.linalg.det(f) > 0):
        np.testing.assert_allclose(r[i], scipy_polar(f[i])[0], atol=1e-10)


def test_gradient_and_hessian_are_the_derivatives_of_the_energy(body):
    rng = np.random.default_rng(1)
    strong = dataclasses.replace(body, material=Material())
    fem = FullFem(strong, H)
    x1, x0 = _bent(fem, rng)
    step = _Step(fem, x1, x0, np.array([-0.6, 0.5, 0.1, 0.4]))
    x = x1 + 1e-3 * rng.normal(size=x1.shape)
    point = step.evaluate(x)
    hessian = step.hessian(point)
    for _ in range(3):
        d = rng.normal(size=x.shape)
        up, down = (step.evaluate(x + s * 1e-6 * d) for s in (1, -1))
        slope = (point.gradient * d).sum()
        assert (up.energy - down.energy) / 2e-6 == pytest.approx(slope, rel=1e-6)
        curve = (up.gradient - down.gradient) / 2e-6
        size = np.abs(curve).max()
        np.testing.assert_allclose((hessian @ d.ravel()).reshape(-1, 3), curve, atol=1e-6 * size)
    assert np.linalg.eigvalsh(step.hessian(point, definite=True).toarray()).min() > 0.0
    assert abs(hessian - hessian.T).max() < 1e-12 * abs(hessian).max()


def test_momentum_is_kept_and_energy_never_grows_without_a_medium(body):
    fem = FullFem(body, H, drag=False, tolerance=1e-10)
    before, now = _bent(fem, np.random.default_rng(3))[::-1]
    start = fem.energy(now, before)
    total = start["kinetic"] + start["elastic"]
    for _ in range(8):
        now, before = fem.step(now, before), now
        state = fem.energy(now, before)
        np.testing.assert_allclose(state["momentum"], start["momentum"], atol=1e-11 * body.mass)
        assert state["kinetic"] + state["elastic"] <= total
        total = state["kinetic"] + state["elastic"]


def test_energy_never_grows_in_the_medium_with_damping_and_a_held_rest_shape(body):
    medium = Medium(gravity=0.0, righting_height=0.0)
    held = dataclasses.replace(body, material=Material(), medium=medium)
    fem = FullFem(held, 0.04)
    before, now = _bent(fem, np.random.default_rng(4))[::-1]
    total = np.inf
    for _ in range(6):
        state = fem.energy(now, before)
        # under a zero target the pull is the elastic energy again, control_stiffness times
        energy = state["kinetic"] + (1 + held.material.control_stiffness) * state["elastic"]
        assert energy <= total
        total = energy
        now, before = fem.step(now, before, np.zeros(4)), now


def test_rigid_motion_costs_no_elastic_energy(body):
    fem = FullFem(body, H)
    x = body.vertices @ exponential(np.array([1.0, 2.0, -0.5])).T + [3.0, 0.0, 1.0]
    assert fem.energy(x, x)["elastic"] == pytest.approx(0.0, abs=1e-15)


def test_a_small_mode_follows_the_exact_implicit_euler_recursion(body):
    fem = FullFem(body, H, drag=False, tolerance=1e-13)
    for mode in (0, 3):
        size = 1e-6
        before = now = body.vertices + size * body.modes[:, :, mode]
        old = new = 1.0
        square = (2 * np.pi * body.frequencies[mode]) ** 2
        weight = body.modes[:, :, mode] * body.vertex_mass[:, None]
        for _ in range(12):
            now, before = fem.step(now, before), now
            old, new = new, (2.0 * new - old) / (1.0 + H**2 * square)
            q = (weight * (now - body.vertices)).sum() / (weight * body.modes[:, :, mode]).sum()
            assert q / size == pytest.approx(new, abs=1e-4)


def test_damping_and_target_follow_their_recursion_too(body):
    material = Material(damping=0.02, control_stiffness=4.0)
    fem = FullFem(dataclasses.replace(body, material=material), H, drag=False, tolerance=1e-13)
    now = before = body.vertices
    target = 1e-6 * np.array([1.0, 0.0, 0.0, 0.0])
    weight = body.modes[:, :, 0] * body.vertex_mass[:, None]
    mass = (weight * body.modes[:, :, 0]).sum()
    stiffness = body.stiffness[0]
    old = new = 0.0
    for _ in range(10):
        now, before = fem.step(now, before, target), now
        # M (q - 2 q1 + q0) / h^2 + K q + 4 K (q - u) + 0.02 K (q - q1) / h = 0
        top = mass * (2 * new - old) / H**2 + stiffness * (4.0 * 1e-6 + 2.0 * new)
        old, new = new, top / (mass / H**2 + stiffness * (1.0 + 4.0 + 2.0))
        q = (weight * (now - body.vertices)).sum() / mass
        assert q == pytest.approx(new, abs=1e-10)


def test_a_held_target_settles_at_its_share_of_the_strain():
    material = Material(damping=0.05, control_stiffness=4.0)
    slender = unreduced_body(bar((16, 2, 2), (1.0, 0.08, 0.08)), modes=2, material=material)
    fem = FullFem(slender, 0.1, drag=False)
    target = np.array([1.0, 0.0])
    now = before = slender.vertices
    for _ in range(25):
        now, before = fem.step(now, before, target), now
    expected = fem.shape(0.8 * target)  # k_c / (1 + k_c)
    np.testing.assert_allclose(
        np.linalg.norm(now[-1] - now[0]), np.linalg.norm(expected[-1] - expected[0]), rtol=0.01
    )


def test_drag_on_a_box_is_the_formula():
    # stiff enough to stay a box: M (v1 - v0) / h = -rho Cd A v1^2 (front and back) - skin friction
    stiff = Material(youngs_modulus=1e12, control_stiffness=0.0, damping=0.0)
    medium = Medium(density=900.0, drag_normal=1.3, drag_tangential=0.05, righting_height=0.0)
    box = unreduced_body(bar((2, 2, 2), (0.5, 0.3, 0.2)), 1, stiff, medium)
    fem = FullFem(box, 0.02, tolerance=1e-11)
    v0 = 2.0
    now = fem.step(box.vertices, box.vertices - [0.02 * v0, 0.0, 0.0])
    front, all_sides = 0.3 * 0.2, 2 * (0.3 * 0.2 + 0.5 * 0.2 + 0.5 * 0.3)

    def balance(v):
        pressure = 900.0 * 1.3 * front * v * abs(v)
        skin = 0.5 * 900.0 * 0.05 * all_sides * np.sqrt(v * v + 1e-4) * v
        return box.mass * (v - v0) / 0.02 + pressure + skin

    velocity = fem.energy(now, box.vertices)["momentum"] / box.mass
    np.testing.assert_allclose(velocity, [brentq(balance, 0, 2), 0, 0], rtol=1e-6, atol=1e-6)


def test_gravity_and_righting_act_as_a_force_and_a_moment(body):
    medium = Medium(density=1e-9, gravity=-2.0, righting_height=0.05)
    fem = FullFem(dataclasses.replace(body, medium=medium), 1e-3, tolerance=1e-13)
    angle = 0.3  # rolled about x
    x = body.vertices @ exponential(np.array([angle, 0.0, 0.0])).T
    now = fem.step(x, x)
    state = fem.energy(now, x)
    expected = body.mass * -2.0 * 1e-3
    np.testing.assert_allclose(state["momentum"], [0, 0, expected], rtol=1e-4, atol=1e-9)
    # moment M g D sin(angle) about -x, which brings the body's z axis back up
    spin = -body.mass * 9.81 * 0.05 * np.sin(angle) * 1e-3
    np.testing.assert_allclose(state["angular_momentum"], [spin, 0, 0], rtol=1e-3, atol=1e-6)


def test_rollout_is_steps_one_after_another(body):
    fem = FullFem(dataclasses.replace(body, material=Material()), 0.04)
    targets = np.array([[0.5, 0, 0, 0], [0, 0.3, 0, 0]])
    states = fem.rollout(body.vertices, body.vertices, targets)
    first = fem.step(body.vertices, body.vertices, targets[0])
    np.testing.assert_array_equal(states[1], first)
    np.testing.assert_array_equal(states[2], fem.step(first, body.vertices, targets[1]))


def test_a_solve_that_fails_is_said(body):
    fem = FullFem(body, H, max_newton=1)
    x1, x0 = _bent(fem, np.random.default_rng(5))
    with pytest.raises(DefplanError, match="did not converge in 1"):
        fem.step(x1, x0)


def test_a_target_of_the_wrong_size_is_refused(body):
    with pytest.raises(DefplanError, match=r"shape \(3,\), wanted \(4,\)"):
        FullFem(body, H).step(body.vertices, body.vertices, np.zeros(3))


@pytest.mark.slow
def test_a_released_bent_fish_is_followed_by_the_reduced_step_within_3_percent():
    from defplan_mj.body.build import build_body
    from defplan_mj.body.check import released_shape_error
    from defplan_mj.task import BodyOptions

    fish = build_body(FISH, BodyOptions(vertices=2118))
    assert released_shape_error(fish)["relative"] < 0.03
    # and swinging freely, where nothing damps the modes that the reduction leaves out
    loose = dataclasses.replace(
        fish, material=LOOSE, medium=Medium(density=0.0, righting_height=0.0)
    )
    assert released_shape_error(loose, timestep=0.01, duration=0.4)["relative"] < 0.03
