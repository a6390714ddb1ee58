"""Any mesh in: kinds of files that people have, what comes of each, and what is said of it."""

from __future__ import annotations

import io
import json
import struct
from typing import Any

import meshio
import numpy as np
import pytest
import trimesh

from defplan_mj import cli
from defplan_mj.base.errors import DefplanError
from defplan_mj.body.cells import FACES, split_cells, split_polygons
from defplan_mj.body.fidelity import covered_volume, measure
from defplan_mj.body.formats import read_file
from defplan_mj.body.loading import fill_file
from defplan_mj.body.look import look
from defplan_mj.body.meshing import stuff
from defplan_mj.body.options import BodyOptions
from defplan_mj.body.repair import repair
from defplan_mj.body.surface import Surface
from defplan_mj.body.tetmesh import TetMesh, boundary, face_pieces, volumes
from tests.samples.meshes import bar, pill, surface_of

BOX = (1.0, 0.25, 0.25)


def hexahedra(nx=4, n=2):
    """Return vertices and hexahedra of a box of 1 x 0.25 x 0.25 m."""
    grid = np.stack(np.meshgrid(*(np.arange(k + 1) for k in (nx, n, n)), indexing="ij"), -1)
    vertices = grid.reshape(-1, 3) / [nx, n, n] * BOX
    number = np.arange(len(vertices)).reshape(nx + 1, n + 1, n + 1)
    corner = [
        (0, 0, 0),
        (1, 0, 0),
        (1, 1, 0),
        (0, 1, 0),
        (0, 0, 1),
        (1, 0, 1),
        (1, 1, 1),
        (0, 1, 1),
    ]
    cells = [number[a : a + nx, b : b + n, c : c + n].ravel() for a, b, c in corner]
    return vertices, np.stack(cells, 1)


def volume(mesh: TetMesh) -> float:
    return float(volumes(mesh.vertices, mesh.tetrahedra).sum())


def test_cells_of_all_kinds_split_into_one_conforming_mesh(tmp_path):
    vertices, cells = hexahedra()
    # two hexahedra become two wedges each, one a pyramid's six; the others stay
    wedges = np.concatenate([cells[:2][:, [0, 1, 2, 4, 5, 6]], cells[:2][:, [0, 2, 3, 4, 6, 7]]])
    middle = len(vertices)
    vertices = np.vstack([vertices, vertices[cells[2]].mean(0)])
    pyramids = np.array([[*cells[2][list(face)][::-1], middle] for face in FACES["hexahedron"]])
    mesh = meshio.Mesh(
        vertices, [("hexahedron", cells[3:]), ("wedge", wedges), ("pyramid", pyramids)]
    )
    meshio.write(tmp_path / "mixed.vtk", mesh)
    filled = fill_file(tmp_path / "mixed.vtk", BodyOptions(shape_error=0.01))
    assert volume(filled.mesh) == pytest.approx(0.0625)
    assert face_pieces(filled.mesh.tetrahedra)[0].max() == 0
    skin = trimesh.Trimesh(filled.mesh.vertices, boundary(filled.mesh.tetrahedra)[0])
    assert skin.is_watertight and skin.volume == pytest.approx(0.0625)
    assert "4 wedges" in filled.notes[0] and "6 pyramids" in filled.notes[0]


def test_hexahedra_follow_the_diagonals_of_tetrahedra_beside_them():
    vertices, cells = hexahedra(2, 1)
    for diagonal in ((1, 2, 6, 5), (2, 6, 5, 1)):
        a, b, c, d = cells[0][list(diagonal)]
        top = len(vertices)
        more = np.vstack([vertices, [[0.75, 0.125, 0.125]]])
        tetrahedra = np.array([[a, b, c, top], [a, c, d, top]])
        out, split = split_cells(more, {"hexahedron": cells[:1], "tetra": tetrahedra})
        size = volumes(out, split)
        split[size < 0] = split[size < 0][:, [0, 2, 1, 3]]
        assert face_pieces(split)[0].max() == 0
        assert trimesh.Trimesh(out, boundary(split)[0], process=False).is_watertight
        assert np.abs(size).sum() == pytest.approx(0.03125 + 0.0625 * 0.25 / 3)


