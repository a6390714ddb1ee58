"""What surrounds a robot, as data: the water that it swims in, or the air and the ground that it walks on."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from defplan_mj.base.errors import DefplanError
from defplan_mj.body.model import Medium
from defplan_mj.dynamics import terrain as terrains
from defplan_mj.dynamics.terrain import Terrain

MAX_TILT = np.radians(30.0)
"""Of the body's z axis, rad: past it a body that is to stay upright has fallen."""
MIN_HEIGHT = 0.6
"""Of a walker's centre of mass, in units of its height at rest: below it the walker has sunk."""


@dataclass(frozen=True)
class World:
    """A medium and a terrain that agree; who needs to know whether there is a ground asks `walks`.

    Attributes:
        medium: what surrounds the body.
        terrain: what it walks on; None: it swims.
    """

    medium: Medium = Medium()
    terrain: Terrain | None = None

    def __post_init__(self) -> None:
        if self.terrain is not None and self.medium.gravity >= 0:
            raise DefplanError(
                f"nothing holds a body of gravity {self.medium.gravity:g} m/s^2 on a terrain: give"
                f" the {self.medium.name} a negative one, or leave out the terrain"
            )

    @property
    def walks(self) -> bool:
        """Whether a robot stands here, and can fall."""
        return self.terrain is not None

    @property
    def ground(self) -> Terrain:
        """The terrain of a world in which a robot `walks`.

        Raises:
            DefplanError: there is none.
        """
        if self.terrain is None:
            raise DefplanError(f"there is no ground in {self.medium.name}: the robot swims")
        return self.terrain

    @property
    def level(self) -> bool:
        """Whether the ground is the plane z = 0 and nothing else."""
        return self.walks and self.ground.heightfield is None and self.ground.geoms == LEVEL

    @property
    def terrain_data(self) -> dict[str, Any] | None:
        """The terrain as plain data, see `terrain.terrain_json`; None if there is none."""
        return terrains.terrain_json(self.ground) if self.walks else None

    def sunk(self, height: np.ndarray, standing: float) -> np.ndarray:
        """Return whether walkers with their centres of mass at `height` (...,), m, came down; swimmers never do.

        Args:
            standing: height of the centre of mass at rest, m.
        """
        return np.asarray(height) < (MIN_HEIGHT * standing if self.walks else -np.inf)

    def fallen(self, x: np.ndarray, standing: float) -> np.ndarray:
        """Return whether bodies in states (..., >= 7) tilt past `MAX_TILT` or have `sunk`, (...,)."""
        return (tilt(x) > MAX_TILT) | self.sunk(x[..., 2], standing)


def tilt(x: np.ndarray) -> np.ndarray:
    """Return the angle (...,), rad, between the vertical and the z axis of bodies in states (..., >= 7)."""
    a, b = np.asarray(x)[..., 4], np.asarray(x)[..., 5]
    return np.arccos(np.clip(1 - 2 * (a * a + b * b), -1, 1))


LEVEL = terrains.GROUND
WATER = World()
GROUND = World(Medium(name="air", density=1.2, gravity=-9.81, righting_height=0.0), Terrain())
"""Level, without an end, in the air."""
