"""How well the rigid surrogate predicts each gait cycle of logged episodes, from the logs alone."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from defplan_mj.base import rotations
from defplan_mj.base.errors import DefplanError
from defplan_mj.base.space import PLANE, SPACE, SPACES
from defplan_mj.dynamics.rigid import RigidDynamics
from defplan_mj.log.reader import EpisodeLog, read_log

FARTHEST_CLEARANCE = 1.0  # m; where the host's distance query (CUTOFF in host/plugin.c) saturates

SETTLING = 3
"""Cycles in which a body that starts at rest gets up to speed; the surrogate knows the first and full speed."""


def _heading_error(true: np.ndarray, predicted: np.ndarray) -> np.ndarray:
    """Return true minus predicted heading (m,) of rotations (m, 3, 3), in (-pi, pi], rad."""
    return np.pi - (np.pi - (rotations.heading(true) - rotations.heading(predicted))) % (2 * np.pi)


def _rotation_error(true: np.ndarray, predicted: np.ndarray) -> np.ndarray:
    """Return the angles (m,) between true and predicted rotations (m, 3, 3), rad."""
    return rotations.angle(np.swapaxes(predicted, 1, 2) @ true)


@dataclass(frozen=True)
class Turning:
    """What an error of attitude is in a space.

    Attributes:
        name: what it is called.
        signed: whether left is positive, else it is a size.
        error: true and predicted rotations (m, 3, 3) -> (m,) rad.
    """

    name: str
    signed: bool
    error: Callable[[np.ndarray, np.ndarray], np.ndarray]


TURNING = {
    PLANE.name: Turning("heading", True, _heading_error),
    SPACE.name: Turning("rotation", False, _rotation_error),
}
"""By the name of the space."""


@dataclass(frozen=True)
class LoggedEpisode:
    """One log of a comparison.

    Attributes:
        path: the log.
        fault: what is wrong with it, '' if it is whole.
        outcome: of the episode, '' if the log does not hold it.
        reward: sum over its cycles.
        clearance: smallest one, m; NaN without a step.
        collisions: physics steps in contact.
        truth, chained: (m + 1, 7) poses at the ends of the compared cycles: the true ones, and
            those the surrogate gives when it starts with the first and never sees the truth again.
        space: 'planar' or 'spatial'.
    """

    path: Path
    fault: str
    outcome: str
    reward: float
    clearance: float
    collisions: int
    truth: np.ndarray
    chained: np.ndarray
    space: str = PLANE.name

    @property
    def drift(self) -> float:
        """Distance between true and chained position after the last cycle, m."""
        return float(np.linalg.norm(self.truth[-1, :3] - self.chained[-1, :3]))

    @property
    def turning_drift(self) -> float:
        """True from chained attitude after the last cycle, rad; see `Comparison.turning`."""
        return float(_turning(self.truth[-1:], self.chained[-1:], self.space)[0])

    @property
    def travelled(self) -> float:
        """Length of the true path from cycle to cycle, m."""
        return float(np.linalg.norm(np.diff(self.truth[:, :3], axis=0), axis=1).sum())


@dataclass(frozen=True)
class Comparison:
    """Surrogate against reduced dynamics, cycle by cycle; every cycle starts at its true state.

    Attributes:
        task_names: (K,) gaits.
        episodes: the logs.
        log: (n,) index of each cycle's log.
        gait: (n,) index of its gait.
        cycle: (n,) number of the cycle in its episode, from 0.
        start: (n,) time it began, s.
        predicted, truth: (n, 3) displacement of the centre of mass over the cycle, m: of a planar
            task in the body's yaw frame at its start (forward, left, up), of a spatial one in its
            body frame there.
        turning: (n,) what is wrong with the attitude at its end, rad: of a planar task true minus
            predicted heading, in (-pi, pi], of a spatial one the angle of the rotation between
            prediction and truth, about whatever axis, in [0, pi].
        space: 'planar' or 'spatial'.
    """

    task_names: tuple[str, ...]
    episodes: tuple[LoggedEpisode, ...]
    log: np.ndarray
    gait: np.ndarray
    cycle: np.ndarray
    start: np.ndarray
    predicted: np.ndarray
    truth: np.ndarray
    turning: np.ndarray
    space: str = PLANE.name

    @property
    def turning_name(self) -> str:
        """What an error of attitude is called: 'heading' or 'rotation'."""
        return TURNING[self.space].name

    @property
    def position(self) -> np.ndarray:
        """(n,) distance between true and predicted position at the end of each cycle, m."""
        return np.linalg.norm(self.truth - self.predicted, axis=1)

    @property
    def settled(self) -> np.ndarray:
        """(n,) whether a cycle is not one of its episode's first, which start from rest."""
        return self.cycle >= SETTLING

    def summary(self, name: str, some: np.ndarray) -> dict[str, Any]:
        """Return the figures of some cycles, `some` being (n,) of bool.

        'position' and 'heading' or 'rotation': mean, sd (n - 1) and p95; heading's mean is signed
        (left is positive) and its p95 is of the absolute value; 'spread': root mean square distance of the
        true displacements from their gait's mean, that is, what no rigid surrogate could predict.
        """
        parts = [self.truth[some & (self.gait == k)] for k in np.unique(self.gait[some])]
        about = np.vstack([part - part.mean(0) for part in parts]) if parts else np.zeros((0, 3))
        return {
            "name": name,
            "cycles": int(some.sum()),
            "position": _figures(self.position[some], self.position[some]),
            self.turning_name: _figures(self.turning[some], np.abs(self.turning[some])),
            "spread": float(np.sqrt((about**2).sum(1).mean())) if len(about) else None,
        }

    def summaries(self) -> list[dict[str, Any]]:
        """Return `summary` of each gait that was used, of all cycles, and of all settled ones."""
        everything = np.ones(len(self.gait), bool)
        return [
            *(self.summary(self.task_names[k], self.gait == k) for k in gaits_used(self)),
            self.summary("all", everything),
            self.summary(f"all but each first {SETTLING}", self.settled),
        ]

    @property
    def columns(self) -> tuple[str, ...]:
        """Heads of the columns of `table`."""
        errors = (f"{name} mean ({unit})" for name, unit in
                  (("position", "m"), (self.turning_name, "rad")))  # fmt: skip
        return ("gait", "cycles", *(c for e in errors for c in (e, "sd", "p95")), "spread (m)")

    def table(self) -> list[list[str]]:
        """Return rows of text, for `columns`."""
        signed = TURNING[self.space].signed
        return [
            [
                row["name"],
                str(row["cycles"]),
                *(_text(row["position"][key]) for key in ("mean", "sd", "p95")),
                *(
                    _text(row[self.turning_name][key], signed and key == "mean")
                    for key in ("mean", "sd", "p95")
                ),
                _text(row["spread"]),
            ]
            for row in self.summaries()
        ]

    def drift_rows(self) -> list[list[str]]:
        """Return rows of text, one a log: what happened, and where chained predictions end up."""
        return [
            [
                episode.path.name,
                episode.outcome or episode.fault,
                str(len(episode.truth) - 1),
                _text(episode.travelled),
                _text(episode.drift),
                _text(episode.turning_drift, TURNING[self.space].signed),
                clearance_text(episode.clearance),
                _text(episode.reward),
            ]
            for episode in self.episodes
        ]

    def to_json(self) -> dict[str, Any]:
        """Return all figures as plain data (m, rad)."""
        return {
            "space": self.space,
            "gaits": self.summaries(),
            "logs": [
                {
                    "log": str(episode.path),
                    "whole": not episode.fault,
                    "fault": episode.fault,
                    "outcome": episode.outcome,
                    "cycles": len(episode.truth) - 1,
                    "travelled": episode.travelled,
                    "drift": {
                        "position": episode.drift,
                        self.turning_name: episode.turning_drift,
                    },
                    "reward": episode.reward,
                    "clearance": _number(episode.clearance),
                    "collisions": episode.collisions,
                }
                for episode in self.episodes
            ],
        }

    def plot(self, path: str | Path) -> None:
        """Write the comparison's figure to `path` (PNG, SVG or PDF), atomically."""
        from defplan_mj.log.compare_plot import comparison_figure
        from defplan_mj.log.plotting import save_figure

        save_figure(comparison_figure(self), path)


