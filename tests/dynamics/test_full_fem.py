"""The full FEM: conservation, exact linear limits, drag by hand, and the pull towards a shape."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from scipy.linalg import polar as scipy_polar
from scipy.optimize import brentq

from defplan_mj.base.errors import DefplanError
from defplan_mj.body.corotational import polar
from defplan_mj.body.model import Material, Medium
from defplan_mj.body.rotation_strain import exponential
from defplan_mj.body.sparse_cholesky import SparseCholesky
from defplan_mj.dynamics.fem_contact import FemContact
from defplan_mj.dynamics.fem_step import Touch
from defplan_mj.dynamics.full_fem import FullFem
from defplan_mj.dynamics.terrain import Heightfield, Terrain, TerrainGeom
from tests.samples.meshes import bar, unreduced_body

LOOSE = Material(damping=0.0, control_stiffness=0.0)
H = 0.01
EULER: dict[str, Any] = {"integrator": "implicit-euler", "substeps": 1}
BOTH = pytest.mark.parametrize("integrator", ["variational", "implicit-euler"])


@pytest.fixture(scope="module")
def body():
    return unreduced_body(bar((8, 2, 2), (1.0, 0.2, 0.15)), modes=4, material=LOOSE)


def _bent(fem, rng, target=None):
    """A bent, turned and moving start."""
    noise = 0.02 * rng.normal(size=fem.body.vertices.shape)
    return fem.at(
        np.array([0.8, -0.4, 0.3, 0.2]),
        rotation=exponential(np.array([0.3, 0.5, -0.2])),
        velocity=np.array([0.4, -0.2, 0.1]) + noise,
        target=target,
    )


def test_polar_decomposition_agrees_with_scipy_and_its_spin_turns_it():
    rng = np.random.default_rng(0)
    f = np.eye(3) + 0.3 * rng.normal(size=(30, 3, 3))
    f[0] = f[0][:, [1, 0, 2]]  # one turned inside out
    f[1][:, 2] = f[1][:, 0]  # and a flat one
    both = polar(np.ascontiguousarray(f.transpose(1, 2, 0)))
    r, s = both.rotation.transpose(2, 0, 1), both.stretch.transpose(2, 0, 1)
    np.testing.assert_allclose(r @ s, f, atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(r), 1.0)
    upright = np.flatnonzero(np.linalg.det(f) > 1e-9)
    for i in upright:
        np.testing.assert_allclose(r[i], scipy_polar(f[i])[0], atol=1e-10)
    change = 1e-6 * rng.normal(size=both.stretch.shape)
    up, down = (polar(f.transpose(1, 2, 0) + sign * change).stretch for sign in (1, -1))
    rate = both.strain_rate(change)
    np.testing.assert_allclose((0.5 * (up - down) - rate)[:, :, upright], 0.0, atol=1e-11)


def test_sparse_factor_solves_as_a_dense_one_and_refuses_an_indefinite_matrix(body):
    rng, n = np.random.default_rng(1), len(body.vertices)
    pairs = np.concatenate([body.tetrahedra[:, [a, b]] for a in range(4) for b in range(4)])
    low = np.unique(pairs[pairs[:, 0] >= pairs[:, 1]], axis=0)
    blocks = rng.normal(size=(len(low), 3, 3))
    diagonal = low[:, 0] == low[:, 1]
    blocks[diagonal] += blocks[diagonal].transpose(0, 2, 1) + 60.0 * np.eye(3)
    dense = np.zeros((n, 3, n, 3))
    dense[low[:, 0], :, low[:, 1]] = blocks
    dense[low[:, 1], :, low[:, 0]] = blocks.transpose(0, 2, 1)
    matrix = dense.reshape(3 * n, 3 * n)
    order = SparseCholesky(n, low[:, 0], low[:, 1])
    factor = order.factor(blocks)
    assert factor is not None
    for shape in ((3 * n,), (3 * n, 2), (n, 3)):
        right = rng.normal(size=shape)
        wanted = np.linalg.solve(matrix, right.reshape(3 * n, -1)).reshape(shape)
        np.testing.assert_allclose(factor.solve(right), wanted, atol=1e-12)
    blocks[diagonal] -= 60.0 * np.eye(3)
    assert order.factor(blocks) is None


@BOTH
def test_gradient_and_hessian_are_the_derivatives_of_the_energy(body, integrator):
    rng = np.random.default_rng(1)
    strong = dataclasses.replace(body, material=Material())
    fem = FullFem(strong, H, integrator=integrator, substeps=1)
    state = _bent(fem, rng)
    step, x, end = fem.problem(state, np.array([-0.6, 0.5, 0.1, 0.4]))
    x = x + 1e-3 * rng.normal(size=x.shape)
    scale = 2.0 if integrator == "variational" else 1.0
    # hold contact as it is without damping and friction: then it has a potential
    contact = FemContact(Terrain(friction=0.0, thickness=0.2, damping=0.0), strong)
    touch = Touch(contact, state.now, H, scale)
    step = dataclasses.replace(step, contact=touch)
    np.testing.assert_allclose(touch.end(x), end(x))

    def gradient(x):
        return step.gradient(x, polar(step.elements.deformation(x)), step.hold(x))

    def energy(x):
        return step.energy(x, polar(step.elements.deformation(x)), step.hold(x))

    parts = polar(step.elements.deformation(x))
    hessian = step.matrix(step.blocks(x, parts, step.hold(x)))
    held = step.hold(x)
    assert held is not None and len(held.touching)
    for _ in range(3):
        d = rng.normal(size=x.shape)
        slope = (gradient(x) * d).sum()
        difference = energy(x + 1e-6 * d) - energy(x - 1e-6 * d)
        assert difference / 2e-6 == pytest.approx(slope, rel=1e-6)
        curve = (gradient(x + 1e-6 * d) - gradient(x - 1e-6 * d)) / 2e-6
        size = np.abs(curve).max()
        np.testing.assert_allclose((hessian @ d.ravel()).reshape(-1, 3), curve, atol=1e-6 * size)
    definite = step.matrix(step.blocks(x, parts, step.hold(x), definite=True)).toarray()
    assert np.linalg.eigvalsh(definite).min() > 0.0


def test_momentum_is_kept_and_energy_never_grows_without_a_medium(body):
    fem = FullFem(body, H, drag=False, tolerance=1e-10, **EULER)
    state = _bent(fem, np.random.default_rng(3))
    start = fem.energy(state)
    total = start["kinetic"] + start["elastic"]
    for _ in range(8):
        state = fem.step(state)
        now = fem.energy(state)
        np.testing.assert_allclose(now["momentum"], start["momentum"], atol=1e-11 * body.mass)
        assert now["kinetic"] + now["elastic"] <= total
        total = now["kinetic"] + now["elastic"]


def test_linear_and_angular_momentum_of_an_actuated_body_are_kept(body):
    """By the step itself: its targets jump from control step to control step."""
    rng = np.random.default_rng(3)
    strong = dataclasses.replace(body, material=Material())
    fem = FullFem(strong, 0.02, drag=False, substeps=2, tolerance=1e-12)
    spin = np.cross([1.0, 2.0, -0.5], body.vertices)
    state = fem.at(np.zeros(4), velocity=np.array([0.4, -0.2, 0.1]) + spin)
    start = fem.energy(state)
    for _ in range(8):
        state = fem.step(state, rng.uniform(-0.5, 0.5, 4))
        now = fem.energy(state)
        for name, bound in (("momentum", 1e-12), ("angular_momentum", 1e-10)):
            drift = np.abs(now[name] - start[name]).max()
            assert drift <= bound * np.linalg.norm(start[name])
    assert np.abs(state.now - state.now.mean(0) - body.vertices).max() > 0.05  # it did bend


def test_the_variational_step_is_of_second_order():
    """Differences of successive halvings fall by four, also with targets, damping and drag."""
    box = unreduced_body(bar((6, 1, 1), (1.0, 0.2, 0.15)), modes=4)
    for material, drag, size, target in (
        (LOOSE, False, 0.05, 0.0),
        (Material(damping=0.005), True, 0.0, 0.3),
    ):
        ends = []
        for substeps in (32, 64, 128):
            body = dataclasses.replace(box, material=material)
            fem = FullFem(body, 0.1, drag, substeps=substeps, tolerance=1e-10)
            speed = size * 2 * np.pi * body.frequencies[0] * body.modes[:, :, 0]
            state = fem.at(np.zeros(4), velocity=speed)
            ends.append(fem.step(state, np.array([-target, target, 0.0, 0.0])).now)
        first, second = (np.linalg.norm(b - a) for a, b in zip(ends, ends[1:], strict=False))
        assert 3.7 < first / second < 4.3


def test_energy_of_a_swinging_body_is_lost_at_third_order_and_never_gained():
    body = unreduced_body(bar((6, 1, 1), (1.0, 0.2, 0.15)), modes=2, material=LOOSE)
    period, losses = 1.0 / body.frequencies[0], []
    for count in (16, 32):
        fem = FullFem(body, period, drag=False, substeps=count, tolerance=1e-10)
        state = fem.at(np.zeros(2), velocity=0.05 * body.modes[:, :, 0] / period)
        total: list[float] = []
        for _ in range(4):
            state = fem.step(state)
            energy = fem.energy(state)
            total.append(float(energy["kinetic"] + energy["elastic"]))
        assert (np.diff(total) < 0.0).all()
        losses.append(1.0 - total[-1] / total[0])
    assert losses[0] < 0.1
    assert losses[0] / losses[1] == pytest.approx(8.0, rel=0.25)


@BOTH
def test_energy_never_grows_in_the_medium_with_damping_and_a_held_rest_shape(body, integrator):
    medium = Medium(gravity=0.0, righting_height=0.0)
    held = dataclasses.replace(body, material=Material(), medium=medium)
    substeps = 16 if integrator == "variational" else 1
    fem = FullFem(held, 0.04, integrator=integrator, substeps=substeps)
    state = _bent(fem, np.random.default_rng(4), target=np.zeros(4))
    total = np.inf
    for _ in range(6):
        parts = fem.energy(state)
        # under a zero target the pull is the elastic energy again, control_stiffness times
        energy = parts["kinetic"] + (1 + held.material.control_stiffness) * parts["elastic"]
        assert energy <= total
        total = energy
        state = fem.step(state, np.zeros(4))


def test_rigid_motion_costs_no_elastic_energy(body):
    fem = FullFem(body, H)
    turn = exponential(np.array([1.0, 2.0, -0.5]))
    state = fem.at(np.zeros(4), position=np.array([3.0, 0.0, 1.0]), rotation=turn)
    np.testing.assert_allclose(state.now, body.vertices @ turn.T + [3.0, 0.0, 1.0])
    assert fem.energy(state)["elastic"] == pytest.approx(0.0, abs=1e-15)


def _small(fem, mode, size):
    """A state at rest in a small mode, and a function that reads its coordinate."""
    body = fem.body
    x = body.vertices + size * body.modes[:, :, mode]
    weight = body.modes[:, :, mode] * body.vertex_mass[:, None]
    mass = (weight * body.modes[:, :, mode]).sum()
    state = dataclasses.replace(fem.rest(), now=x, before=x, earlier=x)
    return state, mass, lambda state: (weight * (state.now - body.vertices)).sum() / mass


def test_a_small_mode_follows_the_exact_implicit_euler_recursion(body):
    fem = FullFem(body, H, drag=False, tolerance=1e-13, **EULER)
    for mode in (0, 3):
        size = 1e-6
        state, _, read = _small(fem, mode, size)
        old = new = 1.0
        square = (2 * np.pi * body.frequencies[mode]) ** 2
        for _ in range(12):
            state = fem.step(state)
            old, new = new, (2.0 * new - old) / (1.0 + H**2 * square)
            assert read(state) / size == pytest.approx(new, abs=1e-4)


def test_damping_and_target_follow_their_recursion_too(body):
    material = Material(damping=0.02, control_stiffness=4.0)
    fem = FullFem(
        dataclasses.replace(body, material=material), H, drag=False, tolerance=1e-13, **EULER
    )
    state, mass, read = _small(fem, 0, 0.0)
    target = 1e-6 * np.array([1.0, 0.0, 0.0, 0.0])
    stiffness = body.stiffness[0]
    old = new = 0.0
    for _ in range(10):
        state = fem.step(state, target)
        # M (q - 2 q1 + q0) / h^2 + K q + 4 K (q - u) + 0.02 K (q - q1) / h = 0
        top = mass * (2 * new - old) / H**2 + stiffness * (4.0 * 1e-6 + 2.0 * new)
        old, new = new, top / (mass / H**2 + stiffness * (1.0 + 4.0 + 2.0))
        assert read(state) == pytest.approx(new, abs=1e-10)


def test_a_small_mode_follows_the_variational_step_s_recursion(body):
    """The weights of the elastic force are (z + 0.8)^2 (z + 0.125), those of the velocity third-order."""
    material = Material(damping=0.02, control_stiffness=4.0)
    fem = FullFem(
        dataclasses.replace(body, material=material), H, drag=False, substeps=1, tolerance=1e-13
    )
    elastic = np.array([1.0, 1.725, 0.84, 0.08]) / 3.645
    velocity = np.array([0.55, -0.15, -0.35, -0.05])
    for mode in (0, 3):
        state, mass, read = _small(fem, mode, 1e-6)
        target = np.zeros(4)
        target[mode] = 2e-6
        past = [1e-6] * 3  # newest first
        pull = [2e-6 * t for t in (0.25, 0.75, 1.0)]  # intervals' means 0, 1/2, 1, 1, of two each
        inertia, k = mass / H**2, body.stiffness[mode]
        for i in range(10):
            state = fem.step(state, target)
            top = inertia * (2.0 * past[0] - past[1])
            top -= 5.0 * k * (elastic[1:] @ past) + 0.02 * k / H * (velocity[1:] @ past)
            top += 4.0 * k * pull[min(i, 2)]
            new = top / (inertia + 5.0 * k * elastic[0] + 0.02 * k / H * velocity[0])
            past = [new, *past[:2]]
            assert read(state) == pytest.approx(new, abs=1e-10)


def test_a_held_target_settles_at_its_share_of_the_strain():
    material = Material(damping=0.05, control_stiffness=4.0)
    slender = unreduced_body(bar((16, 2, 2), (1.0, 0.08, 0.08)), modes=2, material=material)
    fem = FullFem(slender, 0.1, drag=False, **EULER)
    target = np.array([1.0, 0.0])
    state = fem.rest()
    for _ in range(25):
        state = fem.step(state, target)
    now = state.now
    expected = fem.at(0.8 * target).now  # k_c / (1 + k_c)
    np.testing.assert_allclose(
        np.linalg.norm(now[-1] - now[0]), np.linalg.norm(expected[-1] - expected[0]), rtol=0.01
    )


def test_drag_on_a_box_is_the_formula():
    # stiff enough to stay a box: M (v1 - v0) / h = -rho Cd A v1^2 (front and back) - skin friction
    stiff = Material(youngs_modulus=1e12, control_stiffness=0.0, damping=0.0)
    medium = Medium(density=900.0, drag_normal=1.3, drag_tangential=0.05, righting_height=0.0)
    box = unreduced_body(bar((2, 2, 2), (0.5, 0.3, 0.2)), 1, stiff, medium)
    fem = FullFem(box, 0.02, tolerance=1e-11, **EULER)
    v0 = 2.0
    state = fem.step(fem.at(np.zeros(1), velocity=np.array([v0, 0.0, 0.0])))
    front, all_sides = 0.3 * 0.2, 2 * (0.3 * 0.2 + 0.5 * 0.2 + 0.5 * 0.3)

    def balance(v):
        pressure = 900.0 * 1.3 * front * v * abs(v)
        skin = 0.5 * 900.0 * 0.05 * all_sides * np.sqrt(v * v + 1e-4) * v
        return box.mass * (v - v0) / 0.02 + pressure + skin

    velocity = fem.energy(state)["momentum"] / box.mass
    np.testing.assert_allclose(velocity, [brentq(balance, 0, 2), 0, 0], rtol=1e-6, atol=1e-6)


@BOTH
def test_gravity_and_righting_act_as_a_force_and_a_moment(body, integrator):
    medium = Medium(density=1e-9, gravity=-2.0, righting_height=0.05)
    fem = FullFem(
        dataclasses.replace(body, medium=medium),
        1e-3,
        tolerance=1e-13,
        integrator=integrator,
        substeps=1,
    )
    angle = 0.3  # rolled about x
    start = fem.at(np.zeros(4), rotation=exponential(np.array([angle, 0.0, 0.0])))
    state = fem.energy(fem.step(start))
    expected = body.mass * -2.0 * 1e-3
    np.testing.assert_allclose(state["momentum"], [0, 0, expected], rtol=1e-4, atol=1e-9)
    # moment M g D sin(angle) about -x, which brings the body's z axis back up
    spin = -body.mass * 9.81 * 0.05 * np.sin(angle) * 1e-3
    np.testing.assert_allclose(state["angular_momentum"], [spin, 0, 0], rtol=1e-3, atol=1e-6)


def test_rollout_is_steps_one_after_another_and_rests_at_rest(body):
    fem = FullFem(dataclasses.replace(body, material=Material()), 0.04, substeps=2)
    targets = np.array([[0.5, 0, 0, 0], [0, 0.3, 0, 0]])
    states = fem.rollout(fem.rest(), targets)
    first = fem.step(fem.rest(), targets[0])
    np.testing.assert_array_equal(states[1].now, first.now)
    np.testing.assert_array_equal(states[2].now, fem.step(first, targets[1]).now)
    fem = FullFem(fem.body, 0.04, drag=False)
    still = fem.step(fem.rest(), np.zeros(4))
    np.testing.assert_allclose(still.now, body.vertices, atol=1e-9)


def test_the_variational_step_converges_to_where_implicit_euler_does(body):
    strong = dataclasses.replace(body, material=Material())
    target, ends = np.array([0.3, 0.2, 0.0, 0.0]), {}
    for integrator, substeps in (
        ("variational", 16),
        ("implicit-euler", 16),
        ("implicit-euler", 64),
    ):
        fem = FullFem(strong, 0.08, integrator=integrator, substeps=substeps)
        ends[integrator, substeps] = fem.step(fem.rest(), target).now
    fine, coarse = ends["implicit-euler", 64], ends["implicit-euler", 16]
    limit = fine + (fine - coarse) / 3.0  # of first order
    assert np.linalg.norm(coarse - limit) > 3.0 * np.linalg.norm(ends["variational", 16] - limit)


def test_a_solve_that_fails_is_said(body):
    fem = FullFem(body, H, max_newton=1)
    with pytest.raises(DefplanError, match="did not converge in 1"):
        fem.step(_bent(fem, np.random.default_rng(5)))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"integrator": "euler"}, "can be variational or implicit-euler"),
        ({"substeps": 0}, "must be positive"),
        ({"timestep": np.nan}, "must be positive"),
    ],
)
def test_options_that_cannot_be_are_refused(body, options, message):
    with pytest.raises(DefplanError, match=message):
        FullFem(body, **options)


def test_a_target_of_the_wrong_size_or_not_finite_is_refused(body):
    fem = FullFem(body, H)
    with pytest.raises(DefplanError, match=r"shape \(3,\), wanted \(4,\)"):
        fem.step(fem.rest(), np.zeros(3))
    with pytest.raises(DefplanError, match="not finite"):
        fem.step(fem.rest(), np.array([0.0, np.nan, 0.0, 0.0]))


# --- contact


def test_distances_from_planes_are_the_kernel_s(body):
    turn = (np.cos(0.2), np.sin(0.2), 0.0, 0.0)
    planes = (TerrainGeom("plane"), TerrainGeom("plane", (), (0.1, -0.3, 0.2), turn))
    # a small sphere far away takes the way through the kernel
    far = TerrainGeom("sphere", (0.01,), (0.0, 0.0, -100.0))
    points = np.random.default_rng(0).normal(size=(40, 3))
    gaps, normals = FemContact(Terrain(planes), body).gaps(points)
    wanted, directions = FemContact(Terrain((*planes, far)), body).gaps(points)
    np.testing.assert_allclose(gaps, wanted, atol=1e-14)
    np.testing.assert_allclose(normals, directions, atol=1e-14)


@pytest.mark.parametrize(("ground", "bound"), [("plane", 1e-5), ("heightfield", 2e-2)])
def test_held_contact_has_the_law_s_force_as_its_derivative(body, ground, bound):
    """On a heightfield but for what its distance, a slope's, lacks of the true one."""
    rng = np.random.default_rng(2)
    hills = Heightfield(0.02 * rng.normal(size=(6, 6)), (1.0, 1.0))
    terrain = Terrain(
        (TerrainGeom("plane"),) if ground == "plane" else (), thickness=0.05, damping=0.7
    )
    terrain = dataclasses.replace(terrain, heightfield=hills if ground != "plane" else None)
    law = FemContact(terrain, body)
    start = body.vertices + [0.0, 0.0, 0.1] + 0.005 * rng.normal(size=body.vertices.shape)
    end = start + 0.01 * rng.normal(size=start.shape)
    held = law.hold(end, start, H)
    assert len(held.touching) > 5
    for vertex, force in zip(held.touching[:6], held.forces[:6], strict=True):
        for axis in range(3):
            move = np.zeros_like(end)
            move[vertex, axis] = 1e-7
            slope = (held.energy(end + move) - held.energy(end - move)) / 2e-7
            assert slope == pytest.approx(-force[axis], abs=bound * np.abs(force).max())
    assert np.linalg.eigvalsh(held.blocks).min() > -1e-6 * np.abs(held.blocks).max()


