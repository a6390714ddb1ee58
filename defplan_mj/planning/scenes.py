"""Navigation scenes as plain data (start, target, obstacles on the way) and their generators."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from defplan_mj.base.errors import DefplanError
from defplan_mj.base.rotations import level_attitude
from defplan_mj.base.space import OF_DIMENSION, OF_OBSTACLE, Space
from defplan_mj.planning.frames import (
    random_attitudes,
    random_directions,
    spread_directions,
)
from defplan_mj.task import Navigation

FAR = 1e4
"""Where the padding of a batch keeps obstacles that are not there, m."""

# First words of the seeds, so that no two kinds of scenes share random numbers.
_K2_STREAM, _NOVEL_STREAM, _TRAINING_STREAM, _VALIDATION_STREAM = range(101, 105)
_K2_TARGETS_STREAM, _VALIDATION_TARGETS_STREAM = 105, 106


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


def scene_batch(
    navigation: Navigation,
    generator: np.random.Generator,
    *,
    directions: np.ndarray,
    orientations: np.ndarray,
    distances: np.ndarray,
    counts: np.ndarray,
    lateral: float,
    radii: tuple[float, float] = (0.5, 2.0),
    speed: float | np.ndarray = 0.0,
) -> SceneBatch:
    """Put obstacles of random size and place on the way to each target (Fig. 3 of the paper).

    An obstacle's centre lies 3 m to `distance` along the straight way and up to `lateral` beside
    it, in space on any side of it; 3 m around the start and 2 m around the target stay clear. Short
    ways may hold fewer obstacles than asked for.

    Args:
        directions: (n, d) unit vectors to the targets.
        orientations: (n, 4) start attitudes.
        distances: (n,) m.
        counts: (n,) obstacles wanted.
        lateral: m.
        radii: range of the obstacles' radii, m.
        speed: of the obstacles, each in its own random direction, m/s; of all scenes or of each (n,).
    """
    n, most = len(directions), int(counts.max(initial=0))
    tries = 6 * most + 16
    targets = distances[:, None] * directions
    radius = generator.uniform(*radii, (n, tries))
    forward = generator.uniform(3.0, np.maximum(distances, 3.0)[:, None], (n, tries))
    sideways = generator.uniform(-lateral, lateral, (n, tries))
    course = random_directions(generator, n * tries, directions.shape[1]).reshape(n, tries, -1)
    beside = _beside(directions, generator, tries)
    centre = forward[..., None] * directions[:, None] + sideways[..., None] * beside
    clear = np.linalg.norm(centre, axis=2) >= radius + 3.0
    clear &= np.linalg.norm(centre - targets[:, None], axis=2) >= radius + 2.0
    chosen = np.argsort(~clear, axis=1, kind="stable")[:, :most]  # the first that are clear
    rows = np.arange(n)[:, None]
    used = clear[rows, chosen] & (np.arange(most) < counts[:, None])
    return SceneBatch(
        targets=targets,
        orientations=orientations,
        centres=np.where(used[..., None], centre[rows, chosen], FAR),
        radii=np.where(used, radius[rows, chosen], 0.0),
        velocities=np.where(
            used[..., None], np.reshape(speed, (-1, 1, 1)) * course[rows, chosen], 0.0
        ),
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
    """Return the scenes of the training targets (the paper's K2): few obstacles on the way, start upright.

    The targets are evenly spread around the circle; over the sphere they are a Poisson-disk sample of
    the seed (`frames.spread_directions`).

    More episodes than targets go round the targets again, with new obstacles.

    Raises:
        DefplanError: a count or speed is negative, or there are no episodes.
    """
    episodes = navigation.k2 if episodes is None else episodes
    obstacles = navigation.k2_obstacles if obstacles is None else obstacles
    _check(episodes, obstacles, obstacle_speed)
    return _k2(navigation, [_K2_STREAM, seed], seed, episodes, obstacles, obstacle_speed)


def _k2(
    navigation: Navigation,
    stream: list[int],
    seed: int,
    episodes: int,
    obstacles: int,
    speed: float,
) -> list[Scene]:
    """Return scenes of the seed's training targets, with obstacles from a stream of random numbers."""
    targets = spread_directions(
        navigation.k2, navigation.dimension, np.random.default_rng([_K2_TARGETS_STREAM, seed])
    )
    batch = scene_batch(
        navigation,
        np.random.default_rng(stream),
        directions=targets[np.arange(episodes) % navigation.k2],
        orientations=level_attitude(np.zeros(episodes)),
        distances=np.full(episodes, navigation.distance),
        counts=np.full(episodes, obstacles),
        lateral=1.5,
        speed=speed,
    )
    return batch.scenes(_labels("k2", seed, episodes))


def novel_scenes(
    navigation: Navigation,
    n: int,
    seed: int,
    obstacles: int | None = None,
    obstacle_speed: float = 0.0,
) -> list[Scene]:
    """Return n unseen scenes: a random target direction, a random start attitude and many obstacles.

    Raises:
        DefplanError: a count or speed is negative, or n is 0.
    """
    obstacles = navigation.novel_obstacles if obstacles is None else obstacles
    _check(n, obstacles, obstacle_speed)
    generator = np.random.default_rng([_NOVEL_STREAM, seed])
    batch = scene_batch(
        navigation,
        generator,
        directions=random_directions(generator, n, navigation.dimension),
        orientations=random_attitudes(generator, n, navigation.dimension),
        distances=np.full(n, navigation.distance),
        counts=np.full(n, obstacles),
        lateral=4.0,
        speed=obstacle_speed,
    )
    return batch.scenes(_labels("novel", seed, n))


def training_scenes(navigation: Navigation, n: int, seed: int, fastest: float = 0.0) -> SceneBatch:
    """Return n varied scenes: targets at 0.3 to 1.1 of the distance, 0 to all obstacles.

    Args:
        fastest: speed of the obstacles, m/s: in half of the scenes they stand, in the others they have
            a speed up to this one, the same for all of a scene.
    """
    generator = np.random.default_rng([_TRAINING_STREAM, seed])
    batch = scene_batch(
        navigation,
        generator,
        directions=random_directions(generator, n, navigation.dimension),
        orientations=random_attitudes(generator, n, navigation.dimension),
        distances=generator.uniform(0.3, 1.1, n) * navigation.distance,
        counts=generator.integers(0, navigation.novel_obstacles + 1, n),
        lateral=4.0,
        radii=(0.3, 2.0),
        speed=1.0,
    )
    speed = np.maximum(generator.uniform(-fastest, fastest, n), 0)[:, None, None]
    return replace(batch, velocities=speed * batch.velocities)


def validation_scenes(
    navigation: Navigation, n: int, seed: int, obstacle_speed: float = 0.0
) -> SceneBatch:
    """Return n scenes like `novel_scenes`, from a stream of their own: to choose a policy by."""
    generator = np.random.default_rng([_VALIDATION_STREAM, seed])
    return scene_batch(
        navigation,
        generator,
        directions=random_directions(generator, n, navigation.dimension),
        orientations=random_attitudes(generator, n, navigation.dimension),
        distances=np.full(n, navigation.distance),
        counts=np.full(n, navigation.novel_obstacles),
        lateral=4.0,
        speed=obstacle_speed,
    )


def validation_targets(
    navigation: Navigation, n: int, seed: int, obstacle_speed: float = 0.0
) -> SceneBatch:
    """Return n scenes like `k2_scenes`, of the same targets and other obstacles: to choose a policy by."""
    stream = [_VALIDATION_TARGETS_STREAM, seed]
    return SceneBatch.of(_k2(navigation, stream, seed, n, navigation.k2_obstacles, obstacle_speed))


def _labels(kind: str, seed: int, n: int) -> list[dict]:
    return [{"kind": kind, "seed": seed, "index": i} for i in range(n)]


def _beside(along: np.ndarray, generator: np.random.Generator, tries: int) -> np.ndarray:
    """Return unit vectors (n, tries or 1, d) orthogonal to `along` (n, d): left of it, or any."""
    if along.shape[1] == 2:
        return np.stack([-along[:, 1], along[:, 0]], axis=1)[:, None]
    least = np.eye(3)[np.abs(along).argmin(1)]  # the axis that is farthest from parallel
    first = np.cross(along, least)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    angle = generator.uniform(0, 2 * np.pi, (len(along), tries, 1))
    return np.cos(angle) * first[:, None] + np.sin(angle) * np.cross(along, first)[:, None]


def _in_space(points: np.ndarray) -> np.ndarray:
    """Return copies of points (..., 2 or 3) as points (..., 3), at height 0 if they are planar."""
    spare = [(0, 0)] * (points.ndim - 1) + [(0, 3 - points.shape[-1])]
    return np.pad(points, spare)


def _check(episodes: int, obstacles: int, speed: float) -> None:
    if episodes < 1:
        raise DefplanError(f"an evaluation needs at least 1 episode, not {episodes}")
    if obstacles < 0:
        raise DefplanError(f"the number of obstacles must be 0 or more, not {obstacles}")
    if not (np.isfinite(speed) and speed >= 0):
        raise DefplanError(f"the obstacle speed must be 0 m/s or more, not {speed}")


@dataclass(frozen=True)
class NovelScenes:
    """Draws the scene of an episode: a sampler that pickles, so that an environment does.

    Attributes:
        navigation: the problem.
        obstacles: on the way to the target; None: navigation.novel_obstacles.
        speed: of the obstacles, m/s.
    """

    navigation: Navigation
    obstacles: int | None = None
    speed: float = 0.0

    def __call__(self, random: np.random.RandomState) -> Scene:
        """Return an unseen scene."""
        seed = int(random.randint(2**31))
        return novel_scenes(self.navigation, 1, seed, self.obstacles, self.speed)[0]
