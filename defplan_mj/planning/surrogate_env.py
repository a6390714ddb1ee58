"""Many robots at once on the rigid surrogate f_fit, among cylinders: laser, collisions, targets.

All arrays are float32 and all loops run over whole arrays, so that a planner can be trained on
hundreds of thousands of transitions in seconds.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from defplan_mj.planning.scenes import SceneBatch
from defplan_mj.planning.surrogate import Surrogate
from defplan_mj.task import Navigation

RUNNING, SUCCESS, COLLISION, TIMEOUT = range(4)
COLLISION_PENALTY = 1000.0
"""The paper's penalty of a collision in Eq. 2."""


def scan(
    position: np.ndarray,
    yaw: np.ndarray,
    centres: np.ndarray,
    radii: np.ndarray,
    beams: int,
    laser_range: float,
) -> np.ndarray:
    """Return the (n, beams) distances to the nearest circle along each beam, at most the range.

    Beam k of robot i points yaw_i + 2 pi k / beams. From inside a circle every distance is 0.

    Args:
        position: (n, 2) m.
        yaw: (n,) rad.
        centres: (n, m, 2) m.
        radii: (n, m) m; circles of radius 0 are not there.
        laser_range: m.
    """
    n = len(position)
    distances = np.full((n, beams), laser_range, np.float32)
    offset = centres - position[:, None]
    reach = laser_range + radii
    near = (np.einsum("nmd,nmd->nm", offset, offset) < reach * reach) & (radii > 0)
    robot, circle = np.nonzero(near)
    if not len(robot):
        return distances
    angle = np.arange(beams) * (2 * np.pi / beams)
    beam_x, beam_y = np.cos(angle).astype(np.float32), np.sin(angle).astype(np.float32)
    world_x, world_y = offset[robot, circle, 0], offset[robot, circle, 1]
    cosine, sine = np.cos(yaw)[robot], np.sin(yaw)[robot]
    x = (cosine * world_x + sine * world_y)[:, None]
    y = (cosine * world_y - sine * world_x)[:, None]
    radius = radii[robot, circle][:, None]
    along = x * beam_x + y * beam_y
    across = y * beam_x - x * beam_y
    half_chord = radius * radius - across * across  # squared
    hit = (half_chord > 0) & (along > 0)
    along -= np.sqrt(np.maximum(half_chord, 0, out=half_chord), out=half_chord)
    depth = np.where(hit, along, np.float32(laser_range))
    inside = (x * x + y * y <= radius * radius)[:, 0]
    depth[inside] = 0
    first = np.flatnonzero(np.diff(robot, prepend=-1))  # circles come sorted by robot
    nearest = np.minimum.reduceat(depth, first, axis=0)
    distances[robot[first]] = np.minimum(nearest, distances[robot[first]])
    return distances


