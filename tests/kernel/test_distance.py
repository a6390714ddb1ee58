"""Distances of points and of the deformed surface to MuJoCo's primitive geoms, against MuJoCo and numpy."""

from __future__ import annotations

import ctypes

import mujoco
import numpy as np
import pytest

from defplan_mj.dynamics.reduced import ReducedDynamics
from defplan_mj.kernel.library import Geom, kernel
from tests.samples.kernel_cases import matrix, random_quaternion, random_state

SIZES = {
    "plane": (1.0, 1.0, 1.0),
    "sphere": (0.7, 0.0, 0.0),
    "capsule": (0.4, 0.8, 0.0),
    "ellipsoid": (0.9, 0.35, 0.6),
    "cylinder": (0.5, 0.7, 0.0),
    "box": (0.5, 0.3, 0.8),
}
NAMES = list(SIZES)
TYPES = {name: int(getattr(mujoco.mjtGeom, f"mjGEOM_{name.upper()}")) for name in NAMES}


def make_geom(name: str, pos=(0.0, 0.0, 0.0), mat=None) -> Geom:
    mat = np.eye(3) if mat is None else mat
    return Geom(TYPES[name], SIZES[name], tuple(pos), tuple(np.ravel(mat)))


def distance(geom: Geom, point) -> tuple[float, np.ndarray]:
    normal = np.empty(3)
    value = kernel().dp_geom_distance(ctypes.byref(geom), np.array(point, float), normal)
    return value, normal


