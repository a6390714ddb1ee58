"""Mesh files that mean harm, written by script: counts that lie, bombs, and small whole files to be damaged."""

from __future__ import annotations

import base64
import functools
import io
import json
import struct
import sys
import tempfile
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import meshio

from tests.samples.meshes import bar, pill

BILLION = 10**9
BY_TRIMESH = ("stl", "obj", "ply", "off", "gltf", "glb", "3mf", "dae")
BY_MESHIO = {
    "vtk": {}, "vtu": {}, "mesh": {}, "inp": {}, "vol": {}, "su2": {}, "avs": {}, "xml": {},
    "bdf": {}, "ugrid": {}, "f3grid": {}, "mdpa": {}, "meshb": {},
    "msh": {"file_format": "gmsh"}, "msh2": {"file_format": "gmsh22"},
}  # fmt: skip


@functools.cache
def whole(form: str) -> tuple[str, bytes]:
    """Return a small whole file of a format: the ending of its name, its bytes."""
    if form in BY_TRIMESH:
        return form, _exported(form)
    mesh = bar((2, 1, 1), (1.0, 0.4, 0.4))
    suffix = "msh" if form == "msh2" else form
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"bar.{suffix}"
        meshio.write(
            path, meshio.Mesh(mesh.vertices, [("tetra", mesh.tetrahedra)]), **BY_MESHIO[form]
        )
        return suffix, path.read_bytes()


def _exported(form: str) -> bytes:
    if form == "gltf":
        files: Any = pill(1).export(file_type="gltf")
        scene = json.loads(files["model.gltf"])
        data = base64.b64encode(files[scene["buffers"][0]["uri"]]).decode()
        scene["buffers"][0]["uri"] = f"data:application/octet-stream;base64,{data}"
        return json.dumps(scene).encode()
    made: Any = pill(1).export(file_type=form)
    return made.encode() if isinstance(made, str) else made


def bombs() -> dict[str, Callable[[], bytes]]:
    """Return makers of files below 50 MB, by name."""
    return {**_counts(), **_packed(), **_nested(), **_long()}


def _counts() -> dict[str, Callable[[], bytes]]:
    """Headers that name far more than there is."""
    made: dict[str, bytes] = {}
    for n in (BILLION, 2**32 - 1, 2**62, -1):
        name = str(n)
        if n < 2**32:
            made[f"stl of {name}.stl"] = bytes(80) + struct.pack("<I", n & 0xFFFFFFFF) + bytes(500)
        for kind in ("ascii", "binary_little_endian"):
            made[f"ply, {kind}, of {name}.ply"] = (
                f"ply\nformat {kind} 1.0\nelement vertex {name}\nproperty float x\nproperty float y\n"
                f"property float z\nelement face {name}\nproperty list uint int vertex_indices\n"
                "end_header\n"
            ).encode() + bytes(500)
        made[f"off of {name}.off"] = f"OFF\n{name} {name} 0\n0 0 0\n3 0 0 0\n".encode()
        made[f"off with a face of {name}.off"] = f"OFF\n1 1 0\n0 0 0\n{name} 0 0 0\n".encode()
        made[f"obj naming {name}.obj"] = f"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 {name}\n".encode()
        made[f"obj of squares naming {name}.obj"] = (
            f"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3 {name}\n".encode()
        )
        made[f"mesh of {name}.mesh"] = (
            f"MeshVersionFormatted 1\nDimension 3\nVertices\n{name}\n0 0 0 0\nTetrahedra\n{name}\n".encode()
        )
        made[f"su2 of {name}.su2"] = (
            f"NDIME= 3\nNELEM= {name}\n10 0 1 2 3\nNPOIN= {name}\n0 0 0\n".encode()
        )
        made[f"avs of {name}.avs"] = f"{name} {name} 0 0 0\n1 0 0 0\n1 1 tet 1 1 1 1\n".encode()
        for dimension in (f"{name} 1 1", f"{name} {name} {name}"):
            for kind in ("STRUCTURED_POINTS", "STRUCTURED_GRID", "RECTILINEAR_GRID"):
                made[f"vtk {kind} of {dimension}.vtk"] = (
                    f"# vtk DataFile Version 4.2\nx\nASCII\nDATASET {kind}\nDIMENSIONS {dimension}\n"
                    "ORIGIN 0 0 0\nSPACING 1 1 1\n"
                ).encode()
        for kind in ("ASCII", "BINARY"):
            made[f"vtk, {kind}, of {name}.vtk"] = (
                f"# vtk DataFile Version 4.2\nx\n{kind}\nDATASET UNSTRUCTURED_GRID\n"
                f"POINTS {name} double\n0 0 0\nCELLS {name} {name}\n4 0 0 0 0\nCELL_TYPES {name}\n10\n"
            ).encode()
        for version, nodes in (
            ("2.2", f"{name}\n1 0 0 0\n"),
            ("4.0", f"1 {name}\n1 3 0 {name}\n1 0 0 0\n"),
            ("4.1", f"1 {name} 1 {name}\n3 1 0 {name}\n1\n0 0 0\n"),
        ):
            made[f"msh {version} of {name}.msh"] = (
                f"$MeshFormat\n{version} 0 8\n$EndMeshFormat\n$Nodes\n{nodes}$EndNodes\n"
                f"$Elements\n{nodes}$EndElements\n"
            ).encode()
        made[f"vol of {name}.vol"] = (
            f"mesh3d\ndimension\n3\nvolumeelements\n{name}\n1 4 1 1 1 1\npoints\n{name}\n0 0 0\n".encode()
        )
        made[f"xml of {name}.xml"] = (
            f'<dolfin><mesh celltype="tetrahedron" dim="3"><vertices size="{name}">'
            f'<vertex index="0" x="0" y="0" z="0"/></vertices><cells size="{name}">'
            '<tetrahedron index="0" v0="0" v1="0" v2="0" v3="0"/></cells></mesh></dolfin>'
        ).encode()
        made[f"skn of {name}.skn"] = struct.pack("<4i", *[min(n, 2**31 - 1)] * 4) + bytes(500)
        made[f"ugrid of {name}.ugrid"] = f"{name} {name} 0 {name} 0 0 0\n0 0 0\n".encode()
        made[f"gltf of {name}.gltf"] = _gltf_counting(n)
    return {name: functools.partial(bytes, data) for name, data in made.items()}


