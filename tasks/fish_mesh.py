"""Generates the fish's surface mesh: `python -m defplan_tasks.fish_mesh` writes assets/fish.obj.

The fish is 1 m long, head at +x, z up, y to its left; the tail fin stands in the x-z plane, so it
beats sideways. It is left-right symmetric: at a point (x, z) of its side view the body reaches
from y = -w(x, z) to w(x, z).
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from scipy.interpolate import PchipInterpolator

from defplan_tasks.surfaces import write_obj

ASSET = Path(__file__).parent / "assets" / "fish.obj"

# Stations from nose (0) to tail (1): half-height above and below the axis, and half-width, m.
STATION = [0.0, 0.03, 0.10, 0.20, 0.35, 0.50, 0.65, 0.78, 0.85, 0.92, 0.97, 1.0]
HALF_HEIGHT = [0.014, 0.047, 0.085, 0.115, 0.125, 0.110, 0.080, 0.045, 0.050, 0.105, 0.140, 0.135]
HALF_WIDTH = [0.012, 0.037, 0.062, 0.076, 0.078, 0.066, 0.046, 0.026, 0.019, 0.015, 0.013, 0.012]
TAIL_START, TAIL_FORK = 0.82, 0.035  # the fork: how far the tips trail behind the middle, m
DORSAL = [0.26, 0.33, 0.42, 0.52, 0.62, 0.70]  # stations of the fin on the back
DORSAL_HEIGHT = [0.0, 0.030, 0.052, 0.040, 0.018, 0.0]  # above the back, m
FIN_HALF_WIDTH = 0.013


def _half_width(z: np.ndarray, half_height: float, half_width: float, top: float) -> np.ndarray:
    """Return w at heights z: an ellipse, joined with a fin that reaches up to `top`."""
    ellipse = half_width * np.sqrt(np.clip(1.0 - (z / half_height) ** 2, 0.0, None))
    if top <= half_height:
        return ellipse
    fin_width = min(FIN_HALF_WIDTH, half_width)
    fin = np.where(z > 0.0, fin_width * np.sqrt(np.clip(1.0 - (z / top) ** 6, 0.0, None)), 0.0)
    return np.maximum(ellipse, fin)


def fish_mesh(rings: int = 46, ring_points: int = 22) -> tuple[np.ndarray, np.ndarray]:
    """Return the surface: vertices (n, 3) in metres and outward triangles (t, 3).

    Args:
        rings: cross-sections from nose to tail.
        ring_points: vertices of a cross-section; even.
    """
    fraction = np.linspace(0.0, 1.0, rings)
    # denser at the nose and at the trailing edge, where the outline bends most
    station = 0.65 * fraction + 0.35 * 0.5 * (1.0 - np.cos(np.pi * fraction))
    half_height = PchipInterpolator(STATION, HALF_HEIGHT)(station)
    half_width = PchipInterpolator(STATION, HALF_WIDTH)(station)
    fin = PchipInterpolator(DORSAL, DORSAL_HEIGHT)(np.clip(station, DORSAL[0], DORSAL[-1]))
    fork = TAIL_FORK * np.clip((station - TAIL_START) / (1.0 - TAIL_START), 0.0, None) ** 2
    angle = 2.0 * np.pi * np.arange(ring_points) / ring_points
    x_nose, x_middle = 0.5 - 0.004, -0.5 + TAIL_FORK
    vertices = []
    for s, height, width, extra, notch in zip(
        station, half_height, half_width, fin, fork, strict=True
    ):
        top = height + extra
        z = np.where(np.cos(angle) > 0.0, top, height) * np.cos(angle)
        y = _half_width(z, height, width, top) * np.sign(np.round(np.sin(angle), 12))
        x = x_nose + s * (x_middle - x_nose) - notch * (z / height) ** 2
        vertices.append(np.stack([x, y, z], axis=1))
    nose, tail = rings * ring_points, rings * ring_points + 1
    points = np.vstack([*vertices, [[0.5, 0.0, 0.0], [x_middle - 0.003, 0.0, 0.0]]])
    faces = []
    for i in range(rings - 1):
        for j in range(ring_points):
            a, b = i * ring_points + j, i * ring_points + (j + 1) % ring_points
            c, d = a + ring_points, b + ring_points
            # diagonals mirror each other across the plane y = 0
            faces += [[a, b, c], [b, d, c]] if j < ring_points // 2 else [[a, b, d], [a, d, c]]
    last = (rings - 1) * ring_points
    for j in range(ring_points):
        following = (j + 1) % ring_points
        faces += [[nose, following, j], [tail, last + j, last + following]]
    return points, np.array(faces)


def write_fish(path: str | Path = ASSET) -> Path:
    """Write the fish as a Wavefront OBJ file; the same bytes every time."""
    return write_obj(path, "Fish, 1 m; made by defplan_tasks.fish_mesh", *fish_mesh())


def main() -> None:
    """Write the mesh where it is asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--output", type=Path, default=ASSET)
    print(write_fish(parser.parse_args().output))


if __name__ == "__main__":
    main()
