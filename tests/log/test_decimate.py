"""A coarser surface is made of the body's own vertices and keeps its extent and orientation."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from defplan_mj.log.decimate import decimate


@pytest.fixture(scope="module")
def surface():
    mesh = trimesh.creation.icosphere(subdivisions=4)
    mesh.apply_scale([0.5, 0.1, 0.2])
    # vertices inside, which no face uses, as those of a tetrahedral mesh
    points = np.vstack([np.zeros((7, 3)), mesh.vertices])
    return points, np.asarray(mesh.faces) + 7


@pytest.mark.parametrize("wanted", [50, 300, 1000])
def test_faces_are_at_most_as_many_as_wanted_and_not_far_fewer(surface, wanted):
    points, faces = surface
    kept, coarse = decimate(points, faces, wanted)
    assert 0.6 * wanted < len(coarse) <= wanted
    assert len(np.unique(kept)) == len(kept) and kept.min() >= 7
    assert set(np.unique(coarse)) == set(range(len(kept)))
    assert all(len(set(face)) == 3 for face in coarse.tolist())


def test_extent_and_orientation_stay(surface):
    points, faces = surface
    kept, coarse = decimate(points, faces, 600)
    fine, rough = np.ptp(points, axis=0), np.ptp(points[kept], axis=0)
    assert (rough > 0.9 * fine).all()
    corners = points[kept][coarse]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    outward = np.einsum("fi,fi->f", normal, corners.mean(1) / np.array([0.5, 0.1, 0.2]) ** 2) > 0
    assert outward.mean() > 0.98


def test_a_small_surface_is_kept_whole(surface):
    points, faces = surface
    kept, same = decimate(points, faces, len(faces))
    np.testing.assert_array_equal(kept[same], faces)