def _gltf_counting(n: int) -> bytes:
    scene = json.loads(whole("gltf")[1])
    for accessor in scene["accessors"]:
        accessor["count"] = n
    return json.dumps(scene).encode()


def _model(objects: str, build: str) -> str:
    return (
        '<?xml version="1.0"?><model unit="meter" xmlns="http://schemas.microsoft.com/3dmanufacturing'
        f'/core/2015/02"><resources>{objects}</resources><build>{build}</build></model>'
    )


def _three_mf(model: bytes) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("3D/3dmodel.model", model)
    return stream.getvalue()


def _zip_of(size: int, inside: str) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        archive.writestr("3D/3dmodel.model", _model("", ""))
        with archive.open(inside, "w", force_zip64=True) as part:
            for _ in range(size >> 24):
                part.write(bytes(1 << 24))
    return stream.getvalue()


def _vtu_of(size: int) -> bytes:
    """Return a VTU file whose points unpack to `size` bytes."""
    block = zlib.compress(bytes(1 << 24))
    head = struct.pack("<3I", size >> 24, 1 << 24, 0) + struct.pack("<I", len(block)) * (size >> 24)
    data = base64.b64encode(head) + base64.b64encode(block * (size >> 24))
    return (
        b'<VTKFile type="UnstructuredGrid" version="0.1" byte_order="LittleEndian"'
        b' compressor="vtkZLibDataCompressor"><UnstructuredGrid>'
        b'<Piece NumberOfPoints="1" NumberOfCells="1"><Points><DataArray type="Float64"'
        b' NumberOfComponents="3" format="binary">' + data + b"</DataArray></Points></Piece>"
        b"</UnstructuredGrid></VTKFile>"
    )


def _packed() -> dict[str, Callable[[], bytes]]:
    """What unpacks to far more than its size."""
    return {
        "3mf of 5 GB.3mf": lambda: _zip_of(5 << 30, "3D/other.model"),
        "3mf whose model has 2 GB.3mf": lambda: _three_mf(bytes(2 << 30)),
        "vtu of 4 GB.vtu": lambda: _vtu_of(4 << 30),
    }


def _entities(body: str) -> bytes:
    named = "".join(f'<!ENTITY e{i} "{f"&e{i - 1};" * 10}">' for i in range(1, 12))
    return f'<!DOCTYPE x [<!ENTITY e0 "0123456789">{named}]>{body.format("&e11;")}'.encode()


