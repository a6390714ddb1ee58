"""The report's section on how well the surrogate predicts the logged cycles."""

from __future__ import annotations

from defplan_mj.base.errors import DefplanError
from defplan_mj.log.compare import DRIFT_COLUMNS, compare_logs
from defplan_mj.log.compare_plot import comparison_figures
from defplan_mj.report.content import Figures, Missing, Section, Table, Text, drawing
from defplan_mj.report.material import Material

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
            "the body gets up to speed from rest; the surrogate knows the very first cycle and full speed.",
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
