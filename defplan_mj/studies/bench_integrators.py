"""The benchmark's table of integrators: what a step costs, and how far from the finest one it is."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from defplan_mj.body.model import Body
from defplan_mj.dynamics.reduced import ReducedDynamics
from defplan_mj.studies.timing import measure
from defplan_mj.task import TaskSpec

CHOICES = (
    *(("implicit-euler", n) for n in (1, 4)),
    *(("variational", n) for n in (1, 2, 4, 8)),
)
REFERENCE = ("variational", 16)


@dataclass(frozen=True)
class Integrator:
    """One way to integrate a body.

    Attributes:
        name: e.g. 'variational, 2 substeps'.
        dynamics: a step of the task by it.
    """

    name: str
    dynamics: ReducedDynamics


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
    """Return what the table compares, CHOICES; the last one is the reference."""
    return [
        Integrator(
            f"{name}, {n} substep{'s' if n > 1 else ''}",
            replace(spec, substeps=n, integrator=name).dynamics(body),
        )
        for name, n in (*CHOICES, REFERENCE)
    ]


def error_against_time(
    ways: list[Integrator], table: np.ndarray, cycles: int
) -> list[ErrorAgainstTime]:
    """Play a gait's cycle (n, r) from rest with each integrator; errors against the last of them.

    All integrate the same motion of the target: within a step it goes on evenly from the last one
    (kernel.h), whatever the substeps.
    """
    shapes = np.tile(table, (cycles, 1))
    ends, times = [], []
    for way in ways:
        rest = way.dynamics.rest_state()
        ends.append(way.dynamics.rollout_count(rest, shapes)[0][-1])
        timing = measure(lambda d=way.dynamics, x=rest: d.rollout_count(x, shapes), 3, 1)  # type: ignore[misc]
        times.append(timing.median / len(shapes))
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