def test_second_order_cells_keep_their_size(tmp_path):
    mesh = bar((3, 2, 2), BOX)
    mid = [mesh.vertices[mesh.tetrahedra[:, [i, j]]].mean(1)
           for i, j in ((0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3))]  # fmt: skip
    n, t = len(mesh.vertices), len(mesh.tetrahedra)
    extra = n + np.arange(6 * t).reshape(6, t).T
    cells = np.hstack([mesh.tetrahedra, extra])
    meshio.write(
        tmp_path / "t10.vtu", meshio.Mesh(np.vstack([mesh.vertices, *mid]), [("tetra10", cells)])
    )
    assert volume(fill_file(tmp_path / "t10.vtu", BodyOptions()).mesh) == pytest.approx(0.0625)


@pytest.mark.parametrize("suffix", ["vtk", "vtu", "ply", "off", "obj", "mesh"])
def test_quadrilaterals_are_faces(tmp_path, suffix):
    vertices, cells = hexahedra(1, 1)
    quads = np.array([cells[0][list(face)] for face in FACES["hexahedron"]])
    path = tmp_path / f"box.{suffix}"
    if suffix == "obj":
        lines = [f"v {x} {y} {z}" for x, y, z in vertices]
        path.write_text("\n".join(lines + ["f " + " ".join(map(str, q + 1)) for q in quads]))
    elif suffix == "off":
        lines = ["OFF", "8 6 0", *(f"{x} {y} {z}" for x, y, z in vertices)]
        path.write_text("\n".join(lines + ["4 " + " ".join(map(str, q)) for q in quads]))
    else:
        meshio.write(path, meshio.Mesh(vertices, [("quad", quads)]))
    raw = read_file(path)
    box = repair(raw.vertices, raw.triangles, path)
    assert box.surface.volume == pytest.approx(0.0625) and box.simple and not box.said


def test_a_concave_polygon_is_cut_into_ears():
    ell = np.array([[0, 0, 0], [2, 0, 0], [2, 1, 0], [1, 1, 0], [1, 2, 0], [0, 2, 0]], float)
    for start in range(6):
        polygon = np.roll(np.arange(6), start)
        triangles = split_polygons(ell, polygon[None])
        a, b, c = (ell[triangles[:, i]] for i in range(3))
        area = np.cross(b - a, c - a)[:, 2] / 2
        assert len(triangles) == 4 and area.min() > 0 and area.sum() == pytest.approx(3.0)


def test_three_mf_dae_and_mujocos_own_are_read(tmp_path):
    box = trimesh.creation.box([1.0, 0.4, 0.3])
    box.export(tmp_path / "box.dae")
    assert len(read_file(tmp_path / "box.dae").triangles) == 12
    mm = box.copy()
    mm.apply_scale(1000.0)
    mm.export(tmp_path / "box.3mf")
    raw = read_file(tmp_path / "box.3mf")
    np.testing.assert_allclose(np.ptp(raw.vertices, 0), [1.0, 0.4, 0.3])
    assert any("millimeter" in note for note in raw.notes)
    v, f = np.asarray(box.vertices, "<f4"), np.asarray(box.faces, "<i4")
    (tmp_path / "own.msh").write_bytes(
        struct.pack("<4i", len(v), 0, 0, len(f)) + v.tobytes() + f.tobytes()
    )
    bone = b"torso".ljust(40, b"\0") + struct.pack("<7f2i1f", *[0.0] * 7, 1, 0, 1.0)
    (tmp_path / "own.skn").write_bytes(
        struct.pack("<4i", len(v), 0, len(f), 1) + v.tobytes() + f.tobytes() + bone
    )
    for name in ("own.msh", "own.skn"):
        raw = read_file(tmp_path / name)
        assert Surface(raw.vertices, raw.triangles).volume == pytest.approx(0.12)


def _repair(mesh: Any):
    return repair(np.array(mesh.vertices), np.array(mesh.faces), "it")


