"""Tells a mesh file's format by its first bytes, for names that say another."""

from __future__ import annotations

import re
from pathlib import Path

_HEAD = 4096  # bytes looked at
_SIGNS: tuple[tuple[str, bytes], ...] = (
    (".glb", rb"glTF"),
    (".ply", rb"ply\r?\n"),
    (".vtk", rb"# vtk DataFile"),
    (".vtu", rb"\s*(?:<\?xml[^>]*>\s*)?(?:<!--.*?-->\s*)?<VTKFile[^>]*UnstructuredGrid"),
    (".dae", rb"(?:\xef\xbb\xbf)?\s*(?:<\?xml[^>]*>\s*)?(?:<!--.*?-->\s*)?<COLLADA"),
    (".msh", rb"\s*\$(?:MeshFormat|NOD\b|Comments)"),
    (".mesh", rb"(?:\s*#[^\n]*\n)*\s*MeshVersionFormatted"),
    (".off", rb"(?:\s*#[^\n]*\n)*\s*(?:ST)?C?N?OFF\b"),
    (".stl", rb"\s*solid\b[^\n]*\n\s*facet\s+normal"),
    (".gltf", rb'\s*\{(?=[\s\S]*"asset"\s*:)'),
    (
        ".obj",
        rb"(?:\s*(?:#|(?:mtllib|o|g|s|usemtl)[ \t])[^\n]*\n)*\s*v[ \t]+[-+.\d]+\S*[ \t]+[-+.\d]",
    ),
)


def form_of(path: Path) -> str | None:
    """Return the ending that a mesh file's first bytes stand for (".ply"); None if they tell nothing."""
    size = path.stat().st_size
    with path.open("rb") as stream:
        head = stream.read(_HEAD)
        stream.seek(max(0, size - _HEAD))
        tail = stream.read(_HEAD)  # a zip archive's list of files
    if head[:4] == b"PK\x03\x04" and b"3D/" in head + tail:
        return ".3mf"
    for form, sign in _SIGNS:
        if re.match(sign, head, re.IGNORECASE | re.DOTALL):
            return form
    if size > 84 and size == 84 + 50 * int.from_bytes(head[80:84], "little"):
        return ".stl"
    return None
