"""The report's section on the seconds of each stage: the paper's Table I."""

from __future__ import annotations

from defplan_mj.report.content import Section, Table, duration
from defplan_mj.report.material import Material, missing
from defplan_mj.report.sections.paper import cost_table


def time_section(material: Material) -> Section:
    """Return the seconds of each stage beside the paper's Table I."""
    section = Section("time", "Seconds per stage")
    seconds, paper = material.seconds, material.paper
    if not seconds:
        section.blocks.append(missing(material, "run.json"))
        return section
    theirs = {"gait": paper.get("gait_h")}
    if "planner_h" in paper:
        theirs["planner"] = paper["planner_h"] + paper.get("features_h", 0.0)
    rows = []
    for stage, spent in seconds.items():
        hours = theirs.get(stage)
        ratio = f"{3600 * hours / spent:.0f}×" if hours and spent else "–"
        rows.append(
            [stage.replace("_", " "), duration(spent), f"{hours:g} h" if hours else "–", ratio]
        )
    rows.append(["total", duration(sum(seconds.values())), "–", "–"])
    section.blocks.append(
        Table(
            ["stage", "here", "paper", "faster by"],
            rows,
            "Wall time of each stage in this run, beside the paper's Table I (an 8-core CPU; its "
            "planner's time is learning and the laser's features together). A stage that was reused counts with "
            "the time it took when it was made.",
        )
    )
    section.blocks.append(cost_table(material))
    return section
