"""Stages from the mesh to the planner: body, gaits, surrogate, training."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from defplan_mj.base import files, threads
from defplan_mj.base.errors import DefplanError
from defplan_mj.base.files import file_hash
from defplan_mj.base.reading import read_json
from defplan_mj.pipeline.provenance import content_of, plugin_data
from defplan_mj.pipeline.stage import Stage
from defplan_mj.pipeline.store import write_json
from defplan_mj.studies.gait_solvers import SWITCHING_CYCLES

if TYPE_CHECKING:
    from defplan_mj.body.model import Body
    from defplan_mj.dynamics.reduced import ReducedDynamics
    from defplan_mj.gait.gait import Gait
    from defplan_mj.gait.problem import GaitProblem
    from defplan_mj.gait.switching import Switching
    from defplan_mj.pipeline.judging import Attempt
    from defplan_mj.pipeline.run import Run
    from defplan_mj.planning.planner import Planner
    from defplan_mj.planning.surrogate import Surrogate

BODY_FILE, GAIT_FILE, SURROGATE_FILE = "body.npz", "gait.npz", "surrogate.npz"
SWITCHING_FILE = "gait.json"
TRAINING_VERSION = 1


# ---- body


def _packaged_body(run: Run) -> Path | None:
    """Return the task's packaged body if the gait solver asks for it, because its gaits belong to that one."""
    if not getattr(run.plan.gait_solver, "body_as_packaged", False):
        return None
    shipped = run.plan.spec.shipped
    return shipped[0] if shipped and shipped[0].is_file() else None


def _body_inputs(run: Run) -> dict[str, Any]:
    packaged = _packaged_body(run)
    if packaged is not None:
        return {"packaged": content_of(packaged)}
    mesh = run.plan.spec.mesh
    return {
        "mesh": file_hash(mesh) if mesh.is_file() else "missing",
        "task": {"body": run.plan.spec.body.stated()},
    }


def _make_body(run: Run) -> Iterable[Path]:
    from defplan_mj.body.build import build_body
    from defplan_mj.body.model import Body

    path, spec, packaged = run.file(BODY_FILE), run.plan.spec, _packaged_body(run)
    if packaged is not None:
        body = Body.load(packaged)
    else:
        body = build_body(spec.mesh, spec.body, run.progress_of("body"))
    body.save(path)
    return [path]


def _load_body(run: Run) -> Body:
    from defplan_mj.body.model import Body

    return Body.load(run.file(BODY_FILE))


BODY = Stage(
    "body",
    _body_inputs,
    _make_body,
    load=_load_body,
    sections=("body",),
    timed=True,
    lent=True,
)


# ---- gaits


def dynamics(run: Run) -> ReducedDynamics:
    """Return the reduced dynamics of the run's body at the task's time step."""
    return run.plan.spec.dynamics(run.result("body"))


def gait_problem(run: Run, gait: Gait | None = None) -> GaitProblem:
    """Return Eq. 1 for the run's body: of all its tasks, or of those that a gait has, in its period."""
    from defplan_mj.gait.problem import GaitProblem

    spec = run.plan.spec
    if gait is not None:
        spec = dataclasses.replace(
            spec.of_gaits(gait.task_names), steps_per_cycle=gait.steps_per_cycle
        )
    return GaitProblem.of(spec, dynamics(run))


def solve_gait(run: Run, solver: Any, stage: str, seed: int, steps: int | None = None) -> Gait:
    """Let a gait solver solve the problem; Ctrl-C is heard meanwhile.

    Args:
        steps: in a cycle; None: as the task says.

    Raises:
        DefplanError: it returns no gait.
    """
    from defplan_mj.gait.gait import Gait
    from defplan_mj.gait.problem import GaitProblem

    spec, progress = run.plan.spec, run.progress_of(stage)
    if steps is not None:  # as many cycles as before
        whole = spec.gait_steps * steps // spec.steps_per_cycle
        spec = dataclasses.replace(spec, steps_per_cycle=steps, gait_steps=whole)
    problem = GaitProblem.of(spec, dynamics(run))
    gait = threads.interruptible(lambda: solver.solve(problem, seed, progress))
    return expect(gait, Gait, f"the gait solver {solver.name}", "solve")


