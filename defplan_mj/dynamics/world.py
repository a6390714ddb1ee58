"""What surrounds a robot, as data: the water that it swims in, or the air and the ground that it walks on."""

from __future__ import annotations

from dataclasses import dataclass

from defplan_mj.base.errors import DefplanError
from defplan_mj.body.model import Medium
from defplan_mj.dynamics.terrain import Terrain


@dataclass(frozen=True)
class World:
    """A medium and a terrain that agree.

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


WATER = World()
GROUND = World(Medium(name="air", density=1.2, gravity=-9.81, righting_height=0.0), Terrain())
"""Level, without an end, in the air."""
