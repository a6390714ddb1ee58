"""Evaluation: planners steer the reduced dynamics through scenes in MuJoCo, episode by episode."""

from __future__ import annotations

import functools
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from defplan_mj.base import parallel
from defplan_mj.base.progress import Progress, no_progress
from defplan_mj.base.statistics import wilson_interval
from defplan_mj.host.navigation import robot_environment
from defplan_mj.planning.outcome import ENDINGS, Outcome
from defplan_mj.planning.planner import Planner, needs_obstacles
from defplan_mj.planning.scene import Scene
from defplan_mj.planning.shield import Shield
from defplan_mj.planning.surrogate import check_decisions
from defplan_mj.task import Navigation

if TYPE_CHECKING:
    from dm_control.rl.control import Environment

    from defplan_mj.planning.robot import Robot
    from defplan_mj.planning.surrogate import Surrogate

ROOM = 32  # obstacles that there is room for in any case
PARALLEL_FROM = 16  # episodes; fewer are done before a second process has started


class EpisodeRecorder(Protocol):
    """What `run_episode` reports to while an episode runs; `log.recorder.Recorder` is one."""

    def begin(self, context: Mapping[str, Any], scene: Scene) -> None:
        """Take what is known before the first step."""

    def step(self, time: float, x: np.ndarray, target_shape: np.ndarray, clearance: float) -> None:
        """Take one physics step: time, s; state (13 + 3r,) and target shape (r,) after it; clearance, m."""

    def cycle(
        self,
        index: int,
        time: float,
        x: np.ndarray,
        gait_index: int,
        values: np.ndarray,
        reward: float,
        laser: np.ndarray,
    ) -> None:
        """Take one decision, after its last step: the planner's values (K,) and what it sensed, (beams,)."""

    def end(self, outcome: str, reason: str = "") -> None:
        """Take how the episode ended."""


RecorderFactory = Callable[[int, Scene], AbstractContextManager[EpisodeRecorder] | None]
"""Gives the recorder of episode i, or None; it must be picklable for parallel evaluation."""


@dataclass(frozen=True)
class Episode:
    """How one episode went.

    Attributes:
        index: of the scene.
        outcome: one of `planning.outcome.ENDINGS`.
        cycles: gait cycles begun.
        seconds: simulated time, s.
        distance: from the target at the end, m.
        closest: smallest clearance to an obstacle, m, at most 1.
        reward: Eq. 2, summed.
        path: length of the way of the centre of mass, from decision to decision, m.
        tilt: largest tilt at the end of what a decision played, rad.
        wall: time of decisions and physics, s; the only entry that differs between reruns.
        decision: time of a decision, mean, s; likewise.
    """

    index: int
    outcome: str
    cycles: int
    seconds: float
    distance: float
    closest: float
    reward: float
    path: float
    tilt: float
    wall: float
    decision: float


@dataclass(frozen=True)
class EvaluationResult:
    """All episodes of one evaluation, in the order of their scenes."""

    episodes: tuple[Episode, ...]

    def count(self, outcome: str) -> int:
        """Return how many episodes ended with `outcome`."""
        return sum(episode.outcome == outcome for episode in self.episodes)

    def rate(self, outcome: str) -> float:
        """Return the share of episodes that ended with `outcome`."""
        return self.count(outcome) / len(self.episodes)

    def real_time_factor(self) -> float:
        """Return simulated seconds a second of decisions and physics, of one process."""
        wall = sum(episode.wall for episode in self.episodes)
        return sum(episode.seconds for episode in self.episodes) / wall

    def to_json(self) -> dict[str, Any]:
        """Return rates, their 95% intervals and every episode as plain data."""
        n = len(self.episodes)
        good = [episode for episode in self.episodes if episode.outcome == Outcome.SUCCESS]
        decisions = [episode.decision for episode in self.episodes]
        return {
            "episodes": n,
            **{outcome: self.rate(outcome) for outcome in ENDINGS},
            "interval": {
                outcome: list(wilson_interval(self.count(outcome), n)) for outcome in ENDINGS
            },
            "cycles_mean": float(np.mean([e.cycles for e in good])) if good else None,
            "decision_ms": 1e3 * float(np.median(decisions)),
            "real_time_factor": self.real_time_factor(),
            "rows": [asdict(episode) for episode in self.episodes],
        }


