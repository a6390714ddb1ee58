"""The stages of a run, in their order: the list that a run loops over. A new stage is a new entry."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from defplan_mj.base.files import file_hash
from defplan_mj.pipeline.comparison import COMPARISON
from defplan_mj.pipeline.evaluation import EVALUATION, MOVING
from defplan_mj.pipeline.making import BODY, GAIT, PLANNER, SURROGATE
from defplan_mj.pipeline.stage import Stage
from defplan_mj.pipeline.store import RUN_FILE
from defplan_mj.pipeline.video import VIDEO, VIDEO_FILE

if TYPE_CHECKING:
    from defplan_mj.pipeline.run import Run

REPORT_FILE = "report.html"
_SHOWN = ("[!.]*.json", "[!.]*.npz", "**/[!.]*.mcap", VIDEO_FILE)


def _report_inputs(run: Run) -> dict[str, Any]:
    """Return all that the page is made of: what lies in the folder, and what run.json says of it."""
    folder = run.folder
    shown = {path for pattern in _SHOWN for path in folder.path.glob(pattern) if path.is_file()}
    return {
        "shown": {
            str(path.relative_to(folder.path)): file_hash(path)
            for path in sorted(shown)
            if path.name != RUN_FILE
        },
        "config": folder.config,
        **({"file": _task_text(run)} if run.plan.spec.file is not None else {}),
        "seconds": {
            key: record.seconds for key, record in folder.records.items() if key != "report"
        },
    }


def _make_report(run: Run) -> Iterable[Path]:
    from defplan_mj.report.report import write_report

    copy = _copy_task(run)
    return [*copy, write_report(run.folder.path, run.progress_of("report"))]


def _copy_task(run: Run) -> list[Path]:
    """Keep the task in the run's folder if it is a file's, as the report reads it and as it was."""
    from defplan_mj.taskfile.find import COPY
    from defplan_mj.taskfile.write import write_task

    spec = run.plan.spec
    return [] if spec.file is None else [write_task(spec, run.file(COPY))]


def _task_text(run: Run) -> str:
    """Return what the copy says."""
    from defplan_mj.taskfile.find import COPY
    from defplan_mj.taskfile.write import task_text

    return task_text(run.plan.spec, run.file(COPY))


REPORT = Stage(
    "report",
    _report_inputs,
    _make_report,
    load=lambda run: run.file(REPORT_FILE),
    guarded=False,
)

STAGES = (BODY, GAIT, COMPARISON, SURROGATE, PLANNER, EVALUATION, MOVING, VIDEO, REPORT)
