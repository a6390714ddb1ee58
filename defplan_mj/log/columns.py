"""The columns of the tables that logs are read into: what each is called, what it is, how it is made of a log.

Nothing here needs the task, its plugin or MuJoCo: a log holds all that its tables are made of.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from defplan_mj.base import rotations
from defplan_mj.base.space import PLANE, SPACE, SPACES
from defplan_mj.log import channels
from defplan_mj.log.compare import TURNING, into_frame
from defplan_mj.log.reader import EpisodeLog


@dataclass(frozen=True)
class Field:
    """A column of a table, or a family of columns.

    Attributes:
        name: of the column, with its unit at the end unless it has none; a '*' stands for what tells the
            columns of a family apart.
        what: it is.
        values: log -> (n,) one for each row, or (n, k) for a family of k columns.
        members: log -> k names, what the '*' stands for.
    """

    name: str
    what: str
    values: Callable[[EpisodeLog], Any]
    members: Callable[[EpisodeLog], Sequence[str]] | None = None

    def columns(self, log: EpisodeLog) -> dict[str, np.ndarray]:
        """Return this field's columns of a log."""
        values = np.asarray(self.values(log))
        if self.members is None:
            return {self.name: values}
        names = [self.name.replace("*", member) for member in self.members(log)]
        if values.shape[1:] != (len(names),):  # filtered out
            return {}
        return dict(zip(names, values.T, strict=True))


def _count(log: EpisodeLog) -> int:
    return len(log.states)


def _cycle_of_state(log: EpisodeLog) -> np.ndarray:
    """Return the whole cycle (row) that each state belongs to, the last one's end included; -1: none."""
    ends = log.cycle_steps
    at = np.searchsorted(ends, np.arange(_count(log)), side="right") - 1
    at[(at == len(ends) - 1) & (np.arange(_count(log)) == ends[-1])] -= 1
    return np.where((at >= 0) & (at < len(ends) - 1), at, -1)


def _phase(log: EpisodeLog) -> np.ndarray:
    cycle = _cycle_of_state(log)
    if not len(log.gait_index):
        return np.full(_count(log), np.nan)
    start, length = log.cycle_steps[cycle], np.diff(log.cycle_steps)[cycle]
    m = log.decisions_per_cycle
    phase = ((cycle + log.first_cycle) % m + (np.arange(_count(log)) - start) / length) / m
    return np.where(cycle < 0, np.nan, phase)


def _gait_names(log: EpisodeLog, index: np.ndarray) -> np.ndarray:
    names = log.task_names
    known = [names[j] if j < len(names) else f"gait {j}" for j in index]
    return np.array(known, dtype=object)


def _gait_of_state(log: EpisodeLog) -> np.ndarray:
    cycle, names = _cycle_of_state(log), _gait_names(log, log.gait_index)
    return np.array([names[c] if c >= 0 else "" for c in cycle], dtype=object)


def _after(values: np.ndarray) -> np.ndarray:
    """Return numbers of the steps (n,) as ones of the states (n + 1,): the start has none."""
    return np.append(np.nan, values)


def _heading(log: EpisodeLog) -> np.ndarray:
    if log.space != PLANE.name:
        return np.full(_count(log), np.nan)
    return rotations.heading(rotations.matrix(log.states[:, 3:7]))


def _target_distance(log: EpisodeLog) -> np.ndarray:
    d = SPACES[log.space].dimension
    return np.linalg.norm(log.states[:, :d] - log.scene.target[:d], axis=1)


def _part(start: Callable[[int], int], stop: Callable[[int], int]) -> Callable[[EpisodeLog], Any]:
    """Return log -> a part of the states, whose bounds depend on the number of modes."""

    def values(log: EpisodeLog) -> np.ndarray:
        r = log.target_shapes.shape[1]
        return log.states[:, start(r) : stop(r)]

    return values


def _modes(log: EpisodeLog) -> list[str]:
    return [str(i + 1) for i in range(log.target_shapes.shape[1])]


def _state(column: int) -> Callable[[EpisodeLog], np.ndarray]:
    return lambda log: log.states[:, column]


def _velocity(column: int) -> Callable[[EpisodeLog], np.ndarray]:
    return lambda log: log.states[:, 7 + log.target_shapes.shape[1] + column]


