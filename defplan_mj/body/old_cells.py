"""Reads cells of a format that meshio has given up: Gmsh 1."""

from __future__ import annotations

import re
from pathlib import Path

import meshio
import numpy as np

from defplan_mj.base.errors import DefplanError

_KINDS = {
    1: "line", 2: "triangle", 3: "quad", 4: "tetra", 5: "hexahedron", 6: "wedge", 7: "pyramid", 15: "vertex",
}  # fmt: skip


def read_gmsh1(path: Path) -> meshio.Mesh | None:
    """Return the mesh of a .msh file of Gmsh 1, which begins with $NOD; None of another file."""
    with path.open("rb") as stream:
        if not stream.read(64).lstrip().startswith(b"$NOD"):
            return None
    text = path.read_text(encoding="utf-8", errors="replace")
    nodes, elements = (_words(text, path, name) for name in ("NOD", "ELM"))
    count = int(nodes[0])
    table = np.array(nodes[1 : 1 + 4 * count], float).reshape(count, 4)
    names = table[:, 0].astype(np.int64)
    order = np.argsort(names)
    cells: dict[int, list[list[str]]] = {}
    at = 1
    for _ in range(int(elements[0])):
        kind, corners = int(elements[at + 1]), int(elements[at + 4])
        cells.setdefault(kind, []).append(elements[at + 5 : at + 5 + corners])
        at += 5 + max(corners, 0)
    blocks: list[tuple[str, np.ndarray]] = []
    for kind, rows in cells.items():
        if kind not in _KINDS:
            raise DefplanError(
                f"{path} has cells of Gmsh's kind {kind}: export it in Gmsh's format 4"
            )
        named = np.array(rows, np.int64)
        place = np.minimum(np.searchsorted(names[order], named), count - 1)
        if (names[order][place] != named).any():
            raise DefplanError(f"{path} names vertices that it does not have: export it again")
        blocks.append((_KINDS[kind], order[place]))
    return meshio.Mesh(table[:, 1:], blocks)


def _words(text: str, path: Path, name: str) -> list[str]:
    section = re.search(rf"\${name}\s(.*?)\$END{name}", text, re.DOTALL)
    if section is None:
        raise DefplanError(f"{path} is cut short: it has no $END{name}; copy or export it again")
    return section[1].split()
