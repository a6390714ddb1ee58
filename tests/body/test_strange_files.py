"""Files as strangers' programs write them: variants of formats, wrong names, odd surfaces and cells."""

from __future__ import annotations

import json
import zipfile

import meshio
import numpy as np
import pytest
import trimesh

from defplan_mj.base.errors import DefplanError
from defplan_mj.body.formats import read_file
from defplan_mj.body.loading import fill_file
from defplan_mj.body.options import BodyOptions
from defplan_mj.body.surface import Surface
from defplan_mj.body.tetmesh import face_pieces, volumes
from defplan_mj.taskfile.find import MESHES
from tests.samples.meshes import bar

BOX = trimesh.creation.box([1.0, 0.4, 0.3])
CORNERS, FACES = np.array(BOX.vertices), np.array(BOX.faces)
VOLUME = 0.12


def size_of(path):
    raw = read_file(path)
    return Surface(raw.vertices, raw.triangles).volume


# ---- plain formats


def obj(faces):
    return "".join(f"v {x} {y} {z} 1 0 0\n" for x, y, z in CORNERS) + "".join(faces)


def test_obj_corners_of_all_forms_are_read(tmp_path):
    path = tmp_path / "box.obj"
    for corners in ("{}/1/1 {}//1 {} # the top", "{} \\\n {} {}", "{}/2\t{} {}/3/"):
        path.write_text(obj("f " + corners.format(*face) + "\n" for face in FACES + 1))
        assert size_of(path) == pytest.approx(VOLUME)
    path.write_text(obj(f"f {a} {b} {c}\n" for a, b, c in FACES - len(CORNERS)))
    assert size_of(path) == pytest.approx(VOLUME)
    path.write_bytes(obj(f"f {a} {b} {c}\r\n" for a, b, c in FACES + 1).encode("utf-16"))
    assert size_of(path) == pytest.approx(VOLUME)


def test_obj_indices_that_are_not_there_are_refused(tmp_path):
    path = tmp_path / "box.obj"
    for faces in (FACES, FACES + 2):  # of a program that counts from 0; one too many
        path.write_text(obj(f"f {a} {b} {c}\n" for a, b, c in faces))
        with pytest.raises(DefplanError, match="names vertices that it does not have"):
            read_file(path)


def test_an_obj_that_ends_within_a_vertex_is_called_cut_and_one_of_a_plane_is_not(tmp_path):
    path = tmp_path / "box.obj"
    path.write_text(obj([])[:-14])
    with pytest.raises(DefplanError, match="is cut short: it ends within a vertex"):
        read_file(path)
    path.write_text("v 0 0\nv 1 0\nv 1 1\nf 1 2 3\n")
    with pytest.raises(DefplanError, match="its vertices have 2 coordinates, not 3"):
        read_file(path)


def test_off_with_colours_keeps_concave_polygons(tmp_path):
    ell = np.array([[0, 0], [2, 0], [2, 1], [1, 1], [1, 2], [0, 2]], float)
    vertices = [f"{x} {y} {z} 9 9 9 255" for z in (0, 1) for x, y in ell]
    sides = [f"4 {i} {(i + 1) % 6} {(i + 1) % 6 + 6} {i + 6} 0.5 0.5 0.5" for i in range(6)]
    lines = [
        "COFF",
        "# of a painter",
        "12 8 0",
        *vertices,
        "6 5 4 3 2 1 0",
        "6 6 7 8 9 10 11",
        *sides,
    ]
    path = tmp_path / "ell.off"
    path.write_text("\n".join(lines))
    assert size_of(path) == pytest.approx(3.0)
    path.write_text("\n".join(lines[:-2]))
    with pytest.raises(DefplanError, match="cut short: its header names 12 vertices and 8 faces"):
        read_file(path)
    path.write_bytes(b"OFF BINARY\n" + bytes(100))
    with pytest.raises(DefplanError, match="binary OFF"):
        read_file(path)


def test_stl_of_all_kinds_is_read_and_what_is_cut_is_called_that(tmp_path):
    path = tmp_path / "box.stl"
    text = trimesh.exchange.stl.export_stl_ascii(BOX)
    path.write_text(text.upper())
    assert size_of(path) == pytest.approx(VOLUME)
    for end in ("vertex", "endloop", "endsolid"):
        path.write_text(text[: text.rindex(end)])
        with pytest.raises(DefplanError, match="cut short: its last solid has no end"):
            read_file(path)
    data = trimesh.exchange.stl.export_stl(BOX)
    path.write_bytes(b"solid, says who" + data[15:])
    assert size_of(path) == pytest.approx(VOLUME)
    path.write_bytes(data + b"colours")
    assert size_of(path) == pytest.approx(VOLUME)
    assert read_file(path).notes == ["7 bytes after the last triangle are not used"]


