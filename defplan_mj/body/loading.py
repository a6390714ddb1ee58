"""From a mesh file to tetrahedra: read, turned, scaled, mended, filled, and compared with the file."""

from __future__ import annotations

import resource
from contextlib import suppress
from copy import deepcopy
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from defplan_mj.base import files
from defplan_mj.base.errors import DefplanError
from defplan_mj.base.progress import Progress, no_progress
from defplan_mj.body.fidelity import MOST_DISTANCE, Fidelity, distances, measure
from defplan_mj.body.formats import read_file
from defplan_mj.body.look import View, look
from defplan_mj.body.meshing import fill
from defplan_mj.body.options import BodyOptions
from defplan_mj.body.orientation import frame_of
from defplan_mj.body.raw_mesh import RawMesh
from defplan_mj.body.repair import Repaired, edge_pieces, repair
from defplan_mj.body.surface import (
    Surface,
    check_extent,
    check_surface,
    check_tetrahedra,
    merge_vertices,
)
from defplan_mj.body.tetmesh import TetMesh, boundary, compact, face_pieces, volumes
from defplan_mj.body.tetwild import CPU_SECONDS, decimate, mesh_hash, run_tetwild

SMALL, LARGE = 0.02, 20.0  # m: an extent beyond is rarely meant
_MANY = 80_000  # triangles; a surface with more is simplified first
_THIN = 0.5  # of a lattice cell: mean thickness below which the lattice is not tried
_ENVELOPE = 2e-3  # of the diagonal, at most
_SIMPLIFIED = 0.6  # of the bound on the mesh: how far a simplified surface may be from its own
_FEW = 0.6  # of the wanted vertices: with fewer it is filled again, finer
_CRUMB = 1e-3  # share of the volume
_ONE_PLACE = 1e-7  # of the length
_SHAPING = ("vertices", "length", "up", "forward", "strict", "shape_error")
"""The options that a mesh depends on."""


@dataclass
class Filled:
    """A file's mesh, filled.

    Attributes:
        mesh: tetrahedra, m; x forward, z up.
        fidelity: how like the file it is; None if that was not asked for.
        repaired, notes, warnings: sentences.
        source: what the body keeps of it.
    """

    mesh: TetMesh
    fidelity: Fidelity | None = None
    repaired: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    source: dict = field(default_factory=dict)


_LAST: dict[tuple, Filled] = {}
"""What was filled last: who guesses a task of a mesh builds its body next, and fTetWild takes long."""


def fill_file(
    path: Path, options: BodyOptions, progress: Progress = no_progress, measured: bool = True
) -> Filled:
    """Read a mesh file and fill it with tetrahedra.

    Args:
        measured: also say how like the file the mesh is; `options.shape_error` asks for it anyway.

    Raises:
        DefplanError: the file cannot be used; the sentence says why and what mends it.
    """
    progress("reading the mesh", 0.0)
    measured = measured or options.shape_error is not None
    if not path.is_file():
        return _fill_file(path, options, progress, measured)  # which says what is wrong
    key = (files.file_hash(path), path, measured, *(getattr(options, name) for name in _SHAPING))
    if key not in _LAST:
        filled = _fill_file(path, options, progress, measured)
        _LAST.clear()
        _LAST[key] = filled
    return deepcopy(_LAST[key])


