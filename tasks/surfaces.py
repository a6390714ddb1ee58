"""Closed surfaces of smooth solids: distance functions of simple parts, and their mesh by surface nets.

A solid is a function points (n, 3) -> (n,): negative inside, about the distance from its surface.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from defplan_mj.base import files

Solid = Callable[[np.ndarray], np.ndarray]


def rounded_box(
    points: np.ndarray, centre: tuple, half: tuple[float, float, float], radius: float
) -> np.ndarray:
    """Return (n,) distances from a box of half sizes `half` whose edges are rounded by `radius`."""
    beyond = np.abs(points - np.array(centre)) - (np.array(half) - radius)
    outside = np.linalg.norm(np.maximum(beyond, 0), axis=1)
    return outside + np.minimum(beyond.max(1), 0) - radius


def limb(
    points: np.ndarray, start: np.ndarray, end: np.ndarray, radii: tuple[float, float]
) -> np.ndarray:
    """Return (n,) about the distances from a limb from `start` to `end`, round at both ends.

    Its cross-section is an ellipse: `radii` are the half widths around and towards the z axis.
    """
    around, towards = radii
    axis = np.asarray(end, float) - start
    wide = np.cross([0.0, 0.0, 1.0], axis)
    wide /= np.linalg.norm(wide)
    share = np.clip((points - start) @ axis / (axis @ axis), 0, 1)
    offset = points - start - share[:, None] * axis
    across = offset @ wide
    rest = offset - across[:, None] * wide
    return np.sqrt((across * towards / around) ** 2 + (rest * rest).sum(1)) - towards


def blend(a: np.ndarray, b: np.ndarray, width: float) -> np.ndarray:
    """Return the union of two solids' values, rounded over `width` where they meet."""
    share = np.clip(0.5 + 0.5 * (b - a) / width, 0, 1)
    return b * (1 - share) + a * share - width * share * (1 - share)


def surface_net(solid: Solid, cell: float, half: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the surface of a solid within |x|, |y|, |z| < half: vertices (n, 3), outward triangles (t, 3).

    Surface nets (Gibson 1998): a vertex in each cell that the surface crosses, at the mean of its
    edges' crossings; a quadrilateral around each crossed edge. The planes x = 0 and y = 0 pass through
    the middle of cells, so a symmetric solid has a symmetric mesh.
    """
    count = 2 * int(np.ceil(half / cell)) + 2
    line = cell * (np.arange(count) - 0.5 * (count - 1))
    grid = np.stack(np.meshgrid(line, line, line, indexing="ij"), axis=-1)
    value = solid(grid.reshape(-1, 3)).reshape(count, count, count)
    inside = value < 0
    total, crossings = np.zeros((*(3 * [count - 1]), 3)), np.zeros(3 * [count - 1])
    quads = []
    number = np.arange((count - 1) ** 3).reshape(3 * [count - 1])
    for axis in range(3):
        low = [slice(None)] * 3
        high = list(low)
        low[axis], high[axis] = slice(None, -1), slice(1, None)
        first, second = value[tuple(low)], value[tuple(high)]
        crossed = inside[tuple(low)] != inside[tuple(high)]
        place = np.argwhere(crossed)
        share = (first / (first - second + 1e-300))[crossed]
        point = line[place]
        point[:, axis] += cell * share
        others = [(axis + 1) % 3, (axis + 2) % 3]
        cells = []
        for back in ((0, 0), (1, 0), (1, 1), (0, 1)):  # the four cells around the edge
            at = place.copy()
            at[:, others] -= back
            np.add.at(total, tuple(at.T), point)
            np.add.at(crossings, tuple(at.T), 1)
            cells.append(number[tuple(at.T)])
        ring = np.stack(cells, axis=1)
        leaving = inside[tuple(low)][crossed]  # outward is along the axis
        ring[~leaving] = ring[~leaving][:, ::-1]
        quads.append(ring)
    used = crossings > 0
    vertices = total[used] / crossings[used][:, None]
    new = np.full(used.size, -1)
    new[used.ravel()] = np.arange(len(vertices))
    return vertices, _split(np.round(vertices, 9), new[np.concatenate(quads)])


def _split(vertices: np.ndarray, quads: np.ndarray) -> np.ndarray:
    """Return two triangles for each quadrilateral, cut at the corner nearest the z axis: mirror images."""
    x, y, z = vertices[quads].transpose(2, 0, 1)
    order = np.round(x * x + y * y, 7) - 1e-4 * z
    even = np.minimum(order[:, 0], order[:, 2]) <= np.minimum(order[:, 1], order[:, 3])
    first = np.where(even[:, None], quads, np.roll(quads, -1, axis=1))
    return np.concatenate([first[:, [0, 1, 2]], first[:, [0, 2, 3]]])


def write_obj(path: str | Path, comment: str, vertices: np.ndarray, faces: np.ndarray) -> Path:
    """Write a surface as a Wavefront OBJ file, atomically; the same bytes every time."""
    lines = [f"# {comment}"]
    lines += [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in vertices + 0.0]
    lines += [f"f {a} {b} {c}" for a, b, c in faces + 1]
    files.write_text(path, "\n".join(lines) + "\n")
    return Path(path)
