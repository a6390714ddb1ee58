"""Reads mesh files of all formats: vertices, triangles, tetrahedra, and what else the file said."""

from __future__ import annotations

import contextlib
import io
import re
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import meshio
import numpy as np
import trimesh

from defplan_mj.base.bounded import TooLong, bounded
from defplan_mj.base.errors import DefplanError
from defplan_mj.body import cells as split
from defplan_mj.body.old_cells import read_gmsh1
from defplan_mj.body.plain_files import read_obj, read_off, read_stl
from defplan_mj.body.raw_mesh import RawMesh, of_polygons
from defplan_mj.body.scene_files import check_3mf, check_gltf, read_collada
from defplan_mj.body.sniffing import form_of

SURFACE_FORMATS = (".stl", ".obj", ".ply", ".off", ".gltf", ".glb", ".3mf", ".dae")
_MESHIO: dict[str, tuple[str, ...]] = {  # two programs use .msh (and MuJoCo a third)
    ".msh": ("gmsh", "ansys"), ".vtk": ("vtk",), ".vtu": ("vtu",), ".mesh": ("medit",),
    ".meshb": ("medit",), ".inp": ("abaqus",), ".bdf": ("nastran",), ".nas": ("nastran",),
    ".fem": ("nastran",), ".vol": ("netgen",), ".su2": ("su2",), ".ele": ("tetgen",),
    ".node": ("tetgen",), ".avs": ("avsucd",), ".ugrid": ("ugrid",), ".xml": ("dolfin",),
    ".f3grid": ("flac3d",), ".mdpa": ("mdpa",),
}  # fmt: skip
_MUJOCO = (".skn",)
CELL_FORMATS = (*_MESHIO, *_MUJOCO)
_UNITS = {
    "micrometer": 1e-6, "micron": 1e-6, "millimeter": 1e-3, "centimeter": 1e-2, "decimeter": 0.1,
    "meter": 1.0, "inch": 0.0254, "foot": 0.3048, "feet": 0.3048,
}  # fmt: skip
# What reading may take, bytes and seconds of CPU: those who wrote the loaders trust the counts in a file.
_MEMORY, _GROWTH = 600 << 20, 4
_LARGE, _MORE_GROWTH = 50 << 20, 16
_SECONDS, _SECONDS_PER_BYTE = 6.0, 1e-6
_CURVED = 1e-3  # of the length: second-order cells are split at their edges' middles
_MOST_STRAIGHTENED = 1e-2  # of the length


def read_file(path: Path) -> RawMesh:
    """Read a mesh file.

    Raises:
        DefplanError: it cannot be read; the sentence says why, in the format's words.
    """
    if not path.is_file():
        there = "is a folder: name a file in it" if path.is_dir() else "does not exist"
        raise DefplanError(f"mesh file {path} {there}")
    size = path.stat().st_size
    named, known = path.suffix.lower(), (*SURFACE_FORMATS, *CELL_FORMATS)
    if size == 0 and named in known:
        raise DefplanError(f"{path} is empty: it has no bytes; export it again")
    form = _form(path, named)
    if form not in known:
        raise DefplanError(f"cannot read {path}: a mesh file ends in one of {', '.join(known)}")
    memory = _MEMORY + _GROWTH * min(size, _LARGE) + _MORE_GROWTH * max(size - _LARGE, 0)
    try:
        with bounded(memory, _SECONDS + _SECONDS_PER_BYTE * size):
            mesh = _read(path, form)
    except (MemoryError, TooLong) as error:
        what = "memory" if isinstance(error, MemoryError) else "time"
        raise DefplanError(
            f"{path} asks for more {what} than a mesh of {size} bytes needs: it is damaged or no mesh;"
            " export it again"
        ) from None
    if len(mesh.triangles) == 0 and len(mesh.tetrahedra) == 0:
        if len(mesh.vertices):
            raise DefplanError(
                f"{path} is a cloud of {len(mesh.vertices)} points without triangles or tetrahedra:"
                " make a surface of it first"
            )
        raise DefplanError(
            f"{path} has no triangles and no tetrahedra: it is damaged, of another format or was"
            " exported without faces; export it again"
        )
    if form != named:
        mesh.notes.insert(0, f"read as {form}: that is what its first bytes say")
    for corners in (mesh.triangles, mesh.tetrahedra):
        if len(corners) and (corners.min() < 0 or corners.max() >= len(mesh.vertices)):
            raise DefplanError(f"{path} names vertices that it does not have: export it again")
    return mesh


def _form(path: Path, named: str) -> str:
    """Return the format of a file: what its first bytes say, else its name."""
    said = form_of(path)
    return named if said is None or (said, named) == (".mesh", ".meshb") else said


def _read(path: Path, form: str) -> RawMesh:
    if form in _MUJOCO:
        return _mujoco_skin(path)
    if form in SURFACE_FORMATS:
        return _surface(path, form)
    return (_mujoco_mesh(path) if form == ".msh" else None) or _cells(path, form)


