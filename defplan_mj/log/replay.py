"""Simulate a logged episode again, from the log alone, and say whether every bit is the same."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from defplan_mj.base.errors import DefplanError
from defplan_mj.base.progress import Progress, no_progress
from defplan_mj.log import channels, schemas
from defplan_mj.log.columns import steps_column
from defplan_mj.log.reader import EpisodeLog, read_log
from defplan_mj.log.recorder import versions
from defplan_mj.log.validate import check_cycles, refuse
from defplan_mj.planning.sensors.sensor import sensor_of
from defplan_mj.task import Navigation

_NUMBERS_OF = {
    channels.CONTACTS: "clearance",
    channels.RANGES: "laser",
    channels.REWARD: "reward",
}


@dataclass(frozen=True)
class Difference:
    """The first place where a replay and its log part.

    Attributes:
        simulator: 'kernel' or 'mujoco'.
        quantity: 'state', 'clearance', 'laser', 'reward' or 'length'.
        step: physics step after which it was measured (0: the start).
        label: which number of it, e.g. 'qw' or 'beam 12'.
        logged, replayed: both numbers.
    """

    simulator: str
    quantity: str
    step: int
    label: str
    logged: float
    replayed: float

    def __str__(self) -> str:
        return (
            f"{self.quantity} {self.label} differs at step {self.step} ({self.simulator}): "
            f"logged {self.logged!r}, replayed {self.replayed!r}"
        )


@dataclass(frozen=True)
class ReplayResult:
    """What a replay found.

    Attributes:
        path: the log.
        fault: what is wrong with the log itself, '' if it is whole.
        steps: physics steps replayed.
        simulators: what replayed them: the kernel's rollout, and MuJoCo in the logged scene.
        difference: the first one; None if all is the same to the bit.
        largest: largest difference of any number of any state.
        changed: what differs between the machine of the log and this one, for example
            'numpy 2.4.5 -> 2.4.6'.
    """

    path: Path
    fault: str
    steps: int
    simulators: tuple[str, ...]
    difference: Difference | None
    largest: float
    changed: tuple[str, ...]

    @property
    def identical(self) -> bool:
        """Whether log and replay agree to the bit."""
        return self.difference is None

    def sentence(self) -> str:
        """Return the result as one sentence."""
        with_what = " and ".join(self.simulators)
        start = f"{self.path}{f' ({self.fault})' if self.fault else ''}: "
        if self.difference is None:
            return start + f"{self.steps} steps replayed by {with_what}, identical to the bit"
        since = f"; since the log: {', '.join(self.changed)}" if self.changed else ""
        return start + f"{self.difference}; largest difference of a state {self.largest:.3g}{since}"

    def to_json(self) -> dict[str, Any]:
        """Return the result as plain data."""
        return {
            "log": str(self.path),
            "whole": not self.fault,
            "fault": self.fault,
            "steps": self.steps,
            "simulators": list(self.simulators),
            "identical": self.identical,
            "difference": None if self.difference is None else _finite(vars(self.difference)),
            "largest": self.largest if np.isfinite(self.largest) else None,
            "changed": list(self.changed),
        }


def replay_log(path: str | Path | EpisodeLog, progress: Progress = no_progress) -> ReplayResult:
    """Simulate a log again and compare every state to the bit.

    The kernel repeats the logged target shapes from the logged start. If the log holds its gait,
    MuJoCo also repeats the episode in the logged scene from the chosen gaits alone (from the logged
    target shapes, if there was feedback), and distances to obstacles, laser scans and rewards are
    compared as well.

    Raises:
        DefplanError: the log cannot be read, or holds no body.
    """
    from defplan_mj.dynamics.reduced import ReducedDynamics

    log = path if isinstance(path, EpisodeLog) else read_log(path)
    if channels.TARGET_SHAPE in log.missing:
        raise DefplanError(f"log {log.path} is {log.fault}: there is nothing to replay it from")
    if not len(log.target_shapes):
        fault = f" ({log.fault})" if log.fault else ""
        raise DefplanError(f"log {log.path} holds no step to replay{fault}: record it anew")
    if log.body.n_modes != log.target_shapes.shape[1]:
        refuse(log, "body.npz", f"has {log.body.n_modes} modes, not those of the log")
    if "gait.npz" in log.attachments:
        check_cycles(log, log.gait)
    progress("replay in the kernel", 0.0)
    with _named(log):
        dynamics = ReducedDynamics(log.body, log.timestep, log.terrain, **log.stepping)
    states, _ = dynamics.rollout_count(log.states[0], log.target_shapes)
    largest = _largest(log.states, states)
    simulators = ["kernel"]
    difference = _first("kernel", "state", log.states, states, _state_labels(log))
    whole_start = log.first == 0  # MuJoCo starts where the episode did
    if difference is None and whole_start and "gait.npz" in log.attachments and len(log.gait_index):
        simulators.append("mujoco")
        with _named(log):
            replayed = _in_mujoco(log, progress)
            difference = _compare_episode(log, replayed)
        n = len(replayed["state"])
        largest = max(largest, _largest(log.states[:n], replayed["state"]))
    progress("replay done", 1.0)
    return ReplayResult(
        path=log.path,
        fault=log.fault,
        steps=len(log.target_shapes),
        simulators=tuple(simulators),
        difference=difference,
        largest=largest,
        changed=tuple(_changed(log)),
    )


@contextlib.contextmanager
def _named(log: EpisodeLog) -> Iterator[None]:
    """Say of which log an error is."""
    try:
        yield
    except DefplanError as error:
        if str(log.path) in str(error):
            raise
        raise DefplanError(f"log {log.path} cannot be replayed: {error}") from error


def _in_mujoco(log: EpisodeLog, progress: Progress) -> dict[str, np.ndarray]:
    """Run the episode again in the navigation environment; return what it measures."""
    from defplan_mj.feedback import Recorded
    from defplan_mj.host.navigation import navigation_environment
    from defplan_mj.host.physics import Physics

    open_loop = log.configuration.get("feedback", "none") == "none"
    env = navigation_environment(
        log.body,
        log.gait,
        _navigation(log),
        lambda random: log.scene,
        terrain=log.terrain,
        scene=log.scene,
        feedback=None if open_loop else Recorded(log.target_shapes),
    )
    states: list[np.ndarray] = []
    clearances: list[float] = []

    def keep(physics: Physics, target_shape: np.ndarray) -> None:
        states.append(physics.reduced_state())
        clearances.append(physics.clearance())

    env.task.step_hook = keep
    timestep = env.reset()
    states.append(env.physics.reduced_state())
    lasers, rewards = [], []
    for number, gait in enumerate(log.gait_index):
        progress("replay in MuJoCo", number / len(log.gait_index))
        if timestep.last():
            break
        lasers.append(timestep.observation["laser"].copy())
        timestep = env.step(int(gait))
        rewards.append(timestep.reward)
    env.close()
    return {
        "state": np.array(states),
        "clearance": np.array(clearances),
        "laser": np.array(lasers),
        "reward": np.array(rewards, float),
    }


def _compare_episode(log: EpisodeLog, replayed: dict[str, np.ndarray]) -> Difference | None:
    """Return the earliest difference between a log and its episode in MuJoCo."""
    ends = log.cycle_steps
    logged = {
        # a cycle that a cut has taken the end of is not replayed by MuJoCo
        "state": log.states[: ends[-1] + 1],
        "clearance": log.clearance[: ends[-1]],
        "laser": log.laser,
        "reward": log.reward,
    }
    steps = {
        "state": np.arange(ends[-1] + 1),
        "clearance": np.arange(1, ends[-1] + 1),
        "laser": ends[:-1],
        "reward": ends[1:],
    }
    labels = {
        "state": _state_labels(log),
        "laser": _reading_labels(log),
    }
    missing = {_NUMBERS_OF[topic] for topic in log.missing if topic in _NUMBERS_OF}
    differences = [
        _first("mujoco", name, logged[name], replayed[name], labels.get(name, [""]), steps[name])
        for name in logged
        if name not in missing
    ]
    return min((d for d in differences if d is not None), key=lambda d: d.step, default=None)


def _first(
    simulator: str,
    quantity: str,
    logged: np.ndarray,
    replayed: np.ndarray,
    labels: list[str],
    steps: np.ndarray | None = None,
) -> Difference | None:
    """Return the first number whose bits differ, row by row."""
    n = min(len(logged), len(replayed))
    old, new = logged[:n].reshape(n, -1), replayed[:n].reshape(n, -1)
    at = np.arange(n) if steps is None else steps
    rows, columns = np.nonzero(_bits(old) != _bits(new))
    if len(rows):
        i, j = rows[0], columns[0]
        return Difference(
            simulator, quantity, int(at[i]), labels[j], float(old[i, j]), float(new[i, j])
        )
    if len(logged) != len(replayed):
        counts = float(len(logged)), float(len(replayed))
        return Difference(
            simulator, "length", int(at[n - 1]) if n else 0, f"of {quantity}", *counts
        )
    return None


def _bits(values: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(values, np.float64).view(np.uint64)


def _largest(logged: np.ndarray, replayed: np.ndarray) -> float:
    n = min(len(logged), len(replayed))
    return float(np.abs(logged[:n] - replayed[:n]).max(initial=0.0))


def _state_labels(log: EpisodeLog) -> list[str]:
    return schemas.state_labels(log.target_shapes.shape[1])


def _reading_labels(log: EpisodeLog) -> list[str]:
    there = _navigation(log)
    return sensor_of(there).labels(there)


def _navigation(log: EpisodeLog) -> Navigation:
    """Return what a log says of the navigation problem, as far as the robot senses it."""
    navigation: dict[str, Any] = log.configuration.get("navigation") or {}
    return Navigation(
        beams=int(navigation.get("beams") or log.laser.shape[1] or Navigation().beams),
        laser_range=float(navigation.get("laser_range", Navigation().laser_range)),
        space=log.space,
        sensor=navigation.get("sensor", ""),
        decisions_per_cycle=log.decisions_per_cycle,
    )


def _changed(log: EpisodeLog) -> Iterator[str]:
    """Yield what a replay here does not share with the run of the log."""
    here = versions()
    for name, version in log.versions.items():
        if here.get(name, "none") != version:
            yield f"{name} {version} -> {here.get(name, 'none')}"


def _finite(values: dict[str, Any]) -> dict[str, Any]:
    """Make numbers that JSON cannot hold into text."""
    return {
        k: str(v) if isinstance(v, float) and not np.isfinite(v) else v for k, v in values.items()
    }


def write_video(
    log: str | Path | EpisodeLog,
    video: str | Path,
    size: tuple[int, int] | None = None,
    fps: float = 25.0,
    camera: str = "chase",
    progress: Progress = no_progress,
    seconds: tuple[float, float] = (0.0, np.inf),
) -> None:
    """Draw a log's states in their scene as a video (.mp4, .gif), or the last one (.png).

    Gait, time and distance to the target are written into it.

    Args:
        size: width, height in pixels; None: see `host.render.render_states`.
        fps: frames a second.
        seconds: the part of the log that is drawn, from and to, s.

    Raises:
        DefplanError: the log cannot be read, or the video cannot be drawn or written.
    """
    from defplan_mj.host.render import render_states
    from defplan_mj.host.skin import texture_of

    log = log if isinstance(log, EpisodeLog) else read_log(log)
    since, until = np.searchsorted(log.time - log.time[0], [seconds[0], seconds[1]])
    part = slice(int(since), max(int(until), int(since) + 1))
    if part.start >= len(log.states):
        raise DefplanError(f"log {log.path} ends before {seconds[0]:g} s")
    gait, distance = steps_column(log, "gait"), steps_column(log, "target_distance_m")

    def caption(index: int) -> tuple[str, str]:
        at = part.start + index
        values = (gait[at] or "-", f"{log.time[at]:.1f} s", f"{distance[at]:.1f} m")
        return "gait\ntime\nto target", "\n".join(values)

    shift = log.time[part.start] * log.scene.velocities  # a film begins at time 0
    render_states(
        log.body,
        log.states[part],
        dataclasses.replace(log.scene, centres=log.scene.centres + shift),
        video,
        size,
        fps,
        camera,
        timestep=log.timestep,
        terrain=log.terrain,
        texture=texture_of(log.task),
        caption=caption,
        progress=progress,
    )