STEPS: list[Field] = [
    Field("log", "the file", lambda log: [str(log.path)] * _count(log)),
    Field(
        "step",
        "physics step that led here; 0: the start",
        lambda log: log.first + np.arange(_count(log)),
    ),
    Field("time_s", "simulated time", lambda log: log.time),
    Field(
        "cycle",
        "gait cycle, from 0; -1: in no whole cycle",
        lambda log: np.where(_cycle_of_state(log) < 0, -1, _cycle_of_state(log) + log.first_cycle),
    ),
    Field("gait", "its name; empty: in no whole cycle", _gait_of_state),
    Field("phase", "of the cycle, 0 to 1", _phase),
    Field("x_m", "centre of mass in the world", _state(0)),
    Field("y_m", "centre of mass in the world", _state(1)),
    Field("z_m", "centre of mass in the world, up", _state(2)),
    Field("qw", "attitude, a unit quaternion", _state(3)),
    Field("qx", "attitude", _state(4)),
    Field("qy", "attitude", _state(5)),
    Field("qz", "attitude", _state(6)),
    Field("heading_rad", "of planar tasks: of the body's x axis, from +x to +y", _heading),
    Field("vx_m_per_s", "velocity in the world", _velocity(0)),
    Field("vy_m_per_s", "velocity in the world", _velocity(1)),
    Field("vz_m_per_s", "velocity in the world", _velocity(2)),
    Field("wx_rad_per_s", "angular velocity in the body frame", _velocity(3)),
    Field("wy_rad_per_s", "angular velocity in the body frame", _velocity(4)),
    Field("wz_rad_per_s", "angular velocity in the body frame", _velocity(5)),
    Field("target_distance_m", "from the centre of mass to the target", _target_distance),
    Field(
        "clearance_m",
        "from the body to the nearest obstacle, negative in contact; 1 if none is nearer",
        lambda log: _after(log.clearance),
    ),
    Field("collision", "whether it touches an obstacle", lambda log: _after(log.clearance) < 0),
    Field("q*", "modal coordinates of the shape", _part(lambda r: 7, lambda r: 7 + r), _modes),
    Field("dq*_per_s", "their rates", _part(lambda r: 13 + r, lambda r: 13 + 2 * r), _modes),
    Field(
        "u*",
        "target shape of the step that led here",
        _part(lambda r: 13 + 2 * r, lambda r: 13 + 3 * r),
        _modes,
    ),
]
"""Of the table `steps`: a row for each state, the start's first."""


def _poses(log: EpisodeLog) -> tuple[np.ndarray, np.ndarray]:
    """Return the poses (m, 7) at the starts and ends of the cycles."""
    poses = log.states[log.cycle_steps][:, :7]
    return poses[:-1], poses[1:]


def _move(log: EpisodeLog, ends: np.ndarray) -> np.ndarray:
    """Return the displacements (m, 3) from the cycles' starts to some places, in the starts' frames."""
    start, _ = _poses(log)
    frame = SPACES[log.space].frame(rotations.matrix(start[:, 3:]))
    return into_frame(ends[:, :3] - start[:, :3], frame)


def _done(axis: int) -> Callable[[EpisodeLog], np.ndarray]:
    return lambda log: _move(log, _poses(log)[1])[:, axis]


def _predicted(axis: int) -> Callable[[EpisodeLog], np.ndarray]:
    return lambda log: _move(log, log.surrogate_pose)[:, axis]