def _fill_file(path: Path, options: BodyOptions, progress: Progress, measured: bool) -> Filled:
    raw, warnings = _place(read_file(path), options, path)
    anew: list[str] = []
    welded: list[str] = []
    if len(raw.tetrahedra):
        if not options.strict:
            raw, welded = _weld_cells(raw)
        try:
            mesh = check_tetrahedra(raw.vertices, raw.tetrahedra, path)
        except DefplanError as error:
            if options.strict:
                raise
            why = str(error).removeprefix(f"{path} ").rsplit(":", 1)[0].rsplit(";", 1)[0]
            raw = replace(raw, triangles=_skin(raw), tetrahedra=raw.tetrahedra[:0])
            anew = [f"filled anew: it {why}"]
        else:
            same = Fidelity(0.0, 0.0, 0.0, tuple(welded)) if measured else None
            return Filled(mesh, same, welded, notes=raw.notes, warnings=warnings)
    surface, far = _simplify(raw, path)
    repaired = _sound(surface, path, options.strict)
    filled = _fill(repaired, path, options, progress, measured)
    filled.repaired = [*welded, *anew, *far[1], *filled.repaired]
    if filled.fidelity is not None:
        filled.fidelity = replace(
            filled.fidelity,
            surface_distance=filled.fidelity.surface_distance + far[0],
            repaired=tuple(filled.repaired),
        )
        bound = options.shape_error
        if bound is not None and not filled.fidelity.within(bound):
            raise DefplanError(
                f"{path} cannot be filled well enough ({filled.fidelity}; at most {bound:.2%} and 3%"
                " are allowed): ask for more --vertices, or thicken or simplify its thinnest parts"
            )
    filled.notes, filled.warnings = raw.notes, warnings
    return filled


def read_view(
    path: Path, medium: str, length: float, up: str | None = None, forward: str | None = None
) -> tuple[Surface | TetMesh, View]:
    """Return what a file holds, mended if need be, along the file's axes, and which way it looks.

    Args:
        medium: 'water' or 'ground'.
        length: the longest extent is scaled to it, m.
        up, forward: axes of the file, if the user says so.

    Raises:
        DefplanError: the file cannot be used; the sentence says why and what mends it.
    """
    raw = read_file(path)
    cells = raw.tetrahedra if len(raw.tetrahedra) else raw.triangles
    extent = check_extent(raw.vertices, cells, path)
    finite = np.where(np.isfinite(raw.vertices), raw.vertices, 0.0)
    raw = replace(raw, vertices=length / extent.max() * finite)
    shape: Surface | TetMesh | None = None
    if len(raw.tetrahedra):
        with suppress(DefplanError):
            shape = check_tetrahedra(raw.vertices, raw.tetrahedra, path)
        raw = replace(raw, triangles=_skin(raw))
    if shape is None:
        shape = _sound(_simplify(raw, path)[0], path, strict=False).surface
    return shape, look(shape, medium, *_axes(raw, up, forward))


def _place(raw: RawMesh, options: BodyOptions, path: Path) -> tuple[RawMesh, list[str]]:
    """Turn and scale what was read; return it and warnings."""
    cells = raw.tetrahedra if len(raw.tetrahedra) else raw.triangles
    used = np.unique(cells)
    extent = check_extent(raw.vertices, cells, path)
    vertices, notes = np.where(np.isfinite(raw.vertices), raw.vertices, 0.0), list(raw.notes)
    faces = _skin(raw) if len(raw.tetrahedra) else raw.triangles
    medium = "ground" if options.medium.gravity else "water"
    up, forward = _axes(raw, options.up, options.forward)
    because = ""
    if up is None or forward is None:
        view = look(Surface(vertices, faces), medium, up, forward)
        up, forward = view.up, view.forward
        because = f" ({view.why})" if view.why else ""
    frame = frame_of(up, forward)
    if not np.array_equal(frame, np.eye(3)):
        vertices = vertices @ frame.T
        notes.append(
            f"turned: {up} of the file is up, {forward} is forward{because};"
            " --up and --forward overrule"
        )
        extent = np.ptp(vertices[used], axis=0)
    warnings: list[str] = []
    if options.length is not None:
        vertices = vertices * (options.length / extent.max())
    elif extent.max() < SMALL or extent.max() > LARGE:
        lengths = " x ".join(f"{e:.3g}" for e in extent)
        warnings.append(
            f"the mesh is {lengths} m, taken as the file says: --length M scales its longest extent"
            " to M metres"
        )
    return replace(raw, vertices=vertices, notes=notes), warnings


