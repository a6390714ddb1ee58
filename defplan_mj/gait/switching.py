"""How a gait fares when its tasks are switched at random: the measure gaits are judged by."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from defplan_mj.base import rotations
from defplan_mj.base.space import Space
from defplan_mj.dynamics.reduced import ReducedDynamics
from defplan_mj.dynamics.world import MAX_TILT, tilt
from defplan_mj.gait.footing import footing
from defplan_mj.gait.gait import Gait
from defplan_mj.gait.problem import GaitProblem
from defplan_mj.task import GaitTask


@dataclass(frozen=True)
class Switching:
    """Random switching of a gait's tasks, cycle by cycle.

    Attributes:
        tasks: the K tasks and what they want.
        place: the plane or space, which says how cycles are judged.
        length: of the body, m.
        task: (cycles,) task of each cycle.
        move: (cycles, 3) displacement in the frame at the cycle's start (planar: ahead, left, up), m.
        turn: (cycles, 3) rotation vector in that frame (planar: (0, 0, change of heading)), rad.
        tilt: (cycles,) planar: largest tilt of the body's z axis within the cycle, rad.
        down: (cycles,) whether a walker came down: tilted past 30 degrees or sunk below 60% of its height
            at rest. It then stands up again for the next cycle.
        footing: how a walker puts its feet, see `footing.footing`; empty of a swimmer.
        settle: cycles from rest that the statistics leave out.
    """

    tasks: tuple[GaitTask, ...]
    place: Space
    length: float
    task: np.ndarray
    move: np.ndarray
    turn: np.ndarray
    tilt: np.ndarray
    down: np.ndarray
    footing: dict[str, float] = field(default_factory=dict)
    settle: int = 2

    @property
    def counted(self) -> np.ndarray:
        """(cycles,) which cycles count: not the first ones from rest, nor one that comes down."""
        return (since_rest(self.down) >= self.settle) & ~self.down

    @property
    def advance(self) -> np.ndarray:
        """(cycles,) displacement in the task's wanted direction, m."""
        directions = np.array([task.direction for task in self.tasks])
        return (self.move * directions[self.task]).sum(1)

    @property
    def drift(self) -> np.ndarray:
        """(cycles,) length of the displacement across it, m; in the plane, of the horizontal part."""
        directions = np.array([task.direction for task in self.tasks])[self.task]
        across = self.move - self.advance[:, None] * directions
        return np.linalg.norm(across[:, : self.place.dimension], axis=1)

    @property
    def angle(self) -> np.ndarray:
        """(cycles,) rotation about the up axis in the plane, in space about the task's own, rad."""
        if self.place.level:
            return self.turn[:, 2]
        axes = np.array([task.turn_axis for task in self.tasks])
        return (self.turn * axes[self.task]).sum(1)

    @property
    def stray(self) -> np.ndarray:
        """(cycles,) length of the rest of the rotation, rad."""
        return np.sqrt(np.maximum((self.turn**2).sum(1) - self.angle**2, 0.0))

    @property
    def wrong_way(self) -> np.ndarray:
        """(cycles,) which of the counted cycles go, or turn, the wrong way."""
        goes = np.array([task.advance > 0 for task in self.tasks])[self.task]
        sign = [np.sign(task.turn[2]) for task in self.tasks]
        if not self.place.level:
            sign = [float(task.angle > 0) for task in self.tasks]
        turned = self.angle * np.array(sign)[self.task]
        turns = np.array(sign)[self.task] != 0
        return self.counted & ((goes & (self.advance <= 0)) | (turns & (turned <= 0)))

    @property
    def fell(self) -> np.ndarray:
        """(cycles,) cycles that tilt past 30 degrees or come down."""
        return (self.tilt > MAX_TILT) | self.down

    @property
    def falls(self) -> int:
        """Cycles that tilt past 30 degrees or come down, or that go or turn the wrong way."""
        return int((self.fell | self.wrong_way).sum())

    def rows(self) -> list[dict]:
        """Return a row a task: its name, and of its cycles the means and standard deviations.

        'advance_m', 'advance_sd': displacement in the wanted direction; 'drift_m': across it;
        'distance_m': all of it (in the plane: horizontal); 'rise_m': along z; 'turn_rad': rotation
        about the wanted axis (in the plane: up); 'stray_rad': the rest of the rotation. And the
        means 'advance_lengths' and 'distance_lengths' in body lengths. NaN without a cycle.
        """
        flat = self.move[:, : self.place.dimension]
        columns = {
            "advance_m": self.advance,
            "drift_m": self.drift,
            "distance_m": np.linalg.norm(flat, axis=1),
            "rise_m": self.move[:, 2],
            "turn_rad": self.angle,
            "stray_rad": self.stray,
        }
        rows = []
        for j, task in enumerate(self.tasks):
            chosen = (self.task == j) & self.counted
            row: dict = {"name": task.name}
            for name, values in columns.items():
                of_task = values[chosen] if chosen.any() else np.array([np.nan])
                row[name] = float(of_task.mean())
                row[name.rsplit("_", 1)[0] + "_sd"] = float(of_task.std())
            for name in ("advance", "distance"):
                row[f"{name}_lengths"] = row[f"{name}_m"] / self.length
            rows.append(row)
        return rows

    def to_json(self) -> dict:
        """Return what `defplan run --json` shows of it."""
        return {
            "tasks": self.rows(),
            "switching": {
                "cycles": len(self.task),
                "falls": self.falls,
                "max_tilt_deg": float(np.degrees(self.tilt.max())),
            },
            **({"footing": self.footing} if self.footing else {}),
        }


