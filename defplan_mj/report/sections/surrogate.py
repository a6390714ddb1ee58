"""The report's section on the rigid surrogate: the paper's Table III."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from defplan_mj.planning.surrogate import Surrogate
from defplan_mj.report.content import Section, Table, Text, mean_sd
from defplan_mj.report.material import Material, missing


def surrogate_section(material: Material) -> Section:
    """Return Table III's row, here and in the paper."""
    section = Section("surrogate", "Rigid surrogate")
    surrogate = material.surrogate
    if surrogate is None:
        section.blocks.append(missing(material, "surrogate.npz"))
        return section
    shares = surrogate.translation_sd / np.maximum(surrogate.translation_mean, 1e-12)
    section.blocks += [
        Text(
            f"For planning, a whole cycle of a gait is one rigid motion, fitted to {surrogate.pairs} "
            "pairs of states before and after a cycle while gaits are switched at random. The "
            "spread says how far a single cycle is from it: here the translation's standard "
            f"deviation is {100 * shares.min():.0f} to {100 * shares.max():.0f}% of its mean."
        ),
        Table(
            COLUMNS,
            table_three(surrogate, material.paper),
            "Rotation and translation a cycle, mean ± standard deviation over the pairs, beside "
            "the paper's Table III.",
        ),
        *_by_pair(surrogate),
    ]
    return section


COLUMNS = ["gait", "rotation (rad)", "translation (m)", "paper: rotation", "paper: translation"]
"""Of Table III."""


def table_three(
    surrogate: Surrogate, paper: Mapping[str, Any], prefix: str = ""
) -> list[list[str]]:
    """Return the rows of Table III, a gait each: mean and standard deviation here and in the paper."""
    theirs = list(paper.get("tasks", ()))
    rows = []
    for k, name in enumerate(surrogate.task_names):
        row = [
            prefix + name,
            mean_sd(surrogate.rotation_mean[k], surrogate.rotation_sd[k]),
            mean_sd(surrogate.translation_mean[k], surrogate.translation_sd[k]),
        ]
        if name in theirs:
            i = theirs.index(name)
            row.append(mean_sd(paper["rotation_mean"][i], paper["rotation_sd"][i]))
            row.append(mean_sd(paper["translation_mean"][i], paper["translation_sd"][i]))
        else:
            row += ["–", "–"]
        rows.append(row)
    return rows


def _by_pair(surrogate: Surrogate) -> list[Text | Table]:
    """Return what a motion for each gait before brings, on switching that it was not fitted to."""
    if surrogate.switching is None or not surrogate.switching.held_out:
        return []
    held_out = surrogate.switching.held_out
    m = surrogate.decisions_per_cycle
    rows = [
        [name, f"{held_out[f'{key}place_m']:.3f}", f"{held_out[f'{key}turn_rad']:.3f}"]
        for name, key in (("one motion a gait", "plain_"), ("by the gait before, too", ""))
    ]
    text = (
        "What a cycle does depends on the gait before it. Planner, training and collision check use "
        "a motion for each pair of gaits, and one for each gait from rest."
    )
    if m > 1:
        text = (
            f"The gait is chosen {m} times a cycle. What 1 / {m} of one does depends on the gaits of the cycle "
            "before it. Planner, training and collision check use a motion for each gait after each of these."
        )
        rows[0][0], rows[1][0] = "one motion a gait and phase", "by the gaits before, too"
    part, many = ("a cycle", "cycles") if m == 1 else (f"1 / {m} of a cycle", "of them")
    return [
        Text(text),
        Table(
            ["surrogate", "place (m)", "rotation (rad)"],
            rows,
            f"How far {part} is from its prediction, root mean square of {held_out['cycles']:.0f} {many} "
            "that were not fitted.",
        ),
    ]
