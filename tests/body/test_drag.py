"""Drag points: their force against direct sums over all triangles, their symmetry, their areas."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from defplan_mj.body.build import build_body
from defplan_mj.body.check import reduced_vertices
from defplan_mj.body.cubature import drag_points
from defplan_mj.body.drag import DragPoints, SurfaceFields, forces
from defplan_mj.body.mirror import mirror_axes, nearest_places, signs
from defplan_mj.body.model import Material, Medium
from defplan_mj.body.motions import moments_of, swimming_motions
from defplan_mj.body.tetmesh import TetMesh
from defplan_mj.dynamics.reduced import ReducedDynamics
from defplan_mj.task import BodyOptions
from tests.samples.meshes import bar, pill

OPTIONS = BodyOptions(
    vertices=240, modes=4, basis=16, samples=10, drag_error=0.05, material=Material(800.0)
)


@pytest.fixture(scope="module")
def body(tmp_path_factory):
    path = tmp_path_factory.mktemp("mesh") / "pill.stl"
    pill(3).export(path)
    return build_body(path, OPTIONS)


@pytest.fixture(scope="module")
def surface(body):
    shapes = np.concatenate([body.vertices[:, :, None], body.basis], axis=2)
    return SurfaceFields(TetMesh(body.vertices, body.tetrahedra), shapes)


def taken(body):
    return DragPoints(body.drag_points, body.drag_tangents, body.drag_areas)


def moment(body, seed):
    rng, r = np.random.default_rng(seed), body.n_modes
    attitude = np.eye(3)[None]
    return moments_of(
        body,
        0.5 * rng.normal(size=(1, r)),
        3.0 * rng.normal(size=(1, r)),
        rng.normal(size=(1, 3)),
        2.0 * rng.normal(size=(1, 3)),
        attitude,
    )


def test_force_of_all_triangles_is_the_direct_sum_over_the_moved_mesh(body, surface):
    rng = np.random.default_rng(3)
    q, rate = 0.5 * rng.normal(size=4), 3.0 * rng.normal(size=4)
    velocity, spin = rng.normal(size=3), 2.0 * rng.normal(size=3)
    now = moments_of(body, q[None], rate[None], velocity[None], spin[None], np.eye(3)[None])
    h = 1e-6
    place = reduced_vertices(body, q)[0]
    change = (reduced_vertices(body, q + h * rate) - reduced_vertices(body, q - h * rate))[0] / (
        2 * h
    )
    speed = change + velocity + np.cross(spin, place)
    slopes = np.stack(
        [
            (reduced_vertices(body, q + h * e) - reduced_vertices(body, q - h * e))[0] / (2 * h)
            for e in np.eye(4)
        ],
        axis=-1,
    )
    medium, expected = body.medium, np.zeros(10)
    for i, j, k in body.faces:
        a = 0.5 * np.cross(place[j] - place[i], place[k] - place[i])
        p, v = (x[[i, j, k]].mean(0) for x in (place, speed))
        normal = v @ a
        f = -0.5 * medium.density * medium.drag_normal * abs(normal) * normal * a / (a @ a)
        size = np.linalg.norm(a) * np.sqrt(v @ v + 1e-4)
        f = f - 0.5 * medium.density * medium.drag_tangential * size * v
        expected += np.concatenate([f, np.cross(p, f), f @ slopes[[i, j, k]].mean(0)])
    found = forces(surface.triangles(), medium, now).sum(1)[0]
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-6 * np.abs(expected).max())


def test_force_at_a_point_is_that_of_the_kernel(body):
    """The change of momentum in one small step is the drag's impulse."""
    dynamics = ReducedDynamics(body, 1e-5)
    x = dynamics.rest_state()
    x[11:14], x[14:17] = [0.7, -0.4, 0.3], [0.5, 1.0, -0.8]
    after = dynamics.step(x, np.zeros(4))
    still = np.zeros((1, 4))
    now = moments_of(body, still, still, x[None, 11:14], x[None, 14:17], np.eye(3)[None])
    force = forces(taken(body), body.medium, now).sum(1)[0, :3]
    change = body.mass * (after[11:14] - x[11:14]) / 1e-5
    np.testing.assert_allclose(change, force, rtol=2e-3, atol=2e-3 * np.abs(force).max())


def test_error_that_the_file_states_holds_on_other_motions(body, surface):
    stated = body.source["drag"]
    assert stated["error"] <= OPTIONS.drag_error and stated["area_error"] <= 0.02
    assert stated["points"] == len(body.drag_areas) < len(body.faces) / 3
    motion = swimming_motions(body, taken(body), 30, 6, np.random.default_rng(99))
    whole = forces(surface.triangles(), body.medium, motion).sum(1)
    few = forces(taken(body), body.medium, motion).sum(1)
    scale = np.sqrt((whole**2).mean(0))
    error = np.linalg.norm((few - whole) / scale) / np.linalg.norm(whole / scale)
    assert error < 1.5 * OPTIONS.drag_error