def test_what_was_mended_is_said():
    whole = surface_of(pill(3))
    holes = trimesh.Trimesh(whole.vertices, whole.faces[:-3], process=False)
    done = _repair(holes)
    assert done.surface.volume == pytest.approx(whole.volume, rel=0.01) and done.simple
    assert done.said[0].startswith("closed 1 hole, 5 edges")
    rng = np.random.default_rng(0)
    soup = whole.vertices[whole.faces].reshape(-1, 3)
    soup = soup + rng.uniform(-1e-6, 1e-6, soup.shape)
    done = repair(soup, np.arange(len(soup)).reshape(-1, 3), "it")
    assert "welded" in done.said[0] and done.surface.volume == pytest.approx(whole.volume, rel=1e-3)
    faces = whole.faces.copy()
    faces[5:9] = faces[5:9, ::-1]
    done = repair(whole.vertices, faces, "it")
    assert done.said == ("turned 4 triangles that faced the wrong way",)
    done = repair(whole.vertices, whole.faces[:, ::-1], "it")
    assert "inside out" in done.said[0] and done.surface.volume == pytest.approx(whole.volume)


@pytest.mark.parametrize("inwards", [True, False])
def test_an_inner_shell_is_a_cavity_and_the_lattice_keeps_it(inwards):
    outer, inner = pill(3), pill(2)
    inner.apply_scale(0.6)
    wanted = outer.volume - inner.volume
    if inwards:
        inner.invert()
    done = _repair(trimesh.util.concatenate([outer, inner]))
    assert done.said == ("kept 1 inner shell as a cavity",) and done.simple
    assert done.surface.volume == pytest.approx(wanted)
    mesh = stuff(done.surface.vertices, done.surface.faces, np.full(3, 0.05), np.zeros(3))
    assert volume(mesh) == pytest.approx(wanted, rel=0.1)


def test_pieces_apart_and_pieces_that_touch_in_a_point_are_refused():
    box, other = trimesh.creation.box([1, 1, 1]), trimesh.creation.box([1, 1, 1])
    other.apply_translation([1, 1, 1])
    with pytest.raises(DefplanError, match="touch in a point"):
        _repair(trimesh.util.concatenate([box, other]))
    other.apply_translation([1, 0, 0])
    with pytest.raises(DefplanError, match="2 pieces that lie apart"):
        _repair(trimesh.util.concatenate([box, other]))


def test_a_sheet_without_thickness_is_refused():
    vertices, cells = hexahedra(4, 2)
    wavy = vertices[vertices[:, 2] == 0] + [0, 0, 0]
    wavy[:, 2] = 0.02 * np.sin(6 * wavy[:, 0])
    faces = trimesh.Trimesh(*_grid_faces(5, 3, wavy)).faces
    with pytest.raises(DefplanError, match="like a sheet"):
        repair(wavy, np.array(faces), "it")
    assert len(cells)


def _grid_faces(nx, ny, vertices):
    number = np.arange(nx * ny).reshape(nx, ny)
    a, b, c, d = (
        x.ravel() for x in (number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:])
    )
    return vertices, np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])


def test_overlapping_pieces_are_joined_and_the_overlap_counts_once(tmp_path):
    box, other = trimesh.creation.box([1.0, 0.5, 0.5]), trimesh.creation.box([0.3, 0.3, 1.0])
    both = trimesh.util.concatenate([box, other])
    wanted = 0.25 + 0.09 - 0.3 * 0.3 * 0.5
    assert covered_volume(surface_of(both)) == pytest.approx(wanted, rel=0.005)
    both.export(tmp_path / "cross.stl")
    filled = fill_file(tmp_path / "cross.stl", BodyOptions(vertices=60, shape_error=0.03))
    assert "joined pieces that overlap" in filled.repaired
    assert volume(filled.mesh) == pytest.approx(wanted, rel=0.03)
    assert filled.source["mesher"]["name"] == "fTetWild"
    assert face_pieces(filled.mesh.tetrahedra)[0].max() == 0
    with pytest.raises(DefplanError, match="strict"):
        fill_file(tmp_path / "cross.stl", BodyOptions(vertices=200, strict=True))


