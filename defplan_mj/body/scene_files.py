"""Reads what the loaders of scenes leave out without a word: of Collada, and of what glTF names besides."""

from __future__ import annotations

import importlib.util
import json
import re
import zipfile
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np

from defplan_mj.base.errors import DefplanError
from defplan_mj.body.raw_mesh import RawMesh, of_polygons

_PACKED = {"KHR_draco_mesh_compression": "DracoPy", "EXT_meshopt_compression": ""}
"""Extensions that hide the coordinates, and the package that trimesh reads them by."""
_FAN = 6


def read_collada(path: Path) -> RawMesh:
    """Return all surfaces of a Collada scene where they stand, skinned ones as they were bound, in m."""
    import collada

    with path.open("rb") as stream:  # what is broken about materials does not matter
        scene = collada.Collada(stream, ignore=[collada.common.DaeError])
    parts: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
    lines = 0
    for kind in ("geometry", "controller"):
        for bound in scene.scene.objects(kind) if scene.scene is not None else ():
            if kind == "controller":
                bound = _skinned(bound)
            for primitive in bound.primitives():
                sizes = _sizes(primitive)
                if sizes is None:
                    lines += 1
                elif len(sizes):
                    flat = np.asarray(primitive.vertex_index, np.int64).ravel()
                    parts.append((np.asarray(primitive.vertex, float).reshape(-1, 3), flat, sizes))
    before = np.cumsum([0, *(len(vertices) for vertices, _, _ in parts)])
    mesh = of_polygons(
        np.concatenate([np.zeros((0, 3)), *(part[0] for part in parts)]),
        np.concatenate(
            [np.zeros(0, np.int64), *(p[1] + n for p, n in zip(parts, before, strict=False))]
        ),
        np.concatenate([np.zeros(0, np.int64), *(part[2] for part in parts)]),
    )
    unit = scene.assetInfo.unitmeter
    if unit is not None and unit != 1.0 and 0.0 < unit < np.inf:
        mesh.vertices = mesh.vertices * unit
        mesh.notes.append(f"the file's unit is {unit:g} m: taken as such")
    if lines:
        mesh.notes.append(f"{lines} sets of lines are not used")
    mesh.up = str(scene.assetInfo.upaxis or "Y_UP")[0].lower()
    return mesh


def _skinned(bound: Any) -> Any:
    """Return the geometry of a bound skin or morph, before any bone moves it."""
    if hasattr(bound, "geometry"):
        return bound.geometry
    return bound.original.source_geometry.bind(bound.matrix, bound.materialnodebysymbol)


def _sizes(primitive: Any) -> np.ndarray | None:
    """Return how many corners each polygon of a Collada primitive has; None of lines."""
    if hasattr(primitive, "polyindex"):
        return np.diff(np.asarray(primitive.polyindex, np.int64).reshape(-1, 2), axis=1).ravel()
    index = primitive.vertex_index
    if index is None:
        return np.zeros(0, np.int64)
    index = np.asarray(index)
    return np.full(len(index), 3, np.int64) if index.ndim == 2 and index.shape[1] == 3 else None


def check_3mf(path: Path) -> None:
    """Refuse a 3MF file that builds objects of further files in its archive: they would be left out."""
    with zipfile.ZipFile(path) as archive:
        models = [name for name in archive.namelist() if "3d/3dmodel.model" in name.lower()]
        parts = sum(len(re.findall(rb"<item\b[^>]*\bpath=", archive.read(name))) for name in models)
    if parts:
        raise DefplanError(
            f"{path} builds {parts} objects that stand in further files of its archive, which are not"
            " read: export it as one object"
        )


def check_gltf(path: Path, form: str) -> list[str]:
    """Return sentences on what of a glTF file is not used.

    Raises:
        DefplanError: its coordinates are in a file that is not there, or packed.
    """
    try:
        tree = _tree(path, form)
        packed = [e for e in tree.get("extensionsRequired", ()) if e in _PACKED]
        places = [b["uri"] for b in tree.get("buffers", ()) if "uri" in b]
        modes = [p.get("mode", 4) for m in tree.get("meshes", ()) for p in m["primitives"]]
        missing = [uri for uri in places if not uri.startswith("data:")
                   and not (path.parent / unquote(uri)).is_file()]  # fmt: skip
    except (TypeError, AttributeError, KeyError, ValueError, OSError, RecursionError):
        return []  # damaged: who reads it says how
    for extension in packed:
        package = _PACKED[extension]
        if not (package and importlib.util.find_spec(package)):
            raise DefplanError(
                f"{path} is packed by {extension[:40]}, which cannot be read: export it without compression"
            )
    if missing:
        raise DefplanError(
            f"{path} names a file that is not beside it ({ascii(missing[0])[1:-1][:80]}): copy that there, or"
            " export a .glb, which holds all in one"
        )
    fans = modes.count(_FAN)
    return [f"{fans} fans of triangles are not used"] if fans else []


def _tree(path: Path, form: str) -> Any:
    data = path.read_bytes()
    if form == ".glb":
        data = data[20 : 20 + int.from_bytes(data[12:16], "little")]
    return json.loads(data)