def test_coordinates_that_single_precision_rounds_away_are_refused(tmp_path):
    far = BOX.copy()
    far.apply_translation([1e6, 0.0, 0.0])
    far.export(tmp_path / "far.stl")
    with pytest.raises(DefplanError, match="move it to the origin"):
        read_file(tmp_path / "far.stl")


def test_first_bytes_say_the_format_if_the_name_does_not(tmp_path):
    mesh = meshio.Mesh(CORNERS, [("triangle", FACES)])
    meshio.write(tmp_path / "box.vtu", mesh)
    for form in ("ply", "glb", "off", "obj"):
        BOX.export(tmp_path / f"box.{form}")
    for form, name in (
        ("vtu", "a.vtk"),
        ("ply", "a.obj"),
        ("glb", "a.gltf"),
        ("off", "a.stl"),
        ("obj", "a"),
    ):
        (tmp_path / name).write_bytes((tmp_path / f"box.{form}").read_bytes())
        raw = read_file(tmp_path / name)
        assert Surface(raw.vertices, raw.triangles).volume == pytest.approx(VOLUME)
        assert raw.notes[0] == f"read as .{form}: that is what its first bytes say"
        assert not any("first bytes" in note for note in read_file(tmp_path / f"box.{form}").notes)


# ---- scenes


def collada(body, unit):
    places = " ".join(map(str, CORNERS.ravel()))
    corners = " ".join(map(str, FACES.ravel()))
    return (
        '<?xml version="1.0"?><COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">'
        f"<asset>{unit}<up_axis>Z_UP</up_axis></asset><library_geometries><geometry id='g'><mesh>"
        f"<source id='p'><float_array id='pa' count='{CORNERS.size}'>{places}</float_array>"
        f"<technique_common><accessor source='#pa' count='{len(CORNERS)}' stride='3'><param name='X' "
        "type='float'/><param name='Y' type='float'/><param name='Z' type='float'/></accessor>"
        "</technique_common></source><vertices id='v'><input semantic='POSITION' source='#p'/></vertices>"
        f"<triangles count='{len(FACES)}'><input semantic='VERTEX' source='#v' offset='0'/><p>{corners}</p>"
        f"</triangles></mesh></geometry></library_geometries>{body}<scene>"
        "<instance_visual_scene url='#s'/></scene></COLLADA>"
    )


def scene(inside):
    return f"<library_visual_scenes><visual_scene id='s'>{inside}</visual_scene></library_visual_scenes>"


def test_collada_is_read_in_its_unit(tmp_path):
    path = tmp_path / "box.dae"
    node = "<node id='n'><scale>2 1 1</scale><instance_geometry url='#g'/></node>"
    path.write_text(collada(scene(node), "<unit name='centimeter' meter='0.01'/>"))
    raw = read_file(path)
    np.testing.assert_allclose(np.ptp(raw.vertices, 0), [0.02, 0.004, 0.003])
    assert raw.up == "z" and raw.notes == ["the file's unit is 0.01 m: taken as such"]


def test_collada_skins_are_read_as_they_were_bound(tmp_path):
    ones = " ".join(["1"] * len(CORNERS))
    pairs = " ".join(["0 0"] * len(CORNERS))
    unit = "1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1"
    controller = (
        "<library_controllers><controller id='c'><skin source='#g'>"
        f"<bind_shape_matrix>{unit}</bind_shape_matrix>"
        "<source id='j'><Name_array id='ja' count='1'>bone</Name_array><technique_common><accessor "
        "source='#ja' count='1' stride='1'><param name='JOINT' type='Name'/></accessor></technique_common>"
        f"</source><source id='m'><float_array id='ma' count='16'>{unit}</float_array><technique_common>"
        "<accessor source='#ma' count='1' stride='16'><param name='TRANSFORM' type='float4x4'/></accessor>"
        "</technique_common></source><source id='w'><float_array id='wa' count='1'>1</float_array>"
        "<technique_common><accessor source='#wa' count='1' stride='1'><param name='WEIGHT' type='float'/>"
        "</accessor></technique_common></source><joints><input semantic='JOINT' source='#j'/>"
        "<input semantic='INV_BIND_MATRIX' source='#m'/></joints><vertex_weights "
        f"count='{len(CORNERS)}'><input semantic='JOINT' source='#j' offset='0'/><input semantic='WEIGHT' "
        f"source='#w' offset='1'/><vcount>{ones}</vcount><v>{pairs}</v></vertex_weights></skin>"
        "</controller></library_controllers>"
    )
    path = tmp_path / "skin.dae"
    node = "<node id='n'><instance_controller url='#c'/></node>"
    path.write_text(collada(controller + scene(node), "<unit name='meter' meter='1'/>"))
    assert size_of(path) == pytest.approx(VOLUME)


