"""The report's section on how episodes end, and the shares of an evaluation's document."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from defplan_mj.base.statistics import wilson_interval
from defplan_mj.planning.outcome import ENDINGS, SCENES, Outcome
from defplan_mj.report.content import Section, Table, drawing, number, percent
from defplan_mj.report.figures.planning import moving_figure, rates_figure
from defplan_mj.report.material import Material, missing


def evaluations(document: Any, path: tuple[str, ...] = ()) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield label and content of every evaluation in a JSON document, however it is nested."""
    if isinstance(document, dict):
        if "episodes" in document and "success" in document:
            yield ", ".join(SCENES.get(name, name.replace("_", " ")) for name in path), document
            return
        for name, inner in document.items():
            yield from evaluations(inner, (*path, name))


def success_section(material: Material) -> Section:
    """Return how episodes end, with intervals, among obstacles still and moving."""
    section = Section("success", "Does it arrive?")
    results = list(evaluations(material.documents.get("evaluation")))
    if not results:
        section.blocks.append(missing(material, "evaluation.json"))
        return section
    # an evaluation of an older version does not know all of them
    outcomes = [name for name in ENDINGS if any(name in result for _, result in results)]
    if Outcome.FALL in outcomes and not material.walks:
        outcomes.remove(Outcome.FALL)
    rows = [
        [
            label,
            str(episodes(result)),
            *(_rate_text(result, outcome) for outcome in outcomes),
            number(result.get("cycles_mean"), 1),
            number(result.get("real_time_factor"), 0),
        ]
        for label, result in results
    ]
    columns = ["scenes", "episodes", *outcomes, "cycles", "× real time"]
    section.blocks += [
        drawing(
            rates_figure([(label, rate(r, "success"), interval(r)) for label, r in results]),
            "Share of episodes that reach their target without touching an obstacle; the line is "
            "the 95% interval that this number of episodes allows.",
        ),
        Table(
            columns,
            rows,
            "Episodes on the reduced dynamics in the MuJoCo scene, contact checked at every physics "
            "step; in brackets the 95% interval (Wilson's). Unseen scenes had no say in the training; the "
            "collision check (shield) vetoes gaits that have no collision-free continuation "
            "in the laser's points. Cycles: mean of the successful episodes. × real time: simulated "
            "seconds per second of decision and physics, in one process.",
        ),
    ]
    moving = material.documents.get("moving", {}).get("moving")
    if moving:
        still = _still(material)
        still_ones = f" ({still[0]['episodes']} at speed 0)" if still else ""
        section.blocks.append(
            drawing(
                moving_figure(still + moving),
                f"Training targets with the shield, {moving[0]['episodes']} episodes a speed"
                f"{still_ones}, among obstacles that move, each in its own random direction, as in the "
                "paper's Fig. 6; the planner was trained among still ones and sees no speeds.",
            )
        )
    return section


def _still(material: Material) -> list[dict[str, Any]]:
    """Return the row of speed 0: the training targets among still obstacles, with the shield; or none."""
    document = material.documents.get("evaluation", {}).get("k2")
    by_name = dict(evaluations(document))
    result = by_name.get("with shield", by_name.get(""))
    if result is None:
        return []
    share = rate(result, "success")
    row = {"speed": 0.0, "success": share, "interval": {"success": interval(result)}}
    return [{**row, "episodes": episodes(result)}]


def _rate_text(result: dict[str, Any], outcome: str) -> str:
    """Return the share of an outcome with its interval."""
    low, high = interval(result, outcome)
    return f"{percent(rate(result, outcome))} ({100 * low:.0f}–{100 * high:.0f}%)"


def episodes(result: dict[str, Any]) -> int:
    """Return the number of episodes of an evaluation."""
    n = result["episodes"]
    return len(n) if isinstance(n, list) else int(n)


def interval(result: dict[str, Any], outcome: str = "success") -> tuple[float, float]:
    """Return the 95% interval of the share of an outcome."""
    n = episodes(result)
    return wilson_interval(round(rate(result, outcome) * n), n) if n else (0.0, 1.0)


def rate(result: dict[str, Any], outcome: str) -> float:
    """Return the share of an outcome, whether the document has it as a share or as a count."""
    value = result.get(outcome, 0.0)
    if isinstance(value, dict):
        value = value.get("rate", 0.0)
    n = episodes(result)
    return value / n if isinstance(value, int) and n else float(value)