DRIFT_COLUMNS = (
    "log",
    "outcome",
    "cycles",
    "travelled (m)",
    "drift (m)",
    "drift (rad)",
    "clearance (m)",
    "reward",
)


def compare_logs(paths: Iterable[str | Path | EpisodeLog]) -> Comparison:
    """Compare surrogate and reduced dynamics over all whole gait cycles of some logs.

    A cycle that the episode's end cut short is left out: the surrogate knows whole cycles only.

    Raises:
        DefplanError: a log cannot be read, holds no prediction, none has a whole cycle, or some are
            of a planar and some of a spatial task.
    """
    logs = [p if isinstance(p, EpisodeLog) else read_log(p) for p in paths]
    spaces = {log.space: log.path for log in logs}
    if len(spaces) > 1:
        raise DefplanError(
            f"{spaces[PLANE.name]} is of a planar task, {spaces[SPACE.name]} of a spatial one:"
            " compare them one after the other"
        )
    names = list(dict.fromkeys(name for log in logs for name in log.task_names))
    episodes, parts = [], []
    for number, log in enumerate(logs):
        rows = _cycles(log)
        episodes.append(_episode(log, rows))
        gait = np.array([_name_index(log, j, names) for j in log.gait_index[rows]], int)
        parts.append(_errors(log, rows) | {"gait": gait, "log": np.full(len(rows), number)})
    if not any(len(part["gait"]) for part in parts):
        raise DefplanError(f"no whole gait cycle in {', '.join(str(log.path) for log in logs)}")
    joined = {key: np.concatenate([part[key] for part in parts]) for key in parts[0]}
    return Comparison(
        task_names=tuple(names), episodes=tuple(episodes), space=next(iter(spaces)), **joined
    )


