"""Robustness: what gaits do when the world is not the model's: pushes, slopes, other friction, other mass."""

from __future__ import annotations

import functools
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from defplan_mj.base import parallel
from defplan_mj.base.progress import Progress, no_progress
from defplan_mj.base.statistics import wilson_interval
from defplan_mj.body.model import Body
from defplan_mj.dynamics.reduced import ReducedDynamics
from defplan_mj.dynamics.tangent import Frame
from defplan_mj.dynamics.terrain import TerrainGeom, contact_law
from defplan_mj.dynamics.world import MAX_TILT, World, tilt
from defplan_mj.feedback import FeedbackSolver
from defplan_mj.gait.gait import Gait
from defplan_mj.gait.switching import heading, wrap

SETTLE = 2  # cycles from rest whose drift is not counted


@dataclass(frozen=True)
class Condition:
    """How the world differs from the model that gaits and feedback were made with.

    Attributes:
        name: for tables.
        push: a force impulse on the centre of mass once a cycle, at a step drawn at random, in a
            horizontal direction drawn at random: change of velocity, m/s.
        slope: of the ground, rising along x, rad.
        friction, mass: factors.
    """

    name: str
    push: float = 0.0
    slope: float = 0.0
    friction: float = 1.0
    mass: float = 1.0

    @property
    def of_ground(self) -> bool:
        """Whether it means nothing without a ground."""
        return self.slope != 0.0 or self.friction != 1.0


CALM = Condition("calm")


def conditions(push: float, world: World) -> tuple[Condition, ...]:
    """Return what is measured in a world, with pushes of `push` m/s; in water there is no slope nor friction."""
    every = (
        CALM,
        Condition(f"pushes, {push:g} m/s", push=push),
        Condition("slope, 5 degrees", slope=float(np.radians(5.0))),
        Condition("friction -30%", friction=0.7),
        Condition("mass +20%", mass=1.2),
        Condition("mass -20%", mass=0.8),
    )
    return tuple(condition for condition in every if world.walks or not condition.of_ground)


@dataclass(frozen=True)
class PerturbedWalk:
    """Cycles of gaits, switched at random, in one condition.

    Attributes:
        task: (cycles,) gait of each.
        fell: (cycles,) whether the body tilted past 30 degrees, a walker sank below 60% of its height at
            rest, or the simulation failed; it is then put on its feet where it was and the next cycle
            begins.
        counted: (cycles,) whether the cycle's motion counts: not after a fall or a start.
        motion: (cycles, 3) displacement ahead and to the left, in the yaw frame at the cycle's
            start, m, and change of heading, rad.
        decision: processor time of the feedback, mean of a step, s.
    """

    task: np.ndarray
    fell: np.ndarray
    counted: np.ndarray
    motion: np.ndarray
    decision: float = 0.0

    def means(self, tasks: int) -> np.ndarray:
        """Return (tasks, 3): the mean motion of each gait's cycles that count; NaN if there are none."""
        mine = [self.motion[self.counted & (self.task == j)] for j in range(tasks)]
        return np.array([m.mean(0) if len(m) else np.full(3, np.nan) for m in mine])

    def drift(self, expected: np.ndarray) -> tuple[float, float]:
        """Return what cycles are off from `expected` (tasks, 3), root mean square: m, rad."""
        off = (self.motion - expected[self.task])[self.counted]
        off = off[np.isfinite(off).all(1)]
        if not len(off):
            return float("nan"), float("nan")
        place, turn = (off[:, :2] ** 2).sum(1), wrap(off[:, 2]) ** 2
        return float(np.sqrt(place.mean())), float(np.sqrt(turn.mean()))


def real_dynamics(dynamics: ReducedDynamics, condition: Condition) -> ReducedDynamics:
    """Return the dynamics as it really is in a condition."""
    terrain = dynamics.terrain
    if dynamics.world.walks:
        ground = dynamics.world.ground
        half = 0.5 * condition.slope
        lean = (float(np.cos(half)), 0.0, -float(np.sin(half)), 0.0)
        terrain = replace(
            ground,
            friction=condition.friction * ground.friction,
            # of the ground: it does not know the body's mass
            stiffness=contact_law(ground, dynamics.body).stiffness,
            geoms=(TerrainGeom("plane", quaternion=lean),) if condition.slope else ground.geoms,
        )
    body = heavier(dynamics.body, condition.mass) if condition.mass != 1.0 else dynamics.body
    return ReducedDynamics(body, dynamics.timestep, terrain, **dynamics.stepping)


def heavier(body: Body, factor: float) -> Body:
    """Return the same body of other density: shapes, stiffness and drag as they were."""
    root = np.sqrt(factor)
    columns = np.concatenate([[1.0], np.full(body.n_basis, 1 / root)])
    return replace(
        body,
        vertex_mass=factor * body.vertex_mass,
        basis=body.basis / root,  # orthonormal in the new mass
        feature_weights=body.feature_weights * root,
        moments=factor * np.einsum("abij,a,b->abij", body.moments, columns, columns),
        drag_points=body.drag_points * columns,
        drag_tangents=body.drag_tangents * columns,
        frequencies=body.frequencies / root,
    )


