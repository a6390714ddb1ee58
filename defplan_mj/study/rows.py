"""Rows of a study grouped by task and method, and what is measured of a group."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from defplan_mj.base.statistics import wilson_interval
from defplan_mj.study.statistics import mean_over_seeds, rate_over_seeds
from defplan_mj.study.table import Row

METHOD = ("gait_solver", "planner", "feedback", "variant")

Estimate = tuple[float, float, float]
"""Centre and the ends of its 95% interval; nan where there is none."""


def labelled(rows: Sequence[Row]) -> dict[tuple[str, ...], str]:
    """Return a label for each method: its parts that vary within any one task."""
    varying = []
    for part in METHOD:
        of_task: dict[str, set[str]] = {}
        for row in rows:
            of_task.setdefault(row["task"], set()).add(row[part])
        if any(len(values) > 1 for values in of_task.values()):
            varying.append(part)
    return {
        method: " + ".join(filter(None, (method[METHOD.index(part)] for part in varying))) or "runs"
        for method in dict.fromkeys(tuple(row[part] for part in METHOD) for row in rows)
    }


def grouped(rows: Sequence[Row]) -> dict[str, dict[str, list[Row]]]:
    """Return the rows by task and label of their method."""
    labels = labelled(rows)
    groups: dict[str, dict[str, list[Row]]] = {}
    for row in rows:
        label = labels[tuple(row[part] for part in METHOD)]
        groups.setdefault(row["task"], {}).setdefault(label, []).append(row)
    return groups


def rate(rows: Sequence[Row], name: str, count: str) -> Estimate | None:
    """Return a rate over seeds and episodes; None if no row has it.

    Its interval is the wider of Wilson's over all episodes and that of the bootstrap of two levels: the
    first is right of one seed and near 0 and 1, the second of seeds that differ.

    Args:
        name: column of the share.
        count: column of the number of episodes.
    """
    counted = [row for row in rows if row[name] is not None and row[count]]
    if not counted:
        return None
    episodes = [int(row[count]) for row in counted]
    won = [round(row[name] * n) for row, n in zip(counted, episodes, strict=True)]
    centre, low, high = rate_over_seeds(won, episodes)
    least, most = wilson_interval(sum(won), sum(episodes))
    return centre, min(low, least), max(high, most)


def arrival_rates(rows: Sequence[Row]) -> list[Estimate | None]:
    """Return the rates of arrival at training targets, in unseen scenes, and there without the check."""
    kinds = ("k2", "novel", "novel_unchecked")
    return [rate(rows, f"{kind}_success", f"{kind}_episodes") for kind in kinds]


def mean(rows: Sequence[Row], name: str) -> Estimate | None:
    """Return a figure over seeds (`statistics.mean_over_seeds`); None if no row has it."""
    values = [float(row[name]) for row in rows if row[name] is not None]
    return mean_over_seeds(values) if values else None


def scores(rows: Sequence[Row], score: Callable[[Row], float]) -> dict[str, dict[str, np.ndarray]]:
    """Return scores by method and task, one a run."""
    by_label: dict[str, dict[str, np.ndarray]] = {}
    for task, methods in grouped(rows).items():
        for label, own in methods.items():
            by_label.setdefault(label, {})[task] = np.array([score(row) for row in own])
    return by_label


def success(row: Row) -> float:
    """Return a run's score: its success in unseen scenes; of one that failed 0."""
    return float(row["novel_success"] or 0.0)


def gait_cost(row: Row) -> float:
    """Return the re-simulated objective of a run's gaits; of one that failed infinity."""
    value = row["resimulated"]
    return np.inf if value is None else float(value)
