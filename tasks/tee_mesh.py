"""Generates the T-shaped body: `python -m defplan_tasks.tee_mesh` writes assets/tee.obj.

The T stands on its bar, the stem up: x runs along the bar and is forward, z is up. The bar's underside
is hollowed, so that it stands on its two ends. Its longest extent is 1 m.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from defplan_tasks.surfaces import blend, rounded_box, surface_net, write_obj

ASSET = Path(__file__).parent / "assets" / "tee.obj"

BAR_HALF, STEM_HALF, ROUND = (0.50, 0.20, 0.10), (0.12, 0.14, 0.30), 0.05  # m
STEM_CENTRE = (0.0, 0.0, 0.32)  # m
HOLLOW_RADIUS, HOLLOW_DEPTH = 0.85, 0.07  # of the arch under the bar, m
BLEND = 0.06  # m


def tee_mesh(cell: float = 0.03) -> tuple[np.ndarray, np.ndarray]:
    """Return the surface: vertices (n, 3) in metres and outward triangles (t, 3).

    Args:
        cell: of the grid the surface is found on, m.
    """
    arch = -BAR_HALF[2] + HOLLOW_DEPTH - HOLLOW_RADIUS  # height of its axis, which runs along y

    def solid(points: np.ndarray) -> np.ndarray:
        bar = rounded_box(points, (0, 0, 0), BAR_HALF, ROUND)
        hollow = HOLLOW_RADIUS - np.hypot(points[:, 0], points[:, 2] - arch)
        bar = -blend(-bar, -hollow, BLEND)
        return blend(bar, rounded_box(points, STEM_CENTRE, STEM_HALF, ROUND), BLEND)

    vertices, faces = surface_net(solid, cell, 0.66)
    return vertices / np.ptp(vertices, axis=0).max(), faces


def write_tee(path: str | Path = ASSET) -> Path:
    """Write the body as a Wavefront OBJ file; the same bytes every time."""
    return write_obj(path, "T-shaped body, 1 m; made by defplan_tasks.tee_mesh", *tee_mesh())


def main() -> None:
    """Write the mesh where it is asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--output", type=Path, default=ASSET)
    print(write_tee(parser.parse_args().output))


if __name__ == "__main__":
    main()
