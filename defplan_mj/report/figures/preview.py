"""A picture of which way a mesh looks: before anything is built on a guess."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from defplan_mj.log.plotting import INK, new_figure, styled, view
from defplan_mj.report.figures.drawing import draw_surface, fit

_SIDES = (
    ("from its right", view(-90, 0)),
    ("from above", view(-90, 90)),
    ("from the front", view(0, 0)),
    ("obliquely", view(-50, 22)),
)
_ARROW = 0.65  # of the length, from the middle: ahead and up


@styled
def preview_figure(points: np.ndarray, faces: np.ndarray) -> Figure:
    """Return a mesh from four sides, with arrows ahead and up.

    Args:
        points: (n, 3) m, x ahead and z up.
        faces: (f, 3), counterclockwise from outside.
    """
    points = points - (points.min(0) + points.max(0)) / 2
    length = np.ptp(points, axis=0).max()
    figure, grid = new_figure(7.0, 5.2, 2, 2)
    for axes, (name, rotation) in zip(grid.ravel(), _SIDES, strict=True):
        draw_surface(axes, points, faces, rotation)
        tips = []
        for word, direction in (("ahead", (1.0, 0.0, 0.0)), ("up", (0.0, 0.0, 1.0))):
            seen = rotation @ np.array(direction)
            if np.hypot(*seen[:2]) < 0.1:  # it points at the viewer
                continue
            tip = _ARROW * length * seen[:2]
            axes.annotate(
                word, (0.0, 0.0), tip, color=INK, ha="center", va="center",
                arrowprops={"arrowstyle": "<-", "color": INK, "linewidth": 1.2},
            )  # fmt: skip
            tips.append(tip)
        fit(axes, np.concatenate([(points @ rotation.T)[:, :2], tips]), margin=0.08)
        axes.set_title(name)
    return figure
