"""Frames: turns, attitudes, and directions spread over the circle and the sphere."""

import numpy as np
import pytest
from scipy.spatial import SphericalVoronoi
from scipy.spatial.transform import Rotation

from defplan_mj.base.rotations import level_attitude
from defplan_mj.planning.frames import (
    attitude_frames,
    random_attitudes,
    random_directions,
    renewed,
    spread_directions,
    turns,
)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_turns_are_the_rotations_that_scipy_makes(dtype):
    vectors = np.random.default_rng(0).normal(0, 1.5, (200, 3)).astype(dtype)
    vectors[:3] = [[0, 0, 0], [1e-7, 0, 0], [0, 3e-4, -2e-4]]
    made = turns(vectors)
    assert made.dtype == dtype
    assert np.allclose(made, Rotation.from_rotvec(vectors).as_matrix(), atol=2e-6)
    assert np.allclose(
        turns(np.array([[0.3]])), [[[np.cos(0.3), -np.sin(0.3)], [np.sin(0.3), np.cos(0.3)]]]
    )


def test_the_frame_of_an_attitude_is_its_heading_in_the_plane_and_all_of_it_in_space():
    tilted = Rotation.from_euler("ZYX", [[0.7, 0.3, -0.2], [-2.5, -0.4, 0.6]])
    quaternions = tilted.as_quat(scalar_first=True)
    assert np.allclose(attitude_frames(quaternions, 3), tilted.as_matrix())
    assert np.allclose(attitude_frames(quaternions, 2), turns(np.array([[0.7], [-2.5]])))
    assert np.allclose(
        attitude_frames(level_attitude(np.array([0.7])), 2), turns(np.array([[0.7]]))
    )


@pytest.mark.parametrize("dimension", [2, 3])
def test_renewed_frames_are_the_nearest_orthonormal_ones(dimension):
    generator = np.random.default_rng(1)
    exact = attitude_frames(random_attitudes(generator, 50, dimension), dimension)
    spoilt = exact + generator.normal(0, 1e-4, exact.shape)
    u, _, vt = np.linalg.svd(spoilt)
    assert np.allclose(renewed(spoilt), u @ vt, atol=1e-7)


@pytest.mark.parametrize("dimension", [2, 3])
def test_random_directions_and_attitudes_prefer_none(dimension):
    generator = np.random.default_rng(2)
    n = 20_000
    forward = attitude_frames(random_attitudes(generator, n, dimension), dimension)[:, :, 0]
    for vectors in (random_directions(generator, n, dimension), forward):
        assert np.allclose(np.linalg.norm(vectors, axis=1), 1)
        # Of an even distribution mean and covariance are 0 and 1/d, to a few standard errors.
        assert np.abs(vectors.mean(0)).max() < 5 / np.sqrt(dimension * n)
        assert np.abs(vectors.T @ vectors / n - np.eye(dimension) / dimension).max() < 0.02


@pytest.mark.parametrize("n", [1, 2, 10, 30, 100])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_spread_directions_keep_their_distance_on_the_sphere(n, seed):
    directions = spread_directions(n, 3, np.random.default_rng(seed))
    assert directions.shape == (n, 3) and np.allclose(np.linalg.norm(directions, axis=1), 1)
    if n < 10:
        return
    cosine = directions @ directions.T - 2 * np.eye(n)
    packed = np.sqrt(8 * np.pi / (np.sqrt(3) * n))  # of a hexagonal packing, rad
    assert np.arccos(cosine.max()) > 0.5 * packed
    # No hole: random directions leave cells many times the mean.
    areas = SphericalVoronoi(directions).calculate_areas() * n / (4 * np.pi)
    assert areas.max() < 2.5


def test_spread_directions_belong_to_the_seed_and_are_even_in_the_plane():
    first, again, other = (spread_directions(30, 3, np.random.default_rng(s)) for s in (0, 0, 1))
    assert np.array_equal(first, again) and not np.array_equal(first, other)
    square = spread_directions(4, 2, np.random.default_rng(0))
    assert np.allclose(square, [[1, 0], [0, 1], [-1, 0], [0, -1]])
