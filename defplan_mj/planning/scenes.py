"""Navigation scenes as plain data (start, target, obstacles on the way) and their generators."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from defplan_mj.errors import DefplanError
from defplan_mj.task import Navigation

FAR = 1e4
"""Where the padding of a batch keeps obstacles that are not there, m."""

# First words of the seeds, so that no two kinds of scenes share random numbers.
_K2_STREAM, _NOVEL_STREAM, _TRAINING_STREAM, _VALIDATION_STREAM = range(101, 105)


@dataclass(frozen=True)
class Scene:
    """One navigation problem, in the world frame (metres, z up); the body starts at the origin.

    Attributes:
        target: (3,) position.
        centres: (m, 3) obstacle centres at time 0.
        radii: (m,) obstacle radii.
        velocities: (m, 3) constant obstacle velocities, m/s.
        shape: 'cylinder' (upright) or 'sphere'.
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


@dataclass(frozen=True)
class SceneBatch:
    """Many planar scenes as arrays: what the generators make and the surrogate environment runs.

    Attributes:
        targets: (n, 2) m.
        orientations: (n, 4) start attitudes, unit quaternions w x y z.
        centres: (n, m, 2) obstacle centres at time 0, m; unused ones are `FAR` away with radius 0.
        radii: (n, m) m.
        velocities: (n, m, 2) m/s.
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
    def yaw(self) -> np.ndarray:
        """Return the (n,) start headings of level attitudes, rad."""
        return 2 * np.arctan2(self.orientations[:, 3], self.orientations[:, 0])

    def scenes(self, meta: list[dict] | None = None) -> list[Scene]:
        """Return the batch as a list of `Scene` (padding dropped), with `meta` of each."""
        scenes = []
        for i in range(len(self)):
            real = self.radii[i] > 0
            scenes.append(
                Scene(
                    target=np.append(self.targets[i], 0.0),
                    centres=_with_zero_height(self.centres[i, real]),
                    radii=self.radii[i, real].copy(),
                    velocities=_with_zero_height(self.velocities[i, real]),
                    orientation=self.orientations[i].copy(),
                    goal_radius=self.goal_radius,
                    max_cycles=self.max_cycles,
                    meta=meta[i] if meta else {},
                )
            )
        return scenes

    @classmethod
    def of(cls, scenes: list[Scene]) -> SceneBatch:
        """Return scenes of cylinders, which share goal radius and time-out, as one batch."""
        n, m = len(scenes), max((len(scene.radii) for scene in scenes), default=0)
        centres, radii = np.full((n, m, 2), FAR), np.zeros((n, m))
        velocities = np.zeros((n, m, 2))
        for i, scene in enumerate(scenes):
            k = len(scene.radii)
            centres[i, :k] = scene.centres[:, :2]
            radii[i, :k] = scene.radii
            velocities[i, :k] = scene.velocities[:, :2]
        return cls(
            targets=np.array([scene.target[:2] for scene in scenes]).reshape(n, 2),
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


def scene_batch(
    navigation: Navigation,
    generator: np.random.Generator,
    *,
    directions: np.ndarray,
    yaw: np.ndarray,
    distances: np.ndarray,
    counts: np.ndarray,
    lateral: float,
    radii: tuple[float, float] = (0.5, 2.0),
    speed: float = 0.0,
) -> SceneBatch:
    """Put obstacles of random size and place on the way to each target (Fig. 3 of the paper).

    An obstacle's centre lies 3 m to `distance` along the straight way and up to `lateral` beside
    it; 3 m around the start and 2 m around the target stay clear. Short ways may hold fewer
    obstacles than asked for.

    Args:
        directions: (n,) bearing of the targets, rad.
        yaw: (n,) start headings, rad.
        distances: (n,) m.
        counts: (n,) obstacles wanted.
        lateral: m.
        radii: range of the obstacles' radii, m.
        speed: of the obstacles, each in its own random direction, m/s.
    """
    n, most = len(directions), int(counts.max(initial=0))
    tries = 6 * most + 16
    along = np.stack([np.cos(directions), np.sin(directions)], axis=1)
    beside = np.stack([-along[:, 1], along[:, 0]], axis=1)
    targets = distances[:, None] * along
    radius = generator.uniform(*radii, (n, tries))
    forward = generator.uniform(3.0, np.maximum(distances, 3.0)[:, None], (n, tries))
    sideways = generator.uniform(-lateral, lateral, (n, tries))
    heading = generator.uniform(0, 2 * np.pi, (n, tries))
    centre = forward[..., None] * along[:, None] + sideways[..., None] * beside[:, None]
    clear = np.linalg.norm(centre, axis=2) >= radius + 3.0
    clear &= np.linalg.norm(centre - targets[:, None], axis=2) >= radius + 2.0
    chosen = np.argsort(~clear, axis=1, kind="stable")[:, :most]  # the first that are clear
    rows = np.arange(n)[:, None]
    used = clear[rows, chosen] & (np.arange(most) < counts[:, None])
    course = np.stack([np.cos(heading), np.sin(heading)], axis=2)[rows, chosen]
    return SceneBatch(
        targets=targets,
        orientations=level_attitude(yaw),
        centres=np.where(used[..., None], centre[rows, chosen], FAR),
        radii=np.where(used, radius[rows, chosen], 0.0),
        velocities=np.where(used[..., None], speed * course, 0.0),
        goal_radius=navigation.goal_radius,
        max_cycles=navigation.max_cycles,
    )


def k2_scenes(
    navigation: Navigation,
    seed: int,
    episodes: int | None = None,
    obstacles: int | None = None,
    obstacle_speed: float = 0.0,
) -> list[Scene]:
    """Return the K2 scenes: evenly spread targets, a few obstacles on the way to each, heading 0.

    More episodes than targets go round the targets again, with new obstacles.

    Raises:
        DefplanError: a count or speed is negative, or there are no episodes.
    """
    episodes = navigation.k2 if episodes is None else episodes
    obstacles = navigation.k2_obstacles if obstacles is None else obstacles
    _check(episodes, obstacles, obstacle_speed)
    index = np.arange(episodes)
    batch = scene_batch(
        navigation,
        np.random.default_rng([_K2_STREAM, seed]),
        directions=2 * np.pi * (index % navigation.k2) / navigation.k2,
        yaw=np.zeros(episodes),
        distances=np.full(episodes, navigation.distance),
        counts=np.full(episodes, obstacles),
        lateral=1.5,
        speed=obstacle_speed,
    )
    return batch.scenes(_labels("k2", seed, episodes))


def novel_scenes(
    navigation: Navigation,
    n: int,
    seed: int,
    obstacles: int | None = None,
    obstacle_speed: float = 0.0,
) -> list[Scene]:
    """Return n scenes with a random target direction, a random heading and many obstacles.

    Raises:
        DefplanError: a count or speed is negative, or n is 0.
    """
    obstacles = navigation.novel_obstacles if obstacles is None else obstacles
    _check(n, obstacles, obstacle_speed)
    generator = np.random.default_rng([_NOVEL_STREAM, seed])
    batch = scene_batch(
        navigation,
        generator,
        directions=generator.uniform(0, 2 * np.pi, n),
        yaw=generator.uniform(-np.pi, np.pi, n),
        distances=np.full(n, navigation.distance),
        counts=np.full(n, obstacles),
        lateral=4.0,
        speed=obstacle_speed,
    )
    return batch.scenes(_labels("novel", seed, n))


def training_scenes(navigation: Navigation, n: int, seed: int) -> SceneBatch:
    """Return n varied scenes: targets at 0.3 to 1.1 of the distance, 0 to all obstacles."""
    generator = np.random.default_rng([_TRAINING_STREAM, seed])
    return scene_batch(
        navigation,
        generator,
        directions=generator.uniform(0, 2 * np.pi, n),
        yaw=generator.uniform(-np.pi, np.pi, n),
        distances=generator.uniform(0.3, 1.1, n) * navigation.distance,
        counts=generator.integers(0, navigation.novel_obstacles + 1, n),
        lateral=4.0,
        radii=(0.3, 2.0),
    )


def validation_scenes(navigation: Navigation, n: int, seed: int) -> SceneBatch:
    """Return n scenes like the novel ones, from a stream of their own: to choose a policy by."""
    generator = np.random.default_rng([_VALIDATION_STREAM, seed])
    return scene_batch(
        navigation,
        generator,
        directions=generator.uniform(0, 2 * np.pi, n),
        yaw=generator.uniform(-np.pi, np.pi, n),
        distances=np.full(n, navigation.distance),
        counts=np.full(n, navigation.novel_obstacles),
        lateral=4.0,
    )


def level_attitude(yaw: float | np.ndarray) -> np.ndarray:
    """Return the (..., 4) unit quaternions w x y z of upright bodies with headings `yaw` (...,), rad."""
    half, zero = np.asarray(yaw, float) / 2, np.zeros(np.shape(yaw))
    return np.stack([np.cos(half), zero, zero, np.sin(half)], axis=-1)


def _labels(kind: str, seed: int, n: int) -> list[dict]:
    return [{"kind": kind, "seed": seed, "index": i} for i in range(n)]


def _with_zero_height(points: np.ndarray) -> np.ndarray:
    return np.column_stack([points, np.zeros(len(points))])


def _check(episodes: int, obstacles: int, speed: float) -> None:
    if episodes < 1:
        raise DefplanError(f"an evaluation needs at least 1 episode, not {episodes}")
    if obstacles < 0:
        raise DefplanError(f"the number of obstacles must be 0 or more, not {obstacles}")
    if not (np.isfinite(speed) and speed >= 0):
        raise DefplanError(f"the obstacle speed must be 0 m/s or more, not {speed}")
