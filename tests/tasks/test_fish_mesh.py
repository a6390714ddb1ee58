"""The fish's surface: sound, symmetric, one metre long, and the asset is what the generator writes."""

from __future__ import annotations

import numpy as np
import trimesh

from defplan_mj.body.surface import check_surface
from defplan_tasks.fish_mesh import ASSET, fish_mesh, write_fish


def test_surface_is_sound_and_outward():
    vertices, faces = fish_mesh()
    surface = check_surface(vertices, faces, "fish")
    assert 1000 <= len(surface.faces) <= 2500
    assert 0.012 < surface.volume < 0.02
    assert trimesh.Trimesh(vertices, faces, process=False).euler_number == 2


def test_fish_is_one_metre_long_with_its_head_forward_and_fins_upright():
    vertices, _ = fish_mesh()
    size = np.ptp(vertices, axis=0)
    assert size[0] == size.max() and abs(size[0] - 1.0) < 1e-9
    assert size[1] < 0.6 * size[2]  # flat sideways
    tail = vertices[vertices[:, 0] < -0.4]
    head = vertices[vertices[:, 0] > 0.35]
    assert np.ptp(tail[:, 1]) < 0.15 * np.ptp(tail[:, 2])  # the tail fin stands in the x-z plane
    assert np.ptp(head[:, 1]) > 0.5 * np.ptp(head[:, 2])
    assert vertices[:, 2].max() > -vertices[:, 2].min() + 0.02  # the back carries a fin


def test_left_and_right_mirror_each_other():
    vertices, faces = fish_mesh()
    order = np.lexsort(np.round(vertices, 9).T)
    mirrored = vertices * [1.0, -1.0, 1.0]
    twin = np.lexsort(np.round(mirrored, 9).T)
    np.testing.assert_allclose(vertices[order], mirrored[twin], atol=1e-9)
    # the triangles, too: mirrored ones are triangles of the mesh
    image = np.empty(len(vertices), int)
    image[twin] = order
    triangles = {tuple(sorted(t)) for t in faces}
    assert all(tuple(sorted(image[t])) in triangles for t in faces)


def test_asset_is_what_the_generator_writes(tmp_path):
    assert write_fish(tmp_path / "fish.obj").read_bytes() == ASSET.read_bytes()
