"""One run of a study: an ordinary run in an ordinary folder, and its row of the table."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from defplan_mj.base import threads
from defplan_mj.base.errors import DefplanError
from defplan_mj.base.progress import Progress, no_progress
from defplan_mj.pipeline.comparison import COMPARISON, SOLVERS_FILE
from defplan_mj.pipeline.evaluation import EVALUATION_FILE, MOVING, without_rows
from defplan_mj.pipeline.outlook import Consent
from defplan_mj.pipeline.run import Run, open_run
from defplan_mj.pipeline.store import FolderBusy
from defplan_mj.planning.outcome import ENDINGS
from defplan_mj.study.build import require_same
from defplan_mj.study.matrix import Cell
from defplan_mj.study.table import EPISODE_COLUMNS, KEYS, STAGES, Row, complete, moving_name
from defplan_mj.task import TaskSpec
from defplan_mj.taskfile.find import find_task

if TYPE_CHECKING:
    from defplan_mj.gait.gait import Gait

PATIENCE = 60.0
"""How long a folder may be busy, s: a machine that was lost may hold its lock for a while."""


@dataclass(frozen=True)
class Job:
    """What a worker is sent: one run, and how it is to be done.

    Attributes:
        cell: the run.
        root: the study's folder, absolute; all machines have to see it.
        lenders: folders of runs to copy stages from, from the study's folder on.
        remake: finished stages may be made anew for other options.
        processes: that the run may use for its episodes.
        build: what the machine has to have installed (`build.build_of`); none: not asked.
    """

    cell: Cell
    root: Path
    lenders: Sequence[Path] = ()
    remake: bool = False
    processes: int = 1
    build: Mapping[str, str] = field(default_factory=dict)


def run_job(job: Job, progress: Progress = no_progress) -> Row:
    """Carry out a run; return its row. A run that fails is a row with its sentence."""
    threads.set_environment(1)
    threads.limit_processes(job.processes)
    made: Row = {}
    try:
        require_same(job.build)
        _carry_out(job, made, progress)
        return complete({**keys_of(job.cell), "failed": False, **made})
    except DefplanError as error:
        sentence = str(error)
    except MemoryError:
        sentence = "the memory is used up: use fewer --jobs or a smaller mesh"
    except Exception as error:  # a plugin may fail in any way; the other runs go on
        sentence = f"this is a mistake in defplan or a plugin: {type(error).__name__}: {error}"
    row = {"failed_in": "task", **made, "failed": True, "error": sentence}
    return complete({**keys_of(job.cell), **row})


def failed_row(cell: Cell, sentence: str, where: str) -> Row:
    """Return the row of a run that nothing is left of but a sentence."""
    row = {"failed": True, "error": sentence, "failed_in": where}
    return complete({**keys_of(cell), **row})


def keys_of(cell: Cell) -> Row:
    """Return the columns that name a run."""
    steers = cell.until not in ("gait", "surrogate")
    return {
        "task": cell.task,
        "seed": cell.seed,
        "gait_solver": cell.gait_solver,
        "planner": cell.planner if steers else "",
        "feedback": cell.feedback if steers else "",
        "variant": cell.variant,
        "folder": cell.folder.as_posix(),
    }


def _carry_out(job: Job, made: Row, progress: Progress) -> None:
    """Do a run, and put into `made` what its row says; also of a run that fails."""
    cell = job.cell
    spec = _task_of(job, made, progress)
    chosen = {
        "gait_solver": cell.gait_solver,
        "planner": cell.planner,
        "feedback": cell.feedback,
        "rivals": ("none",),
        "solver_seeds": 1,
        **cell.options,
    }
    logs = job.root / cell.method
    deadline = time.monotonic() + PATIENCE
    while True:
        try:
            with open_run(
                spec,
                logs,
                cell.seed,
                chosen,
                progress,
                whole=True,
                consent=Consent(job.remake),
                lenders=[job.root / folder for folder in job.lenders],
            ) as run:
                try:
                    _do(run, cell.until)
                except Exception:
                    made |= {**row_of(run), "failed_in": run.working or "task"}
                    raise
                made |= row_of(run)
                return
        except FolderBusy:
            if time.monotonic() > deadline:
                raise
            time.sleep(1.0)


def _task_of(job: Job, made: Row, progress: Progress) -> TaskSpec:
    """Return the task of a run; of a mesh that of its file in the study's folder, guessed if it is not there."""
    cell = job.cell
    if not cell.medium:
        return find_task(cell.source)
    from defplan_mj.taskfile.guess import guess_task
    from defplan_mj.taskfile.write import write_task

    path = job.root / f"{cell.task}.toml"
    if not path.is_file():
        began = time.perf_counter()
        guess = guess_task(cell.source, cell.medium, progress=progress)
        write_task(guess.spec, path, [f"Guessed: {guess.sentence}."])
        made["guess_seconds"] = time.perf_counter() - began
    return find_task(str(path))