def expect(value: Any, kind: type, who: str, what: str) -> Any:
    """Return what a plugin's function has returned, if it is of the kind that it has to be.

    Raises:
        DefplanError: it is not, for example None because of a forgotten `return`.
    """
    if not isinstance(value, kind):
        got = "None" if value is None else f"a {type(value).__name__}"
        raise DefplanError(f"{who} returns {got} from {what}: it has to return a {kind.__name__}")
    return value


def gait_inputs(run: Run, solver: Any, seed: int) -> dict[str, Any]:
    """Return all that gaits depend on besides the body."""
    from defplan_mj.gait.skills import VERSION

    return {
        **({"judged": VERSION} if is_judged(run) else {}),
        "options": {"gait_solver": solver.name, "seed": seed},
        "plugins": {"gait_solver": plugin_data(solver)},
        "task": _gait_task(run),
        "switching": SWITCHING_CYCLES,
    }


def _gait_task(run: Run) -> dict[str, Any]:
    """Return what a task says of its gaits."""
    spec = run.plan.spec
    return {
        "gait_tasks": [dataclasses.asdict(task) for task in spec.gait_tasks],
        "timestep": spec.timestep,
        **spec.stepping,
        "steps_per_cycle": spec.steps_per_cycle,
        "gait_steps": spec.gait_steps,
        "space": spec.navigation.space,
        "weights": dataclasses.asdict(spec.weights),
        "axis": spec.axis,
        "terrain": spec.world.terrain_data,
    }


def _make_gait(run: Run) -> Iterable[Path]:
    from defplan_mj.gait.switching import evaluate_switching
    from defplan_mj.pipeline.judging import choose

    path, switching, seed = run.file(GAIT_FILE), run.file(SWITCHING_FILE), run.plan.options.seed
    others: list[Path] = []

    def measure(gait: Gait) -> Switching:
        return evaluate_switching(gait_problem(run, gait), gait, SWITCHING_CYCLES, seed)

    def solve(attempt: Attempt) -> Gait:
        return solve_gait(run, run.plan.gait_solver, "gait", attempt.seed, attempt.steps)

    if is_judged(run):
        gait, measured, others = choose(run, solve, measure)
    else:
        gait = solve_gait(run, run.plan.gait_solver, "gait", seed)
        measured = measure(gait)
    gait.save(path)
    write_json(switching, {"gait": measured.to_json()})
    return [path, switching, *others]


def is_judged(run: Run) -> bool:
    """Return whether the run's gaits are judged: those of task files are, nobody has looked at them."""
    return run.plan.spec.file is not None


def skills(run: Run) -> list[dict[str, Any]]:
    """Return what was wanted of each gait, what it does and whether it was kept; empty if not judged."""
    from defplan_mj.pipeline.judging import verdicts_of

    return verdicts_of(run)["skills"] if is_judged(run) and run.is_done("gait") else []


def _require_steering(run: Run) -> None:
    """Raise a DefplanError if the gaits were judged and cannot steer."""
    from defplan_mj.pipeline.judging import require_steering

    if is_judged(run):
        require_steering(run)


def _load_gait(run: Run) -> Gait:
    from defplan_mj.gait.gait import Gait

    return Gait.load(run.file(GAIT_FILE))


def _gait_figures(run: Run) -> dict[str, Any]:
    """Return what the gaits do while they are switched: advance and turn a cycle, falls."""
    return read_json(run.file(SWITCHING_FILE), "measurement")["gait"]


GAIT = Stage(
    "gait",
    lambda run: gait_inputs(run, run.plan.gait_solver, run.plan.options.seed),
    _make_gait,
    needs=("body",),
    load=_load_gait,
    figures=_gait_figures,
    sections=("gaits",),
    timed=True,
    lent=True,
    require=_require_steering,
)


# ---- surrogate


def _make_surrogate(run: Run) -> Iterable[Path]:
    from defplan_mj.planning.fit import fit_surrogate

    path, options = run.file(SURROGATE_FILE), run.plan.options
    progress = run.progress_of("surrogate")
    gait = run.result("gait")
    decisions = run.plan.spec.navigation.decisions_per_cycle
    fit_surrogate(dynamics(run), gait, options.pairs, options.seed, progress, decisions).save(path)
    return [path]


