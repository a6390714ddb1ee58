"""How a gait fares when its tasks are switched at random: the measure gaits are judged by."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from defplan_mj.dynamics.reduced import ReducedDynamics
from defplan_mj.gait.gait import Gait

MAX_TILT = np.radians(30.0)


@dataclass(frozen=True)
class Switching:
    """Random switching of a gait's tasks, cycle by cycle.

    Attributes:
        task_names: (K,) names.
        task: (cycles,) task of each cycle.
        advance: (cycles,) displacement along the heading at the cycle's start, m.
        drift: (cycles,) displacement to the left of it, m.
        rise: (cycles,) vertical displacement, m.
        yaw: (cycles,) change of heading, rad.
        tilt: (cycles,) largest tilt of the body's z axis within the cycle, rad.
        settle: cycles from rest that the statistics leave out.
    """

    task_names: tuple[str, ...]
    task: np.ndarray
    advance: np.ndarray
    drift: np.ndarray
    rise: np.ndarray
    yaw: np.ndarray
    tilt: np.ndarray
    settle: int = 2

    @property
    def falls(self) -> int:
        """Cycles that tilt past 30 degrees or do not go forward."""
        lost = (self.advance <= 0) & (np.arange(len(self.task)) >= self.settle)
        return int(((self.tilt > MAX_TILT) | lost).sum())

    def tasks(self) -> list[dict]:
        """Return name, advance_m, advance_sd, yaw_rad, yaw_sd, drift_m of each task."""
        rows = []
        counted = np.arange(len(self.task)) >= self.settle
        for j, name in enumerate(self.task_names):
            of_task = (self.task == j) & counted
            advance, yaw, drift = self.advance[of_task], self.yaw[of_task], self.drift[of_task]
            if not of_task.any():
                advance = yaw = drift = np.array([np.nan])
            rows.append(
                {
                    "name": name,
                    "advance_m": float(advance.mean()),
                    "advance_sd": float(advance.std()),
                    "yaw_rad": float(yaw.mean()),
                    "yaw_sd": float(yaw.std()),
                    "drift_m": float(drift.mean()),
                    "rise_m": float(self.rise[of_task].mean()) if of_task.any() else float("nan"),
                }
            )
        return rows

    def to_json(self) -> dict:
        """Return what `defplan run --json` shows of it."""
        return {
            "tasks": self.tasks(),
            "switching": {
                "cycles": len(self.task),
                "falls": self.falls,
                "max_tilt_deg": float(np.degrees(self.tilt.max())),
            },
        }


def heading(x: np.ndarray) -> np.ndarray:
    """Return the yaw (...,) of states or qpos (..., >= 7): direction of the body's x axis, rad."""
    w, a, b, c = np.moveaxis(np.asarray(x)[..., 3:7], -1, 0)
    return np.arctan2(2 * (a * b + w * c), 1 - 2 * (b * b + c * c))


def tilt(x: np.ndarray) -> np.ndarray:
    """Return the angle (...,) between the body's z axis and the vertical, rad."""
    a, b = np.asarray(x)[..., 4], np.asarray(x)[..., 5]
    return np.arccos(np.clip(1 - 2 * (a * a + b * b), -1, 1))


def wrap(angle: np.ndarray) -> np.ndarray:
    """Return angles in [-pi, pi), rad."""
    return (angle + np.pi) % (2 * np.pi) - np.pi


def evaluate_switching(
    dynamics: ReducedDynamics, gait: Gait, cycles: int = 200, seed: int = 0
) -> Switching:
    """Roll out `cycles` cycles from rest, the task of each drawn at random."""
    task = np.random.default_rng(seed).integers(0, len(gait.task_names), cycles)
    return measure_cycles(dynamics, gait, task)


def measure_cycles(dynamics: ReducedDynamics, gait: Gait, task: np.ndarray) -> Switching:
    """Roll out the cycles of a given task sequence (cycles,) from rest."""
    n = gait.steps_per_cycle
    shapes = gait.table()[task].reshape(len(task) * n, -1)
    x = dynamics.rollout(dynamics.rest_state(), shapes)
    start, end = x[:-1:n], x[n::n]
    yaw, move = heading(start), end[:, :2] - start[:, :2]
    return Switching(
        task_names=gait.task_names,
        task=task,
        advance=np.cos(yaw) * move[:, 0] + np.sin(yaw) * move[:, 1],
        drift=-np.sin(yaw) * move[:, 0] + np.cos(yaw) * move[:, 1],
        rise=end[:, 2] - start[:, 2],
        yaw=wrap(heading(end) - yaw),
        tilt=tilt(x[1:]).reshape(-1, n).max(1),
    )
