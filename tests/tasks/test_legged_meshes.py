"""The 4-legged and the T-shaped surface: sound, symmetric, one metre, standing; assets as generated."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from defplan_mj.body.surface import check_surface
from defplan_tasks import quadruped_mesh, surfaces, tee_mesh

MESHES = {
    "quadruped": (quadruped_mesh.quadruped_mesh, quadruped_mesh.write_quadruped, quadruped_mesh),
    "tee": (tee_mesh.tee_mesh, tee_mesh.write_tee, tee_mesh),
}


@pytest.fixture(params=MESHES, scope="module")
def mesh(request):
    return (*MESHES[request.param][0](), *MESHES[request.param][1:])


def test_surface_is_sound_outward_and_one_metre(mesh):
    vertices, faces, *_ = mesh
    surface = check_surface(vertices, faces, "body")
    solid = trimesh.Trimesh(vertices, faces, process=False)
    assert solid.is_watertight and solid.euler_number == 2 and surface.volume > 0.05
    assert np.ptp(vertices, axis=0).max() == pytest.approx(1.0)


def test_sides_mirror_each_other(mesh):
    vertices, *_ = mesh
    points = {tuple(p) for p in np.round(vertices, 6) + 0.0}
    for mirror in ([-1, 1, 1], [1, -1, 1]):
        assert {tuple(p) for p in np.round(vertices * mirror, 6) + 0.0} == points


def test_it_stands_on_feet_around_its_centre_of_mass(mesh):
    vertices, faces, *_ = mesh
    centre = trimesh.Trimesh(vertices, faces, process=False).center_mass
    ground = vertices[vertices[:, 2] < vertices[:, 2].min() + 0.02]
    low, high = ground[:, :2].min(0), ground[:, :2].max(0)
    assert (low < centre[:2] - 0.1).all() and (high > centre[:2] + 0.1).all()
    assert not (np.abs(ground[:, 0] - centre[0]) < 0.1).any()  # feet, no belly


def test_asset_is_what_the_generator_writes(mesh, tmp_path):
    _, _, write, module = mesh
    assert write(tmp_path / "made.obj").read_bytes() == module.ASSET.read_bytes()


def test_surface_net_of_a_ball_has_its_volume():
    vertices, faces = surfaces.surface_net(lambda p: np.linalg.norm(p, axis=1) - 0.4, 0.02, 0.5)
    ball = trimesh.Trimesh(vertices, faces, process=False)
    assert ball.is_watertight and ball.euler_number == 2
    assert ball.volume == pytest.approx(4 / 3 * np.pi * 0.4**3, rel=0.01)
