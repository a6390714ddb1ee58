"""Many robots at once on the rigid surrogate f_fit, among obstacles: laser, collisions, targets.

All arrays are float32 and all loops run over whole arrays, so that a planner can be trained on
hundreds of thousands of transitions in seconds.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from defplan_mj.planning.frames import angles, attitude_frames, renewed, turns
from defplan_mj.planning.outcome import COLLISION, RUNNING, SUCCESS, TIMEOUT
from defplan_mj.planning.scenes import SceneBatch
from defplan_mj.planning.sensors.sensor import sensor_of
from defplan_mj.planning.surrogate import Motions, Surrogate
from defplan_mj.task import Navigation

COLLISION_PENALTY = 1000.0
"""The paper's penalty of a collision in Eq. 2."""


def scan(
    position: np.ndarray,
    frames: np.ndarray,
    centres: np.ndarray,
    radii: np.ndarray,
    directions: np.ndarray,
    laser_range: float,
) -> np.ndarray:
    """Return the (n, beams) distances to the nearest ball along each beam, at most the range.

    A ball is a circle in the plane (d = 2) and a sphere in space (d = 3). From inside one every
    distance is 0.

    Args:
        position: (n, d) m.
        frames: (n, d, d), see `planning.frames`.
        centres: (n, m, d) m.
        radii: (n, m) m; balls of radius 0 are not there.
        directions: (beams, d) unit vectors in the robot's frame.
        laser_range: m.
    """
    n, beams = len(position), len(directions)
    distances = np.full((n, beams), laser_range, np.float32)
    offset = centres - position[:, None]
    away2 = np.einsum("nmd,nmd->nm", offset, offset)
    reach = laser_range + radii
    robot, ball = np.nonzero((away2 < reach * reach) & (radii > 0))
    # A beam hits if it is longer than the tangent to the ball where it passes the centre.
    radius = radii[robot, ball]
    tangent2 = away2[robot, ball] - radius * radius
    along = (offset @ frames)[robot, ball] @ directions.T
    hit = along > np.sqrt(np.maximum(tangent2, 0))[:, None]
    pair, beam = np.divmod(np.flatnonzero(hit), beams)  # few: it pays to go on with these alone
    middle = along[pair, beam]
    depth = middle - np.sqrt(np.maximum(middle * middle - tangent2[pair], 0))
    np.minimum.at(distances.reshape(-1), robot[pair] * beams + beam, depth)
    distances[robot[tangent2 <= 0]] = 0
    return distances