def test_projected_areas_are_those_of_the_mesh(body):
    mesh = trimesh.Trimesh(body.vertices, body.faces, process=False)
    unit = np.cross(body.drag_tangents[0], body.drag_tangents[1], axis=1)[:, :, 0]
    np.testing.assert_allclose(np.linalg.norm(unit, axis=1), 1.0)
    directions = np.random.default_rng(1).normal(size=(100, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    expected = np.abs(mesh.face_normals @ directions.T).T @ mesh.area_faces
    found = np.abs(unit @ directions.T).T @ body.drag_areas
    np.testing.assert_allclose(found, expected, rtol=0.02)
    assert body.drag_areas.sum() == pytest.approx(mesh.area, rel=0.02)
    closure = body.drag_areas @ unit
    assert np.abs(closure).max() < 0.02 * expected.mean()
    outward = np.einsum("pi,pi->p", unit, body.drag_points[:, :, 0])
    assert (outward > 0.0).all()  # the pill is convex


def test_points_and_drag_of_a_symmetric_body_are_symmetric(body):
    assert body.source["drag"]["mirrors"] == "yx"
    unit = np.cross(body.drag_tangents[0], body.drag_tangents[1], axis=1)[:, :, 0]
    place = np.hstack([body.drag_points[:, :, 0], unit, body.drag_areas[:, None]])
    for axis in (0, 1):
        mirror = np.ones(7)
        mirror[[axis, 3 + axis]] = -1.0
        gap = np.linalg.norm(place[:, None] - (place * mirror)[None], axis=2).min(1)
        assert gap.max() < 0.01 * body.length  # as far as the mesh itself is symmetric
        # the rest shape, carried along and across: forces are mirror images
        still = np.zeros((2, 4))
        v = np.array([[0.6, 0.3, -0.2]] * 2)
        v[1, axis] *= -1.0
        now = moments_of(body, still, still, v, np.zeros((2, 3)), np.stack([np.eye(3)] * 2))
        force = forces(taken(body), body.medium, now).sum(1)[:, :3]
        flipped = force[1] * mirror[:3]
        np.testing.assert_allclose(flipped, force[0], atol=1e-9 * np.abs(force).max())


def test_a_smaller_bound_takes_more_points_and_a_cap_is_kept(body):
    some, error = drag_points(body, 0.3, 512)
    capped, reached = drag_points(body, 0.01, 24)
    assert len(some) < len(body.drag_areas)
    assert len(capped) == reached.points <= 24
    assert reached.error > 0.01  # and says so
    assert error.error <= 0.3


def test_mirrors_of_a_body_are_found():
    box = bar((6, 4, 3), (1.0, 0.4, 0.3))
    assert mirror_axes(box.vertices, box.tetrahedra) == (1, 0)
    slanted = box.vertices.copy()
    slanted[:, 1] += 0.1 * slanted[:, 0]
    assert mirror_axes(slanted, box.tetrahedra) == ()
    tapered = box.vertices.copy()
    tapered[:, 1:] *= (1.0 + 0.5 * tapered[:, 0])[:, None]
    tapered[:, 0] += 0.05
    assert mirror_axes(tapered, box.tetrahedra) == (1,)
    np.testing.assert_array_equal(signs((1,)), [[1, 1, 1], [1, -1, 1]])


def test_nearest_place_is_the_nearest_of_a_dense_sample():
    ball = pill(2)
    points = np.random.default_rng(0).normal(size=(40, 3)) * [0.5, 0.3, 0.2]
    places = nearest_places(ball.vertices, ball.faces, points)
    corners = ball.vertices[ball.faces[places.triangles]]
    found = np.einsum("mc,mci->mi", places.weights, corners)
    np.testing.assert_allclose(np.linalg.norm(found - points, axis=1), places.distances)
    dense = trimesh.sample.sample_surface(ball, 60000, seed=1)[0]
    near = np.linalg.norm(dense[None] - points[:, None], axis=2).min(1)
    assert (places.distances <= near + 1e-12).all()
    np.testing.assert_allclose(places.distances, near, atol=0.01)


def test_still_water_of_no_drag_needs_no_force(body):
    now = moment(body, 1)
    assert not forces(taken(body), Medium(drag_normal=0.0, drag_tangential=0.0), now).any()
