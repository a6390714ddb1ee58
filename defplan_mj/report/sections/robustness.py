"""The report's section on worlds that are not the model's; `defplan robustness` leaves its figures."""

from __future__ import annotations

from typing import Any

from defplan_mj.report.content import Missing, Section, Table, Text, number, percent
from defplan_mj.report.material import Material


def robustness_section(material: Material) -> Section:
    """Return falls and drift of the gaits in each condition, with each feedback."""
    section = Section("robustness", "In worlds that are not the model's")
    data = material.documents.get("robustness")
    if not data:
        command = f"defplan robustness {material.task}"
        section.blocks.append(Missing(f"Not measured yet: {command} does it."))
        return section
    if material.is_outdated(data):
        section.blocks.append(Missing("Measured with other gaits than these: measure them again."))
    section.blocks += [
        Text(
            f"Gaits are switched at random for {data['cycles']} cycles in each condition, which"
            " neither gaits nor feedback were made for; the same switches and pushes for each"
            " feedback."
        ),
        Table(_COLUMNS, [_row(row) for row in data["rows"]], _CAPTION),
    ]
    return section


_COLUMNS = ["condition", "feedback", "falls", "95%", "drift (m)", "drift (rad)", "m a cycle"]
_CAPTION = (
    "Falls, with the 95% interval of their rate, and what a cycle is off from the mean cycle of the same"
    " gait and feedback when it is calm, root mean square."
)


def _row(row: dict[str, Any]) -> list[str]:
    low, high = row["interval"]
    return [
        row["condition"],
        row["feedback"],
        f"{row['falls']} of {row['cycles']}",
        f"{percent(low)} to {percent(high)}",
        *(number(row[name]) for name in ("place_m", "turn_rad", "way_m")),
    ]
