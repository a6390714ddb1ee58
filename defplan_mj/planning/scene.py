"""A navigation problem as plain data: start, target, obstacles; and many of them as arrays."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from defplan_mj.base.errors import DefplanError
from defplan_mj.base.rotations import level_attitude
from defplan_mj.base.space import OF_DIMENSION, OF_OBSTACLE, Space

FAR = 1e4
"""Where the padding of a batch keeps obstacles that are not there, m."""


@dataclass(frozen=True)
class Scene:
    """One navigation problem, in the world frame (metres, z up); the body starts at the origin.

    Attributes:
        target: (3,) position.
        centres: (m, 3) obstacle centres at time 0.
        radii: (m,) obstacle radii.
        velocities: (m, 3) constant obstacle velocities, m/s.
        shape: 'cylinder' (upright, of a planar scene) or 'sphere' (of one in space).
        orientation: (4,) start attitude, unit quaternion w x y z.
        goal_radius: the target is reached when the centre of mass comes this close.
        max_cycles: gait cycles before the episode times out.
    """

    target: np.ndarray
    centres: np.ndarray
    radii: np.ndarray
    velocities: np.ndarray
    shape: str = "cylinder"
    orientation: np.ndarray = field(default_factory=lambda: level_attitude(0.0))
    goal_radius: float = 1.0
    max_cycles: int = 200
    meta: dict = field(default_factory=dict)

    @property
    def space(self) -> str:
        """'planar' or 'spatial': where obstacles have this shape.

        Raises:
            DefplanError: they have it nowhere.
        """
        return self.place.name

    @property
    def place(self) -> Space:
        """The space itself; raises as `space`."""
        if self.shape not in OF_OBSTACLE:
            raise DefplanError(
                f"unknown obstacle shape {self.shape}: there are {', '.join(OF_OBSTACLE)}"
            )
        return OF_OBSTACLE[self.shape]


@dataclass(frozen=True)
class SceneBatch:
    """Many scenes as arrays: what the generators make and the surrogate environment runs.

    Planar scenes (d = 2) hold the ground plan of cylinders, scenes in space (d = 3) spheres.

    Attributes:
        targets: (n, d) m.
        orientations: (n, 4) start attitudes, unit quaternions w x y z.
        centres: (n, m, d) obstacle centres at time 0, m; unused ones are `FAR` away with radius 0.
        radii: (n, m) m.
        velocities: (n, m, d) m/s.
        goal_radius: m.
        max_cycles: gait cycles before the episode times out.
    """

    targets: np.ndarray
    orientations: np.ndarray
    centres: np.ndarray
    radii: np.ndarray
    velocities: np.ndarray
    goal_radius: float = 1.0
    max_cycles: int = 200

    def __len__(self) -> int:
        return len(self.targets)

    @property
    def dimension(self) -> int:
        """Return d: 2 in the plane, 3 in space."""
        return self.targets.shape[1]

    def scenes(self, meta: list[dict] | None = None) -> list[Scene]:
        """Return the batch as a list of `Scene` (padding dropped), with `meta` of each."""
        shape = OF_DIMENSION[self.dimension].obstacle
        scenes = []
        for i in range(len(self)):
            real = self.radii[i] > 0
            scenes.append(
                Scene(
                    target=_in_space(self.targets[i]),
                    centres=_in_space(self.centres[i, real]),
                    radii=self.radii[i, real].copy(),
                    velocities=_in_space(self.velocities[i, real]),
                    shape=shape,
                    orientation=self.orientations[i].copy(),
                    goal_radius=self.goal_radius,
                    max_cycles=self.max_cycles,
                    meta=meta[i] if meta else {},
                )
            )
        return scenes

    @classmethod
    def of(cls, scenes: list[Scene]) -> SceneBatch:
        """Return scenes, which share shape, goal radius and time-out, as one batch.

        Raises:
            DefplanError: some scenes have cylinders and some spheres.
        """
        shapes = {scene.shape for scene in scenes}
        if len(shapes) > 1:
            raise DefplanError("a batch of scenes has cylinders or spheres, not both: split it")
        n, m = len(scenes), max((len(scene.radii) for scene in scenes), default=0)
        d = scenes[0].place.dimension if scenes else 2
        centres, radii = np.full((n, m, d), FAR), np.zeros((n, m))
        velocities = np.zeros((n, m, d))
        for i, scene in enumerate(scenes):
            k = len(scene.radii)
            centres[i, :k] = scene.centres[:, :d]
            radii[i, :k] = scene.radii
            velocities[i, :k] = scene.velocities[:, :d]
        return cls(
            targets=np.array([scene.target[:d] for scene in scenes]).reshape(n, d),
            orientations=np.array([scene.orientation for scene in scenes]).reshape(n, 4),
            centres=centres,
            radii=radii,
            velocities=velocities,
            goal_radius=scenes[0].goal_radius if scenes else 1.0,
            max_cycles=scenes[0].max_cycles if scenes else 200,
        )

    @classmethod
    def join(cls, batches: list[SceneBatch]) -> SceneBatch:
        """Return the scenes of all batches, which share goal radius and time-out, as one."""
        most = max(batch.radii.shape[1] for batch in batches)
        padded = []
        for batch in batches:
            spare = ((0, 0), (0, most - batch.radii.shape[1]))
            centres = np.pad(batch.centres, (*spare, (0, 0)), constant_values=FAR)
            velocities = np.pad(batch.velocities, (*spare, (0, 0)))
            padded.append((centres, np.pad(batch.radii, spare), velocities))
        centres, radii, velocities = (np.concatenate(parts) for parts in zip(*padded, strict=True))
        return cls(
            targets=np.concatenate([batch.targets for batch in batches]),
            orientations=np.concatenate([batch.orientations for batch in batches]),
            centres=centres,
            radii=radii,
            velocities=velocities,
            goal_radius=batches[0].goal_radius,
            max_cycles=batches[0].max_cycles,
        )


def _in_space(points: np.ndarray) -> np.ndarray:
    """Return copies of points (..., 2 or 3) as points (..., 3), at height 0 if they are planar."""
    spare = [(0, 0)] * (points.ndim - 1) + [(0, 3 - points.shape[-1])]
    return np.pad(points, spare)
