"""The report's sections on training, success, trajectories and the surrogate's errors."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from defplan_mj.base.errors import DefplanError
from defplan_mj.base.statistics import wilson_interval
from defplan_mj.log.compare import DRIFT_COLUMNS, compare_logs
from defplan_mj.log.compare_plot import comparison_figures
from defplan_mj.log.reader import EpisodeLog
from defplan_mj.planning.outcome import ENDINGS, SCENES
from defplan_mj.report.content import (
    Figures,
    Missing,
    Section,
    Table,
    Text,
    drawing,
    number,
    percent,
)
from defplan_mj.report.material import Material
from defplan_mj.report.planning_figures import (
    episode_figures,
    moving_figure,
    overview_figures,
    rates_figure,
    reward_figure,
    success_figure,
)
from defplan_mj.report.sections import missing
from defplan_mj.report.views import PICTURES

MANY = 6  # episodes that call for an overview


def training_section(material: Material) -> Section:
    """Return the planner's training curves."""
    section = Section("training", "Training of the planner")
    if not material.curves:
        section.blocks.append(missing(material, "training.npz"))
        return section
    if material.cut_short:
        section.blocks.append(
            Text(
                "This training was cut short by its limit of wall time before its budget was used up:"
                " on another machine, or at another hour, it gives another planner."
            )
        )
    drawn = [f for f in (reward_figure(material.curves), success_figure(material.curves)) if f]
    section.blocks.append(
        Figures(
            [drawing(figure) for figure in drawn],
            "Training on the surrogate: reward at the training targets at each checkpoint, mean (red) "
            "within minimum and maximum (grey), as in the paper's Fig. 5 (the lower edge rises when "
            "collisions end); and the share of episodes that reach their target.",
        )
        if drawn
        else Missing("training.npz holds neither rewards nor success rates.")
    )
    return section


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
    found = list(evaluations(material.documents.get("evaluation")))
    if not found:
        section.blocks.append(missing(material, "evaluation.json"))
        return section
    # an evaluation of an older version does not know all of them
    outcomes = [name for name in ENDINGS if any(name in result for _, result in found)]
    rows = [
        [
            label,
            str(episodes(result)),
            *(_rate_text(result, outcome) for outcome in outcomes),
            number(result.get("cycles_mean"), 1),
            number(result.get("real_time_factor"), 0),
        ]
        for label, result in found
    ]
    columns = ["scenes", "episodes", *outcomes, "cycles", "× real time"]
    section.blocks += [
        drawing(
            rates_figure([(label, rate(r, "success"), interval(r)) for label, r in found]),
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
        section.blocks.append(
            drawing(
                moving_figure(moving),
                f"Training targets with the shield, {moving[0]['episodes']} episodes a speed, among "
                "obstacles that move, each in its own random direction, as in the paper's Fig. 6; the planner was "
                "trained among still ones and sees no speeds.",
            )
        )
    return section


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


def trajectory_section(material: Material) -> Section:
    """Return the paths of logged episodes, the paper's Fig. 6."""
    section = Section("trajectories", "Trajectories")
    logs, dynamics = material.logs, material.dynamics
    faults = [text for name, text in material.faults.items() if name.endswith(".mcap")]
    section.blocks += [Missing(f"{text}.") for text in faults]
    if not logs and not faults:
        section.blocks.append(Missing("No episode was logged yet (*.mcap)."))
    if not logs or dynamics is None:
        return section
    groups: dict[str, list[EpisodeLog]] = {}
    for log in logs:
        groups.setdefault(log.path.stem.rstrip("0123456789").rstrip("-_") or "episodes", []).append(
            log
        )
    for name, group in groups.items():
        pictures = PICTURES[group[0].space]
        if len(group) >= MANY:
            section.blocks.append(
                Figures(
                    [drawing(figure) for figure in overview_figures(group)],
                    f"All {len(group)} logged {name} episodes in one picture{pictures.overview_sides}: "
                    "paths from the common start (black dot) to the targets (red). Every episode has its own "
                    "obstacles (blue): a path may cross those of another.",
                )
            )
        # what failed is shown first
        most = pictures.shown
        shown = sorted(group, key=lambda log: log.outcome == "success")[:most]
        more = f" ({len(shown)} of {len(group)}, failures first)" if len(group) > most else ""
        section.blocks.append(
            Figures(
                [drawing(figure) for log in shown for figure in episode_figures(log, dynamics)],
                f"Logged {name} episodes{more}, {pictures.episode_sides}: path of the centre of mass (green), "
                "silhouettes of the body on its way (black), obstacles (blue; a moving one where it "
                "is at the end, dotted where it began), target within its goal radius (red).",
            )
        )
    return section


_TURNING = {
    "heading": "Heading: true minus predicted, its p95 of the absolute value.",
    "rotation": "Rotation: the angle between predicted and true attitude, about whatever axis.",
}


def comparison_section(material: Material) -> Section:
    """Return how well the surrogate predicts the logged cycles."""
    section = Section("comparison", "Surrogate against the truth")
    if not material.logs:
        section.blocks.append(Missing("No episode was logged yet (*.mcap)."))
        return section
    try:
        comparison = compare_logs(material.logs)
    except DefplanError as error:
        section.blocks.append(Missing(f"{error}."))
        return section
    name = comparison.turning_name
    section.blocks += [
        Text(
            f"The planner learned on the surrogate and drives the deformable body. Over the "
            f"{len(comparison.gait)} whole cycles of {len(comparison.episodes)} logged episodes, this "
            "is how far the surrogate's prediction is from the truth after one cycle, each time "
            "starting from the true state."
        ),
        Figures(
            [drawing(figure) for figure in comparison_figures(comparison)],
            "Displacement in one cycle as seen from its start (dots: the truth, crosses: the "
            "surrogate); the path of one log beside the surrogate's own, which never sees the truth "
            f"after the start and drifts; errors of position and {name} after one cycle, a dot a "
            "cycle, the box from quartile to quartile. Hollow: an episode's first cycles, in which "
            "the body gets up to speed from rest; the surrogate knows full speed only.",
        ),
        Table(
            comparison.columns,
            comparison.table(),
            f"Error of one cycle; p95: 95th percentile. {_TURNING[name]} "
            "Spread: what is left if the prediction were the mean of these very cycles.",
        ),
        Table(DRIFT_COLUMNS, comparison.drift_rows(), "Each log; drift: of the chained surrogate."),
    ]
    return section