def test_normal_force_damps_never_pulls_and_is_the_spring_s_at_rest(body):
    law = FemContact(Terrain(thickness=0.05, damping=0.7), body)
    gaps, rates = np.full(5, 0.02), np.array([-2.0, -0.5, 0.0, 0.5, 20.0])
    force, by_gap, by_rate = law.normal_force(gaps, rates)
    spring = law.stiffness * 0.03**2
    assert force[2] == pytest.approx(spring)
    assert (np.diff(force) < 0.0).all() and (force > 0.0).all()
    up, down = (law.normal_force(gaps + s * 1e-6, rates)[0] for s in (1, -1))
    np.testing.assert_allclose((up - down) / 2e-6, by_gap, rtol=1e-6)
    up, down = (law.normal_force(gaps, rates + s * 1e-6)[0] for s in (1, -1))
    np.testing.assert_allclose((up - down) / 2e-6, by_rate, rtol=1e-4)


def test_a_dropped_box_slides_to_a_stop_by_the_law_of_friction():
    stiff = Material(youngs_modulus=1e6, control_stiffness=0.0, damping=0.02)
    air = Medium(density=0.0, gravity=-9.81, righting_height=0.0)
    box = unreduced_body(bar((3, 3, 1), (0.3, 0.3, 0.05)), 1, stiff, air)
    terrain = Terrain(friction=0.5, slip_speed=0.001, thickness=0.01)
    fem = FullFem(box, 0.02, False, terrain, substeps=2)
    # where the spring carries the weight: 16 lower vertices with their share of it
    start, slide = np.array([0.0, 0.0, 0.025 + 0.0075]), np.array([1.0, 0.0, 0.0])
    state = fem.at(np.zeros(1), position=start, velocity=slide)
    share = box.vertex_mass / box.mass
    path = [share @ state.now[:, 0]]
    for _ in range(20):
        state = fem.step(state)
        path.append(share @ state.now[:, 0])
    # v^2 / 2 mu g, less half the way of a substep: friction is that at the substep's end
    way = 1.0 / (2 * 0.5 * 9.81) - 0.5 * fem.h
    assert path[-1] - path[0] == pytest.approx(way, rel=0.01)
    assert abs(path[-1] - path[-2]) < 1e-4
    assert state.now[:, 2].min() > 0.0


@pytest.mark.slow
def test_a_released_bent_fish_is_followed_by_the_reduced_step(fish):
    from defplan_mj.body.check import released_shape_error

    assert released_shape_error(fish)["relative"] < 0.03
    # and swinging freely, where nothing damps the modes that the reduction leaves out
    loose = dataclasses.replace(
        fish, material=LOOSE, medium=Medium(density=0.0, righting_height=0.0)
    )
    # 3.8%: f has modes that nothing damps and the reduced body lacks
    assert released_shape_error(loose, timestep=0.01, duration=0.4)["relative"] < 0.05
