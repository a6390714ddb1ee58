"""Many robots at once on the rigid surrogate f_fit, among obstacles: laser, collisions, targets.

All arrays are float32 and all loops run over whole arrays, so that a planner can be trained on
hundreds of thousands of transitions in seconds.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from defplan_mj.base.segments import segment_distance
from defplan_mj.planning.frames import angles, attitude_frames, renewed, turns
from defplan_mj.planning.outcome import COLLISION, RUNNING, SUCCESS, TIMEOUT
from defplan_mj.planning.scene import SceneBatch
from defplan_mj.planning.sensors.sensor import sensor_of
from defplan_mj.planning.surrogate import Motions, Surrogate, check_decisions
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


class Sight(NamedTuple):
    """What n robots see and know.

    Attributes:
        laser: (n, readings) of the sensor, m.
        target: (n, d) in the robots' frames, m.
        before: (n,) the past (`planning.past`), the surrogate's `rest` at the start.
        drift: (n, p, d) how far the reading's points move in a decision, in the robots' frames, m: as a
            tracker knows it, that is of what was seen before, too. None: nothing moves in these scenes.
    """

    laser: np.ndarray
    target: np.ndarray
    before: np.ndarray
    drift: np.ndarray | None

    def of(self, robots: Any) -> Sight:
        """Return what some of the robots see."""
        drift = None if self.drift is None else self.drift[robots]
        return Sight(self.laser[robots], self.target[robots], self.before[robots], drift)

    def replaced(self, robots: np.ndarray, others: Sight) -> Sight:
        """Return a copy in which some robots see something else."""
        copy = Sight(self.laser.copy(), self.target.copy(), self.before.copy(), None)
        for part, new in zip(copy[:3], others[:3], strict=True):
            part[robots] = new
        if self.drift is None or others.drift is None:
            return copy
        drift = self.drift.copy()
        drift[robots] = others.drift
        return copy._replace(drift=drift)


@dataclass(frozen=True)
class Transition:
    """What one decision of all n robots did.

    Attributes:
        sight: the new observation, after any reset.
        final: the same before any reset: what the cycle led to.
        progress: (n,) distance to the target that it gained, m.
        reward: (n,) Eq. 2.
        outcome: (n,) RUNNING, SUCCESS, COLLISION or TIMEOUT (`planning.outcome`).
    """

    sight: Sight
    final: Sight
    progress: np.ndarray
    reward: np.ndarray
    outcome: np.ndarray

    @property
    def laser(self) -> np.ndarray:
        """Of `sight`."""
        return self.sight.laser

    @property
    def target(self) -> np.ndarray:
        """Of `sight`."""
        return self.sight.target


class SurrogateEnv:
    """n robots that each swim through scenes of a batch, on f_fit.

    A robot collides when a ball of the surrogate's radius, moved straight from the start to the end
    of the cycle, or of the part of it that a decision plays, touches an obstacle at any time (a cycle can
    be longer than an obstacle is wide). An episode ends at the goal, at a collision or at the scene's time-out.

    Attributes:
        position: (n, d) m.
        frames: (n, d, d), see `planning.frames`.
        goal, centres, radii, velocities: of each robot's episode.
        cycles: (n,) decisions of its episode; with one a cycle these are gait cycles.

    Args:
        surrogate: f_fit.
        navigation: for the laser; its space is the scenes'.
        batch: the scenes.
        n: robots, which enter scenes picked at random and begin anew when an episode ends. By
            default there is one robot for each scene and no new episode.
        generator: picks the scenes and draws the noise.
        noise: scatter of the cycles, in units of the surrogate's own standard deviations.

    Raises:
        DefplanError: the surrogate is of another number of decisions a cycle.
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
        check_decisions(surrogate, navigation)
        self.past = surrogate.past
        d = navigation.dimension
        rotations, translations = surrogate.switched_motions(navigation.space)
        self.motions = Motions(rotations.astype(np.float32), translations.astype(np.float32))
        turn, way = (sd.astype(np.float32) for sd in surrogate.scatter())
        self.rotation_noise, self.translation_noise = (
            np.float32(noise) * turn,
            np.float32(noise) * way,
        )
        self.sensor = sensor_of(navigation)
        self.seconds = np.float32(surrogate.decision_seconds)
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
        self.before = np.zeros(self.n, np.int64)
        self.moving = bool(np.any(self.bank_velocities))
        self.known = np.zeros((self.n, most), bool)  # balls that were seen before
        self.visible = np.zeros((self.n, most), bool)
        self.cycles = np.zeros(self.n, np.int64)
        self.scene = np.zeros(self.n, np.int64)
        self.reset()

    def reset(self) -> Sight:
        """Start a new episode for every robot; return what they see."""
        everyone = np.arange(self.n)
        self._enter(everyone, self._pick(self.n) if self.endless else everyone)
        return self.observe()

    def observe(self, robots: np.ndarray | slice = slice(None)) -> Sight:
        """Return what robots see now."""
        position, frames = self.position[robots], self.frames[robots]
        view = BallView(position, frames, self.centres[robots], self.radii[robots])
        laser = self.sensor.measure(view, self.navigation)
        target = np.einsum("nij,ni->nj", frames, self.goal[robots] - position)
        return Sight(laser, target, self.before[robots], self._drift(robots, view, laser))

    def _drift(
        self, robots: np.ndarray | slice, view: BallView, laser: np.ndarray
    ) -> np.ndarray | None:
        """Return `Sight.drift`; take note of the balls that are seen: those next to a point."""
        if not self.moving:
            return None
        points, there = self.sensor.points(laser, self.navigation)
        centres, radii = view.obstacles()
        robot, point = np.nonzero(there)
        offset = points[robot, point][:, None] - centres[robot]
        gap = np.abs(np.sqrt(np.einsum("imd,imd->im", offset, offset)) - radii[robot])
        ball = np.where(radii[robot] > 0, gap, np.inf).argmin(1)
        visible = np.zeros(radii.shape, bool)
        visible[robot, ball] = True
        self.visible[robots] = visible
        velocity = np.where(self.known[robots][..., None], self.velocities[robots], 0)
        out = np.zeros_like(points)
        out[robot, point] = (velocity @ view.frames)[robot, ball] * self.seconds
        return out

    def step(self, actions: np.ndarray) -> Transition:
        """Move every robot by one decision for its gait `actions` (n,)."""
        switch = (self.before, np.asarray(actions))
        motions = self.motions.of(switch)
        if self.noise:
            motions = self._scatter(motions, switch)
        self.before = self.past.then[switch]
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
        self.known |= self.visible
        self.cycles += 1
        outcome = np.full(self.n, RUNNING)
        outcome[self.cycles >= self.batch.max_cycles * self.past.decisions] = TIMEOUT
        outcome[reached] = SUCCESS
        outcome[collision] = COLLISION
        final = sight = self.observe()
        ended = np.flatnonzero(outcome != RUNNING)
        if self.endless and len(ended):
            self._enter(ended, self._pick(len(ended)))
            sight = final.replaced(ended, self.observe(ended))
        return Transition(
            sight=sight,
            final=final,
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
        self.before[robots] = self.surrogate.rest
        self.known[robots] = False
        self.cycles[robots] = 0

    def _scatter(self, motions: Motions, switch: tuple[np.ndarray, np.ndarray]) -> Motions:
        """Return the motions with normal noise on each part of the translation and of the turn."""
        d = motions.translations.shape[1]
        noise = self.generator.standard_normal((self.n, d + angles(d)), np.float32)
        noise[:, :d] *= self.translation_noise[switch][:, None]
        noise[:, d:] *= self.rotation_noise[switch][:, None]
        return Motions(motions.rotations @ turns(noise[:, d:]), motions.translations + noise[:, :d])


@dataclass(frozen=True)
class SurrogateRuns:
    """How a policy fares in a batch of scenes on f_fit.

    Attributes:
        outcome: (n,) SUCCESS, COLLISION or TIMEOUT.
        cycles: (n,) decisions used; with one a cycle these are gait cycles.
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
    return run_all(env, lambda sight, robots: act(sight.laser, sight.target, robots))


def run_all(env: SurrogateEnv, act: Callable[[Sight, np.ndarray], np.ndarray]) -> SurrogateRuns:
    """Run every robot of a fresh environment to its end; act(sight (a), robots (a,)) returns gaits (a,)."""
    outcome, reward = np.full(env.n, RUNNING), np.zeros(env.n)
    cycles, gaits = np.zeros(env.n, np.int64), np.zeros(env.n, np.int64)
    sight = env.observe()
    while (running := np.flatnonzero(outcome == RUNNING)).size:
        gaits[running] = act(sight.of(running), running)
        step = env.step(gaits)
        reward[running] += step.reward[running]
        cycles[running] += 1
        outcome[running] = step.outcome[running]
        sight = step.sight
    return SurrogateRuns(outcome, cycles, reward)
