"""The stages that count how episodes end: at training targets, in unseen scenes, among moving obstacles."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from defplan_mj.base.reading import read_json
from defplan_mj.pipeline.provenance import plugin_data
from defplan_mj.pipeline.stage import Stage
from defplan_mj.pipeline.store import write_json
from defplan_mj.pipeline.trial import Recorders, evaluate

if TYPE_CHECKING:
    from defplan_mj.pipeline.run import Run

EVALUATION_FILE, MOVING_FILE = "evaluation.json", "moving.json"
SPEEDS = (0.25, 0.5, 1.0, 2.0)
"""Of moving obstacles, m/s."""
_NEEDS = ("body", "gait", "surrogate", "planner")
_LOGS = ("k2-[0-9]*.mcap", "novel-[0-9]*.mcap")


def _inputs(run: Run, **options: Any) -> dict[str, Any]:
    """Return what every evaluation depends on, besides files."""
    plan = run.plan
    chosen = {"planner": plan.planner.name, "feedback": plan.feedback.name}
    return {
        "options": {**chosen, "seed": plan.options.seed, **options},
        "plugins": {"planner": plugin_data(plan.planner), "feedback": plugin_data(plan.feedback)},
        "task": {
            "navigation": dataclasses.asdict(plan.spec.navigation),
            "terrain": plan.spec.world.terrain_data,
        },
    }


def _make_evaluation(run: Run) -> Iterable[Path]:
    """Evaluate with and without the shield; with it, log all at training targets and some in unseen scenes.

    Of the unseen scenes those without the shield are as many as the task's effort says, the first ones.
    """
    results: dict[str, dict[str, Any]] = {}
    logs: set[Path] = set()
    logged = {"k2": run.plan.spec.navigation.k2, "novel": run.plan.options.logged}
    for scenes, most in logged.items():
        log = Recorders(run.folder.path, scenes, most)
        with_shield = evaluate(run, scenes, True, log=log)
        count = _unchecked(run) if scenes == "novel" else None
        without = evaluate(run, scenes, False, episodes=count)
        results[scenes] = {"with_shield": with_shield, "without_shield": without}
        logs |= {log.path(i) for i in range(min(most, with_shield["episodes"]))}
    _remove_logs_but(run.folder.path, logs)
    write_json(run.file(EVALUATION_FILE), results)
    return [run.file(EVALUATION_FILE), *logs]


def _unchecked(run: Run) -> int:
    """Return how many unseen scenes are gone through without the shield."""
    return max(1, round(run.plan.spec.effort.unchecked * run.plan.options.episodes))


def _evaluation_inputs(run: Run) -> dict[str, Any]:
    """Return what the evaluation depends on; that all scenes are gone through twice goes without saying."""
    options = run.plan.options
    counts = {"episodes": options.episodes, "logged": options.logged}
    if _unchecked(run) < options.episodes:
        counts["unchecked"] = _unchecked(run)
    return _inputs(run, **counts)


def _remove_logs_but(folder: Path, logs: set[Path]) -> None:
    """Remove the logs of earlier evaluations, and no others."""
    for pattern in _LOGS:
        for path in set(folder.glob(pattern)) - logs:
            path.unlink()


def _evaluation_figures(run: Run) -> dict[str, Any]:
    return {
        scenes: without_rows(both["with_shield"])
        | {"without_shield": without_rows(both["without_shield"])}
        for scenes, both in run.result("evaluation").items()
    }


def without_rows(evaluation: dict[str, Any]) -> dict[str, Any]:
    """Return an evaluation without its single episodes."""
    return {name: value for name, value in evaluation.items() if name != "rows"}


EVALUATION = Stage(
    "evaluation",
    _evaluation_inputs,
    _make_evaluation,
    needs=_NEEDS,
    load=lambda run: read_json(run.file(EVALUATION_FILE), "evaluation"),
    figures=_evaluation_figures,
    sections=("success", "trajectories", "comparison"),
    timed=True,
)


def _make_moving(run: Run) -> Iterable[Path]:
    """Evaluate, in the shield, at training targets whose obstacles move (the paper's Fig. 6)."""
    rows, count = [], run.plan.options.moving
    for speed in SPEEDS:
        result = evaluate(run, "k2", True, episodes=count, obstacle_speed=speed)
        rows.append({"speed": speed, **without_rows(result)})
    write_json(run.file(MOVING_FILE), {"moving": rows})
    return [run.file(MOVING_FILE)]


MOVING = Stage(
    "moving",
    lambda run: _inputs(run, moving=run.plan.options.moving),
    _make_moving,
    needs=_NEEDS,
    load=lambda run: read_json(run.file(MOVING_FILE), "evaluation")["moving"],
    figures=lambda run: run.result("moving"),
    sections=("success",),
    included=lambda run: run.plan.options.moving > 0 and not run.plan.spec.navigation.scenes,
)
