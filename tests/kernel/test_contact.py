"""Contact: rest, slopes, forces, derivatives, and the terrain's distances, against analysis and MuJoCo."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
import pytest

from defplan_mj.base.errors import DefplanError
from defplan_mj.body.build import build_body
from defplan_mj.body.model import Body, Medium
from defplan_mj.body.rotation_strain import shape_coordinates
from defplan_mj.dynamics.external import CasadiDynamics
from defplan_mj.dynamics.feet import Feet, lowest_feet
from defplan_mj.dynamics.full_fem import FullFem
from defplan_mj.dynamics.reduced import ReducedDynamics
from defplan_mj.dynamics.terrain import Heightfield, Terrain, TerrainGeom, pack_terrain
from defplan_mj.kernel.contact_points import contact_points
from defplan_mj.kernel.library import kernel
from defplan_mj.task import BodyOptions
from defplan_tasks.environments import ASSETS
from tests.samples.casadi_twin import CasadiTwin
from tests.samples.kernel_cases import (
    EVERY_FORCE,
    block,
    central_differences,
    in_medium,
    matrix,
    random_quaternion,
    random_state,
    synthetic_body,
)

G = 9.81
AIR = Medium(name="air", density=0.0, gravity=-G, righting_height=0.0)
H = 0.03


def slope(angle: float, **law) -> Terrain:
    """A plane that falls along +x."""
    turn = (np.cos(angle / 2), 0.0, np.sin(angle / 2), 0.0)
    return Terrain((TerrainGeom("plane", quaternion=turn),), **law)


def on_slope(angle: float, speed: float, **law) -> tuple[ReducedDynamics, np.ndarray, np.ndarray]:
    """A block that lies on a slope and moves down it: dynamics, state, the direction down."""
    dynamics = ReducedDynamics(block((0.3, 0.3, 0.05), AIR), H, slope(angle, **law))
    x = np.zeros(dynamics.nx)
    down = np.array([np.cos(angle), 0.0, -np.sin(angle)])
    up = np.array([np.sin(angle), 0.0, np.cos(angle)])
    x[:3], x[3:7] = 0.055 * up, [np.cos(angle / 2), 0, np.sin(angle / 2), 0]
    x[8:11] = speed * down
    return dynamics, x, down


def walk(dynamics: ReducedDynamics, x: np.ndarray, steps: int) -> np.ndarray:
    return dynamics.rollout(x, np.zeros((steps, dynamics.nu)))


@pytest.mark.parametrize(("angle", "friction"), [(0.3, 0.1), (0.5, 0.3), (0.2, 0.0)])
def test_a_block_slides_down_a_slope_with_the_acceleration_that_friction_leaves(angle, friction):
    dynamics, x, down = on_slope(angle, 2.0, friction=friction)
    states = walk(dynamics, x, 200)
    speed = states[50:, 8:11] @ down
    wanted = G * (np.sin(angle) - friction * np.cos(angle))
    np.testing.assert_allclose(np.diff(speed) / H, wanted, rtol=2e-3)


@pytest.mark.parametrize(("angle", "friction"), [(0.2, 0.5), (0.3, 0.8), (0.0, 0.4)])
def test_a_block_stops_where_friction_says_and_only_creeps_then(angle, friction):
    speed, slip = 2.0, 1e-3
    dynamics, x, down = on_slope(angle, speed, friction=friction, slip_speed=slip)
    x = walk(dynamics, x, 1)[-1]  # the first step is spent on the block's own settling
    settled = walk(replace_friction(dynamics, 0.0), on_slope(angle, 0.0)[1], 300)[-1]
    settled[8:] = 0.0
    settled[8:11] = speed * down
    settled[:3] -= (settled[:3] @ down) * down
    states = walk(dynamics, settled, 150)
    braking = G * (friction * np.cos(angle) - np.sin(angle))
    way = states[-1, :3] @ down - states[0, :3] @ down
    # implicit Euler is behind the parabola by up to a step's way
    assert way == pytest.approx(speed**2 / (2 * braking), abs=speed * H)
    tan = np.tan(angle)
    creep = slip * tan / np.sqrt(friction**2 - tan**2)
    assert states[-1, 8:11] @ down == pytest.approx(creep, rel=1e-2, abs=1e-9)


def replace_friction(dynamics: ReducedDynamics, friction: float) -> ReducedDynamics:
    assert dynamics.terrain is not None
    terrain = replace(dynamics.terrain, friction=friction)
    return ReducedDynamics(dynamics.body, dynamics.timestep, terrain)


def test_a_body_at_rest_stays_at_rest_for_100_seconds(small_walker):
    dynamics = ReducedDynamics(small_walker, H, Terrain())
    rest = dynamics.rest_state()
    last = walk(dynamics, rest, round(100 / H))[-1]
    assert np.abs(last - rest).max() < 1e-8


@pytest.mark.parametrize("gravity", [-G, -1.6])
def test_contact_forces_at_rest_carry_the_weight_and_the_body_does_not_sink(small_walker, gravity):
    dynamics = ReducedDynamics(in_medium(small_walker, replace(AIR, gravity=gravity)), H, Terrain())
    rest = dynamics.rest_state()
    contacts = dynamics.contacts(rest)
    assert len(contacts.points) >= 3
    np.testing.assert_allclose(
        contacts.total, [0, 0, -small_walker.mass * gravity], rtol=1e-6, atol=1e-6
    )
    surface = dynamics.surface(rest)
    assert surface[:, 2].min() > -0.01 * np.ptp(surface[:, 2])
    # moments balance about the centre of mass, which is over x = y = 0
    turning = np.cross(contacts.points - rest[:3], contacts.forces).sum(0)
    np.testing.assert_allclose(turning, 0.0, atol=1e-5 * small_walker.mass * G)
    np.testing.assert_array_equal(rest[:2], 0.0)
    np.testing.assert_array_equal(dynamics.rest_state(), rest)


def test_contact_forces_are_what_changes_the_momentum(small_walker):
    h = H / 2
    dynamics = ReducedDynamics(small_walker, h, Terrain(), substeps=1)
    rng = np.random.default_rng(0)
    u = rng.uniform(-0.6, 0.6, (120, dynamics.nu))
    states = dynamics.rollout(dynamics.rest_state(), u)
    weight = np.array([0.0, 0.0, -G * small_walker.mass])
    sliding = 0
    for x, target, x_next in zip(states, u, states[1:], strict=False):
        contacts = dynamics.contacts(x_next)
        if dynamics.step_info(x, target)[1].division > 1:  # forces are those of the last part
            continue
        change = small_walker.mass * (x_next[13:16] - x[13:16]) / h
        np.testing.assert_allclose(contacts.total + weight, change, atol=1e-3 * -weight[2])
        normal, tangential = contacts.forces[:, 2], np.hypot(*contacts.forces[:, :2].T)
        assert (tangential <= 0.8 * normal * (1 + 1e-9)).all()
        sliding += int((tangential > 0.79 * normal).sum())
    assert sliding > 20


SOLIDS = {
    "plane": (0.0, 0.0, 1.0),
    "sphere": (0.7,),
    "capsule": (0.4, 0.8),
    "cylinder": (0.5, 0.7),
    "box": (0.5, 0.3, 0.8),
}


def gap(packed: np.ndarray, point: np.ndarray) -> tuple[float, np.ndarray]:
    normal = np.empty(3)
    return kernel().dp_terrain_gap(packed, np.array(point, float), normal), normal


def spheres_contact(model: mujoco.MjModel, data: mujoco.MjData, point, radius: float):
    """MuJoCo's own contact of a small sphere at `point` with the solid: distance of its centre, normal."""
    data.qpos[:3] = point
    mujoco.mj_forward(model, data)
    if not data.ncon:
        return None
    deepest = min(range(data.ncon), key=lambda i: data.contact[i].dist)
    contact = data.contact[deepest]
    sign = 1.0 if model.geom("probe").id == contact.geom2 else -1.0
    return contact.dist + radius, sign * contact.frame[:3]