def _axes(raw: RawMesh, up: str | None, forward: str | None) -> tuple[str | None, str | None]:
    """Return what the user says of up and forward, and else what the file's format does."""
    up = up or (raw.up if forward is None or _across(raw.up, forward) else None)
    forward = forward or (raw.forward if up is None or _across(raw.forward, up) else None)
    return up, forward


def _across(said: str | None, given: str) -> bool:
    return said is not None and said[-1] != given[-1]


def _weld_cells(raw: RawMesh) -> tuple[RawMesh, list[str]]:
    """Join vertices at one place if the tetrahedra hang together less without; return what was done."""
    before = face_pieces(raw.tetrahedra)[0].max()
    if before == 0:
        return raw, []
    size = np.ptp(raw.vertices[np.unique(raw.tetrahedra)], axis=0).max()
    places = np.round(raw.vertices / (_ONE_PLACE * size)) + 0.0
    _, first, index = np.unique(places, axis=0, return_index=True, return_inverse=True)
    cells = index.ravel()[raw.tetrahedra]
    after = np.sort(cells, axis=1)
    if (np.diff(after, axis=1) == 0).any() or face_pieces(cells)[0].max() >= before:
        return raw, []
    joined = len(np.unique(raw.tetrahedra)) - len(np.unique(cells))
    welded = replace(raw, vertices=raw.vertices[first], tetrahedra=cells)
    return welded, [f"welded {joined} vertices of cells that lie at one place"]


def _skin(raw: RawMesh) -> np.ndarray:
    """Return the boundary of tetrahedra, whatever their orientation."""
    turned = raw.tetrahedra.copy()
    back = volumes(raw.vertices, turned) < 0.0
    turned[back] = turned[back][:, [0, 2, 1, 3]]
    return boundary(turned)[0]


