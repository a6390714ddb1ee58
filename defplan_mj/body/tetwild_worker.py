"""Runs fTetWild on one file and writes another: what `tetwild` starts as a process of its own.

The native module is loaded by its path: `import pytetwild` would want pyvista, and VTK with it.
"""

from __future__ import annotations

import importlib.util
import resource
import sys
from pathlib import Path

import numpy as np


def main(given: str, made: str, seconds: int, memory: int) -> None:
    """Fill the surface of the file `given`; write the tetrahedra to `made`."""
    resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds + 1))
    resource.setrlimit(resource.RLIMIT_AS, (memory, memory))
    package = importlib.util.find_spec("pytetwild")
    folders = list(package.submodule_search_locations or []) if package else []
    modules = [p for folder in folders for p in Path(folder).glob("PyfTetWildWrapper*.so")]
    if not modules:
        sys.exit("no pytetwild is there: install it with pip install pytetwild")
    spec = importlib.util.spec_from_file_location("PyfTetWildWrapper", modules[0])
    assert spec is not None and spec.loader is not None
    native = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(native)
    with np.load(given) as data:
        vertices, faces = data["vertices"], data["faces"]
        edge, envelope = float(data["edge"]), float(data["envelope"])
    nothing = np.empty((0, 3)), np.empty((0, 4), np.int32), np.empty(0)  # no sizing field
    points, tetrahedra = native.tetrahedralize_mesh(
        vertices, faces,
        True, False,  # optimise; simplify first
        edge, 0.0, envelope,
        10.0, False, 1, 80,  # energy to stop at, coarsen, threads, iterations
        6, True, True, False,  # log level, quiet, VTK's order, filter what is outside
        *nothing,
    )  # fmt: skip
    part = Path(made).with_suffix(".part.npz")
    np.savez(part, vertices=points, tetrahedra=tetrahedra)
    part.replace(made)


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2], int(sys.argv[3]), int(sys.argv[4]))