def probe_model(spec: mujoco.MjSpec, radius: float) -> mujoco.MjModel:
    probe = spec.worldbody.add_body(name="probe")  # free: MuJoCo finds no contacts of fixed bodies
    probe.add_freejoint()
    probe.add_geom(name="probe", type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[radius, 0, 0])
    model = spec.compile()
    model.opt.ccd_tolerance = 1e-10
    return model


@pytest.mark.parametrize("shape", SOLIDS)
def test_depth_and_normal_equal_those_of_mujocos_contacts(shape):
    radius, rng = 0.05, np.random.default_rng(0)
    pos, quat = rng.normal(size=3), random_quaternion(rng)
    spec = mujoco.MjSpec()
    kind = getattr(mujoco.mjtGeom, f"mjGEOM_{shape.upper()}")
    size = [*SOLIDS[shape], 0.0, 0.0][:3]
    spec.worldbody.add_geom(name="solid", type=kind, size=size, pos=pos, quat=quat)
    model = probe_model(spec, radius)
    model.geom_contype[:], model.geom_conaffinity[:] = 1, 1
    data = mujoco.MjData(model)
    body = block((0.1, 0.1, 0.1), AIR)
    geom = TerrainGeom(shape, SOLIDS[shape], tuple(pos), tuple(quat))
    packed = pack_terrain(Terrain((geom,)), body)
    compared = 0
    for _ in range(3000):
        point = pos + rng.uniform(-1.2, 1.2, 3)
        value, normal = gap(packed, point)
        if not 1e-3 < value < 0.9 * radius:  # where the nearest point is one
            continue
        depth, direction = spheres_contact(model, data, point, radius)
        assert value == pytest.approx(depth, abs=1e-5)
        np.testing.assert_allclose(normal, direction, atol=1e-3)
        compared += 1
    assert compared > 15