def _simplify(raw: RawMesh, path: Path) -> tuple[Surface, tuple[float, list[str]]]:
    """Return the surface, simplified if it is huge, and how far that moved it (of the length), said."""
    surface = Surface(raw.vertices, raw.triangles)
    if len(surface.faces) <= _MANY:
        return surface, (0.0, [])
    vertices, faces = merge_vertices(surface.vertices, surface.faces)
    if len(faces) == 0:
        raise DefplanError(f"{path} is empty: all its triangles collapse")
    whole = Surface(vertices, faces)
    fewer = decimate(whole, _MANY // 2)
    size = np.ptp(vertices, axis=0).max()
    off = max(distances(whole, fewer)[0].max(), distances(fewer, whole)[0].max()) / size
    return fewer, (
        float(off),
        [
            f"simplified {len(faces)} triangles to {len(fewer.faces)}, within {off:.2%} of the length"
        ],
    )


def _sound(surface: Surface, path: Path, strict: bool) -> Repaired:
    """Return the surface as it is if it is sound, else mended (not if `strict`)."""
    try:
        sound = check_surface(surface.vertices, surface.faces, path)
        if edge_pieces(sound.faces).max() > 0:
            raise DefplanError(f"{path} has pieces that touch in points only: let them overlap")
        return Repaired(sound, True, False, ())
    except DefplanError as error:
        mended = repair(surface.vertices, surface.faces, path)
        if strict and any(not text.startswith("kept") for text in mended.said):
            raise DefplanError(f"{error} (without --strict it would be mended)") from error
        return mended


def _fill(
    repaired: Repaired, path: Path, options: BodyOptions, progress: Progress, measured: bool
) -> Filled:
    """Fill the surface: by the lattice if that is like it, else by fTetWild."""
    surface, bound = repaired.surface, options.shape_error
    said = list(repaired.said)
    cell = 1.4 * (2.0 * abs(surface.volume) / options.vertices) ** (1.0 / 3.0)
    failure: DefplanError | None = None
    if repaired.simple and 2.0 * surface.volume / surface.area > _THIN * cell:
        progress("filling it with tetrahedra", 0.05)
        try:
            mesh, cells = fill(surface, options.vertices, str(path))
        except DefplanError as error:
            failure = error
        else:
            like = measure(mesh, surface, own=repaired.own) if measured else None
            if bound is None or (like is not None and like.within(bound)):
                error_of = volumes(mesh.vertices, mesh.tetrahedra).sum() / surface.volume - 1
                source = {"cell": cells.tolist(), "volume_error": float(error_of)}
                return Filled(mesh, like, said, source=source)
    progress("filling it within an envelope", 0.08)
    try:
        return _fill_within(repaired, path, options, said)
    except DefplanError:
        if failure is not None and bound is None:
            raise failure from None
        raise


def _fill_within(repaired: Repaired, path: Path, options: BodyOptions, said: list[str]) -> Filled:
    """Fill by fTetWild within an envelope, twice at most, the second time a narrower one or finer."""
    surface, before = repaired.surface, _child_seconds()
    extent = np.ptp(surface.vertices, axis=0)
    diagonal, bound = float(np.linalg.norm(extent)), options.shape_error or MOST_DISTANCE
    thickness = 2.0 * abs(surface.volume) / surface.area
    envelope = min(_ENVELOPE * diagonal, 0.03 * extent.min(), 0.1 * thickness)
    envelope = min(max(envelope, 2e-4 * diagonal), 0.3 * bound * extent.max())
    best: tuple[TetMesh, Fidelity] | None = None
    aim = float(options.vertices)
    for attempt in range(2):
        left = CPU_SECONDS - (_child_seconds() - before)
        if attempt and left < 10.0:
            break
        again = best is not None and not best[1].within(bound)
        narrow = envelope * (0.3 if again else 1.0)
        simple = _simplified(
            surface,
            int((2.5 if again else 1.25) * options.vertices),
            (0.5 if again else 1.0) * _SIMPLIFIED * bound * extent.max(),
        )
        try:
            mesh = run_tetwild(simple, aim, narrow, str(path), left)
        except DefplanError:
            if best is None:
                raise
            break
        mesh, crumbs = _one_piece(mesh, path)
        like = measure(mesh, surface, repaired.overlaps, repaired.own)
        if best is None or like.within(bound) or like.badness < best[1].badness:
            best, dropped = (mesh, like), crumbs
        count = len(mesh.vertices)
        if best[1].within(bound) and count > _FEW * options.vertices:
            break
        if count < _FEW * options.vertices:
            aim *= options.vertices / count
    assert best is not None
    mesh, like = best
    source = {"mesher": {"name": "fTetWild", "envelope": envelope, "sha256": mesh_hash(mesh)}}
    return Filled(mesh, like, [*said, *dropped], source=source)


def _child_seconds() -> float:
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def _simplified(surface: Surface, count: int, near: float) -> Surface:
    """Return the surface with about `count` triangles, or as many as keep it within `near`, m, of itself.

    fTetWild's time goes with them: a cow took 21 s in place of 47 when they were half as many.
    """
    count = max(count, 500)
    while count < len(surface.faces):
        fewer = decimate(surface, count)
        if len(fewer.faces) and max(
            distances(surface, fewer)[0].max(), distances(fewer, surface)[0].max()
        ) < near:  # fmt: skip
            return fewer
        count *= 2
    return surface


def _one_piece(mesh: TetMesh, path: Path) -> tuple[TetMesh, list[str]]:
    """Return the mesh without crumbs; refuse one that falls apart."""
    label, _ = face_pieces(mesh.tetrahedra)
    size = np.bincount(label, volumes(mesh.vertices, mesh.tetrahedra))
    if len(size) == 1:
        return mesh, []
    rest = 1.0 - size.max() / size.sum()
    if rest > _CRUMB:
        raise DefplanError(
            f"{path} falls into {len(size)} pieces that hang together by points or edges only"
            f" ({rest:.1%} of the volume is not in the largest): let them overlap"
        )
    keep = label == size.argmax()
    return compact(mesh.vertices, mesh.tetrahedra[keep]), [
        f"left out {len(size) - 1} crumbs, {rest:.2%} of the volume"
    ]
