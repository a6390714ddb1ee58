"""The benchmark's table of integrators: what a step costs, and how far from the finest one it is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from defplan_mj.body.model import Body
from defplan_mj.dynamics.reduced import ReducedDynamics
from defplan_mj.task import TaskSpec
from defplan_mj.timing import measure


@dataclass(frozen=True)
class Integrator:
    """One way to integrate a body.

    Attributes:
        name: e.g. 'variational, 2 substeps'.
        dynamics: a control step.
        division: control steps in one step of the task: 1, or for a reference more.
    """

    name: str
    dynamics: ReducedDynamics
    division: int = 1


@dataclass(frozen=True)
class ErrorAgainstTime:
    """A row of the table: how far an integrator is from the finest one, and what it costs.

    Attributes:
        name: of the integrator.
        step_us: median wall time of one step of the task, us.
        advance_error: |way - way of the last row| / |way of the last row|.
        turn_error_rad: rotation between the attitudes at the end, rad.
    """

    name: str
    step_us: float
    advance_error: float
    turn_error_rad: float


def integrators(body: Body, spec: TaskSpec) -> list[Integrator]:
    """Return what the table compares; the last one is the reference."""
    return [
        Integrator(
            f"time step / {n}" if n > 1 else "as it is",
            ReducedDynamics(body, spec.timestep / n, spec.terrain),
            n,
        )
        for n in (1, 2, 4, 16)
    ]


def error_against_time(
    ways: list[Integrator], table: np.ndarray, cycles: int
) -> list[ErrorAgainstTime]:
    """Play a gait's cycle (n, r) from rest with each integrator; errors against the last of them.

    The target shape of a step of the task is reached from the last one in even parts, so that all
    integrate the same motion of the target.
    """
    held = np.tile(table, (cycles, 1))
    before = np.vstack([np.zeros_like(held[:1]), held[:-1]])
    ends, times = [], []
    for way in ways:
        shares = np.arange(1, way.division + 1)[:, None] / way.division
        parts = before[:, None] + shares * (held - before)[:, None]
        shapes = parts.reshape(-1, held.shape[1])
        rest = way.dynamics.rest_state()
        ends.append(way.dynamics.rollout_count(rest, shapes)[0][-1])
        timing = measure(lambda d=way.dynamics, u=shapes, x=rest: d.rollout_count(x, u), 3, 1)  # type: ignore[misc]
        times.append(timing.median / len(held))
    last = ends[-1]
    size = np.linalg.norm(last[:3]) or 1.0
    return [
        ErrorAgainstTime(
            way.name,
            round(1e6 * seconds, 2),
            float(np.linalg.norm(end[:3] - last[:3]) / size),
            float(2 * np.arccos(min(1.0, abs(end[3:7] @ last[3:7])))),
        )
        for way, seconds, end in zip(ways, times, ends, strict=True)
    ]
