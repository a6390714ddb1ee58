"""A built body: its numbers against direct sums, its reduction against the exact map."""

from __future__ import annotations

import dataclasses

import meshio
import numpy as np
import pytest
import trimesh

from defplan_mj.base.errors import DefplanError
from defplan_mj.body.build import build_body, mode_scales
from defplan_mj.body.check import placed_vertices, reconstruction_error, reduced_vertices
from defplan_mj.body.model import Body, Material
from defplan_mj.body.rotation_strain import RotationStrain, feature_map
from defplan_mj.body.tetmesh import TetMesh, boundary
from defplan_mj.task import BodyOptions
from tests.samples.meshes import bar, pill

OPTIONS = BodyOptions(
    vertices=240,
    modes=4,
    basis=16,
    samples=10,
    drag_error=0.1,
    length=2.0,
    material=Material(800.0),
)


@pytest.fixture(scope="module")
def mesh_file(tmp_path_factory):
    path = tmp_path_factory.mktemp("mesh") / "pill.stl"
    pill(3).export(path)
    return path


@pytest.fixture(scope="module")
def body(mesh_file):
    return build_body(mesh_file, OPTIONS)


def test_size_mass_and_centre_are_those_of_the_surface(body):
    volume = pill(3).volume * 8.0
    assert abs(len(body.vertices) - 240) <= 2
    assert body.name == "pill"
    assert body.length == pytest.approx(2.0, rel=0.02)
    assert body.mass == pytest.approx(800.0 * volume, rel=0.02)
    np.testing.assert_allclose(body.vertex_mass @ body.vertices, 0.0, atol=1e-10 * body.mass)
    np.testing.assert_array_equal(body.faces, boundary(body.tetrahedra)[0])
    np.testing.assert_array_equal(body.surface, np.unique(body.faces))
    assert trimesh.Trimesh(body.vertices, body.faces).volume > 0.0


def test_basis_is_orthonormal_and_leaves_the_centre_of_mass(body):
    gram = np.einsum("n,nia,nib->ab", body.vertex_mass, body.basis, body.basis)
    np.testing.assert_allclose(gram, np.eye(16), atol=1e-12)
    moved = np.einsum("n,nik->ik", body.vertex_mass, body.basis)
    np.testing.assert_allclose(moved, 0.0, atol=1e-10 * np.sqrt(body.mass))


def test_moments_are_the_direct_sums(body):
    expected = np.zeros_like(body.moments)
    for v, m in enumerate(body.vertex_mass):
        phi = np.concatenate([body.vertices[v][:, None], body.basis[v]], axis=1)
        for a in range(17):
            expected[a] += m * np.einsum("i,jb->bij", phi[:, a], phi)
    np.testing.assert_allclose(body.moments, expected, atol=1e-10 * np.abs(expected).max())


def test_unit_of_q_is_a_radian_or_a_strain_of_two_fifths(body):
    features = feature_map(TetMesh(body.vertices, body.tetrahedra), body.modes)
    np.testing.assert_allclose(mode_scales(features), 1.0)
    for i in range(4):
        turn, strain = [], []
        for f in features[:, :, i]:
            turn.append(np.linalg.norm(f[:3]))
            a, b, c, d, e, g = f[3:]
            strain.append(np.abs(np.linalg.eigvalsh([[a, b, c], [b, d, e], [c, e, g]])).max())
        largest = max(np.quantile(turn, 0.99), np.quantile(strain, 0.99) / 0.4)
        assert largest == pytest.approx(1.0)
    modal_mass = np.einsum("n,nir->r", body.vertex_mass, body.modes**2)
    np.testing.assert_allclose(
        body.stiffness, (2 * np.pi * body.frequencies) ** 2 * modal_mass, rtol=1e-9
    )


def test_reduction_follows_the_exact_map_over_the_amplitudes(body):
    error = reconstruction_error(body, samples=60, seed=7)
    assert error["relative_rms"] < 0.05
    assert error["basis_relative_rms"] <= error["relative_rms"]
    assert 0.6 < error["volume_ratio_min"] <= error["volume_ratio_max"] < 1.1
    exact = RotationStrain(TetMesh(body.vertices, body.tetrahedra), body.vertex_mass, body.modes)
    q = np.array([[0.4, -0.3, 0.2, 0.5]])
    distance = reduced_vertices(body, q)[0] - body.vertices - exact.displacement(q)[0]
    assert np.linalg.norm(distance, axis=1).max() < 0.05 * np.abs(exact.displacement(q)).max()
    np.testing.assert_array_equal(reduced_vertices(body, np.zeros(4))[0], body.vertices)


def test_rebuilding_gives_the_same_bits(body, mesh_file):
    again = build_body(mesh_file, OPTIONS)
    assert again.hash == body.hash


def test_a_saved_body_is_loaded_whole(body, tmp_path):
    body.save(tmp_path / "pill.npz")
    loaded = Body.load(tmp_path / "pill.npz")
    assert loaded.hash == body.hash
    assert loaded.source == body.source
    assert loaded.source["quality"]["min"] > 0.0 and loaded.source["mesh"] == "pill.stl"


def test_a_tetrahedral_mesh_is_kept(tmp_path):
    mesh = bar((8, 3, 3), (1.0, 0.3, 0.2))
    meshio.write(tmp_path / "bar.vtu", meshio.Mesh(mesh.vertices, [("tetra", mesh.tetrahedra)]))
    built = build_body(
        tmp_path / "bar.vtu", dataclasses.replace(OPTIONS, length=None, basis=8), name="log"
    )
    assert built.name == "log"
    np.testing.assert_array_equal(built.tetrahedra, mesh.tetrahedra)
    np.testing.assert_allclose(np.ptp(built.vertices, axis=0), [1.0, 0.3, 0.2])


def test_placed_vertices_follow_position_and_attitude(body):
    state = np.zeros(13 + 8)
    angle = 0.7
    state[:3] = [1.0, 2.0, 3.0]
    state[3:7] = [np.cos(angle / 2), 0.0, 0.0, np.sin(angle / 2)]
    c, s = np.cos(angle), np.sin(angle)
    expected = body.vertices @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]).T + [1, 2, 3]
    np.testing.assert_allclose(placed_vertices(body, state), expected, atol=1e-12)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"vertices": 3}, "vertices is 3"),
        ({"modes": 17}, "modes is 17"),
        ({"basis": 65}, "between 1 and 64"),
        ({"length": -1.0}, "length"),
        ({"drag_error": 0.0}, "drag_error"),
        ({"drag_points": 513}, "drag_points is 513"),
        ({"material": Material(poissons_ratio=0.5)}, "Poisson"),
        ({"material": Material(youngs_modulus=0.0)}, "Young"),
    ],
)
def test_options_out_of_range_are_refused(mesh_file, change, says):
    with pytest.raises(DefplanError, match=says):
        build_body(mesh_file, dataclasses.replace(OPTIONS, **change))
