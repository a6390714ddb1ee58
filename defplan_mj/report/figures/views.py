"""Orthographic views of the world, for drawing in the plane what happens in space."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from defplan_mj.base.space import PLANE, SPACE, SPACES
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
        for axis in (axes.xaxis, axes.yaxis):
            axis.set_major_locator(MaxNLocator(6, steps=[1, 2, 5, 10]))
        if self.labels:
            axes.set(xlabel=self.labels[0], ylabel=self.labels[1])
        else:
            draw_triad(axes, self.rotation, size)


_ABOVE = View(np.eye(3), np.zeros(3), "from above", ("x (m)", "y (m)"))
_OBLIQUE = View(view(), np.zeros(3), "obliquely")
_ALONG_Y = View(view(-90, 0), np.zeros(3), "along y", ("x (m)", "z (m)"))
_ALONG_X = View(view(0, 0), np.zeros(3), "along x", ("y (m)", "z (m)"))


@dataclass(frozen=True)
class Pictures:
    """How a report draws what happens in a space.

    Attributes:
        world: the views of many episodes.
        path: the views of a gait's path, and in words.
        episode: which of the views of one episode, by name.
        shown: episodes of a kind that are drawn one by one.
        overview_sides, episode_sides: in words.
        solid: how dense obstacles are drawn.
        turning: whether bodies turn any way: then they are also shown cycle by cycle, below their path.
    """

    world: tuple[View, ...]
    path: tuple[View, ...]
    path_sides: str
    episode: tuple[str, ...]
    shown: int
    overview_sides: str
    episode_sides: str
    solid: float
    turning: bool


PICTURES = {
    PLANE.name: Pictures(
        world=(_ABOVE,),
        path=(_ABOVE,),
        path_sides="from above",
        episode=("from above",),
        shown=4,
        overview_sides="",
        episode_sides="from above and turned so that the target is to the right",
        solid=0.85,
        turning=False,
    ),
    SPACE.name: Pictures(
        world=(_OBLIQUE, _ABOVE, _ALONG_Y, _ALONG_X),
        path=(_ALONG_Y, _ALONG_X),
        path_sides="from two sides",
        episode=("obliquely", "from above", "from its right", "from behind"),
        shown=2,
        overview_sides=(
            ", seen obliquely (dotted: each target's foot, level with the start), from above, and "
            "along y and x"
        ),
        episode_sides=(
            "four pictures each: obliquely; turned so that the target is to the right, from above "
            "and from the side; and along the way, with the target straight ahead. A path that "
            "crosses an obstacle in one of them passes before or behind it"
        ),
        solid=0.4,
        turning=True,
    ),
}
"""By the name of the space."""


def episode_views(start: np.ndarray, target: np.ndarray, space: str) -> list[View]:
    """Return the views of one episode, turned so that the way from start to target leads to the right.

    In the plane from above; in space obliquely, from two sides, and along the way.
    """
    way = np.array(target - start, float)
    way[SPACES[space].dimension :] = 0.0
    ahead = way / max(float(np.linalg.norm(way)), 1e-9)
    # a way that leads straight up or down has no left of its own
    spare = np.array([0, 0, 1.0]) if abs(ahead[2]) < 0.99 else np.array([1.0, 0, 0])
    left = np.cross(spare, ahead)
    left /= np.linalg.norm(left)
    up = np.cross(ahead, left)
    towards, aside, over = "towards the target (m)", "to the left (m)", "up (m)"
    views = [
        View(view(), start, "obliquely"),
        View(np.stack([ahead, left, up]), start, "from above", (towards, aside)),
        View(np.stack([ahead, up, -left]), start, "from its right", (towards, over)),
        View(np.stack([-left, up, -ahead]), start, "from behind", ("to the right (m)", over)),
    ]
    return [seen for seen in views if seen.name in PICTURES[space].episode]