def heading(x: np.ndarray) -> np.ndarray:
    """Return the yaw (...,) of states or qpos (..., >= 7): direction of the body's x axis, rad."""
    return rotations.quaternion_heading(np.asarray(x)[..., 3:7])


def wrap(angle: np.ndarray) -> np.ndarray:
    """Return angles (...,) in [-pi, pi), rad."""
    return (angle + np.pi) % (2 * np.pi) - np.pi


def evaluate_switching(
    problem: GaitProblem, gait: Gait, cycles: int = 200, seed: int = 0
) -> Switching:
    """Roll out `cycles` cycles from rest, the task of each drawn at random."""
    task = np.random.default_rng(seed).integers(0, len(gait.task_names), cycles)
    return measure_cycles(problem, gait, task)


def measure_cycles(problem: GaitProblem, gait: Gait, task: np.ndarray) -> Switching:
    """Roll out the cycles of a given task sequence (cycles,) from rest.

    A walker that comes down starts the next cycle from rest.
    """
    dynamics = problem.dynamics
    x, down = roll_cycles(dynamics, gait.table()[task])
    start, end = x[:, 0], x[:, -1]
    turn, tilts = np.zeros((len(task), 3)), np.zeros(len(task))
    if problem.place.level:
        yaw = heading(start)
        frame = rotations.upright(yaw)
        turn[:, 2] = wrap(heading(end) - yaw)
        tilts = tilt(x[:, 1:]).max(1)
    else:
        frame = rotations.rotation(start[:, 3:7])
        turn = (frame.inv() * rotations.rotation(end[:, 3:7])).as_rotvec()
    return Switching(
        tasks=problem.tasks,
        place=problem.place,
        length=dynamics.body.length,
        task=task,
        move=frame.inv().apply(end[:, :3] - start[:, :3]),
        turn=turn,
        tilt=tilts,
        down=down,
        footing=footing(dynamics, x[~down]) if dynamics.world.walks else {},
    )


def roll_cycles(dynamics: ReducedDynamics, shapes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Roll out cycles of target shapes (cycles, n, r) from rest; a walker that comes down begins again.

    Returns:
        The states (cycles, n + 1, nx), and (cycles,) which came down, see `Switching.down`.

    Raises:
        DefplanError: a step of a swimmer did not converge.
    """
    rest, world = dynamics.rest_state(), dynamics.world
    x, down = np.empty((len(shapes), shapes.shape[1] + 1, len(rest))), np.zeros(len(shapes), bool)
    now = rest
    for i, cycle in enumerate(shapes):
        if world.walks:
            x[i], failed = dynamics.rollout_count(now, cycle)
            down[i] = failed > 0 or world.fallen(x[i], rest[2]).any()
        else:
            x[i] = dynamics.rollout(now, cycle)
        now = rest if down[i] else x[i, -1]
    return x, down


def since_rest(down: np.ndarray) -> np.ndarray:
    """Return how many cycles there were since the robot was at rest, (cycles,), see `roll_cycles`."""
    since = np.arange(len(down))
    for start in np.flatnonzero(down) + 1:
        since[start:] = np.arange(len(down) - start)
    return since
