"""Reading meshes: every readable format, and one clear sentence for every bad file."""

from __future__ import annotations

import meshio
import numpy as np
import pytest
import trimesh

from defplan_mj.base.errors import DefplanError
from defplan_mj.body.intersections import _near_pairs, crossing_triangles
from defplan_mj.body.surface import Surface
from defplan_mj.body.tetmesh import TetMesh, volumes
from tests.samples.meshes import FISH, bar, load_mesh, pill


@pytest.mark.parametrize("suffix", ["stl", "obj", "ply", "off", "gltf", "glb"])
def test_surface_formats_are_read_alike(tmp_path, suffix):
    path = tmp_path / f"pill.{suffix}"
    pill().export(path)
    surface = load_mesh(path)
    assert isinstance(surface, Surface)
    assert len(surface.vertices) == len(pill().vertices)
    assert surface.volume == pytest.approx(pill().volume, rel=1e-4)
    assert surface.area == pytest.approx(pill().area, rel=1e-4)


@pytest.mark.parametrize("suffix", ["msh", "vtk", "vtu"])
def test_tetrahedral_formats_are_used_as_they_are(tmp_path, suffix):
    mesh = bar((3, 2, 2), (1.0, 0.4, 0.4))
    path = tmp_path / f"bar.{suffix}"
    meshio.write(path, meshio.Mesh(mesh.vertices, [("tetra", mesh.tetrahedra)]))
    loaded = load_mesh(path)
    assert isinstance(loaded, TetMesh)
    np.testing.assert_array_equal(loaded.tetrahedra, mesh.tetrahedra)
    np.testing.assert_allclose(loaded.vertices, mesh.vertices)


def test_a_vtk_file_with_triangles_is_a_surface(tmp_path):
    path = tmp_path / "pill.vtk"
    meshio.write(path, meshio.Mesh(pill().vertices, [("triangle", pill().faces)]))
    assert isinstance(load_mesh(path), Surface)


def test_the_other_order_of_corners_is_turned(tmp_path):
    mesh = bar((2, 2, 2), (1.0, 0.4, 0.4))
    path = tmp_path / "bar.vtu"
    meshio.write(path, meshio.Mesh(mesh.vertices, [("tetra", mesh.tetrahedra[:, [0, 2, 1, 3]])]))
    loaded = load_mesh(path)
    assert isinstance(loaded, TetMesh)
    assert volumes(loaded.vertices, loaded.tetrahedra).min() > 0.0


def test_length_scales_the_longest_extent(tmp_path):
    pill().export(tmp_path / "pill.ply")
    surface = load_mesh(tmp_path / "pill.ply", 2.5)
    assert np.ptp(surface.vertices, axis=0).max() == pytest.approx(2.5)


def _write(folder, mesh, name="bad.ply"):
    mesh.export(folder / name)
    return folder / name


def _raw(vertices, faces):
    return trimesh.Trimesh(vertices, faces, process=False)


def _open(folder):
    return _write(folder, _raw(pill().vertices, pill().faces[:-3]))


def _inside_out(folder):
    return _write(folder, _raw(pill().vertices, pill().faces[:, ::-1]))


def _one_turned(folder):
    faces = np.array(pill().faces)
    faces[7] = faces[7][::-1]
    return _write(folder, _raw(pill().vertices, faces))


def _pieces(folder):
    return _write(folder, trimesh.util.concatenate([pill(), pill().apply_translation([2, 0, 0])]))


def _crossing(folder):
    ball = pill()
    vertices = np.array(ball.vertices)
    vertices[vertices[:, 0].argmax(), 0] = -1.0  # the nose pushed out through the tail
    return _write(folder, _raw(vertices, ball.faces))


def _nan(folder):
    path = folder / "bad.obj"
    path.write_text("v 0 0 0\nv nan 1 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 4 2\nf 2 4 3\nf 1 3 4\n")
    return path


def _infinite(folder):
    vertices = np.array(pill().vertices)
    vertices[3, 1] = np.inf
    return _write(folder, _raw(vertices, pill().faces), "bad.off")


def _point(folder):
    return _write(folder, _raw(0.0 * pill().vertices, pill().faces))


def _flat(folder):
    return _write(folder, _raw(pill().vertices * [1, 0, 1], pill().faces))


def _double(folder):
    return _write(folder, _raw(pill().vertices, np.vstack([pill().faces, pill().faces[:1]])))


def _text(name, content=""):
    def write(folder):
        (folder / name).write_text(content)
        return folder / name

    return write


def _tets(change):
    def write(folder):
        mesh = bar((3, 2, 2), (1.0, 0.4, 0.4))
        vertices, cells = change(mesh.vertices.copy(), mesh.tetrahedra.copy())
        meshio.write(folder / "bad.vtk", meshio.Mesh(vertices, [("tetra", cells)]))
        return folder / "bad.vtk"

    return write


def _invert_one(vertices, cells):
    cells[0] = cells[0][[0, 2, 1, 3]]
    return vertices, cells


def _flatten_one(vertices, cells):
    return np.vstack([vertices, vertices[cells[0, :3]].mean(0)]), np.vstack(
        [cells, [*cells[0, :3], len(vertices)]]
    )


