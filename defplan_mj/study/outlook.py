"""What of a study is there, what is to be made, and about how long that takes: nothing is made for it."""

from __future__ import annotations

import statistics
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from defplan_mj.pipeline.plan import RunOptions
from defplan_mj.pipeline.store import read_config, stage_seconds
from defplan_mj.study.matrix import Cell

_ORDER = {
    "gait": ("body", "gait"),
    "surrogate": ("body", "gait", "surrogate"),
    "planner": ("body", "gait", "surrogate", "planner"),
    "evaluation": ("body", "gait", "surrogate", "planner", "evaluation", "moving"),
    "report": ("body", "gait", "surrogate", "planner", "evaluation", "moving", "report"),
}
_SHARED = ("body", "gait", "surrogate", "planner")
_DEFAULTS = RunOptions()


@dataclass(frozen=True)
class Prospect:
    """One run of a study, before it.

    Attributes:
        cell: the run.
        state: 'there' (all stages are; whether they still fit is seen when it is run), 'begun' or
            'to be made'.
        missing: the stages that are to be made, without those that it will copy.
        seconds: about how long they take, as they took elsewhere; None: nobody knows of one of them.
    """

    cell: Cell
    state: str
    missing: tuple[str, ...]
    seconds: float | None


def prospects(cells: Sequence[Cell], root: Path, logs: Path) -> list[Prospect]:
    """Return what is to be made of each run.

    Args:
        root: the study's folder.
        logs: a folder of other runs, whose times count, too.
    """
    times = _Times([*_runs(root), *_runs(logs)])
    shared: set[tuple[object, ...]] = set()
    there = {cell.folder: stage_seconds(root / cell.folder) for cell in cells}
    for cell in cells:
        shared |= {_shares(cell, _plain(key, cell)) for key in there[cell.folder]}
    outlook = []
    for cell in cells:
        made = {_plain(key, cell) for key in there[cell.folder]}
        missing = [s for s in _stages(cell) if s not in made]
        state = "there" if not missing else "begun" if made else "to be made"
        due = [s for s in missing if s not in _SHARED or _shares(cell, s) not in shared]
        shared |= {_shares(cell, stage) for stage in due if stage in _SHARED}
        times_due = [times.of(cell, stage) for stage in due]
        seconds = None if None in times_due else sum(t for t in times_due if t is not None)
        outlook.append(Prospect(cell, state, tuple(due), seconds))
    return outlook


def _stages(cell: Cell) -> list[str]:
    moving = cell.asked["moving"] and not cell.stands
    return [stage for stage in _ORDER[cell.until] if stage != "moving" or moving]


def _plain(key: str, cell: Cell) -> str:
    """Return the stage of a key in run.json: 'planner' of 'planner-NAME'."""
    return "planner" if key == f"planner-{cell.planner}" else key


def _shares(cell: Cell, stage: str) -> tuple[object, ...]:
    """Return what a stage depends on: runs alike in it copy it from each other."""
    parts: tuple[object, ...] = (cell.source, stage)
    if stage != "body":
        parts = (*parts, cell.gaits)
    if stage in ("surrogate", "planner"):
        parts = (*parts, cell.options.get("pairs"))
    if stage == "planner":
        parts = (*parts, cell.planner, cell.options.get("training_seconds"))
    return parts


def _runs(folder: Path) -> Iterable[Path]:
    return sorted(path.parent for path in folder.glob("**/run.json"))


class _Times:
    """How long stages took in runs that are there."""

    def __init__(self, runs: Iterable[Path]) -> None:
        self.seconds_of: dict[tuple[str, ...], list[float]] = {}
        for folder in runs:
            config = read_config(folder)
            for key, seconds in stage_seconds(folder).items():
                stage = key.partition("-")[0] if key.startswith("planner") else key
                share = _share(stage, config)
                planner = key.partition("-")[2] or str(config.get("planner"))
                names = {"gait": str(config.get("gait_solver")), "planner": planner}
                for known in _from_near_to_far(
                    stage, str(config.get("task")), names.get(stage, "")
                ):
                    self.seconds_of.setdefault(known, []).append(seconds / share)

    def of(self, cell: Cell, stage: str) -> float | None:
        """Return about how long a stage of a run takes, s; None: there is no other to go by."""
        names = {"gait": cell.gait_solver, "planner": cell.planner}
        for known in _from_near_to_far(stage, cell.task, names.get(stage, "")):
            if known in self.seconds_of:
                return statistics.median(self.seconds_of[known]) * _share(stage, cell.asked)
        return None


def _from_near_to_far(stage: str, task: str, name: str) -> list[tuple[str, ...]]:
    return [(stage, task, name), (stage, "", name)]


def _share(stage: str, options: object) -> float:
    """Return how many episodes or pairs a stage does: its time is in proportion to them."""
    chosen = options if isinstance(options, dict) else dict(options)  # type: ignore[call-overload]
    if stage not in ("evaluation", "moving", "surrogate"):
        return 1.0
    name = {"evaluation": "episodes", "moving": "moving", "surrogate": "pairs"}[stage]
    value = chosen.get(name) or getattr(_DEFAULTS, name)
    return float(value) + (10 if stage == "evaluation" else 0)