def _name_index(log: EpisodeLog, gait: int, names: list[str]) -> int:
    """Return which of `names` a log's gait is; logs of different gaits are joined by name."""
    name = log.task_names[gait] if gait < len(log.task_names) else f"gait {gait}"
    if name not in names:
        names.append(name)
    return names.index(name)


def _cycles(log: EpisodeLog) -> np.ndarray:
    """Return the rows of a log's whole cycles."""
    lengths = np.diff(log.cycle_steps)
    if not len(lengths):
        return np.zeros(0, int)
    whole = lengths.max()
    if "gait.npz" in log.attachments:
        whole = log.gait.steps_per_cycle // log.decisions_per_cycle
    return np.flatnonzero(lengths == whole)


def _predictions(log: EpisodeLog, rows: np.ndarray) -> np.ndarray:
    """Return the (m, 7) logged predictions; those that were not logged are made of the attachment."""
    poses, surrogate = log.surrogate_pose[rows].copy(), RigidDynamics(log.surrogate)
    pasts = _pasts(log)
    for i in np.flatnonzero(~np.isfinite(poses).all(1)):
        row = int(rows[i])
        poses[i] = surrogate.step(
            log.states[log.cycle_steps[row]], int(log.gait_index[row]), int(pasts[row])
        )
    return poses


def _pasts(log: EpisodeLog) -> np.ndarray:
    """Return the past (`planning.past`) that each cycle of a log began after, (m,)."""
    history, pasts = log.surrogate.past, np.zeros(len(log.gait_index), int)
    past, phase = history.rest, log.first_cycle % history.decisions
    if phase and len(pasts):  # what came before was filtered out
        past = int(history.kept(phase)[log.gait_index[0]])
    for row, gait in enumerate(log.gait_index):
        pasts[row], past = past, int(history.then[past, gait])
    return pasts


def _errors(log: EpisodeLog, rows: np.ndarray) -> dict[str, np.ndarray]:
    """Return start time, displacements in the starts' frames, and errors of attitude of some cycles."""
    start = log.states[log.cycle_steps[rows]][:, :7]
    end = log.states[log.cycle_steps[rows + 1]][:, :7]
    predicted = _predictions(log, rows)
    frame = SPACES[log.space].frame(rotations.matrix(start[:, 3:]))
    return {
        "cycle": rows // log.decisions_per_cycle,
        "start": log.time[log.cycle_steps[rows]],
        "predicted": into_frame(predicted[:, :3] - start[:, :3], frame),
        "truth": into_frame(end[:, :3] - start[:, :3], frame),
        "turning": _turning(end, predicted, log.space),
    }


def _episode(log: EpisodeLog, rows: np.ndarray) -> LoggedEpisode:
    """Return one log's own figures; the surrogate is chained over its leading whole cycles."""
    leading = rows[rows == np.arange(len(rows))]
    truth = log.states[log.cycle_steps[: len(leading) + 1]][:, :7]
    return LoggedEpisode(
        path=log.path,
        fault=log.fault,
        outcome=log.outcome,
        reward=float(log.reward.sum()),
        clearance=float(log.clearance.min()) if len(log.clearance) else float("nan"),
        collisions=int((log.clearance < 0).sum()),
        truth=truth,
        chained=RigidDynamics(log.surrogate).rollout(truth[0], log.gait_index[leading]),
        space=log.space,
    )


def into_frame(vectors: np.ndarray, frames: np.ndarray) -> np.ndarray:
    """Return world vectors (m, 3) as seen in frames (m, 3, 3)."""
    return np.einsum("nji,nj->ni", frames, vectors)


def _turning(truth: np.ndarray, predicted: np.ndarray, space: str) -> np.ndarray:
    """Return the errors of attitude (m,) of (m, 7) poses; see `Comparison.turning`."""
    true, attitude = rotations.matrix(truth[:, 3:7]), rotations.matrix(predicted[:, 3:7])
    return TURNING[space].error(true, attitude)


def _figures(values: np.ndarray, sizes: np.ndarray) -> dict[str, float | None]:
    """Return mean and sd of `values` and the 95th percentile of `sizes`; None where undefined."""
    return {
        "mean": float(values.mean()) if len(values) else None,
        "sd": float(values.std(ddof=1)) if len(values) > 1 else None,
        "p95": float(np.percentile(sizes, 95)) if len(values) else None,
    }


def clearance_text(clearance: float) -> str:
    """Return a smallest clearance (m) for people: the query looks no farther than `FARTHEST_CLEARANCE`."""
    if not np.isfinite(clearance):
        return "-"
    return "at least 1" if clearance >= FARTHEST_CLEARANCE else _text(clearance)


def _number(value: float) -> float | None:
    return value if np.isfinite(value) else None


def _text(value: float | None, signed: bool = False) -> str:
    if value is None:
        return "-"
    return f"{value:+.3f}" if signed else f"{value:.3f}"


def gaits_used(comparison: Comparison) -> Sequence[int]:
    """Return the indices of the gaits that occur in a comparison."""
    return [int(k) for k in np.unique(comparison.gait)]