def _attempt(path: Path, form: str, read: Callable[[], Any]) -> Any:
    """Return read(), without what it prints; turn its failures into a sentence."""
    try:
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            return read()
    except (MemoryError, DefplanError):
        raise
    except (Exception, SystemExit) as error:  # every loader fails in its own way on a damaged file
        why = _short(error)
        raise DefplanError(
            f"{path} cannot be read as a {form} mesh{f' ({why})' if why else ''}: it is damaged or of"
            " another format; export it again"
        ) from error


def _short(error: BaseException) -> str:
    """Return the first line of an error's message, if it has any; bytes that are no text are no message."""
    lines = str(error).strip().splitlines()
    text = lines[0] if lines else ""
    if isinstance(error, UnicodeDecodeError):
        text = "its bytes are no text"
    return re.sub(r"[^\x20-\x7e]", "?", text).rstrip(".:")[:120]


# ---- surfaces


def _surface(path: Path, form: str) -> RawMesh:
    polygons = _attempt(path, form, lambda: _POLYGONS[form](path)) if form in _POLYGONS else None
    if polygons is not None:
        return polygons
    gltf = form in (".gltf", ".glb")
    notes = check_gltf(path, form) if gltf else []
    if form == ".3mf":
        _attempt(path, form, partial(check_3mf, path))
    mesh = _attempt(path, form, lambda: trimesh.load(str(path), file_type=form[1:], process=False))
    factor, said = _unit(getattr(mesh, "units", None), form)
    if isinstance(mesh, trimesh.Scene):
        others = [g for g in mesh.geometry.values() if not isinstance(g, trimesh.Trimesh)]
        if others and len(others) == len(mesh.geometry):
            return RawMesh(np.concatenate([_vertices(g, path) for g in others]))
        if others:
            notes.append(f"{len(others)} lines or point clouds beside the surfaces are not used")
        mesh = _attempt(path, form, mesh.to_mesh)
    vertices = _vertices(mesh, path)
    faces = np.array(getattr(mesh, "faces", np.zeros((0, 3))), np.int64).reshape(-1, 3)
    up = "y" if gltf else "z" if form == ".3mf" else None
    return RawMesh(
        vertices * factor, faces, notes=notes + said, up=up, forward="z" if gltf else None
    )


def _vertices(part: Any, path: Path) -> np.ndarray:
    """Return the vertices (n, 3) of what trimesh has read, which may be flat."""
    vertices = np.array(getattr(part, "vertices", np.zeros((0, 3))), float)
    if vertices.size and vertices.shape[1:] != (3,):
        raise DefplanError(f"{path}: its vertices have {vertices.shape[-1]} coordinates, not 3")
    return vertices.reshape(-1, 3)


def _unit(name: str | None, form: str) -> tuple[float, list[str]]:
    """Return metres in a 3MF file's unit and what to say of it; glTF's numbers are metres."""
    if form != ".3mf":
        return 1.0, []
    unit = str(name or "millimeter").lower().rstrip("s")
    factor = _UNITS.get(unit, _UNITS.get(unit + "s", 1e-3))
    return factor, [] if factor == 1.0 else [f"the file's unit is the {unit}: taken as such"]


def _ply(path: Path) -> RawMesh | None:
    """Return a PLY file's polygons; None if it has triangles only, or meshio cannot read it."""
    try:
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            mesh = meshio.ply.read(str(path))
    except MemoryError:
        raise
    except (Exception, SystemExit):
        return None
    if all(block.type == "triangle" for block in mesh.cells):
        return None
    return _of_meshio(path, mesh)


_POLYGONS: dict[str, Callable[[Path], RawMesh | None]] = {
    ".obj": read_obj, ".off": read_off, ".ply": _ply, ".stl": read_stl, ".dae": read_collada,
}  # fmt: skip


# ---- cells


def _cells(path: Path, form: str) -> RawMesh:
    old = _attempt(path, form, partial(read_gmsh1, path)) if form == ".msh" else None
    if old is not None:
        return _of_meshio(path, old)
    if form == ".vtk":
        with path.open("rb") as stream:
            if b"DATASET POLYDATA" in stream.read(1024):
                raise DefplanError(
                    f"{path} is a surface of VTK (POLYDATA), which cannot be read: save it as .stl or"
                    " .ply, or as an unstructured grid"
                )
    failure: DefplanError | None = None
    for name in _MESHIO[form]:
        try:
            mesh = _attempt(path, form, partial(getattr(meshio, name).read, str(path)))
            return _attempt(path, form, partial(_of_meshio, path, mesh))
        except DefplanError as error:
            failure = failure or error
    assert failure is not None
    raise failure


