"""What the paper's claims need besides the runs of a study: times of a step, falls among pushes."""

from __future__ import annotations

import json
import statistics
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from defplan_mj import registry
from defplan_mj.base import threads
from defplan_mj.base.errors import DefplanError
from defplan_mj.base.progress import Progress
from defplan_mj.body.model import Body
from defplan_mj.dynamics.full_fem import FullFem
from defplan_mj.dynamics.reduced import ReducedDynamics
from defplan_mj.gait.gait import Gait
from defplan_mj.pipeline.making import BODY_FILE, GAIT_FILE, SURROGATE_FILE
from defplan_mj.pipeline.store import write_json
from defplan_mj.planning.scenes import training_scenes
from defplan_mj.planning.surrogate import Surrogate
from defplan_mj.planning.surrogate_env import SurrogateEnv
from defplan_mj.studies.robustness import CALM, conditions, measure_robustness
from defplan_mj.task import TaskSpec

FILE = "paper.json"
ROBOTS = 256  # of the surrogate, stepped together
CYCLES, PUSH = 60, 0.3  # of robustness; m/s
FULL_STEPS = 4  # of f, after two that are not counted


def measured(root: Path, spec: TaskSpec, run: Path, feedback: str, progress: Progress) -> dict:
    """Return the measures of a task by the files of one of its runs; measured once for each gaits.

    'full_step_s', 'reduced_step_s', 'surrogate_cycle_s' (one transition, laser and collision check in it),
    all in processor time, so that what else the machine does has no part in it; 'elements' (D);
    'robustness' (of what walks: rows of `measure_robustness`, open loop and `feedback`).

    Raises:
        DefplanError: the run's files are missing or damaged.
    """
    body, gait = Body.load(run / BODY_FILE), Gait.load(run / GAIT_FILE)
    surrogate = Surrogate.load(run / SURROGATE_FILE)
    kept = _kept(root)
    key = {
        "gait": gait.hash,
        "feedback": feedback,
        "cycles": CYCLES,
        "steps": FULL_STEPS,
        "clock": "processor",
    }
    entry = kept.get(spec.name)
    if isinstance(entry, dict) and entry.get("of") == key:
        return entry
    threads.limit_threads(1)
    progress(f"{spec.name}: times of a step", 0.0)
    dynamics = spec.dynamics(body)
    figures: dict[str, Any] = {
        "of": key,
        "elements": int(gait.alpha.shape[1]),
        "reduced_step_s": _reduced_step(dynamics, gait),
        "surrogate_cycle_s": _surrogate_cycle(spec, surrogate),
        "full_step_s": _full_step(spec, body, gait),
        "robustness": _robustness(spec, dynamics, gait, feedback, progress),
    }
    write_json(root / FILE, {**kept, spec.name: figures})
    return figures


def _kept(root: Path) -> dict[str, Any]:
    try:
        document = json.loads((root / FILE).read_text(encoding="utf-8"))
        return document if isinstance(document, dict) else {}
    except (OSError, ValueError):
        return {}


def _reduced_step(dynamics: ReducedDynamics, gait: Gait) -> float:
    """Return the seconds of a step of f reduced, in rollouts of its own gait."""
    shapes = np.tile(gait.table()[0], (10, 1))
    rest = dynamics.rest_state()
    return _seconds(lambda: dynamics.rollout(rest, shapes), 5, 1) / len(shapes)


def _surrogate_cycle(spec: TaskSpec, surrogate: Surrogate) -> float:
    """Return the seconds of a cycle of f_fit for one of many robots, with laser and collision check."""
    generator = np.random.default_rng(0)
    scenes = training_scenes(spec.navigation, 512, 0)
    environment = SurrogateEnv(surrogate, spec.navigation, scenes, ROBOTS, generator)
    actions = generator.integers(0, len(surrogate.task_names), ROBOTS)
    return _seconds(lambda: environment.step(actions), 20, 3) / ROBOTS


def _full_step(spec: TaskSpec, body: Body, gait: Gait) -> float:
    """Return the seconds of a control step of f, the full FEM, from rest into the gait."""
    fem = FullFem(body, gait.timestep, terrain=spec.terrain, integrator=gait.integrator)
    x = spec.dynamics(body).rest_state()
    state = fem.at(np.zeros(body.n_modes), x[:3], np.eye(3), target=np.zeros(body.n_modes))
    table = gait.table()[0]
    count = iter(range(len(table)))

    def step() -> None:
        nonlocal state
        i = next(count)
        state = fem.step(state, table[i] * (i + 1) / len(table))

    return _seconds(step, FULL_STEPS, 2)


def _seconds(call: Callable[[], Any], repeats: int, warm: int) -> float:
    """Return the processor time of a call, median of some, s."""
    for _ in range(warm):
        call()
    spent = []
    for _ in range(repeats):
        began = time.process_time()
        call()
        spent.append(time.process_time() - began)
    return statistics.median(spent)


def _robustness(
    spec: TaskSpec, dynamics: ReducedDynamics, gait: Gait, feedback: str, progress: Progress
) -> list[dict[str, Any]]:
    if not spec.world.walks or not spec.navigation.place.level or not feedback:
        return []
    names = ["none", feedback]
    try:
        solvers = [registry.get_solver(name, "feedback") for name in names]
    except DefplanError:
        return []
    pushed = [c for c in conditions(PUSH, spec.world) if c.push]
    return measure_robustness(dynamics, gait, solvers, [CALM, *pushed], CYCLES, 0, progress)


def falls(figures: dict[str, Any], names: Sequence[str]) -> list[tuple[int, int] | None]:
    """Return falls and cycles among pushes of each feedback; None: it was not measured."""
    counts: list[tuple[int, int] | None] = []
    for name in names:
        rows = [
            row
            for row in figures.get("robustness", [])
            if row["feedback"] == name and row["condition"] != CALM.name
        ]
        counts.append((rows[0]["falls"], rows[0]["cycles"]) if rows else None)
    return counts