def test_a_heightfield_is_mujocos_up_to_its_curvature_within_a_cell():
    n, half, radius = 81, 2.0, 0.02
    grid = np.linspace(-half, half, n)
    heights = 0.2 * np.cos(1.5 * grid)[:, None] * np.cos(1.1 * grid)[None, :] + 0.2
    pos = (0.3, -0.2, 0.4)
    spec = mujoco.MjSpec()
    low, swing = heights.min(), float(np.ptp(heights))  # MuJoCo has heights in [0, 1]
    spec.add_hfield(
        name="h",
        nrow=n,
        ncol=n,
        size=[half, half, swing, 0.1],
        userdata=((heights - low) / swing).ravel(),
    )
    spec.worldbody.add_geom(
        name="solid",
        type=mujoco.mjtGeom.mjGEOM_HFIELD,
        hfieldname="h",
        pos=[pos[0], pos[1], pos[2] + low],
    )
    model = probe_model(spec, radius)
    data = mujoco.MjData(model)
    field = Heightfield(heights, (half, half), pos)
    packed = pack_terrain(Terrain((), field), block((0.1, 0.1, 0.1), AIR))
    rng = np.random.default_rng(1)
    cell = 2 * half / (n - 1)
    for _ in range(100):
        xy = rng.uniform(-1.5, 1.5, 2)
        surface = 0.2 * np.cos(1.5 * xy[1]) * np.cos(1.1 * xy[0]) + 0.2
        point = np.array([pos[0] + xy[0], pos[1] + xy[1], pos[2] + surface + 0.5 * radius])
        value, normal = gap(packed, point)
        slopes = [
            0.2 * np.cos(1.5 * xy[1]) * 1.1 * np.sin(1.1 * xy[0]),
            0.2 * np.cos(1.1 * xy[0]) * 1.5 * np.sin(1.5 * xy[1]),
        ]
        true = np.array([*slopes, 1.0]) / np.hypot(1.0, np.hypot(*slopes))
        assert value == pytest.approx(0.5 * radius * true[2], abs=2e-5)
        np.testing.assert_allclose(normal, true, atol=1e-3)
        depth, direction = spheres_contact(model, data, point, radius)
        assert value == pytest.approx(depth, abs=0.2 * 2.5 * cell**2)
        np.testing.assert_allclose(normal, direction, atol=0.2 * 3.5 * cell)


def test_the_ground_of_a_level_heightfield_is_the_plane(small_walker):
    plane = ReducedDynamics(small_walker, H, Terrain())
    field = Heightfield(np.full((5, 4), 0.2), (3.0, 2.0), (0.0, 0.0, -0.2))
    level = ReducedDynamics(small_walker, H, Terrain((), field))
    u = np.random.default_rng(2).uniform(-0.3, 0.3, (20, plane.nu))
    x0 = plane.rest_state()
    np.testing.assert_allclose(level.rollout(x0, u), plane.rollout(x0, u), atol=1e-6)