def _of_meshio(path: Path, mesh: Any) -> RawMesh:
    vertices = np.asarray(mesh.points, float)
    if vertices.ndim == 2 and vertices.shape[1] == 2:
        vertices = np.hstack([vertices, np.zeros((len(vertices), 1))])
    size = float(np.ptp(vertices, axis=0).max()) if len(vertices) else 0.0
    solid: dict[str, list[np.ndarray]] = {}
    flat: list[np.ndarray] = []
    notes: list[str] = []
    unused: dict[str, int] = {}
    for block in mesh.cells:
        kind = split.linear_kind(block.type)
        if kind is None and block.type.startswith("polygon"):
            sizes = np.array([len(polygon) for polygon in block.data], np.int64)
            corners = np.array([i for polygon in block.data for i in polygon], np.int64)
            flat.append(of_polygons(vertices, corners, sizes).triangles)
            continue
        if kind is None:
            if not block.type.startswith(("vertex", "line")):
                raise DefplanError(
                    f"{path} has {len(block.data)} cells of the kind {block.type}, which cannot be"
                    " split: export tetrahedra, hexahedra, wedges, pyramids or a surface"
                )
            unused[block.type] = unused.get(block.type, 0) + len(block.data)
            continue
        rows = np.asarray(block.data, np.int64)
        if len(rows) == 0:
            continue
        if rows.min() < 0 or rows.max() >= len(vertices):
            raise DefplanError(f"{path} names vertices that it does not have: export it again")
        linear, off = split.straighten(vertices, kind, rows, _CURVED * size)
        if off > _MOST_STRAIGHTENED * size:
            raise DefplanError(
                f"{path} has curved {block.type} cells, whose straight edges would be off by"
                f" {off / size:.1%} of the length: refine it or export linear cells"
            )
        if off > _CURVED * size:
            notes.append(
                f"curved {block.type} cells are taken with straight edges, off by {off / size:.1%}"
                " of the length"
            )
        if kind in split.FACES:
            solid.setdefault(kind, []).append(linear)
        else:
            flat.append(split.split_polygons(vertices, linear))
    triangles = np.concatenate([np.zeros((0, 3), np.int64), *flat])
    if not solid:
        if len(triangles) and unused:
            notes += [f"{n} cells of the kind {k} are not used" for k, n in unused.items() if n]
        return RawMesh(vertices, triangles, notes=notes)
    joined = {kind: np.concatenate(parts) for kind, parts in solid.items()}
    used = np.unique(np.concatenate([part.ravel() for part in joined.values()]))
    beside = int((~np.isin(triangles, used).all(1)).sum())
    if beside:
        notes.append(f"{beside} triangles that belong to no solid cell are not used")
    vertices, tetrahedra = split.split_cells(vertices, joined)
    others = {k: len(v) for k, v in joined.items() if k != "tetra"}
    if others:
        names = {"hexahedron": "hexahedra", "wedge": "wedges", "pyramid": "pyramids"}
        what = " and ".join(f"{n} {names[k]}" for k, n in others.items())
        notes.append(f"{what} are split into tetrahedra")
    return RawMesh(vertices, np.zeros((0, 3), np.int64), tetrahedra, notes)


# ---- MuJoCo's own


def _mujoco_mesh(path: Path) -> RawMesh | None:
    """Return MuJoCo's binary .msh: four counts, vertices, normals, texture places, faces; or None."""
    data = path.read_bytes()
    if len(data) < 16:
        return None
    n, normals, places, faces = (int(k) for k in np.frombuffer(data, "<i4", 4))
    if min(n, normals, places, faces) < 0 or n == 0:
        return None
    if len(data) != 16 + 12 * n + 12 * normals + 8 * places + 12 * faces:
        return None
    vertices = np.frombuffer(data, "<f4", 3 * n, 16).reshape(-1, 3).astype(float)
    if faces == 0:
        return RawMesh(vertices)
    start = 16 + 12 * n + 12 * normals + 8 * places
    return RawMesh(
        vertices, np.frombuffer(data, "<i4", 3 * faces, start).reshape(-1, 3).astype(np.int64)
    )


def _mujoco_skin(path: Path) -> RawMesh:
    """Return MuJoCo's .skn: four counts, vertices, texture places, faces, then bones (not used)."""
    data = path.read_bytes()
    counts = [int(k) for k in np.frombuffer(data[:16], "<i4", 4)] if len(data) >= 16 else [-1] * 4
    n, places, faces, bones = counts
    least = 16 + 12 * n + 8 * places + 12 * faces + 72 * bones
    if min(counts) < 0 or n == 0 or len(data) < least:
        raise DefplanError(
            f"{path} cannot be read as a .skn skin of MuJoCo (its header does not fit its"
            f" {len(data)} bytes): export it again"
        )
    vertices = np.frombuffer(data, "<f4", 3 * n, 16).reshape(-1, 3).astype(float)
    start = 16 + 12 * n + 8 * places
    triangles = np.frombuffer(data, "<i4", 3 * faces, start).reshape(-1, 3).astype(np.int64)
    notes = [f"the skin's {bones} bones are not used"] if bones else []
    return RawMesh(vertices, triangles, notes=notes)
