"""The report's section on the planner's training."""

from __future__ import annotations

from defplan_mj.report.content import Figures, Missing, Section, Text, drawing
from defplan_mj.report.figures.planning import reward_figure, success_figure
from defplan_mj.report.material import Material, missing
from defplan_mj.report.sections.paper import training_table


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
    table = training_table(material)
    section.blocks += [] if table is None else [table]
    return section