def _two_bars(vertices, cells):
    return np.vstack([vertices, vertices + [3, 0, 0]]), np.vstack([cells, cells + len(vertices)])


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda folder: folder / "none.stl", "does not exist"),
        (_text("fish.docx"), r"ends in one of \.stl"),
        (_text("bad.stl"), "empty"),
        (_text("bad.obj"), "empty"),
        (_text("bad.vtk"), "empty"),
        (_text("bad.ply", "ply\nformat ascii 1.0\nelement vertex"), "cannot be read"),
        (_text("bad.off", "not an OFF file"), "cannot be read|empty"),
        (_text("bad.glb", "not a GLB file"), "cannot be read"),
        (_text("bad.msh", "not a mesh"), "cannot be read"),
        (_text("bad.vtu", "<not a mesh"), "cannot be read"),
        (_open, "open: 5 edges.*close its holes"),
        (_inside_out, "inside out.*flip"),
        (_one_turned, "do not agree which side"),
        (_pieces, "in 2 pieces.*join"),
        (_crossing, "intersects itself.*boolean union"),
        (_nan, "not finite"),
        (_infinite, "not finite"),
        (_point, "no volume"),
        (_flat, "flat along y"),
        (_double, "more than two triangles"),
        (_tets(_invert_one), "1 inverted tetrahedra of 72"),
        (_tets(_flatten_one), "without volume"),
        (_tets(_two_bars), "in 2 pieces"),
        (_tets(lambda v, c: (v * [[np.nan, 1, 1]], c)), "not finite"),
        (_tets(lambda v, c: (v, np.vstack([c, c[:1]]))), "remove double"),
    ],
)
def test_a_bad_mesh_gets_one_sentence_that_names_the_file(tmp_path, make, says, capsys):
    path = make(tmp_path)
    with pytest.raises(DefplanError, match=says) as error:
        load_mesh(path)
    assert str(path) in str(error.value) and "\n" not in str(error.value)
    printed = capsys.readouterr()
    assert printed.out == printed.err == ""


@pytest.mark.parametrize("share", [0.0, 0.2, 0.6, 0.97])
@pytest.mark.parametrize("suffix", ["stl", "ply", "glb", "vtu"])
def test_a_file_cut_short_is_refused(tmp_path, suffix, share):
    whole = tmp_path / f"whole.{suffix}"
    if suffix == "vtu":
        mesh = bar((3, 2, 2), (1.0, 0.4, 0.4))
        meshio.write(whole, meshio.Mesh(mesh.vertices, [("tetra", mesh.tetrahedra)]))
    else:
        pill().export(whole)
    data = whole.read_bytes()
    cut = tmp_path / f"cut.{suffix}"
    cut.write_bytes(data[: int(share * len(data))])
    with pytest.raises(DefplanError):
        load_mesh(cut)


def test_sound_surfaces_do_not_cross_themselves():
    for mesh in (pill(), trimesh.creation.torus(0.4, 0.1), trimesh.creation.box([1, 1, 1])):
        assert len(crossing_triangles(np.array(mesh.vertices), np.array(mesh.faces))) == 0
    assert isinstance(load_mesh(FISH), Surface)


@pytest.mark.parametrize("spread", [0.0, 2.0])
def test_crossings_of_random_triangles_agree_with_a_dense_search(spread):
    rng = np.random.default_rng(0)
    size = np.repeat(np.exp(spread * rng.normal(size=20)), 3)[:, None]  # of very different sizes
    vertices = size * rng.normal(size=(60, 3)) + np.repeat(0.3 * rng.normal(size=(20, 3)), 3, 0)
    faces = np.arange(60).reshape(-1, 3)
    found = {tuple(pair) for pair in crossing_triangles(vertices, faces)}
    expected = set()
    for i in range(20):
        for j in range(i + 1, 20):
            if _pierces(vertices[faces[i]], vertices[faces[j]]) or _pierces(
                vertices[faces[j]], vertices[faces[i]]
            ):
                expected.add((i, j))
    assert found == expected and len(expected) > 5


def _pierces(first, second):
    """Solve for the point where an edge meets the triangle's plane: an independent test."""
    a, b, c = second
    for k in range(3):
        p, q = first[k], first[(k + 1) % 3]
        t, u, v = np.linalg.solve(np.stack([p - q, b - a, c - a], axis=1), p - a)
        if 0 < t < 1 and u > 0 and v > 0 and u + v < 1:
            return True
    return False


def test_overlapping_boxes_are_all_found_whatever_their_sizes():
    rng = np.random.default_rng(1)
    low = rng.normal(size=(150, 3))
    high = low + rng.random((150, 3)) * np.exp(rng.normal(size=(150, 1)))
    expected = {
        (i, j)
        for i in range(150)
        for j in range(i + 1, 150)
        if (low[i] <= high[j]).all() and (low[j] <= high[i]).all()
    }
    found = [tuple(pair) for pair in _near_pairs(low, high)]
    assert set(found) == expected and len(found) == len(expected) > 100