def perturbed_walk(
    dynamics: ReducedDynamics,
    gait: Gait,
    solver: FeedbackSolver,
    condition: Condition,
    cycles: int = 200,
    seed: int = 0,
) -> PerturbedWalk:
    """Switch gaits at random in a condition that the feedback is not told of.

    The feedback's model is `dynamics`. It is told the state relative to the ground, which the body feels under its
    feet, so not that on a slope its weight pulls it aside.

    Args:
        dynamics: the model; on level ground or in water.
        seed: of the switching and the pushes; the same for every feedback.
    """
    feedback, real = solver.prepare(dynamics, gait), real_dynamics(dynamics, condition)
    generator = np.random.default_rng(seed)
    n = gait.steps_per_cycle
    task = generator.integers(0, len(gait.task_names), cycles)
    push_step, push_angle = (
        generator.integers(0, n, cycles),
        generator.uniform(0, 2 * np.pi, cycles),
    )
    velocity = slice(7 + dynamics.body.n_modes, 9 + dynamics.body.n_modes)
    rest, world = dynamics.rest_state(), dynamics.world
    half = 0.5 * condition.slope if world.walks else 0.0
    ground = Frame(np.zeros(3), np.array([np.cos(half), 0.0, -np.sin(half), 0.0]))
    x, since, busy, steps = rest, 0, 0.0, 0
    fell, counted, motion = np.zeros(cycles, bool), np.zeros(cycles, bool), np.zeros((cycles, 3))
    feedback.reset()
    for cycle in range(cycles):
        start = Frame.of(x, True, False)
        for i in range(n):
            if condition.push and i == push_step[cycle]:
                angle = push_angle[cycle]
                x = x.copy()
                x[velocity] += condition.push * np.array([np.cos(angle), np.sin(angle)])
            state, began = ground.inside(x), time.thread_time()
            if i == 0:
                feedback.begin(int(task[cycle]), state)
            shape = feedback.shape(state)
            busy, steps = busy + time.thread_time() - began, steps + 1
            x, info = real.step_info(x, shape)
            if info.failed or tilt(x) > MAX_TILT or world.sunk(ground.inside(x)[2], rest[2]):
                fell[cycle] = True
                break
        if fell[cycle]:
            x = ground.outside(Frame.of(ground.inside(x), True, False).outside(rest))
            feedback.reset()
            since = 0
        else:
            moved = start.inside(x)
            motion[cycle] = *moved[:2], heading(moved)
            counted[cycle] = since >= SETTLE
            since += 1
    return PerturbedWalk(task, fell, counted, motion, busy / steps)


def _walk(
    dynamics: ReducedDynamics,
    gait: Gait,
    cycles: int,
    seed: int,
    job: tuple[Condition, FeedbackSolver],
) -> PerturbedWalk:
    where, solver = job
    return perturbed_walk(dynamics, gait, solver, where, cycles, seed)


def measure_robustness(
    dynamics: ReducedDynamics,
    gait: Gait,
    solvers: Sequence[FeedbackSolver],
    measured: Sequence[Condition],
    cycles: int = 200,
    seed: int = 0,
    progress: Progress = no_progress,
) -> list[dict[str, Any]]:
    """Return a row for each condition and feedback; CALM has to be among the conditions.

    'condition', 'feedback'; 'cycles', 'falls', 'rate' and its 95% 'interval' (Wilson); 'place_m' and
    'turn_rad', root mean square of what a cycle is off from the mean cycle of the same gait and feedback in
    the calm condition; 'way_m', the mean displacement of a cycle. None: no cycle counts. 'decision_ms':
    processor time of a step's feedback.
    """
    jobs = [(condition, solver) for condition in measured for solver in solvers]
    walk = functools.partial(_walk, dynamics, gait, cycles, seed)
    walks: list[PerturbedWalk] = []
    for one in parallel.each(walk, jobs):
        where, solver = jobs[len(walks)]
        walks.append(one)
        progress(f"robustness: {where.name}, {solver.name}", len(walks) / len(jobs))
    calm = {solver: one for (where, solver), one in zip(jobs, walks, strict=True) if where == CALM}
    rows = []
    for (where, solver), one in zip(jobs, walks, strict=True):
        falls = int(one.fell.sum())
        place, turn = one.drift(calm[solver].means(len(gait.task_names)))
        way = np.hypot(*one.motion[one.counted, :2].T)
        row = {"condition": where.name, "feedback": solver.name, "cycles": cycles, "falls": falls}
        row |= {"rate": falls / cycles, "interval": list(wilson_interval(falls, cycles))}
        row |= {
            "place_m": place,
            "turn_rad": turn,
            "way_m": float(way.mean()) if len(way) else None,
            "decision_ms": 1e3 * one.decision,
        }
        rows.append({k: None if v != v else v for k, v in row.items()})
    return rows
