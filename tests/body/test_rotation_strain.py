"""Rotation-strain coordinates: exact for rotations, tangent to the modes, and keeping volume."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm

from defplan_mj.body.rotation_strain import (
    RotationStrain,
    affine_coordinates,
    deformation,
    exponential,
    shape_coordinates,
)
from defplan_mj.body.tetmesh import TetMesh, volumes
from tests.samples.meshes import bar, unreduced_body


@pytest.fixture(scope="module")
def body():
    return unreduced_body(bar((8, 2, 2), (1.0, 0.2, 0.15)), modes=3)


@pytest.fixture(scope="module")
def exact(body):
    return RotationStrain(TetMesh(body.vertices, body.tetrahedra), body.vertex_mass, body.modes)


def _skew(w):
    return np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]])


def test_exponential_agrees_with_the_matrix_exponential():
    rng = np.random.default_rng(0)
    for size in (0.0, 1e-9, 1e-5, 1e-3, 0.5, 3.0, 7.0):
        w = rng.normal(size=3)
        w *= size / np.linalg.norm(w)
        np.testing.assert_allclose(exponential(w), expm(_skew(w)), atol=1e-13)


def test_deformation_is_a_rotation_times_a_strain(body, exact):
    q = np.array([0.7, -0.4, 0.9])
    wanted = deformation(exact.features, q[None])[0]
    for tet in (0, 17, 90):
        w, (a, b, c, d, e, f) = np.split(exact.features[tet] @ q, [3])
        strain = np.array([[a, b, c], [b, d, e], [c, e, f]])
        expected = expm(_skew(w)) @ (np.eye(3) + strain) - np.eye(3)
        np.testing.assert_allclose(wanted[tet], expected, atol=1e-12)


def test_a_rotation_of_all_tetrahedra_turns_the_body(body, exact):
    rotation = expm(_skew([0.8, -1.1, 0.4]))
    wanted = np.broadcast_to(rotation - np.eye(3), (1, len(body.tetrahedra), 3, 3))
    turned = body.vertices + exact.nearest(wanted)[0]
    np.testing.assert_allclose(turned, body.vertices @ rotation.T, atol=1e-10)


def test_small_shapes_are_the_linear_modes(body, exact):
    for i in range(3):
        step = 1e-5 * np.eye(3)[i]
        slope = (exact.displacement(step) - exact.displacement(-step))[0] / 2e-5
        np.testing.assert_allclose(slope, body.modes[:, :, i], atol=1e-6)


def test_the_centre_of_mass_stays(body, exact):
    q = np.random.default_rng(1).uniform(-1.5, 1.5, (4, 3))
    moved = np.einsum("n,mni->mi", body.vertex_mass, exact.displacement(q))
    np.testing.assert_allclose(moved, 0.0, atol=1e-10 * body.mass)


def test_large_bends_keep_their_volume_and_linear_modes_do_not():
    body = unreduced_body(bar((20, 2, 2), (1.0, 0.05, 0.05)), modes=1)
    mesh = TetMesh(body.vertices, body.tetrahedra)
    exact = RotationStrain(mesh, body.vertex_mass, body.modes)
    q = np.array([3.0])  # 3 rad
    rest = volumes(body.vertices, body.tetrahedra).sum()
    bent = volumes(body.vertices + exact.displacement(q)[0], body.tetrahedra)
    linear = volumes(body.vertices + body.modes @ q, body.tetrahedra)
    assert bent.sum() / rest == pytest.approx(1.0, abs=0.02) and bent.min() > 0.0
    assert abs(linear.sum() / rest - 1.0) > 0.1


def test_the_reconstruction_minimises_the_distance_of_gradients(body, exact):
    q = np.array([[0.5, 1.0, -0.7]])
    wanted = deformation(exact.features, q)[0]
    best = exact.displacement(q)[0]

    def distance(u):
        edges = lambda x: (x[body.tetrahedra][:, 1:] - x[body.tetrahedra][:, :1]).transpose(0, 2, 1)  # noqa: E731
        gradient = edges(u) @ np.linalg.inv(edges(body.vertices))
        return exact.volumes @ ((gradient - wanted) ** 2).sum((1, 2))

    rng = np.random.default_rng(2)
    for _ in range(5):
        change = 1e-3 * rng.normal(size=best.shape)
        up, down = distance(best + change), distance(best - change)
        assert min(up, down) > distance(best)
        assert up == pytest.approx(down, rel=1e-6)  # the slope vanishes


def test_reduced_coordinates_are_the_weighted_deformation_of_the_sampled_tetrahedra(small_fish):
    q = 0.5 * np.random.default_rng(4).normal(size=(3, small_fish.n_modes))
    for shape, z in zip(q, shape_coordinates(small_fish, q), strict=True):
        parts = []
        for x in small_fish.feature_map @ shape:
            strain = x[[3, 4, 5, 4, 6, 7, 5, 7, 8]].reshape(3, 3)
            parts.append((expm(_skew(x[:3])) @ (np.eye(3) + strain) - np.eye(3)).ravel())
        np.testing.assert_allclose(
            z, small_fish.feature_weights @ np.concatenate(parts), atol=1e-12
        )
    np.testing.assert_array_equal(affine_coordinates(small_fish, q)[:, 0], 1)