def mixed_terrain(rng: np.random.Generator, **law) -> Terrain:
    """Every kind of part around the origin."""
    turns = [tuple(random_quaternion(rng)) for _ in range(4)]
    return Terrain(
        (
            TerrainGeom("box", (0.3, 0.3, 0.2), (0.3, 0.2, 0.0), turns[0]),
            TerrainGeom("sphere", (0.3,), (-0.3, -0.2, 0.0)),
            TerrainGeom("cylinder", (0.2, 0.3), (-0.3, 0.3, 0.0), turns[1]),
            TerrainGeom("capsule", (0.1, 0.5), (0.2, -0.3, 0.0), turns[2]),
            TerrainGeom("ellipsoid", (0.2, 0.3, 0.2), (0.0, 0.0, 0.0), turns[3]),
        ),
        Heightfield(0.05 * rng.normal(size=(20, 20)), (3.0, 3.0)),
        **law,
    )


def touching_states(dynamics: ReducedDynamics, rng: np.random.Generator, count: int):
    """(x, u, x_next) of steps in contact, after falls from any attitude."""
    found: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
    r = dynamics.body.n_modes
    while len(found) < count:
        x = np.zeros(dynamics.nx)
        x[2], x[3:7] = 0.7, random_quaternion(rng)
        x[7 + r : 13 + r] = rng.normal(size=6)
        for _ in range(25):
            u = 0.5 * rng.uniform(-1, 1, dynamics.nu)
            x_next, info = dynamics.step_info(x, u)
            assert not info.failed
            if len(dynamics.contacts(x_next).points) > 1 and rng.random() < 0.2:
                found.append((x, u, x_next))
            x = x_next
    return found[:count]


def rows_close(value: np.ndarray, truth: np.ndarray, tolerance: float) -> None:
    scale = np.maximum(np.abs(truth).max(axis=1, keepdims=True), 1e-6 * np.abs(truth).max())
    assert (np.abs(value - truth) / scale).max() <= tolerance


@pytest.mark.parametrize("friction", [0.8, 0.1, 0.0], ids=["sticking", "sliding", "smooth"])
@pytest.mark.parametrize(
    ("integrator", "substeps"), [("variational", 1), ("variational", 2), ("implicit-euler", 1)]
)
def test_derivatives_through_contact_equal_the_symbolic_twin(integrator, substeps, friction):
    if integrator == "implicit-euler" and friction == 0.0:
        pytest.skip("without friction its contact has no damping: the step stays a minimisation")
    rng = np.random.default_rng(5)
    body = synthetic_body(rng, 3, 6, 4, 5, replace(EVERY_FORCE, gravity=-G))
    body = replace(body, amplitude=np.full(3, 0.5))
    geoms = (
        TerrainGeom("plane", (), (0, 0, -0.1), (0.99, 0.1, 0.05, 0.0)),
        TerrainGeom("sphere", (0.5,), (0.1, 0, -0.3)),
    )
    terrain = Terrain(geoms, friction=friction, thickness=0.03)
    # the kernel's solution has to be nearer to the twin's than contact's curvature shows
    dynamics = ReducedDynamics(
        body, H, terrain, tolerance=1e-9, substeps=substeps, integrator=integrator
    )
    twin = CasadiTwin(dynamics)
    for x, u, x_next in touching_states(dynamics, rng, 5):
        division = dynamics.step_info(x, u)[1].division
        truth = twin.refine(x, u, x_next, division)
        np.testing.assert_allclose(x_next, truth, rtol=1e-8, atol=1e-8 * np.abs(truth).max())
        for value, wanted in zip(
            dynamics.step_jacobian(x, u, x_next),
            twin.jacobians(x, u, x_next, division),
            strict=True,
        ):
            rows_close(value, wanted, 1e-9)


