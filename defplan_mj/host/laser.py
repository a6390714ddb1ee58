"""What a robot senses of MuJoCo's scene: rays from its centre of mass, and where the obstacles are."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from defplan_mj.host.ground import TERRAIN_GROUP
from defplan_mj.host.scene import DECOR_GROUP

_UNSEEN = (DECOR_GROUP, TERRAIN_GROUP)
_GROUPS = np.array([group not in _UNSEEN for group in range(mujoco.mjNGROUP)], np.uint8)


@dataclass(frozen=True)
class SceneView:
    """The scene around one robot (a `planning.sensors.sensor.View`).

    Geoms of the decor and terrain groups, invisible ones and those of the robot are not seen; nor
    are sites and skins.

    Attributes:
        origin: (3,) world position, m.
        frame: (3, d) the axes, as columns in the world, of the frame that the sensor turns with;
            d is 2 (ahead, left) or 3 (a whole attitude).
        robot: the body that is not seen.
    """

    model: mujoco.MjModel
    data: mujoco.MjData
    origin: np.ndarray
    frame: np.ndarray
    robot: int = -1

    def cast(self, directions: np.ndarray, farthest: float) -> np.ndarray:
        """Return the (b,) distances to the nearest geom along rays (b, d), m; `farthest` if there is none."""
        beams = len(directions)
        rays = np.zeros((beams, 3))
        for axis, along in zip(self.frame.T, directions.T, strict=True):
            rays += along[:, None] * axis
        distance = np.empty(beams)
        mujoco.mj_multiRay(
            self.model,
            self.data,
            self.origin,
            rays.ravel(),
            _GROUPS,
            1,
            self.robot,
            np.empty(beams, np.int32),
            distance,
            None,
            beams,
            farthest,
        )
        distance[(distance < 0) | (distance > farthest)] = farthest
        return distance

    def obstacles(self) -> tuple[np.ndarray, np.ndarray]:
        """Return centres (m, d) in the frame and radii (m,) of the scene's obstacles, m."""
        solid = [
            geom
            for geom in range(self.model.ngeom)
            if self.model.geom_contype[geom] and self.model.geom_bodyid[geom] != self.robot
        ]
        centres = (self.data.geom_xpos[solid] - self.origin) @ self.frame
        return centres, self.model.geom_size[solid, 0]