def segment_distance(point: np.ndarray, start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Return the distance of points to segments; all arguments (..., 2), broadcast together."""
    edge = end - start
    offset = point - start
    length = np.maximum((edge * edge).sum(-1), 1e-12)
    share = np.clip((offset * edge).sum(-1) / length, 0, 1)
    gap = offset - share[..., None] * edge
    return np.sqrt((gap * gap).sum(-1))


@dataclass(frozen=True)
class Transition:
    """What one cycle of all n robots did.

    Attributes:
        laser, target: (n, beams) m and (n, 2) m: the new observation, after any reset.
        final_laser, final_target: the same before any reset: what the cycle led to.
        progress: (n,) distance to the target that the cycle gained, m.
        reward: (n,) Eq. 2.
        outcome: (n,) RUNNING, SUCCESS, COLLISION or TIMEOUT.
    """

    laser: np.ndarray
    target: np.ndarray
    final_laser: np.ndarray
    final_target: np.ndarray
    progress: np.ndarray
    reward: np.ndarray
    outcome: np.ndarray


class SurrogateEnv:
    """n robots that each swim through scenes of a batch, on f_fit.

    A robot collides when a disc of the surrogate's radius, moved straight from the start to the end
    of the cycle, touches a circle at any time (a cycle can be longer than an obstacle is wide). An
    episode ends at the goal, at a collision or at the scene's time-out.

    Args:
        surrogate: f_fit.
        navigation: for the laser.
        batch: the scenes.
        n: robots, which enter scenes picked at random and begin anew when an episode ends. By
            default there is one robot for each scene and no new episode.
        generator: picks the scenes and draws the noise.
        noise: scatter of the cycles, in units of the surrogate's own standard deviations.
    """

    def __init__(
        self,
        surrogate: Surrogate,
        navigation: Navigation,
        batch: SceneBatch,
        n: int | None = None,
        generator: np.random.Generator | None = None,
        noise: float = 0.0,
    ) -> None:
        self.surrogate, self.navigation, self.batch = surrogate, navigation, batch
        self.n, self.endless = (len(batch), False) if n is None else (n, True)
        self.generator = np.random.default_rng(0) if generator is None else generator
        self.noise = noise
        self.motions = surrogate.planar().astype(np.float32)
        self.seconds = np.float32(surrogate.cycle_seconds)
        self.bank_centres = batch.centres.astype(np.float32)
        self.bank_radii = batch.radii.astype(np.float32)
        self.bank_velocities = batch.velocities.astype(np.float32)
        most = self.bank_radii.shape[1]
        self.position = np.zeros((self.n, 2), np.float32)
        self.yaw = np.zeros(self.n, np.float32)
        self.goal = np.zeros((self.n, 2), np.float32)
        self.centres = np.zeros((self.n, most, 2), np.float32)
        self.radii = np.zeros((self.n, most), np.float32)
        self.velocities = np.zeros((self.n, most, 2), np.float32)
        self.cycles = np.zeros(self.n, np.int64)
        self.scene = np.zeros(self.n, np.int64)
        self.reset()

    def reset(self) -> tuple[np.ndarray, np.ndarray]:
        """Start a new episode for every robot; return the (n, beams) laser and (n, 2) target."""
        everyone = np.arange(self.n)
        self._enter(everyone, self._pick(self.n) if self.endless else everyone)
        return self.observe()

    def observe(self, robots: np.ndarray | slice = slice(None)) -> tuple[np.ndarray, np.ndarray]:
        """Return the laser distances (n, beams) and the target in the yaw frame (n, 2), m."""
        position, yaw = self.position[robots], self.yaw[robots]
        laser = scan(
            position,
            yaw,
            self.centres[robots],
            self.radii[robots],
            self.navigation.beams,
            self.navigation.laser_range,
        )
        offset = self.goal[robots] - position
        return laser, _rotate(offset, -yaw)

    def step(self, actions: np.ndarray) -> Transition:
        """Move every robot by one cycle of its gait `actions` (n,)."""
        motion = self.motions[actions]
        if self.noise:
            motion = self._scatter(motion, actions)
        start = self.position
        end = start + _rotate(motion[:, :2], self.yaw)
        drift = self.velocities * self.seconds
        # Seen from an obstacle, the robot moves from `start` to `end - drift`.
        gap = segment_distance(self.centres, start[:, None], end[:, None] - drift)
        collision = ((gap < self.radii + self.surrogate.radius) & (self.radii > 0)).any(1)
        reached = np.sum((self.goal - end) ** 2, 1) < self.batch.goal_radius**2
        before = np.sum((self.goal - start) ** 2, 1)
        after = np.sum((self.goal - end) ** 2, 1)
        self.position, self.yaw = end, _wrap(self.yaw + motion[:, 2])
        self.centres = self.centres + drift
        self.cycles += 1
        outcome = np.full(self.n, RUNNING)
        outcome[self.cycles >= self.batch.max_cycles] = TIMEOUT
        outcome[reached] = SUCCESS
        outcome[collision] = COLLISION
        final_laser, final_target = self.observe()
        laser, target = final_laser, final_target
        ended = np.flatnonzero(outcome != RUNNING)
        if self.endless and len(ended):
            self._enter(ended, self._pick(len(ended)))
            laser, target = final_laser.copy(), final_target.copy()
            laser[ended], target[ended] = self.observe(ended)
        return Transition(
            laser=laser,
            target=target,
            final_laser=final_laser,
            final_target=final_target,
            progress=np.sqrt(before) - np.sqrt(after),
            reward=before - after - COLLISION_PENALTY * collision,
            outcome=outcome,
        )

    def _pick(self, count: int) -> np.ndarray:
        return self.generator.integers(0, len(self.batch), count)

    def _enter(self, robots: np.ndarray, scenes: np.ndarray) -> None:
        """Put `robots` at the start of `scenes`."""
        self.scene[robots] = scenes
        self.position[robots] = 0
        self.yaw[robots] = self.batch.yaw[scenes]
        self.goal[robots] = self.batch.targets[scenes]
        self.centres[robots] = self.bank_centres[scenes]
        self.radii[robots] = self.bank_radii[scenes]
        self.velocities[robots] = self.bank_velocities[scenes]
        self.cycles[robots] = 0

    def _scatter(self, motion: np.ndarray, actions: np.ndarray) -> np.ndarray:
        """Return the motions with normal noise on yaw and on forward and left displacement."""
        spread = np.column_stack(
            [
                self.surrogate.translation_sd,
                self.surrogate.translation_sd,
                self.surrogate.rotation_sd,
            ]
        ).astype(np.float32)
        noise = self.generator.standard_normal(motion.shape, np.float32)
        return motion + np.float32(self.noise) * spread[actions] * noise


@dataclass(frozen=True)
class SurrogateRuns:
    """How a policy fares in a batch of scenes on f_fit.

    Attributes:
        outcome: (n,) SUCCESS, COLLISION or TIMEOUT.
        cycles: (n,) cycles used.
        reward: (n,) Eq. 2, summed over the episode.
    """

    outcome: np.ndarray
    cycles: np.ndarray
    reward: np.ndarray

    def rate(self, outcome: int = SUCCESS) -> float:
        """Return the share of the episodes that ended with `outcome`."""
        return float((self.outcome == outcome).mean())


Act = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]
"""act(laser (a, beams), target (a, 2), robots (a,)) returns the gaits (a,) of these robots."""


def run_on_surrogate(
    surrogate: Surrogate,
    navigation: Navigation,
    batch: SceneBatch,
    act: Act,
    generator: np.random.Generator | None = None,
    noise: float = 0.0,
) -> SurrogateRuns:
    """Run `act` once in every scene of the batch, on f_fit.

    With `noise`, the cycles scatter (see `SurrogateEnv`), drawn from `generator`.
    """
    env = SurrogateEnv(surrogate, navigation, batch, generator=generator, noise=noise)
    outcome, reward = np.full(env.n, RUNNING), np.zeros(env.n)
    cycles, gaits = np.zeros(env.n, np.int64), np.zeros(env.n, np.int64)
    laser, target = env.observe()
    while (running := np.flatnonzero(outcome == RUNNING)).size:
        gaits[running] = act(laser[running], target[running], running)
        if noise:
            env.motions = env.motions
        step = env.step(gaits)
        reward[running] += step.reward[running]
        cycles[running] += 1
        outcome[running] = step.outcome[running]
        laser, target = step.laser, step.target
    return SurrogateRuns(outcome, cycles, reward)


def _rotate(vectors: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Return (n, 2) vectors turned by (n,) angles."""
    cosine, sine = np.cos(angle), np.sin(angle)
    x, y = vectors[:, 0], vectors[:, 1]
    return np.stack([cosine * x - sine * y, sine * x + cosine * y], axis=1)


def _wrap(angle: np.ndarray) -> np.ndarray:
    return (angle + np.float32(np.pi)) % np.float32(2 * np.pi) - np.float32(np.pi)
