"""Shaded pictures of triangle surfaces and silhouettes from above, drawn by matplotlib."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colors import to_rgb
from matplotlib.patches import PathPatch
from matplotlib.path import Path

from defplan_mj.log.plotting import BODY

_LIGHT = np.array([-0.35, -0.55, 0.76])  # towards the light, in view coordinates: right, up, viewer


def draw_surface(
    axes: Axes,
    points: np.ndarray,
    faces: np.ndarray,
    rotation: np.ndarray,
    colour: str | Sequence[str] = BODY,
    edges: float = 0.0,
) -> None:
    """Draw a closed surface in orthographic view, with flat shading, far faces first.

    Args:
        points: (n, 3) m.
        faces: (f, 3), counterclockwise from outside.
        rotation: of `view`.
        colour: one, or one a face.
        edges: width of the lines of the mesh, points (0: none).
    """
    seen = points @ rotation.T
    corners = seen[faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True) + 1e-300
    front = np.flatnonzero(normal[:, 2] > 0)
    order = front[np.argsort(corners[front, :, 2].mean(1))]
    base = np.array([to_rgb(colour)] if isinstance(colour, str) else [to_rgb(c) for c in colour])
    base = np.broadcast_to(base, (len(faces), 3))[order]
    light = np.clip(normal[order] @ (_LIGHT / np.linalg.norm(_LIGHT)), 0, 1)[:, None]
    shade = np.clip(base * (0.5 + 0.5 * light) + 0.22 * light**6, 0, 1)
    line = {"edgecolors": shade * 0.72, "linewidths": edges} if edges else {}
    if not line:
        line = {"edgecolors": shade, "linewidths": 0.25}  # no gaps between faces
    axes.add_collection(PolyCollection(corners[order, :, :2], facecolors=shade, **line))
    fit(axes, seen[:, :2])


def fit(axes: Axes, points: np.ndarray, margin: float = 0.03) -> None:
    """Show the (n, 2) points at equal scales, without frame."""
    low, high = points.min(0), points.max(0)
    pad = margin * (high - low).max()
    axes.set_xlim(low[0] - pad, high[0] + pad)
    axes.set_ylim(low[1] - pad, high[1] + pad)
    axes.set_aspect("equal")
    axes.set_axis_off()


def silhouette(axes: Axes, points: np.ndarray, faces: np.ndarray, colour: str) -> None:
    """Fill what a closed surface covers, its points being (n, 2) as seen, or (n, 3) from above."""
    outline = Path.make_compound_path(
        *(Path(np.vstack([loop, loop[:1]]), closed=True) for loop in outlines(points, faces))
    )
    axes.add_patch(PathPatch(outline, facecolor=colour, linewidth=0, zorder=4.5))


def outlines(points: np.ndarray, faces: np.ndarray) -> list[np.ndarray]:
    """Return the closed curves (n, 2) that bound the upward part of a closed surface, from above.

    Around a point, they wind as often as the surface covers it: filled by the nonzero rule, they
    give the silhouette.
    """
    corners = points[faces, :2]
    one, two = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    upward = faces[one[:, 0] * two[:, 1] > one[:, 1] * two[:, 0]]
    edges = upward[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).tolist()
    inside = {(a, b) for a, b in edges}
    onward: dict[int, list[int]] = {}
    for a, b in edges:
        if (b, a) not in inside:
            onward.setdefault(a, []).append(b)
    loops = []
    while onward:
        start = at = next(iter(onward))
        loop = []
        while at in onward:
            loop.append(at)
            at = onward[at].pop()
            if not onward[loop[-1]]:
                del onward[loop[-1]]
            if at == start:
                break
        loops.append(points[loop][:, :2])
    return loops