def random_placement(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    return rng.normal(size=3), matrix(random_quaternion(rng))


@pytest.mark.parametrize("name", NAMES)
def test_distance_outside_equals_mujocos_to_a_tiny_sphere(name):
    radius = 1e-4
    rng = np.random.default_rng(0)
    pos, mat = random_placement(rng)
    quat = np.empty(4)
    mujoco.mju_mat2Quat(quat, mat.ravel())
    spec = mujoco.MjSpec()
    spec.worldbody.add_geom(name="solid", type=TYPES[name], size=SIZES[name], pos=pos, quat=quat)
    probe = spec.worldbody.add_body(name="probe", mocap=True)
    probe.add_geom(name="probe", type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[radius, 0, 0])
    model = spec.compile()
    model.opt.ccd_tolerance, model.opt.ccd_iterations = 1e-10, 500
    data = mujoco.MjData(model)
    geom = make_geom(name, pos, mat)
    seen = 0
    while seen < 100:
        point = pos + rng.normal(size=3)
        value, _ = distance(geom, point)
        if value < 0.01:
            continue
        seen += 1
        data.mocap_pos[0] = point
        mujoco.mj_forward(model, data)
        solid, ball = model.geom("solid").id, model.geom("probe").id
        wanted = mujoco.mj_geomDistance(model, data, solid, ball, 100.0, None) + radius
        # MuJoCo searches the ellipsoid's iteratively; ours is held to 1e-8 below
        np.testing.assert_allclose(value, wanted, atol=1e-3 if name == "ellipsoid" else 2e-6)


def surface_points(name: str, rng: np.random.Generator, n: int) -> np.ndarray:
    """Points on the solid's surface in its own frame, dense enough to bound any distance."""
    a, b, c = SIZES[name]
    unit = rng.normal(size=(n, 3))
    unit /= np.linalg.norm(unit, axis=1, keepdims=True)
    angle, along = rng.uniform(0, 2 * np.pi, n), rng.uniform(-1, 1, n)
    ring = np.stack([np.cos(angle), np.sin(angle), np.zeros(n)], axis=1)
    up = np.array([0.0, 0.0, 1.0])
    if name == "sphere":
        return a * unit
    if name == "ellipsoid":
        return unit * [a, b, c]
    if name == "capsule":
        caps = a * unit + b * np.sign(unit[:, 2:]) * up
        return np.concatenate([caps, a * ring + b * along[:, None] * up])
    if name == "cylinder":
        disc = a * np.sqrt(rng.uniform(0, 1, n))[:, None] * ring
        lids = disc + b * np.sign(along)[:, None] * up
        return np.concatenate([lids, a * ring + b * along[:, None] * up])
    box = rng.uniform(-1, 1, (n, 3))
    box[np.arange(n), rng.integers(3, size=n)] = np.sign(along)
    return box * [a, b, c]


def inside(name: str, p: np.ndarray) -> bool:
    a, b, c = SIZES[name]
    rho = np.hypot(p[0], p[1])
    if name == "sphere":
        return bool(np.linalg.norm(p) < a)
    if name == "ellipsoid":
        return bool(((p / [a, b, c]) ** 2).sum() < 1)
    if name == "capsule":
        return bool(np.hypot(rho, max(0.0, abs(p[2]) - b)) < a)
    if name == "cylinder":
        return bool(rho < a and abs(p[2]) < b)
    return bool((np.abs(p) < [a, b, c]).all())


@pytest.mark.parametrize("name", NAMES[1:])
def test_distance_inside_and_outside_is_the_one_to_the_nearest_surface_point(name):
    rng = np.random.default_rng(1)
    cloud = surface_points(name, rng, 200_000)
    geom = make_geom(name)
    points = rng.uniform(-1.2, 1.2, (150, 3))
    signs = set()
    for point in points:
        value, _ = distance(geom, point)
        wanted = np.sqrt(((cloud - point) ** 2).sum(1).min())
        assert (value < 0) == inside(name, point)
        # no sample is nearer than the truth; the nearest lies within the samples' spacing
        assert -1e-9 <= wanted - abs(value) <= 0.015
        signs.add(value < 0)
    assert signs == {True, False}


@pytest.mark.parametrize("name", NAMES)
def test_normal_is_the_gradient_of_the_distance(name):
    rng = np.random.default_rng(2)
    pos, mat = random_placement(rng)
    geom, eps = make_geom(name, pos, mat), 1e-6
    compared = 0
    for _ in range(200):
        point = pos + mat @ rng.uniform(-1.2, 1.2, 3)
        _, normal = distance(geom, point)
        assert np.linalg.norm(normal) == pytest.approx(1.0, abs=1e-12)
        sides = [[distance(geom, point + s * eps * unit)[1] for s in (-1, 1)] for unit in np.eye(3)]
        if np.abs(np.array(sides) - normal).max() > 1e-3:
            continue  # across an edge of the distance's regions it has no gradient
        difference = [
            (distance(geom, point + eps * unit)[0] - distance(geom, point - eps * unit)[0])
            / (2 * eps)
            for unit in np.eye(3)
        ]
        np.testing.assert_allclose(normal, difference, atol=1e-6)
        compared += 1
    assert compared > 150


SPECIAL = [  # geom, point in its frame, distance
    ("plane", (3.0, -2.0, -0.25), -0.25),
    ("sphere", (0.0, 0.0, 0.0), -0.7),
    ("capsule", (0.0, 0.0, 0.0), -0.4),
    ("capsule", (0.0, 0.0, 0.8), -0.4),
    ("capsule", (0.0, 0.0, 1.5), 0.3),
    ("cylinder", (0.0, 0.0, 0.0), -0.5),
    ("cylinder", (0.0, 0.0, 0.6), -0.1),
    ("cylinder", (0.0, 0.0, -1.0), 0.3),
    ("cylinder", (0.8, 0.0, 1.1), 0.5),
    ("cylinder", (0.5, 0.0, 0.7), 0.0),
    ("box", (0.0, 0.0, 0.0), -0.3),
    ("box", (0.5, 0.3, 0.8), 0.0),
    ("box", (0.6, 0.5, 1.0), 0.3),
    ("box", (0.0, 0.0, 0.75), -0.05),
    ("ellipsoid", (0.0, 0.0, 0.0), -0.35),
    ("ellipsoid", (1.0, 0.0, 0.0), 0.1),
    ("ellipsoid", (0.0, 0.35, 0.0), 0.0),
    ("ellipsoid", (0.0, 0.0, 0.6), 0.0),
    ("ellipsoid", (0.0, 0.3, 0.0), -0.05),
]


@pytest.mark.parametrize(("name", "point", "wanted"), SPECIAL)
def test_distance_of_points_on_axes_faces_and_corners(name, point, wanted):
    value, normal = distance(make_geom(name), point)
    assert value == pytest.approx(wanted, abs=1e-9)
    assert np.isfinite(normal).all()
    assert np.linalg.norm(normal) == pytest.approx(1.0, abs=1e-9)


@pytest.mark.parametrize(
    "sizes", [(0.9, 0.35, 0.6), (0.5, 0.5, 0.2), (0.4, 0.4, 0.4), (2.0, 0.1, 0.1)]
)
def test_distance_to_ellipsoids_of_any_proportion(sizes):
    """The nearest point q has its normal along p - q: built from q outwards, and inwards while unique."""
    rng = np.random.default_rng(3)
    geom = Geom(TYPES["ellipsoid"], sizes, (0.0, 0.0, 0.0), tuple(np.eye(3).ravel()))
    axes = np.array(sizes)
    least_radius = axes.min() ** 2 / axes.max()  # of curvature
    for _ in range(200):
        unit = rng.normal(size=3)
        unit /= np.linalg.norm(unit)
        if rng.random() < 0.3:
            unit[rng.integers(3)] = 0.0
            unit /= np.linalg.norm(unit)
        nearest = axes * unit
        normal = unit / axes
        normal /= np.linalg.norm(normal)
        for wanted in (2.0, 0.1, 1e-7, -0.9 * least_radius):
            value, direction = distance(geom, nearest + wanted * normal)
            assert value == pytest.approx(wanted, abs=1e-8)
            np.testing.assert_allclose(direction, normal, atol=1e-5)


def test_a_type_that_is_none_of_them_is_infinitely_far():
    geom = Geom(int(mujoco.mjtGeom.mjGEOM_MESH), (1, 1, 1), (0, 0, 0), tuple(np.eye(3).ravel()))
    assert distance(geom, (0.0, 0.0, 0.0))[0] == np.inf


def test_clearance_is_the_least_distance_of_all_surface_points(small_fish):
    dynamics = ReducedDynamics(small_fish)
    rng = np.random.default_rng(4)
    found = 0
    for _ in range(40):
        x = random_state(dynamics, rng)
        placed = [(name, *random_placement(rng)) for name in rng.choice(NAMES[1:], 3)]
        geoms = (Geom * 3)(*(make_geom(n, x[:3] + 1.2 * p, m) for n, p, m in placed))
        surface = dynamics.surface(x)
        table = np.array([[distance(g, p)[0] for p in surface] for g in geoms])
        cutoff = 0.5
        index, point = ctypes.c_int(), ctypes.c_int()
        value = kernel().dp_clearance(
            dynamics.blob, x, 3, geoms, cutoff, ctypes.byref(index), ctypes.byref(point)
        )
        if table.min() < cutoff:
            assert value == table.min()
            assert table[index.value, point.value] == value
            found += 1
        else:
            assert value == cutoff
            assert (index.value, point.value) == (-1, -1)
    assert 5 < found < 40
