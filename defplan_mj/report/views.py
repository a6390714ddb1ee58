"""Orthographic views of the world, for drawing in the plane what happens in space."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes

from defplan_mj.log.plotting import draw_triad, view


@dataclass(frozen=True)
class View:
    """What of the world goes to the right, up, and towards the viewer.

    Attributes:
        rotation: (3, 3) rows right, up, towards the viewer.
        origin: (3,) world point that is drawn at (0, 0), m.
        name: where one looks from, e.g. 'from above'.
        labels: of the two axes; () for an oblique view, whose axes mean nothing.
    """

    rotation: np.ndarray
    origin: np.ndarray
    name: str
    labels: tuple[str, ...] = ()

    def place(self, points: np.ndarray) -> np.ndarray:
        """Return where world points (..., 3) are drawn, (..., 2) m."""
        return (points - self.origin) @ self.rotation[:2].T

    def depth(self, points: np.ndarray) -> np.ndarray:
        """Return how near to the viewer world points (..., 3) are, (...) m."""
        return (points - self.origin) @ self.rotation[2]

    def finish(self, axes: Axes, size: float) -> None:
        """Label the axes at equal scales; an oblique view shows the world's axes, `size` (m) long."""
        axes.set_aspect("equal", adjustable="datalim")
        axes.autoscale_view()
        if self.labels:
            axes.set(xlabel=self.labels[0], ylabel=self.labels[1])
        else:
            draw_triad(axes, self.rotation, size)


def world_views(space: str) -> list[View]:
    """Return the views of many episodes: from above in the plane; in space obliquely, and along axes."""
    origin = np.zeros(3)
    above = View(np.eye(3), origin, "from above", ("x (m)", "y (m)"))
    if space == "planar":
        return [above]
    return [
        View(view(), origin, "obliquely"),
        above,
        View(view(-90, 0), origin, "along y", ("x (m)", "z (m)")),
        View(view(0, 0), origin, "along x", ("y (m)", "z (m)")),
    ]


def episode_views(start: np.ndarray, target: np.ndarray, space: str) -> list[View]:
    """Return the views of one episode, turned so that the way from start to target leads to the right.

    In the plane from above; in space obliquely, from two sides, and along the way.
    """
    way = np.array(target - start, float)
    if space == "planar":
        way[2] = 0.0
    ahead = way / max(float(np.linalg.norm(way)), 1e-9)
    # a way that leads straight up or down has no left of its own
    spare = np.array([0, 0, 1.0]) if abs(ahead[2]) < 0.99 else np.array([1.0, 0, 0])
    left = np.cross(spare, ahead)
    left /= np.linalg.norm(left)
    up = np.cross(ahead, left)
    towards, aside, over = "towards the target (m)", "to the left (m)", "up (m)"
    above = View(np.stack([ahead, left, up]), start, "from above", (towards, aside))
    if space == "planar":
        return [above]
    return [
        View(view(), start, "obliquely"),
        above,
        View(np.stack([ahead, up, -left]), start, "from its right", (towards, over)),
        View(np.stack([-left, up, -ahead]), start, "from behind", ("to the right (m)", over)),
    ]
