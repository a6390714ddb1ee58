"""What the scenes of each space look like: shapes of obstacles, cameras, light, decoration."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco

from defplan_mj.base.space import PLANE, SPACE

DRAWN_HALF_HEIGHT, DRAWN_HEIGHT = 2.75, -1.25  # m, of drawn cylinders: from the sea bed to 1.5


Colour = tuple[float, float, float]


@dataclass(frozen=True)
class Surroundings:
    """The colours of what a robot moves in or on.

    Attributes:
        floor: of the two squares of the ground, and of the lines between them.
        sky: far up and far down.
        haze: what is far away fades into.
    """

    floor: tuple[Colour, Colour, Colour]
    sky: tuple[Colour, Colour]
    haze: Colour


SEA = Surroundings(
    floor=((0.57, 0.49, 0.33), (0.53, 0.45, 0.30), (0.48, 0.41, 0.27)),  # sand
    sky=((0.55, 0.80, 0.86), (0.16, 0.42, 0.55)),
    haze=(0.42, 0.66, 0.73),
)
MEADOW = Surroundings(
    floor=((0.27, 0.42, 0.19), (0.31, 0.46, 0.22), (0.24, 0.38, 0.17)),  # grass
    sky=((0.46, 0.66, 0.90), (0.80, 0.88, 0.95)),
    haze=(0.80, 0.88, 0.93),
)
OBSTACLE_RGBA = (0.31, 0.28, 0.62, 1.0)
"""Unlike sand, grass and water."""


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
        side_turns: whether the camera 'side' turns with the robot.
    """

    obstacle: mujoco.mjtGeom
    drawn_height: float
    sea_bed: bool
    top: tuple[tuple[float, float, float], float]
    shadows: bool
    overview: tuple[float, float]
    motes: bool
    side_turns: bool


LOOKS = {
    PLANE.name: Look(
        obstacle=mujoco.mjtGeom.mjGEOM_CYLINDER,
        drawn_height=DRAWN_HEIGHT,
        sea_bed=True,
        top=((0, 0, 14), 11),
        shadows=True,
        overview=(20.0, -52.0),
        motes=False,
        side_turns=True,
    ),
    SPACE.name: Look(
        obstacle=mujoco.mjtGeom.mjGEOM_SPHERE,
        drawn_height=0.0,
        sea_bed=False,
        top=((0, 0, 2.6), 45),
        shadows=False,
        overview=(60.0, -22.0),
        motes=True,
        side_turns=False,
    ),
}
"""By the name of the space."""