@pytest.mark.parametrize("ground", ["plane", "mixed"])
def test_derivatives_through_contact_equal_finite_differences(small_walker, ground):
    rng = np.random.default_rng(6)
    terrain = Terrain() if ground == "plane" else mixed_terrain(rng)
    dynamics = ReducedDynamics(small_walker, H, terrain, tolerance=1e-11)
    for x, u, x_next in touching_states(dynamics, rng, 4):
        a, b = dynamics.step_jacobian(x, u, x_next)
        eps = 1e-7
        for jacobian, at, step in (
            (a, x, lambda value, u=u: dynamics.step(value, u)),
            (b, u, lambda value, x=x: dynamics.step(x, value)),
        ):
            assert (
                np.abs(jacobian - central_differences(step, at, eps)).max()
                <= 1e-5 * np.abs(jacobian).max()
            )
        g = rng.normal(size=dynamics.nx)
        gx, gu = dynamics.step_adjoint(x, u, x_next, g)
        np.testing.assert_allclose(gx, a.T @ g, rtol=0, atol=1e-10 * np.abs(a.T @ g).max())
        np.testing.assert_allclose(gu, b.T @ g, rtol=0, atol=1e-10 * np.abs(b.T @ g).max())


def test_the_adjoint_of_a_rollout_in_contact_chains_its_steps(small_walker):
    dynamics = ReducedDynamics(small_walker, H, Terrain())
    rng = np.random.default_rng(7)
    u = rng.uniform(-0.5, 0.5, (12, dynamics.nu))
    states = dynamics.rollout(dynamics.rest_state(), u)
    partial = rng.normal(size=states.shape)
    g, gu = partial[-1], np.empty_like(u)
    for i in reversed(range(len(u))):
        a, b = dynamics.step_jacobian(states[i], u[i], states[i + 1])
        gu[i], g = b.T @ g, partial[i] + a.T @ g
    g0, value = dynamics.rollout_adjoint(u, states, partial)
    np.testing.assert_allclose(g0, g, rtol=0, atol=1e-9 * np.abs(g).max())
    np.testing.assert_allclose(value, gu, rtol=0, atol=1e-9 * np.abs(gu).max())


def test_terrain_out_of_reach_changes_nothing_but_the_last_digits(small_walker):
    far = Terrain((TerrainGeom("plane", (), (0, 0, -50.0)),))
    u = np.random.default_rng(8).uniform(-0.5, 0.5, (20, small_walker.n_modes))
    free, falling = ReducedDynamics(small_walker, H), ReducedDynamics(small_walker, H, far)
    x0 = free.rest_state()
    np.testing.assert_allclose(falling.rollout(x0, u), free.rollout(x0, u), atol=1e-9)


# --- given forces


def test_given_forces_equal_the_symbolic_twin():
    rng = np.random.default_rng(9)
    body = synthetic_body(rng, 3, 6, 4, 5, EVERY_FORCE)
    dynamics = ReducedDynamics(body, H).with_feet(Feet((np.array([0, 3]), np.array([7]))))
    twin = CasadiTwin(dynamics)
    for _ in range(4):
        x = random_state(dynamics, rng)
        u = np.concatenate([rng.uniform(-1, 1, 3), 20 * rng.normal(size=6)])
        x_next, info = dynamics.step_info(x, u)
        assert not info.failed
        truth = twin.refine(x, u, x_next)
        np.testing.assert_allclose(x_next, truth, rtol=1e-10, atol=1e-10 * np.abs(truth).max())
        for value, wanted in zip(
            dynamics.step_jacobian(x, u, x_next), twin.jacobians(x, u, x_next), strict=True
        ):
            rows_close(value, wanted, 1e-10)


def test_casadi_sees_given_forces_and_feet(small_walker):
    import casadi

    feet = lowest_feet(small_walker)
    assert len(feet) == 4
    dynamics = ReducedDynamics(small_walker, H).with_feet(feet)
    symbolic, r = CasadiDynamics(dynamics), small_walker.n_modes
    rng = np.random.default_rng(10)
    x, u = random_state(dynamics, rng), rng.uniform(-1, 1, r)
    forces = 50 * rng.normal(size=(4, 3))
    x_next = dynamics.step_forced(x, u, forces)
    value = np.array(symbolic.step_forced(x, u, forces.T)).ravel()
    np.testing.assert_array_equal(value, x_next)
    sx, su = casadi.MX.sym("x", dynamics.nx), casadi.MX.sym("u", r)
    sf = casadi.MX.sym("f", 3, 4)
    out = symbolic.step_forced(sx, su, sf)
    blocks = [casadi.jacobian(out, s) for s in (sx, su, casadi.vec(sf))]
    got = casadi.Function("j", [sx, su, sf], blocks)(x, u, forces.T)
    a, b = dynamics.step_jacobian(x, np.concatenate([u, forces.ravel()]), x_next)
    for value, wanted in zip(got, (a, b[:, :r], b[:, r:]), strict=True):
        np.testing.assert_array_equal(np.array(value), wanted)
    np.testing.assert_array_equal(np.array(symbolic.feet(x)).T, dynamics.feet_positions(x))
    moved = casadi.Function("j", [sx], [casadi.jacobian(symbolic.feet(sx), sx)])(x)
    np.testing.assert_array_equal(
        np.array(moved), dynamics.feet_jacobian(x).reshape(12, dynamics.nx)
    )