def run_episode(
    env: Environment,
    scene: Scene,
    planner: Planner,
    recorder: EpisodeRecorder | None = None,
    context: Mapping[str, Any] | None = None,
    index: int = 0,
) -> Episode:
    """Let a planner steer through one scene of the host's navigation environment.

    Args:
        env: of `host.navigation.navigation_environment`.
        recorder: told every step and cycle.
        context: of the log, JSON-able; time step and start state are added.
        index: of the episode.
    """
    task, physics = env.task, env.physics
    task.scene = scene
    task.tells_obstacles = needs_obstacles(planner)
    observation = env.reset().observation
    planner.reset()
    if recorder is not None:
        start = {
            "timestep": physics.timestep(),
            **physics.stepping,
            "state": physics.reduced_state(),
        }
        recorder.begin({**(context or {}), **start}, scene)
        task.step_hook = lambda now, shape: recorder.step(
            now.time(), now.reduced_state(), shape, now.clearance()
        )
    reward = path = tilt = thinking = moving = 0.0
    try:
        while task.outcome == Outcome.RUNNING:
            at, x, laser = physics.time(), physics.reduced_state(), observation["laser"]
            begun = time.perf_counter()
            values = planner.values(observation)
            gait = int(np.argmax(values))
            decided = time.perf_counter()
            step = env.step(gait)
            thinking += decided - begun
            moving += time.perf_counter() - decided
            observation = step.observation
            reward += step.reward
            path += float(np.linalg.norm(physics.com() - x[:3]))
            tilt = max(tilt, float(np.arccos(np.clip(physics.upright(), -1, 1))))
            if recorder is not None:
                recorder.cycle(task.decisions - 1, at, x, gait, values, step.reward, laser)
    finally:
        task.step_hook = None
    distance = task.distance(physics)
    if recorder is not None:
        recorder.end(task.outcome, _reason(task.outcome, task.cycles, distance))
    return Episode(
        index=index,
        outcome=task.outcome,
        cycles=task.cycles,
        seconds=physics.time(),
        distance=distance,
        closest=task.closest,
        reward=reward,
        path=path,
        tilt=tilt,
        wall=thinking + moving,
        decision=thinking / max(task.decisions, 1),
    )


def evaluate(
    robot: Robot,
    surrogate: Surrogate,
    navigation: Navigation,
    planner: Planner,
    scenes: Sequence[Scene],
    *,
    shield: bool = True,
    recorder: RecorderFactory | None = None,
    context: Mapping[str, Any] | None = None,
    workers: int | None = None,
    progress: Progress = no_progress,
) -> EvaluationResult:
    """Run one episode in every scene on the reduced dynamics; the result is that of one process.

    Args:
        planner: picklable.
        shield: wrap the planner in the safety shield.
        recorder: gives the recorders of those episodes that are to be logged.
        context: of the logs.
        workers: processes (default: `parallel.places()`, and 1 for a few episodes).

    Raises:
        DefplanError: the surrogate is of another number of decisions a cycle.
    """
    check_decisions(surrogate, navigation)
    pilot: Planner = Shield(planner, surrogate, navigation) if shield else planner
    if workers is None:
        workers = parallel.places() if len(scenes) >= PARALLEL_FROM else 1
    room = max([ROOM, *(len(scene.radii) for scene in scenes)])
    run = functools.partial(_run_share, robot, navigation, room, pilot, recorder, context)
    numbered = list(enumerate(scenes))
    pieces = 1 if workers == 1 else 8 * workers
    shares = [numbered[i::pieces] for i in range(pieces) if numbered[i::pieces]]
    ended: list[Episode] = []
    one_by_one = map(run, shares)  # so that each episode is told of at once
    many = parallel.each(functools.partial(_as_list, run), shares, workers, ordered=False)
    for episodes in one_by_one if workers == 1 else many:
        for episode in episodes:
            ended.append(episode)
            progress(f"{episode.outcome} in {episode.cycles} cycles", len(ended) / len(scenes))
    return EvaluationResult(tuple(sorted(ended, key=lambda episode: episode.index)))


_Share = list[tuple[int, Scene]]


def _as_list(run: Callable[[_Share], Iterator[Episode]], share: _Share) -> list[Episode]:
    return list(run(share))


def _run_share(
    robot: Robot,
    navigation: Navigation,
    room: int,
    pilot: Planner,
    recorder: RecorderFactory | None,
    context: Mapping[str, Any] | None,
    share: _Share,
) -> Iterator[Episode]:
    """Run the episodes of some scenes, one after the other."""
    env = _environment(robot, navigation, room)
    for index, scene in share:
        manager = recorder(index, scene) if recorder is not None else None
        if manager is None:
            yield run_episode(env, scene, pilot, index=index)
            continue
        with manager as log:
            yield run_episode(env, scene, pilot, log, {**(context or {}), "episode": index}, index)


_environments: dict[tuple[str, ...], Environment] = {}


def _environment(robot: Robot, navigation: Navigation, room: int) -> Environment:
    """Return this process' environment with room for so many obstacles, built once."""
    key = (*robot.identity, repr(navigation), str(room))
    if key not in _environments:
        _environments.clear()

        def sampler(random: np.random.RandomState) -> Scene:
            raise AssertionError("an evaluation sets every scene itself")

        _environments[key] = robot_environment(robot, navigation, sampler, max_obstacles=room)
    return _environments[key]


def _reason(outcome: Outcome, cycles: int, distance: float) -> str:
    """Return how an episode ended, for people."""
    what = {
        Outcome.SUCCESS: "reached the target",
        Outcome.COLLISION: "touched an obstacle",
        Outcome.FALL: "fell",
        Outcome.TIMEOUT: "ran out of time",
    }[outcome]
    return f"{what} after {cycles} cycles, {distance:.2f} m from its centre"
