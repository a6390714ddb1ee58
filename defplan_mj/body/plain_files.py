"""Reads the plain formats by itself: OBJ, OFF and STL, whose variants the loaders of others drop or misread."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from defplan_mj.base.errors import DefplanError
from defplan_mj.body.raw_mesh import RawMesh, of_polygons

_PRECISE = 1e-3  # of the length: coarser steps between single-precision coordinates are refused


# ---- OBJ


def read_obj(path: Path) -> RawMesh:
    """Return an OBJ file's vertices and polygons: of a corner, what stands before its first slash counts."""
    text = _text(path.read_bytes()).replace("\\\n", " ")
    places = re.findall(r"^[ \t]*v[ \t]+(\S+)[ \t]+(\S+)[ \t]+(\S+)", text, re.MULTILINE)
    vertices = np.array(places, float).reshape(-1, 3)
    short = re.search(r"^[ \t]*v((?:[ \t]+[^\s#]+){0,2})[ \t]*(?:#.*)?$", text, re.MULTILINE)
    if short is not None:
        if not text[short.end() :].strip():
            raise DefplanError(
                f"{path} is cut short: it ends within a vertex; copy or export it again"
            )
        count = len(short[1].split())
        raise DefplanError(f"{path}: its vertices have {count} coordinates, not 3")
    lines = re.findall(r"^[ \t]*fo?[ \t]+([^\n#]*)", text, re.MULTILINE)
    # normals and texture places, "/7/3", go at once: that is faster than corner by corner
    rows = (
        [line.split() for line in re.sub(r"/[^\s]*", "", "\n".join(lines)).split("\n")]
        if lines
        else []
    )
    sizes = np.array([len(row) for row in rows], np.int64)
    index = np.array([word for row in rows for word in row], np.int64)
    if len(index) and index.min() < 0:
        index = _absolute(text, index, sizes)
    return of_polygons(vertices, index - 1, sizes)


def _absolute(text: str, index: np.ndarray, sizes: np.ndarray) -> np.ndarray:
    """Return OBJ indices, of which negative ones count back from the last vertex above the face."""
    kinds = re.findall(r"^[ \t]*(v|fo?)[ \t]", text, re.MULTILINE)
    is_face = np.array([kind != "v" for kind in kinds])
    before = np.cumsum(~is_face)[is_face]
    return np.where(index < 0, index + 1 + np.repeat(before, sizes), index)


def _text(data: bytes) -> str:
    """Return a file's text with plain line ends, in the encoding that its first bytes tell."""
    coding = "utf-16" if data[:2] in (b"\xff\xfe", b"\xfe\xff") else "utf-8-sig"
    return data.decode(coding, errors="replace").replace("\r\n", "\n").replace("\r", "\n")


# ---- OFF


def read_off(path: Path) -> RawMesh | None:
    """Return a text OFF file's polygons, with colours or normals beside the vertices or without.

    None if it has no lines as usual.
    """
    data = path.read_bytes()
    if re.match(rb"\s*\w*OFF\s+BINARY", data[:100]):
        raise DefplanError(f"{path} is a binary OFF file: export it as text, or as STL or PLY")
    text = re.sub(r"#.*", "", _text(data))
    head = re.match(r"\s*(ST)?C?N?OFF\b", text)
    if head is None:
        return None
    rows = [row for row in (line.split() for line in text[head.end() :].split("\n")) if row]
    if not rows or len(rows[0]) < 2:
        return None
    n, f = int(rows[0][0]), int(rows[0][1])
    if min(n, f) < 0 or len(rows) < 1 + n + f:
        raise DefplanError(
            f"{path} is cut short: its header names {n} vertices and {f} faces, it has"
            f" {len(rows) - 1} lines for them; copy or export it again"
        )
    vertices = np.array([row[:3] for row in rows[1 : 1 + n]], float).reshape(n, 3)
    faces = rows[1 + n : 1 + n + f]
    sizes = np.array([row[0] for row in faces], np.int64)
    flat = [word for row, size in zip(faces, sizes, strict=True) for word in row[1 : 1 + size]]
    if len(flat) != sizes.sum():
        raise DefplanError(f"{path} has faces with fewer corners than they name: export it again")
    return of_polygons(vertices, np.array(flat, np.int64), sizes)


# ---- STL


def read_stl(path: Path) -> RawMesh:
    """Return an STL file's triangles: of all solids of a text one, of a binary one whatever follows them.

    Raises:
        DefplanError: it is neither a whole binary file nor a text one.
    """
    data = path.read_bytes()
    count = int.from_bytes(data[80:84], "little") if len(data) >= 84 else -1
    whole = 84 + 50 * count
    text = data.lstrip()[:5].lower() == b"solid"
    # some programs begin binary files with 'solid' as well: a length that fits decides
    if len(data) == whole and count or (not text and count > 0 and whole < len(data)):
        notes = [] if len(data) == whole else [
            f"{len(data) - whole} bytes after the last triangle are not used"
        ]  # fmt: skip
        parts = np.frombuffer(data, np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)),
                                              ("more", "<u2")]), count, 84)  # fmt: skip
        vertices = parts["corners"].reshape(-1, 3).astype(float)
        _check_precision(vertices, path)
        return RawMesh(vertices, np.arange(3 * count).reshape(-1, 3), notes=notes)
    head = data[:2048].lower()
    if text and b"facet" in head:
        return _text_stl(data, path)
    if text and b"endsolid" in head or (len(data) == 84 and count == 0):
        raise DefplanError(f"{path} is empty: its solid has no facets")
    if 0 < count < 50_000_000 and len(data) < whole:
        raise DefplanError(
            f"{path} is cut short: its header names {count} triangles ({whole} bytes), the file has"
            f" {len(data)} bytes; copy or export it again"
        )
    raise DefplanError(
        f"{path} cannot be read as a .stl mesh (it has neither the length of a binary one nor the"
        " word 'facet' of a text one): it is damaged or of another format; export it again"
    )


def _text_stl(data: bytes, path: Path) -> RawMesh:
    corners = re.findall(rb"\bvertex\s+(\S+\s+\S+\s+\S+)", data, re.IGNORECASE)
    if len(corners) % 3 or not re.search(rb"end\s*solid", data[-2048:], re.IGNORECASE):
        raise DefplanError(
            f"{path} is cut short: its last solid has no end, after {len(corners)} corners; copy or export"
            " it again"
        )
    vertices = np.array(b" ".join(corners).split(), float).reshape(-1, 3)
    return RawMesh(vertices, np.arange(len(vertices)).reshape(-1, 3))


def _check_precision(vertices: np.ndarray, path: Path) -> None:
    """Refuse coordinates so far from the origin that single precision rounds the shape away."""
    size = float(np.ptp(vertices, axis=0).max())
    step = float(np.spacing(np.float32(np.abs(vertices).max())))
    if np.isfinite(size) and step > _PRECISE * size > 0.0:
        raise DefplanError(
            f"{path} lies so far from its origin that its coordinates are rounded to"
            f" {step / size:.1%} of its length: move it to the origin and export it again"
        )