def _do(run: Run, until: str) -> None:
    run.plan.check()
    run.do("gait", COMPARISON)
    if until == "report":
        run.do_all()
    elif until == "evaluation" and MOVING.included(run):
        run.do("evaluation", MOVING)
    else:
        run.do(until)


def row_of(run: Run) -> Row:
    """Return what a table's row says of the stages of a run that are done."""
    row: Row = {f"{stage}_seconds": run.seconds(stage) or None for stage in STAGES}
    row["total_seconds"] = run.total_seconds()
    if run.is_done("body"):
        body = run.result("body")
        row |= {"vertices": len(body.vertices), "modes": body.n_modes}
    if run.is_done("gait"):
        row |= _gait_figures(run.result("gait"))
    if run.is_done(COMPARISON.name):
        row |= _solver_figures(run)
    if run.is_done("surrogate"):
        surrogate = run.result("surrogate")
        row["pairs"] = surrogate.pairs
        row["rotation_sd"] = float(np.mean(surrogate.rotation_sd))
        row["translation_sd"] = float(np.mean(surrogate.translation_sd))
    if run.is_done("planner"):
        row["cut_short"] = run.figures("planner")["cut_short"]
    if run.is_done("evaluation"):
        row |= _evaluation_figures(run.result("evaluation"))
    for moving in run.result("moving") if run.is_done("moving") else ():
        row["moving_episodes"] = moving["episodes"]
        row[moving_name(moving["speed"])] = moving["success"]
    return row


def _gait_figures(gait: Gait) -> Row:
    stages = [entry for entry in gait.meta.get("stages", []) if isinstance(entry, dict)]
    row: Row = {"gaits": len(gait.task_names), "steps_per_cycle": gait.steps_per_cycle}
    for name in ("iterations", "evaluations"):
        counts = [entry[name] for entry in stages if isinstance(entry.get(name), int)]
        row[name] = sum(counts) if counts else None
    return row


def _solver_figures(run: Run) -> Row:
    """Return what `studies.gait_solvers.measure` says of the run's own gaits."""
    document = json.loads(run.file(SOLVERS_FILE).read_text(encoding="utf-8"))
    own = document["solvers"][0]
    names = {
        "objective": "objective",
        "resimulated": "resimulated",
        "advance": "advance_m",
        "turn": "turn_rad",
        "slip": "slip_share",
        "gait_cycles": "cycles",
        "gait_falls": "falls",
        "solver_seconds": "seconds",
    }
    return {column: own.get(name) for column, name in names.items()}


def _evaluation_figures(evaluation: Mapping[str, Any]) -> Row:
    row: Row = {}
    for scenes, both in evaluation.items():
        for suffix, result in (("", "with_shield"), ("_unchecked", "without_shield")):
            figures = without_rows(both[result])
            row[f"{scenes}{suffix}_episodes"] = figures["episodes"]
            row[f"{scenes}{suffix}_cycles"] = figures["cycles_mean"]
            row |= {f"{scenes}{suffix}_{ending}": figures[ending] for ending in ENDINGS}
        row[f"{scenes}_decision"] = both["with_shield"]["decision_ms"]
        row[f"{scenes}_real_time"] = both["with_shield"]["real_time_factor"]
    return row


def episode_rows(root: Path, cell: Cell) -> list[Row]:
    """Return a row for each episode of a finished run; none if it was not evaluated."""
    try:
        text = (root / cell.folder / EVALUATION_FILE).read_text(encoding="utf-8")
        document = json.loads(text)
        return list(_episodes(document, keys_of(cell)))
    except (OSError, ValueError, KeyError, TypeError, AttributeError):  # not there, or damaged
        return []


def _episodes(document: Mapping[str, Any], run: Row) -> Iterator[Row]:
    names = {column.name for column in EPISODE_COLUMNS}
    keys = {name: run[name] for name in KEYS}
    for scenes, both in document.items():
        for name, checked in (("with_shield", True), ("without_shield", False)):
            for episode in both[name]["rows"]:
                own = {key: value for key, value in episode.items() if key in names}
                row = {**keys, "scenes": scenes, "checked": checked, **own}
                yield complete(row, EPISODE_COLUMNS)