def test_feet_are_where_their_vertices_are_and_move_as_their_jacobian_says(small_walker):
    feet = lowest_feet(small_walker)
    dynamics = ReducedDynamics(small_walker, H).with_feet(feet)
    rng = np.random.default_rng(11)
    x = random_state(dynamics, rng)
    at = (
        small_walker.vertices
        + small_walker.basis
        @ shape_coordinates(small_walker, x[None, 7 : 7 + small_walker.n_modes])[0]
    )
    world = x[:3] + at @ matrix(x[3:7]).T
    wanted = np.array([world[foot].mean(0) for foot in feet.vertices])
    np.testing.assert_allclose(dynamics.feet_positions(x), wanted, atol=1e-12)
    x[3:7] *= 1.4
    wanted = central_differences(dynamics.feet_positions, x, 1e-6)
    np.testing.assert_allclose(dynamics.feet_jacobian(x), wanted, atol=1e-8)


def test_forces_on_the_feet_that_carry_the_weight_hold_the_body_as_contact_does(small_walker):
    contact = ReducedDynamics(small_walker, H, Terrain())
    rest = contact.rest_state()
    touching = contact.contacts(rest)
    surface = contact.surface(rest)
    nearest = [int(np.argmin(((surface - p) ** 2).sum(1))) for p in touching.points]
    feet = Feet(tuple(small_walker.surface[[i]] for i in nearest))
    forced = ReducedDynamics(small_walker, H).with_feet(feet)
    x_next = forced.step_forced(rest, np.zeros(small_walker.n_modes), touching.forces)
    np.testing.assert_allclose(x_next, rest, atol=1e-8)


# --- against the full FEM


@pytest.fixture(scope="module")
def supple_walker() -> Body:
    """Return `small_walker` with 12 modes: braking bends its legs beyond the first 6."""
    options = BodyOptions(
        vertices=450, modes=12, basis=40, samples=16, drag_error=0.3, amplitude=1.0, medium=AIR
    )
    return build_body(ASSETS / "quadruped.obj", options, name="supple walker")


@pytest.mark.parametrize(
    ("walker", "speed", "centre", "shape"),
    [("small_walker", 0.0, 0.015, 0.01), ("supple_walker", 1.0, 0.015, 0.01)],
    ids=["dropped", "thrown"],
)
def test_a_body_in_contact_follows_the_full_fem(walker, speed, centre, shape, request):
    body = request.getfixturevalue(walker)
    terrain = Terrain(slip_speed=0.05)
    # implicit Euler takes the bounce, which is a matter of the subspace: what is compared is contact
    euler: dict[str, Any] = {"integrator": "implicit-euler", "substeps": 1}
    reduced = ReducedDynamics(body, H, terrain, **euler)
    full = FullFem(body, H, False, terrain, **euler)
    x0 = reduced.rest_state()
    r = body.n_modes
    x0[7 : 7 + r], x0[2] = 0.0, 0.1 - body.vertices[:, 2].min()
    x0[7 + r] = speed
    target = np.zeros((16, r))
    states = reduced.rollout(x0, target)
    start = full.at(target[0], position=x0[:3], velocity=x0[7 + r : 10 + r])
    path = np.array([state.now for state in full.rollout(start, target)])
    centres = np.einsum("v,nvi->ni", body.vertex_mass / body.mass, path)
    assert max(len(reduced.contacts(x).points) for x in states) > 2
    np.testing.assert_allclose(states[:, :3], centres, atol=centre * body.length)
    if speed:  # it slides, and is braked
        assert centres[-1, 0] - centres[0, 0] < 0.4 * speed * len(target) * H
    bent = np.array([reduced.surface(x) - x[:3] for x in states])
    truth = path[:, body.surface] - centres[:, None]
    swing = np.abs(truth - truth[0]).max()
    error = np.sqrt(((bent - truth) ** 2).sum(2).mean(1)).max()
    assert error < shape * body.length
    assert swing > error