@dataclass(frozen=True)
class BallView:
    """What n robots among balls can sense (a `planning.sensors.sensor.View`); see `scan`."""

    position: np.ndarray
    frames: np.ndarray
    centres: np.ndarray
    radii: np.ndarray

    def cast(self, directions: np.ndarray, farthest: float) -> np.ndarray:
        """Return the distances (n, b) along rays in the robots' frames, m."""
        along = directions.astype(self.position.dtype)
        return scan(self.position, self.frames, self.centres, self.radii, along, farthest)

    def obstacles(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the balls' centres in the robots' frames (n, m, d) and radii (n, m), m."""
        return (self.centres - self.position[:, None]) @ self.frames, self.radii


def segment_distance(point: np.ndarray, start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Return the distance of points to segments; all arguments (..., d), broadcast together."""
    edge = end - start
    offset = point - start
    length = np.maximum(np.einsum("...d,...d->...", edge, edge), 1e-12)
    share = np.clip(np.einsum("...d,...d->...", offset, edge) / length, 0, 1)
    gap = offset - share[..., None] * edge
    return np.sqrt(np.einsum("...d,...d->...", gap, gap))


@dataclass(frozen=True)
class Transition:
    """What one cycle of all n robots did.

    Attributes:
        laser, target: (n, beams) m and (n, d) m: the new observation, after any reset.
        final_laser, final_target: the same before any reset: what the cycle led to.
        progress: (n,) distance to the target that the cycle gained, m.
        reward: (n,) Eq. 2.
        outcome: (n,) RUNNING, SUCCESS, COLLISION or TIMEOUT (`planning.outcome`).
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

    A robot collides when a ball of the surrogate's radius, moved straight from the start to the end
    of the cycle, touches an obstacle at any time (a cycle can be longer than an obstacle is wide).
    An episode ends at the goal, at a collision or at the scene's time-out.

    Attributes:
        position: (n, d) m.
        frames: (n, d, d), see `planning.frames`.
        goal, centres, radii, velocities, cycles: of each robot's episode.

    Args:
        surrogate: f_fit.
        navigation: for the laser; its space is the scenes'.
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
        d = navigation.dimension
        rotations, translations = surrogate.motions(navigation.space)
        self.motions = Motions(rotations.astype(np.float32), translations.astype(np.float32))
        self.rotation_noise = np.float32(noise) * surrogate.rotation_sd.astype(np.float32)
        self.translation_noise = np.float32(noise) * surrogate.translation_sd.astype(np.float32)
        self.sensor = sensor_of(navigation)
        self.seconds = np.float32(surrogate.cycle_seconds)
        self.bank_frames = attitude_frames(batch.orientations, d).astype(np.float32)
        self.bank_centres = batch.centres.astype(np.float32)
        self.bank_radii = batch.radii.astype(np.float32)
        self.bank_velocities = batch.velocities.astype(np.float32)
        most = self.bank_radii.shape[1]
        self.position = np.zeros((self.n, d), np.float32)
        self.frames = np.zeros((self.n, d, d), np.float32)
        self.goal = np.zeros((self.n, d), np.float32)
        self.centres = np.zeros((self.n, most, d), np.float32)
        self.radii = np.zeros((self.n, most), np.float32)
        self.velocities = np.zeros((self.n, most, d), np.float32)
        self.cycles = np.zeros(self.n, np.int64)
        self.scene = np.zeros(self.n, np.int64)
        self.reset()

    def reset(self) -> tuple[np.ndarray, np.ndarray]:
        """Start a new episode for every robot; return the (n, beams) laser and (n, d) target."""
        everyone = np.arange(self.n)
        self._enter(everyone, self._pick(self.n) if self.endless else everyone)
        return self.observe()

    def observe(self, robots: np.ndarray | slice = slice(None)) -> tuple[np.ndarray, np.ndarray]:
        """Return the laser distances (n, beams) and the target in the robots' frames (n, d), m."""
        position, frames = self.position[robots], self.frames[robots]
        view = BallView(position, frames, self.centres[robots], self.radii[robots])
        return self.sensor.measure(view, self.navigation), np.einsum(
            "nij,ni->nj", frames, self.goal[robots] - position
        )

    def step(self, actions: np.ndarray) -> Transition:
        """Move every robot by one cycle of its gait `actions` (n,)."""
        motions = self.motions.of(actions)
        if self.noise:
            motions = self._scatter(motions, actions)
        start = self.position
        end, frames = motions.after(start, self.frames)
        drift = self.velocities * self.seconds
        # Seen from an obstacle, the robot moves from `start` to `end - drift`.
        gap = segment_distance(self.centres, start[:, None], end[:, None] - drift)
        collision = ((gap < self.radii + self.surrogate.radius) & (self.radii > 0)).any(1)
        before = np.sum((self.goal - start) ** 2, 1)
        after = np.sum((self.goal - end) ** 2, 1)
        reached = after < self.batch.goal_radius**2
        self.position, self.frames = end, renewed(frames)
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
        self.frames[robots] = self.bank_frames[scenes]
        self.goal[robots] = self.batch.targets[scenes]
        self.centres[robots] = self.bank_centres[scenes]
        self.radii[robots] = self.bank_radii[scenes]
        self.velocities[robots] = self.bank_velocities[scenes]
        self.cycles[robots] = 0

    def _scatter(self, motions: Motions, actions: np.ndarray) -> Motions:
        """Return the motions with normal noise on each part of the translation and of the turn."""
        d = motions.translations.shape[1]
        noise = self.generator.standard_normal((self.n, d + angles(d)), np.float32)
        noise[:, :d] *= self.translation_noise[actions, None]
        noise[:, d:] *= self.rotation_noise[actions, None]
        return Motions(motions.rotations @ turns(noise[:, d:]), motions.translations + noise[:, :d])


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
"""act(laser (a, beams), target (a, d), robots (a,)) returns the gaits (a,) of these robots."""


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
        step = env.step(gaits)
        reward[running] += step.reward[running]
        cycles[running] += 1
        outcome[running] = step.outcome[running]
        laser, target = step.laser, step.target
    return SurrogateRuns(outcome, cycles, reward)
