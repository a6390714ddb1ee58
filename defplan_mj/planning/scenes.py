"""Generators of navigation scenes: training targets, unseen, training and validation scenes."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from defplan_mj.base.errors import DefplanError
from defplan_mj.base.places import PLACES
from defplan_mj.base.rotations import level_attitude, quaternion_heading
from defplan_mj.planning.frames import (
    random_attitudes,
    random_directions,
    spread_directions,
)
from defplan_mj.planning.places import place_batch, place_scenes
from defplan_mj.planning.scene import FAR, Scene, SceneBatch
from defplan_mj.task import Navigation

# First words of the seeds, so that no two kinds of scenes share random numbers.
_K2_STREAM, _NOVEL_STREAM, _TRAINING_STREAM, _VALIDATION_STREAM = range(101, 105)
_K2_TARGETS_STREAM, _VALIDATION_TARGETS_STREAM = 105, 106


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

    Where the task navigates in scenes of a place, the obstacles are that place's, and what is said
    here of obstacles does not matter.

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
    if navigation.scenes:
        bearings = np.arctan2(directions[:, 1], directions[:, 0])
        where = (bearings, quaternion_heading(orientations), distances)
        return place_batch(navigation.scenes, navigation, generator, navigation.room, *where)
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
    _check(navigation, episodes, obstacles, obstacle_speed)
    obstacles = navigation.k2_obstacles if obstacles is None else obstacles
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
    _check(navigation, n, obstacles, obstacle_speed)
    obstacles = navigation.novel_obstacles if obstacles is None else obstacles
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


def draw_scenes(
    kind: str,
    navigation: Navigation,
    seed: int,
    n: int | None,
    radius: float,
    obstacles: int | None = None,
    obstacle_speed: float = 0.0,
) -> list[Scene]:
    """Return n scenes of a kind: 'k2' (training targets), 'novel' (unseen scenes) or a name of `base.places`.

    Args:
        n: None: of 'k2' one for each training target.
        radius: of the disc or ball that holds the robot, which a place is made for, m.

    Raises:
        DefplanError: a place has obstacles of its own; or as the generators say.
    """
    if kind == "k2":
        return k2_scenes(navigation, seed, n, obstacles, obstacle_speed)
    if n is None:
        raise DefplanError(f"say how many scenes of the kind {kind} there are to be")
    if kind in PLACES:
        _keep_obstacles(kind, obstacles, obstacle_speed)
        return place_scenes(kind, navigation, n, seed, radius)
    return novel_scenes(navigation, n, seed, obstacles, obstacle_speed)


def _keep_obstacles(place: str, obstacles: int | None, speed: float) -> None:
    if obstacles is not None or speed:
        raise DefplanError(f"the scenes {place} have obstacles of their own, which stand still")


def _check(navigation: Navigation, episodes: int, obstacles: int | None, speed: float) -> None:
    if episodes < 1:
        raise DefplanError(f"an evaluation needs at least 1 episode, not {episodes}")
    if obstacles is not None and obstacles < 0:
        raise DefplanError(f"the number of obstacles must be 0 or more, not {obstacles}")
    if not (np.isfinite(speed) and speed >= 0):
        raise DefplanError(f"the obstacle speed must be 0 m/s or more, not {speed}")
    if navigation.scenes:
        _keep_obstacles(navigation.scenes, obstacles, speed)


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