def _nested() -> dict[str, Callable[[], bytes]]:
    """What names itself, or the same thing over and over."""
    mesh = (
        '<object id="0" type="model"><mesh><vertices><vertex x="0" y="0" z="0"/><vertex x="1" y="0"'
        ' z="0"/><vertex x="0" y="1" z="0"/></vertices><triangles><triangle v1="0" v2="1" v3="2"/>'
        "</triangles></mesh></object>"
    )
    towers = "".join(
        f'<object id="{i}" type="model"><components>'
        + f'<component objectid="{i - 1}"/>' * 10
        + "</components></object>"
        for i in range(1, 12)
    )
    circle = (
        '<object id="1" type="model"><components><component objectid="2"/></components></object>'
        '<object id="2" type="model"><components><component objectid="1"/></components></object>'
    )
    scene = json.loads(whole("gltf")[1])
    scene["nodes"] = [{"mesh": 0}, *({"children": [i, i, i]} for i in range(40))]
    scene["scenes"] = [{"nodes": [40]}]
    tower = json.dumps(scene).encode()
    scene["nodes"] = [{"children": [1], "mesh": 0}, {"children": [0]}]
    scene["scenes"] = [{"nodes": [0]}]
    return {
        "3mf of 10^11 parts.3mf": lambda: _three_mf(_model(mesh + towers, '<item objectid="11"/>').encode()),
        "3mf in a circle.3mf": lambda: _three_mf(_model(mesh + circle, '<item objectid="1"/>').encode()),
        "3mf of entities.3mf": lambda: _three_mf(_entities("<model>{}</model>")),
        "gltf of 3^40 parts.gltf": lambda: tower,
        "gltf in a circle.gltf": lambda: json.dumps(scene).encode(),
        "gltf nested.gltf": lambda: b"[" * 100_000 + b"]" * 100_000,
        "dae of entities.dae": lambda: _entities("<COLLADA>{}</COLLADA>"),
        "vtu of entities.vtu": lambda: _entities("<VTKFile>{}</VTKFile>"),
        "xml of entities.xml": lambda: _entities("<dolfin>{}</dolfin>"),
        "vtu nested.vtu": lambda: b"<a>" * 1_000_000,
        "dae nested.dae": lambda: b"<a>" * 1_000_000,
    }  # fmt: skip


def _long() -> dict[str, Callable[[], bytes]]:
    """Much of what is short."""
    corners = 100_000
    ring = b"".join(b"v %d %d 0\n" % (i, i * i % 101) for i in range(corners))
    polygon = b"f " + b" ".join(b"%d" % i for i in range(1, corners + 1)) + b"\n"
    return {
        "obj with a face of 100,000 corners.obj": lambda: ring + polygon,
        "obj of 45 MB of spaces.obj": lambda: b" " * 45_000_000 + b"f",
        "obj of 45 MB of f.obj": lambda: b"f " * 22_500_000,
        "obj of a line of 45 MB.obj": lambda: b"v 0 0 0\nf 1 1 1 1\nv " + b"0 " * 22_500_000,
        "obj of 10^7 empty faces.obj": lambda: b"v 0 0 0\n" + b"f 1 1 1 1\n" * 4_500_000,
        "stl of 45 MB of facets.stl": lambda: b"solid\n" + b"facet normal\n" * 3_400_000,
        "stl of 45 MB of points.stl": lambda: b"solid\nfacet " + b"vertex 0 0 0\n" * 3_400_000,
        "off of 45 MB of zeros.off": lambda: b"OFF\n1 1 0\n" + b"0 " * 22_500_000,
        "ply of 10^6 properties.ply": lambda: (
            b"ply\nformat ascii 1.0\nelement vertex 1\n" + b"property float x\n" * 1_000_000
            + b"end_header\n0\n"
        ),
        "vtk of 45 MB of words.vtk": lambda: (
            b"# vtk DataFile Version 4.2\nx\nASCII\nDATASET UNSTRUCTURED_GRID\n" + b"FIELD a 1\n" * 4_500_000
        ),
        "inp of 45 MB of stars.inp": lambda: b"*NODE\n" * 7_500_000,
        "msh of 45 MB of sections.msh": lambda: (
            b"$MeshFormat\n2.2 0 8\n$EndMeshFormat\n" + b"$A\n$EndA\n" * 5_000_000
        ),
    }  # fmt: skip


def main() -> None:
    """Print what reading each bomb that is named took, a JSON object a line."""
    from tests.samples.meshes import load_mesh
    from tests.samples.peak import tell

    tell(bombs(), load_mesh, sys.argv[1:])


if __name__ == "__main__":
    main()