def test_gltf_says_what_is_missing_packed_or_not_used(tmp_path):
    path = tmp_path / "box.gltf"
    files = trimesh.exchange.gltf.export_gltf(trimesh.Scene(BOX))
    for name, data in files.items():
        (tmp_path / ("box.gltf" if name == "model.gltf" else name)).write_bytes(data)
    tree = json.loads(path.read_text())
    assert read_file(path).notes == []
    tree["meshes"][0]["primitives"].append({**tree["meshes"][0]["primitives"][0], "mode": 6})
    path.write_text(json.dumps(tree))
    assert read_file(path).notes == ["1 fans of triangles are not used"]
    path.write_text(json.dumps({**tree, "extensionsRequired": ["EXT_meshopt_compression"]}))
    with pytest.raises(DefplanError, match="packed by EXT_meshopt_compression"):
        read_file(path)
    tree["buffers"][0]["uri"] = "lost.bin"
    path.write_text(json.dumps(tree))
    with pytest.raises(DefplanError, match=r"not beside it \(lost.bin\)"):
        read_file(path)


def test_three_mf_with_objects_in_further_files_is_refused(tmp_path):
    path = tmp_path / "box.3mf"
    BOX.export(path)
    with zipfile.ZipFile(path) as archive:
        files = {name: archive.read(name) for name in archive.namelist()}
    model = next(name for name in files if name.endswith("3dmodel.model"))
    item = b'<item objectid="1" p:path="/3D/other.model"/></build>'
    files[model] = files[model].replace(b"</build>", item)
    with zipfile.ZipFile(path, "w") as archive:
        for name, data in files.items():
            archive.writestr(name, data)
    with pytest.raises(DefplanError, match="builds 1 objects that stand in further files"):
        read_file(path)


# ---- cells


def test_gmsh_1_is_read(tmp_path):
    mesh = bar((2, 1, 1), (1.0, 0.4, 0.3))
    nodes = [f"{7 * i + 3} {x} {y} {z}" for i, (x, y, z) in enumerate(mesh.vertices)]
    cells = [
        f"{i} 4 1 1 4 " + " ".join(str(7 * k + 3) for k in cell)
        for i, cell in enumerate(mesh.tetrahedra)
    ]
    path = tmp_path / "bar.msh"
    lines = ["$NOD", str(len(nodes)), *nodes, "$ENDNOD", "$ELM", str(len(cells)), *cells, "$ENDELM"]
    path.write_text("\n".join(lines))
    raw = read_file(path)
    assert np.abs(volumes(raw.vertices, raw.tetrahedra)).sum() == pytest.approx(VOLUME)
    path.write_text("\n".join(lines[:-1]))
    with pytest.raises(DefplanError, match=r"cut short: it has no \$ENDELM"):
        read_file(path)


def test_a_surface_of_vtk_is_called_that(tmp_path):
    path = tmp_path / "box.vtk"
    path.write_text("# vtk DataFile Version 3.0\nbox\nASCII\nDATASET POLYDATA\nPOINTS 0 float\n")
    with pytest.raises(DefplanError, match=r"POLYDATA.*save it as \.stl"):
        read_file(path)


def test_straight_cells_of_third_order_are_no_curved_ones(tmp_path):
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], float)
    edges = ((0, 1), (1, 2), (2, 0), (3, 0), (3, 2), (3, 1))
    thirds = [(1 - s) * corners[a] + s * corners[b] for a, b in edges for s in (1 / 3, 2 / 3)]
    centres = [np.delete(corners, k, 0).mean(0) for k in range(4)]
    path = tmp_path / "third.msh"
    for bulge, volume in ((0.0, 1 / 6), (0.2, None)):
        points = np.vstack([corners, thirds, centres])
        points[4] -= [0.0, bulge, 0.0]
        mesh = meshio.Mesh(points, [("tetra20", np.arange(20)[None])])
        meshio.write(path, mesh, file_format="gmsh22")
        if volume is None:
            with pytest.raises(DefplanError, match="off by 16.7% of the length"):
                read_file(path)
        else:
            raw = read_file(path)
            assert np.abs(volumes(raw.vertices, raw.tetrahedra)).sum() == pytest.approx(volume)


def test_cells_of_two_parts_are_welded_where_they_meet(tmp_path):
    mesh = bar((4, 2, 2), (1.0, 0.4, 0.3))
    ahead = mesh.vertices[mesh.tetrahedra].mean(1)[:, 0] > np.median(mesh.vertices[:, 0])
    cells = mesh.tetrahedra + np.where(ahead, len(mesh.vertices), 0)[:, None]
    twice = np.vstack([mesh.vertices, mesh.vertices])
    path = tmp_path / "two.vtu"
    meshio.write(path, meshio.Mesh(twice, [("tetra", cells)]))
    filled = fill_file(path, BodyOptions())
    assert face_pieces(filled.mesh.tetrahedra)[0].max() == 0
    assert filled.repaired == ["welded 9 vertices of cells that lie at one place"]
    with pytest.raises(DefplanError, match="in 2 pieces"):
        fill_file(path, BodyOptions(strict=True))


def test_every_format_that_is_read_is_a_mesh_to_the_commands():
    assert {".skn", ".msh", ".dae", ".obj"} <= set(MESHES)