def test_fidelity_sees_a_part_that_was_cut_off():
    whole, cut = bar((8, 2, 2), BOX), bar((7, 2, 2), (0.875, 0.25, 0.25))
    surface = Surface(whole.vertices, boundary(whole.tetrahedra)[0])
    exact = measure(whole, surface)
    assert exact.surface_distance < 1e-3 and abs(exact.volume_error) < 1e-9 and exact.within()
    cut = TetMesh(cut.vertices - [0.0625, 0, 0], cut.tetrahedra)
    lost = measure(cut, surface)
    assert lost.surface_distance == pytest.approx(0.125) and not lost.within()
    assert lost.extents_error == pytest.approx(0.125)
    assert lost.volume_error == pytest.approx(-0.125)


def test_axes_are_told_or_guessed_by_the_mirror():
    # a cone along the file's z with a fin along y: left and right are along x
    cone = trimesh.creation.cone(0.2, 1.0)
    fin = trimesh.creation.box([0.02, 0.3, 0.2])
    fin.apply_translation([0, 0.25, 0.4])
    shape = surface_of(trimesh.util.concatenate([cone, fin]))
    view = look(shape)
    assert (view.up, view.forward) == ("y", "-z") and "left and right are alike" in view.why
    view = look(shape, up="-z", forward="y")
    assert (view.up, view.forward, view.why) == ("-z", "y", "")
    view = look(surface_of(pill()))
    assert (view.up, view.forward) == ("z", "x")
    with pytest.raises(DefplanError, match="different axes"):
        look(shape, up="z", forward="-z")


def test_gltf_is_turned_as_its_format_says(tmp_path):
    pill().export(tmp_path / "pill.glb")
    mesh = fill_file(tmp_path / "pill.glb", BodyOptions(vertices=150))
    np.testing.assert_allclose(np.ptp(mesh.mesh.vertices, 0), [0.3, 1.0, 0.4], atol=0.04)
    assert "y of the file is up, z is forward" in mesh.notes[0]


def test_a_file_cut_short_and_random_bytes_are_called_that(tmp_path):
    buffer = io.BytesIO()
    pill().export(buffer, file_type="stl")
    (tmp_path / "cut.stl").write_bytes(buffer.getvalue()[:3000])
    with pytest.raises(DefplanError, match="cut short: its header names 320 triangles"):
        read_file(tmp_path / "cut.stl")
    noise = np.random.default_rng(0).bytes(5000)
    for suffix in ("stl obj ply off gltf glb 3mf dae msh vtk vtu mesh skn inp").split():
        (tmp_path / f"noise.{suffix}").write_bytes(noise)
        with pytest.raises(DefplanError, match="cannot be read|no triangles") as error:
            read_file(tmp_path / f"noise.{suffix}")
        assert "empty" not in str(error.value) and "\n" not in str(error.value)


def test_sizes_are_the_files_and_tiny_ones_are_warned_of(tmp_path, capfd):
    mesh = bar((6, 2, 2), (0.01, 0.003, 0.002))
    meshio.write(tmp_path / "egg.vtu", meshio.Mesh(mesh.vertices, [("tetra", mesh.tetrahedra)]))
    small = ["--modes", "2", "--json"]
    out = str(tmp_path / "egg.npz")
    assert cli.main(["body", str(tmp_path / "egg.vtu"), "-o", out, *small]) == 0
    captured = capfd.readouterr()
    data = json.loads(captured.out)
    assert data["length_m"] == pytest.approx(0.01, rel=0.03)
    assert "--length" in data["warnings"][0] and "warning: the mesh is 0.01" in captured.err
    assert set(data["fidelity"]) == {
        "surface_distance", "extents_error", "volume_error", "repaired",
    }  # fmt: skip
    assert data["fidelity"]["surface_distance"] < 0.01 and data["fidelity"]["repaired"] == []


def test_flat_vertices_are_refused_with_how_many_coordinates_they_have(tmp_path):
    path = tmp_path / "flat.obj"
    path.write_text("v 0 0\nv 1 0\nv 0 1\nv 1 1\nv .5 .5\n")
    with pytest.raises(DefplanError, match=r"flat.obj: its vertices have 2 coordinates, not 3"):
        fill_file(path, BodyOptions())
