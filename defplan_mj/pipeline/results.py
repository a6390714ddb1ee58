"""What a run is about, in figures: the JSON of `defplan run`."""

from __future__ import annotations

from typing import Any

from defplan_mj.pipeline.making import (
    BODY_FILE,
    GAIT_FILE,
    is_judged,
    policy_file,
    skills,
)
from defplan_mj.pipeline.run import Run
from defplan_mj.pipeline.stages import STAGES


def run_results(run: Run) -> dict[str, Any]:
    """Do everything that is not done yet; return what `defplan run --json` prints."""
    run.do_all()
    seconds = {stage.name: run.seconds(stage.name) for stage in STAGES if stage.timed}
    figures = {s.name: run.figures(s.name) for s in STAGES if run.is_done(s.name)}
    return {
        "task": run.plan.spec.name,
        "seed": run.plan.options.seed,
        "seconds": {**seconds, "total": run.total_seconds()},
        **{name: value for name, value in figures.items() if value is not None},
        **({"skills": skills(run)} if is_judged(run) else {}),
        "moving": figures.get("moving", []),
        "files": _files(run),
    }


def _files(run: Run) -> dict[str, Any]:
    """Return where the results lie."""
    logs = [str(run.file(name)) for name in run.files if name.endswith(".mcap")]
    return {
        "log": logs[0] if logs else None,
        "report": str(run.result("report")),
        "body": str(run.file(BODY_FILE)),
        "gait": str(run.file(GAIT_FILE)),
        "policy": str(policy_file(run)),
        "logs": logs,
    }
