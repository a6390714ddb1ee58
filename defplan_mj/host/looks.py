"""What the scenes of each space look like: shapes of obstacles, cameras, light, decoration."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco

from defplan_mj.base.space import PLANE, SPACE

DRAWN_HALF_HEIGHT, DRAWN_HEIGHT = 2.75, -1.25  # m, of drawn cylinders: from the sea bed to 1.5


@dataclass(frozen=True)
class Look:
    """How a space is shown.

    Attributes:
        obstacle: the obstacles' geom type.
        drawn_height: of the pictures of obstacles above these, m.
        sea_bed: whether swimmers see one; else it is open water all around.
        top: place (lengths of the body) and field of view (degrees) of the camera 'top'. From above
            the plane's obstacles are tall, so that one looks from afar; balls would be in the way there.
        shadows: whether the sun casts any.
        overview: degrees right of the way, and down, of the camera 'overview'.
        motes: whether specks float in the water, so that motion shows.
    """

    obstacle: mujoco.mjtGeom
    drawn_height: float
    sea_bed: bool
    top: tuple[tuple[float, float, float], float]
    shadows: bool
    overview: tuple[float, float]
    motes: bool


LOOKS = {
    PLANE.name: Look(
        obstacle=mujoco.mjtGeom.mjGEOM_CYLINDER,
        drawn_height=DRAWN_HEIGHT,
        sea_bed=True,
        top=((0, 0, 14), 16),
        shadows=True,
        overview=(20.0, -52.0),
        motes=False,
    ),
    SPACE.name: Look(
        obstacle=mujoco.mjtGeom.mjGEOM_SPHERE,
        drawn_height=0.0,
        sea_bed=False,
        top=((0, 0, 2.6), 45),
        shadows=False,
        overview=(60.0, -22.0),
        motes=True,
    ),
}
"""By the name of the space."""
