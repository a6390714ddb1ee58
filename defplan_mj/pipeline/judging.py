"""Judges a run's gaits after they are made: those that fail are tried again, then dropped with a sentence."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from defplan_mj.base.errors import DefplanError
from defplan_mj.base.reading import read_json
from defplan_mj.gait.skills import Skill, can_steer, faults, goes, judge
from defplan_mj.pipeline.store import write_json

if TYPE_CHECKING:
    from defplan_mj.gait.gait import Gait
    from defplan_mj.gait.switching import Switching
    from defplan_mj.pipeline.run import Run

TRIED_FILE, SKILLS_FILE = "gait-tried.npz", "skills.json"
_OTHER_SEED = 1000  # is added for each try: the seeds of other runs are small
_LONGER = 1.3  # times the steps of a cycle, of the last try


@dataclass(frozen=True)
class Attempt:
    """A way to solve the gaits of a task.

    Attributes:
        words: how, for people.
        seed: of the solver.
        steps: in a cycle.
    """

    words: str
    seed: int
    steps: int


@dataclass(frozen=True)
class Solved:
    """Gaits, how they were solved, what they do while they are switched, and what is thought of it."""

    attempt: Attempt
    gait: Gait
    measured: Switching
    skills: list[Skill]

    @property
    def failed(self) -> int:
        """How many are not what they are called."""
        return sum(not skill.kept for skill in self.skills)

    def to_json(self) -> dict[str, Any]:
        """Return what the run keeps of a try."""
        entry = {"tried": self.attempt.words, "seed": self.attempt.seed}
        return {**entry, "steps_per_cycle": self.attempt.steps, "faults": faults(self.skills)}


Solve = Callable[[Attempt], "Gait"]
Measure = Callable[["Gait"], "Switching"]


def attempts(seed: int, steps: int, decisions: int = 1) -> list[Attempt]:
    """Return what is tried, one after the other until no gait fails.

    Args:
        decisions: in a cycle, which has to have so many equal parts.
    """
    longer = decisions * round(_LONGER * steps / decisions)
    return [
        Attempt("as the task says", seed, steps),
        Attempt("from another start", seed + _OTHER_SEED, steps),
        Attempt(f"from another start, {longer} steps a cycle", seed + 2 * _OTHER_SEED, longer),
    ]


def choose(run: Run, solve: Solve, measure: Measure) -> tuple[Gait, Switching, list[Path]]:
    """Solve gaits, try again while some fail, and drop those that failed; keep all if the others cannot steer.

    Args:
        solve: makes the gaits of an attempt.
        measure: rolls out the gaits while they are switched.

    Returns:
        The gaits, what they do when these are switched, and the files with the verdicts.
    """
    spec = run.plan.spec
    tries: list[Solved] = []
    decisions = spec.navigation.decisions_per_cycle
    for attempt in attempts(run.plan.options.seed, spec.steps_per_cycle, decisions):
        try:
            gait = solve(attempt)
            measured = measure(gait)
        except DefplanError:
            if not tries:  # the task's own way is to work; of the others nothing is promised
                raise
            continue
        tries.append(Solved(attempt, gait, measured, judge(measured)))
        if not tries[-1].failed:
            break
        run.consent.say(f"{attempt.words}: {faults(tries[-1].skills)}")
    best = min(tries, key=lambda tried: tried.failed)
    gait, seen, verdicts, steers = _without_failed(run, best, measure)
    document = {
        "steers": steers,
        "skills": [skill.to_json() for skill in verdicts],
        "tries": [tried.to_json() for tried in tries],
    }
    others = [run.file(SKILLS_FILE)]
    write_json(run.file(SKILLS_FILE), document)
    if steers and faults(verdicts):
        best.gait.save(run.file(TRIED_FILE))
        others.append(run.file(TRIED_FILE))
        left = ", ".join(gait.task_names)
        run.consent.say(f"dropped: {faults(verdicts)}; it goes on with {left}")
    return gait, seen, others


def _without_failed(
    run: Run, best: Solved, measure: Measure
) -> tuple[Gait, Switching, list[Skill], bool]:
    """Return the gaits that do what they are called, what these do, all verdicts, and whether they steer.

    If they cannot, all gaits.
    """
    spec = run.plan.spec
    verdicts = {skill.name: skill for skill in best.skills}
    chosen, seen = best.gait, best.measured
    while True:  # without those that failed the others may do otherwise
        names = [name for name in chosen.task_names if verdicts[name].kept]
        left = spec.of_gaits(names).gait_tasks
        steers = not faults(verdicts.values()) or (
            can_steer(left, spec.navigation.space, spec.axis) and goes(verdicts.values())
        )
        if not steers or len(names) == len(chosen.task_names):
            break
        chosen = best.gait.of_tasks(names)
        seen = measure(chosen)
        verdicts |= {skill.name: skill for skill in judge(seen)}
    if not steers:
        chosen, seen = best.gait, best.measured
    return chosen, seen, list(verdicts.values()), steers


def verdicts_of(run: Run) -> dict[str, Any]:
    """Return what `choose` has written."""
    return read_json(run.file(SKILLS_FILE), "verdict")


def require_steering(run: Run) -> None:
    """Raise a DefplanError if the gaits that do what they are called cannot steer."""
    document = verdicts_of(run)
    if document["steers"]:
        return
    verdicts = document["skills"]
    failed = "; ".join(
        f"{skill['name']} {skill['fault']}" for skill in verdicts if not skill["kept"]
    )
    left = ", ".join(skill["name"] for skill in verdicts if skill["kept"]) or "none"
    tried = ", ".join(one["tried"] for one in document.get("tries", ()))
    raise DefplanError(
        f"{run.plan.spec.name}: these gaits cannot steer, so nothing is trained: {failed or 'none failed'};"
        f" what is left: {left}; tried: {tried}. Change gait_tasks, the time step or the material in"
        f" {run.plan.spec.file}, or try another --gait-solver or --seed"
    )