# --- robustness


def gaits(rng: np.random.Generator, amplitude: np.ndarray, steps: int) -> np.ndarray:
    """Each mode swings through 20% to 100% of its amplitude, 1 to 3 times in 23 steps."""
    r = len(amplitude)
    rate = rng.integers(1, 4, r) * 2 * np.pi / 23
    phase, size = rng.uniform(0, 2 * np.pi, r), rng.uniform(0.2, 1.0, r)
    return amplitude * size * np.sin(np.arange(steps)[:, None] * rate + phase)


def jumps(rng: np.random.Generator, amplitude: np.ndarray, steps: int) -> np.ndarray:
    """Every step each mode's target is at one end or the other of its amplitude, with 10% noise."""
    size = (steps, len(amplitude))
    return amplitude * (rng.choice([-1.0, 1.0], size) + 0.1 * rng.normal(size=size))


def shake(dynamics: ReducedDynamics, steps: int, seed: int, inputs, run: int = 500) -> None:
    """Falls from 1 m at any attitude, with 1 m/s and 1 rad/s, then `inputs`: every solve must succeed."""
    rng, r = np.random.default_rng(seed), dynamics.body.n_modes
    for _ in range(steps // run):
        x0 = np.zeros(dynamics.nx)
        x0[2], x0[3:7] = 1.0, random_quaternion(rng)
        x0[7 + r : 13 + r] = rng.normal(size=6)
        states, failed = dynamics.rollout_count(x0, inputs(rng, dynamics.body.amplitude, run))
        assert failed == 0
        assert np.isfinite(states).all()


@pytest.mark.parametrize("inputs", [gaits, jumps])
def test_no_solve_fails_under_vigorous_random_motion(small_walker, inputs):
    shake(ReducedDynamics(small_walker, H, Terrain()), 3000, 1, inputs)


def test_no_solve_fails_on_rough_ground(small_walker):
    ground = mixed_terrain(np.random.default_rng(0))
    shake(ReducedDynamics(small_walker, H, ground), 1500, 1, gaits)


@pytest.mark.slow
@pytest.mark.parametrize(("inputs", "steps"), [(gaits, 1_000_000), (jumps, 200_000)])
def test_a_million_steps_of_vigorous_random_motion_never_fail(small_walker, inputs, steps):
    shake(ReducedDynamics(small_walker, H, Terrain()), steps, 2, inputs)


def test_contact_points_reach_as_far_as_the_surface_for_any_attitude(small_walker):
    chosen = contact_points(small_walker)
    np.testing.assert_array_equal(chosen, contact_points(small_walker))
    rng = np.random.default_rng(12)
    surface = small_walker.vertices[small_walker.surface]
    directions = rng.normal(size=(300, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    heights = surface @ directions.T
    assert (heights.max(0) - heights[chosen].max(0)).max() < 0.01 * small_walker.length


@pytest.mark.parametrize(
    ("terrain", "message"),
    [
        (Terrain((TerrainGeom("cone"),)), "shape 'cone'"),
        (Terrain((TerrainGeom("box", (1.0,)),)), "3 positive numbers"),
        (Terrain(friction=-1.0), "friction"),
        (Terrain(thickness=0.0), "thickness"),
        (Terrain((), Heightfield(np.zeros(3), (1.0, 1.0))), "grid"),
    ],
)
def test_terrain_that_cannot_be_is_refused(terrain, message):
    with pytest.raises(DefplanError, match=message):
        pack_terrain(terrain, block((0.1, 0.1, 0.1), AIR))


def test_feet_that_cannot_be_are_refused(small_walker):
    with pytest.raises(DefplanError, match="feet"):
        ReducedDynamics(small_walker, H, feet=Feet(()))
    with pytest.raises(DefplanError, match="not the body's"):
        ReducedDynamics(small_walker, H, feet=Feet((np.array([100_000]),)))
