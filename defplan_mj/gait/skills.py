"""Judges gaits by what they do while they are switched: which are what they are called, and can they steer."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from defplan_mj.base.space import SPACES
from defplan_mj.gait.switching import Switching
from defplan_mj.task import GaitTask

ENOUGH = 1.0 / 3.0
"""Share of the wanted size that a gait has to reach; guessed tasks want twice what trials reached."""
MOST_FALLS = 0.1
"""Share of its cycles that may fall."""
VERSION = 3
"""Of this judgement: what was judged otherwise is judged anew."""


@dataclass(frozen=True)
class Skill:
    """What was wanted of a gait and what it does, a cycle.

    Attributes:
        name: of its task.
        wanted, got: 'advance_m' and 'turn_rad'; `got` also their standard deviations, 'advance_sd' and
            'turn_sd', and 'falls' of 'cycles'. None where no cycle counts.
        fault: why it is not what it is called; empty: it is.
    """

    name: str
    wanted: dict[str, float]
    got: dict[str, Any]
    fault: str = ""

    @property
    def kept(self) -> bool:
        """Whether it does what it is called."""
        return not self.fault

    def to_json(self) -> dict[str, Any]:
        """Return what `defplan run --json` shows of it."""
        entry = {"name": self.name, "wanted": self.wanted, "got": self.got, "kept": self.kept}
        return {**entry, "fault": self.fault}


def judge(measured: Switching) -> list[Skill]:
    """Return a verdict on each gait: sign and size, spread, and falls, of what its task wants most.

    That is its turn if it wants one, else its advance. It has failed if it goes the other way, under a third
    as far, or varies by more than its mean from cycle to cycle, or if more than a tenth of its cycles fall.
    """
    level = measured.place.level
    verdicts = []
    for j, (task, row) in enumerate(zip(measured.tasks, measured.rows(), strict=True)):
        mine = measured.task == j
        goal = {"advance_m": task.advance, "turn_rad": task.turn[2] if level else task.angle}
        names = ("advance_m", "advance_sd", "turn_rad", "turn_sd")
        got: dict[str, Any] = {n: row[n] if np.isfinite(row[n]) else None for n in names}
        got |= {"falls": int(measured.fell[mine].sum()), "cycles": int(mine.sum())}
        verdicts.append(Skill(task.name, goal, got, _fault(task, goal, got)))
    return verdicts


def _fault(task: GaitTask, goal: dict[str, float], got: dict[str, Any]) -> str:
    """Return what is wrong with a gait, as a clause without its name."""
    key, unit, verb = ("turn_rad", "rad", "turns") if task.angle else ("advance_m", "m", "goes")
    want, mean, spread = goal[key], got[key], got[f"{key.split('_')[0]}_sd"]
    if got["falls"] > MOST_FALLS * got["cycles"]:
        return f"falls in {got['falls']} of {got['cycles']} cycles"
    if mean is None:
        return "was never seen to do anything but begin"
    if mean * want <= 0:
        return f"{verb} the wrong way: {mean:+.2f} {unit} a cycle, wanted {want:+.2f}"
    if abs(mean) < ENOUGH * abs(want):
        return f"{verb} {abs(mean):.2f} {unit} a cycle, under a third of the {abs(want):.2f} wanted"
    if spread > abs(mean):
        return f"{verb} {abs(mean):.2f} {unit} a cycle, but varies by {spread:.2f}"
    return ""


def can_steer(tasks: Sequence[GaitTask], space: str, axis: Sequence[float]) -> bool:
    """Return whether gaits can reach every place: by turning and going, or by going every way.

    In the plane they turn if they want at least two different turns; in space if they tilt the own axis
    about two directions. They go every way without turning if no half plane is free of their directions.
    """
    goes = any(task.advance for task in tasks)
    if not SPACES[space].level:
        own = np.array(axis, float)
        tilts = [np.array(t.turn) - (np.array(t.turn) @ own) * own for t in tasks if t.angle]
        return goes and bool(tilts) and int(np.linalg.matrix_rank(np.array(tilts), 1e-6)) == 2
    turns = {round(task.turn[2], 6) for task in tasks}
    if len(turns) > 1:
        return goes
    ways = sorted(np.arctan2(t.move[1], t.move[0]) for t in tasks if t.advance and not t.angle)
    if len(ways) < 3:
        return False
    gaps = np.diff([*ways, ways[0] + 2 * np.pi])
    return bool(gaps.max() < np.pi - 1e-6)


def goes(skills: Iterable[Skill]) -> bool:
    """Return whether one of the gaits that do what they are called gets on: that all only turn is no way."""
    return any(
        skill.kept
        and skill.wanted["advance_m"]
        and (skill.got["advance_m"] or 0.0) >= ENOUGH * skill.wanted["advance_m"]
        for skill in skills
    )


def faults(skills: Iterable[Skill]) -> str:
    """Return what is wrong with the gaits that failed, in one clause each."""
    return "; ".join(f"{skill.name} {skill.fault}" for skill in skills if not skill.kept)
