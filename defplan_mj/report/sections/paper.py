"""The paper's Tables I and II, with this run's figures beside them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from defplan_mj.report.content import Table, duration
from defplan_mj.report.material import Material


def cost_table(material: Material) -> Table:
    """Return Table I: sizes of the problem and what its parts cost, a row for each of its columns."""
    paper, gait, body, seconds = material.paper, material.gait, material.body, material.seconds
    spec = material.spec
    rows: list[list[Any]] = [
        ["vertices", None if body is None else len(body.vertices), paper.get("vertices")],
        ["degrees of freedom of the reduced body, |x̄|",
         None if body is None else 6 + body.n_modes, paper.get("dof")],
        ["a step of the full FEM, f", None, _time(paper.get("full_step_s"))],
        ["a step of the reduced dynamics, f̄", None, _time(paper.get("reduced_step_s"))],
        ["gaits, K₁", None if gait is None else len(gait.task_names), len(paper.get("tasks", ())) or None],
        ["steps of a trajectory in the gaits' optimisation, N₁",
         spec.gait_steps if spec else None, paper.get("gait_steps")],
        ["wavelets of a gait, D", None if gait is None else gait.alpha.shape[1], paper.get("wavelets")],
        ["gaits (Eq. 1)", _time(seconds.get("gait")), _hours(paper.get("gait_h"))],
        ["planner (DQL)", _time(seconds.get("planner")), _hours(paper.get("planner_h"))],
        ["features of the laser (CNN)", "in the planner's", _hours(paper.get("features_h"))],
    ]  # fmt: skip
    return Table(
        ["Table I", "here", "paper"],
        [[name, _text(here), _text(theirs)] for name, here, theirs in rows],
        "The paper's Table I. Steps are timed by `defplan bench`, not by a run; the paper's are on an 8-core CPU.",
    )


def training_table(material: Material) -> Table | None:
    """Return Table II, the parameters of the planner's training; None: the paper has none of this task."""
    paper, gait, spec = material.paper, material.gait, material.spec
    calls = paper_calls(paper)
    if calls is None or spec is None:
        return None
    navigation = spec.navigation
    k2, n2 = navigation.k2, navigation.max_cycles
    steps = gait.steps_per_cycle if gait else None
    made = material.curves.get("transitions")
    rows: list[list[Any]] = [
        ["training targets, K₂", k2, paper.get("k2")],
        ["gait cycles of an episode at most, N₂", n2, paper["n2_cycles"]],
        ["steps of a gait cycle", steps, paper["steps_per_cycle"]],
        ["states in the memory", None, paper.get("memory")],
        ["steps of f̄ for K₂ episodes", k2 * n2 * steps if steps else None, calls[0]],
        ["steps of the surrogate for the same", k2 * n2, calls[1]],
        ["transitions of the whole training", None if made is None else int(made[-1]), None],
    ]
    return Table(
        ["Table II", "here", "paper"],
        [[name, _text(here), _text(theirs)] for name, here, theirs in rows],
        "The paper's Table II: parameters of the planner's training. One of its iterations plays K₂ episodes of "
        "N₂ cycles; the surrogate takes a step a cycle. Here training scenes are drawn anew all the time.",
    )


def paper_calls(paper: Mapping[str, Any]) -> tuple[int, int] | None:
    """Return how often an iteration of the paper's DQL calls f reduced and f_fit (Table II); None: not said.

    That is in each step, and once in each cycle, of K₂ trajectories of N₂ cycles.
    """
    k2, cycles, steps = (paper.get(name) for name in ("k2", "n2_cycles", "steps_per_cycle"))
    return (k2 * cycles * steps, k2 * cycles) if k2 and cycles and steps else None


def _time(seconds: float | None) -> str | None:
    return None if seconds is None else duration(seconds)


def _hours(hours: float | None) -> str | None:
    return None if hours is None else f"{hours:g} h"


def _text(value: Any) -> str:
    if value is None:
        return "–"
    return f"{value:,}" if isinstance(value, int) else str(value)
