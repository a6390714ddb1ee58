"""What a run is about, in figures: the JSON of `defplan run` and of the single stages."""

from __future__ import annotations

import json
from typing import Any

from defplan_mj.pipeline.run import GAIT_FILE, STAGES, Run
from defplan_mj.studies.gait_solvers import compare_solvers


def run_results(run: Run) -> dict[str, Any]:
    """Do everything that is not done yet; return what `defplan run --json` prints."""
    _ = (
        run.gait_solver,
        run.planner_solver,
        run.feedback_solver,
    )  # a wrong name is told before the work, not after
    gait = gait_results(run)
    compare_solvers(run)
    surrogate = surrogate_results(run)
    evaluation, moving = run.evaluation(), run.moving()
    report = run.report()
    seconds = {name: run.seconds(name) for name in STAGES}
    logs = sorted(str(run.folder.file(n)) for n in run.hashes if n.endswith(".mcap"))
    return {
        "task": run.spec.name,
        "seed": run.options.seed,
        "seconds": {**seconds, "total": run.total_seconds()},
        "gait": gait,
        "surrogate": surrogate,
        "evaluation": {
            scenes: without_rows(both["with_shield"])
            | {"without_shield": without_rows(both["without_shield"])}
            for scenes, both in evaluation.items()
        },
        "moving": moving,
        "files": {
            "log": logs[0] if logs else None,
            "report": str(report),
            "body": str(run.folder.file("body.npz")),
            "gait": str(run.folder.file("gait.npz")),
            "policy": str(run.policy),
            "logs": logs,
        },
    }


def gait_results(run: Run) -> dict[str, Any]:
    """Return what the gaits do while they are switched: advance and turn a cycle, falls."""
    _ = run.gait
    document = json.loads(run.folder.file(GAIT_FILE).read_text(encoding="utf-8"))
    return document["gait"]


def surrogate_results(run: Run) -> dict[str, Any]:
    """Return the row of the paper's Table III."""
    found = run.surrogate
    names = ("rotation_mean", "rotation_sd", "translation_mean", "translation_sd")
    tasks = [
        {"name": task, **{name: float(getattr(found, name)[k]) for name in names}}
        for k, task in enumerate(found.task_names)
    ]
    return {"pairs": found.pairs, "tasks": tasks}


def without_rows(evaluation: dict[str, Any]) -> dict[str, Any]:
    """Return an evaluation without its single episodes."""
    return {name: value for name, value in evaluation.items() if name != "rows"}