def _load_surrogate(run: Run) -> Surrogate:
    from defplan_mj.planning.surrogate import Surrogate

    return Surrogate.load(run.file(SURROGATE_FILE))


def _surrogate_figures(run: Run) -> dict[str, Any]:
    """Return the row of the paper's Table III."""
    surrogate = run.result("surrogate")
    names = ("rotation_mean", "rotation_sd", "translation_mean", "translation_sd")
    tasks = [
        {"name": task, **{name: float(getattr(surrogate, name)[k]) for name in names}}
        for k, task in enumerate(surrogate.task_names)
    ]
    switching = surrogate.switching
    held_out = {} if switching is None else switching.held_out
    m = surrogate.decisions_per_cycle
    parts = {"decisions_per_cycle": m} if m != 1 else {}
    return {"pairs": surrogate.pairs, "tasks": tasks, "held_out": held_out, **parts}


def _surrogate_inputs(run: Run) -> dict[str, Any]:
    from defplan_mj.planning.surrogate import FORMAT_VERSION

    options, decisions = run.plan.options, run.plan.spec.navigation.decisions_per_cycle
    return {
        "the file format": FORMAT_VERSION,
        "options": {"pairs": options.pairs, "seed": options.seed},
        **({"task": {"decisions_per_cycle": decisions}} if decisions != 1 else {}),
    }


SURROGATE = Stage(
    "surrogate",
    _surrogate_inputs,
    _make_surrogate,
    needs=("body", "gait"),
    load=_load_surrogate,
    figures=_surrogate_figures,
    sections=("surrogate",),
    timed=True,
    lent=True,
)


# ---- planner


def policy_file(run: Run) -> Path:
    """Return where the planner lies; one that is not the task's own lies beside it."""
    return run.file(f"{run.plan.of_planner('policy')}.npz")


def training_file(run: Run) -> Path:
    """Return where the planner's training curves lie."""
    return run.file(f"{run.plan.of_planner('training')}.npz")


def _planner_inputs(run: Run) -> dict[str, Any]:
    plan = run.plan
    limit = plan.options.training_seconds
    return {
        "options": {
            "planner": plan.planner_name,
            "seed": plan.options.seed,
            **({} if limit is None else {"training_seconds": limit}),
        },
        "plugins": {"planner": plugin_data(plan.planner)},
        "task": {"navigation": dataclasses.asdict(plan.spec.navigation)},
    }


def _make_planner(run: Run) -> Iterable[Path]:
    from defplan_mj.planning.planner import TrainResult

    plan, policy, training = run.plan, policy_file(run), training_file(run)
    trained = plan.planner.train(
        run.result("surrogate"),
        plan.spec.navigation,
        plan.options.seed,
        seconds=plan.options.training_seconds,
        progress=run.progress_of("planner"),
    )
    expect(trained, TrainResult, f"the planner {plan.planner.name}", "train")
    plan.planner.save(trained.planner, policy)
    curves = {name: np.asarray(curve) for name, curve in trained.curves.items()}
    meta = {
        "planner": plan.planner.name,
        "seconds": trained.seconds,
        "cut_short": trained.cut_short,
    }
    files.save_archive(training, "training", TRAINING_VERSION, curves, meta)
    return [policy, training]


def _load_planner(run: Run) -> Planner:
    surrogate, navigation = run.result("surrogate"), run.plan.spec.navigation
    return run.plan.planner.load(policy_file(run), surrogate, navigation)


def _planner_figures(run: Run) -> dict[str, Any]:
    """Return how the planner was trained."""
    _, meta, _ = files.load_archive(training_file(run), "training", TRAINING_VERSION)
    return {"planner": run.plan.planner.name, "cut_short": bool(meta.get("cut_short"))}


PLANNER = Stage(
    "planner",
    _planner_inputs,
    _make_planner,
    needs=("surrogate",),
    load=_load_planner,
    figures=_planner_figures,
    sections=("training",),
    key=lambda run: run.plan.of_planner("planner"),
    timed=True,
    lent=True,
)