def _turn(log: EpisodeLog, true: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Return how far attitudes are turned from others; NaN where one is not known."""
    turn = np.full(len(true), np.nan)
    known = np.isfinite(other).all(1)
    if known.any():
        matrices = rotations.matrix(true[known, 3:]), rotations.matrix(other[known, 3:])
        turn[known] = TURNING[log.space].error(*matrices)
    return turn


def _clearest(log: EpisodeLog) -> list[float]:
    return [
        log.clearance[a:b].min() for a, b in zip(log.cycle_steps, log.cycle_steps[1:], strict=False)
    ]


def _has_laser(log: EpisodeLog) -> bool:
    """Whether the readings are beams; a log of a task that names no sensor has the laser of its space."""
    name = (log.configuration.get("navigation") or {}).get("sensor", "")
    return channels.RANGES not in log.missing and name in ("", PLANE.sensor, SPACE.sensor)


def _gait_members(log: EpisodeLog) -> list[str]:
    return [str(name) for name in _gait_names(log, np.arange(log.values.shape[1]))]


def _m(log: EpisodeLog) -> int:
    return len(log.gait_index)


CYCLES: list[Field] = [
    Field("log", "the file", lambda log: [str(log.path)] * _m(log)),
    Field("cycle", "from 0", lambda log: log.first_cycle + np.arange(_m(log))),
    Field("gait", "that was done", lambda log: _gait_names(log, log.gait_index)),
    Field("gait_index", "its number", lambda log: log.gait_index),
    Field(
        "start_step",
        "physics step at which it starts",
        lambda log: log.first + log.cycle_steps[:-1],
    ),
    Field("start_s", "simulated time", lambda log: log.time[log.cycle_steps[:-1]]),
    Field("duration_s", "how long it took", lambda log: np.diff(log.time[log.cycle_steps])),
    Field("reward_m2", "Eq. 2 of the paper", lambda log: log.reward),
    Field("ahead_m", "displacement along x of the frame at its start", _done(0)),
    Field("left_m", "displacement along y of that frame", _done(1)),
    Field("up_m", "displacement along z of that frame", _done(2)),
    Field(
        "turn_rad",
        "planar: change of heading, to the left; spatial: angle of the rotation",
        lambda log: _turn(log, _poses(log)[1], _poses(log)[0]),
    ),
    Field("predicted_ahead_m", "the surrogate's displacement", _predicted(0)),
    Field("predicted_left_m", "the surrogate's displacement", _predicted(1)),
    Field("predicted_up_m", "the surrogate's displacement", _predicted(2)),
    Field(
        "position_error_m",
        "distance of the truth from the prediction",
        lambda log: np.linalg.norm(_poses(log)[1][:, :3] - log.surrogate_pose[:, :3], axis=1),
    ),
    Field(
        "turn_error_rad",
        "truth minus prediction, as `turn_rad`",
        lambda log: _turn(log, _poses(log)[1], log.surrogate_pose),
    ),
    Field(
        "target_distance_m",
        "at its start, from the centre of mass to the target",
        lambda log: _target_distance(log)[log.cycle_steps[:-1]],
    ),
    Field("clearance_min_m", "smallest clearance in it", _clearest),
    Field(
        "value_*",
        "the planner's value of the gait of that name",
        lambda log: log.values,
        _gait_members,
    ),
    Field(
        "laser_*_m",
        "lengths of the laser's beams at its start; the first points ahead, the next to its left",
        lambda log: log.laser[:, : None if _has_laser(log) else 0],
        lambda log: [f"{k:02d}" for k in range(log.laser.shape[1] if _has_laser(log) else 0)],
    ),
    Field(
        "reading_*",
        "what another sensor measures at its start",
        lambda log: log.laser[:, : 0 if _has_laser(log) else None],
        lambda log: [f"{k:02d}" for k in range(0 if _has_laser(log) else log.laser.shape[1])],
    ),
]
"""Of the table `cycles`: a row for each whole gait cycle."""


def _told(name: str) -> Callable[[EpisodeLog], list[Any]]:
    """Return log -> what its configuration says under a name, as text; '' if nothing."""
    return lambda log: [str(log.configuration.get(name, ""))]


def _way(log: EpisodeLog) -> list[float]:
    return [np.linalg.norm(np.diff(log.states[:, :3], axis=0), axis=1).sum()]


EPISODES: list[Field] = [
    Field("log", "the file", lambda log: [str(log.path)]),
    Field("task", "that was run", lambda log: [log.task]),
    Field("seed", "of the run", lambda log: [log.seed]),
    Field("episode", "number of the scene", _told("episode")),
    Field("planner", "that steered", _told("planner")),
    Field("shield", "whether its choice was checked for collisions", _told("shield")),
    Field("feedback", "that played the gaits", _told("feedback")),
    Field("space", "planar or spatial", lambda log: [log.space]),
    Field(
        "outcome",
        "success, collision, fall or timeout; empty: not in the log",
        lambda log: [log.outcome],
    ),
    Field("reason", "of the outcome, for people", lambda log: [log.reason]),
    Field("fault", "what is wrong with the log; empty: it is whole", lambda log: [log.fault]),
    Field("steps", "physics steps", lambda log: [len(log.target_shapes)]),
    Field("cycles", "whole gait cycles", lambda log: [len(log.gait_index)]),
    Field("duration_s", "simulated time", lambda log: [log.time[-1] - log.time[0]]),
    Field("way_m", "length of the centre of mass's path", _way),
    Field("target_distance_m", "at the start", lambda log: _target_distance(log)[:1]),
    Field("end_distance_m", "to the target, at the end", lambda log: _target_distance(log)[-1:]),
    Field(
        "clearance_min_m",
        "smallest clearance",
        lambda log: [log.clearance.min(initial=np.inf) if len(log.clearance) else np.nan],
    ),
    Field(
        "collision_steps", "physics steps in contact", lambda log: [int((log.clearance < 0).sum())]
    ),
    Field("reward_m2", "sum over the cycles", lambda log: [log.reward.sum()]),
    Field("obstacles", "their number", lambda log: [len(log.scene.radii)]),
    Field(
        "obstacle_speed_m_per_s",
        "of the fastest",
        lambda log: [np.linalg.norm(log.scene.velocities, axis=1).max(initial=0.0)],
    ),
    Field("timestep_s", "of a physics step", lambda log: [log.timestep]),
    Field("body_hash", "of the body that moved", lambda log: [log.body_hash]),
]
"""Of the table `episodes`: a row for each log."""

TABLES = {"steps": STEPS, "cycles": CYCLES, "episodes": EPISODES}


def steps_column(log: EpisodeLog, name: str) -> np.ndarray:
    """Return one column of the table `steps` of a log, a row for each state."""
    return next(field for field in STEPS if field.name == name).columns(log)[name]
