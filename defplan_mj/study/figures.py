"""Figures of a study's page: rates with intervals, profiles of solvers, objective against seconds, robots."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure

from defplan_mj.body.model import Body
from defplan_mj.log.plotting import FAINT, INK, SERIES, new_figure, styled, view
from defplan_mj.report.figures.drawing import draw_surface

_ENDINGS = {
    "success": "#3f9b6c",
    "collision": "#b5443c",
    "fall": "#8a4f9e",
    "timeout": "#d98a1f",
    "not run": "#9aa1a8",
}


def colour(i: int) -> str:
    """Return the colour of the i-th of several methods or tasks."""
    return SERIES[i % len(SERIES)]


@styled
def intervals_figure(
    groups: Mapping[str, Mapping[str, tuple[float, float, float]]], label: str, percent: bool = True
) -> Figure:
    """Return a dot with its interval for each method, tasks one below the other.

    Args:
        groups: (centre, low, high) by task and method.
        label: of the axis.
    """
    count = sum(len(methods) for methods in groups.values())
    figure, grid = new_figure(6.4, 0.7 + 0.24 * (count + len(groups)))
    axes = grid[0, 0]
    names = list(dict.fromkeys(name for methods in groups.values() for name in methods))
    factor, place, ticks = (100.0 if percent else 1.0), 0.0, []
    for task, methods in groups.items():
        axes.text(
            0.0, place, task, transform=axes.get_yaxis_transform(), fontweight="bold", va="center"
        )
        place -= 1
        for name, (centre, low, high) in methods.items():
            shade = colour(names.index(name))
            if np.isfinite([low, high]).all():
                axes.plot(
                    [factor * low, factor * high], [place, place], color=shade, lw=2.2, alpha=0.5
                )
            axes.plot(factor * centre, place, "o", color=shade, ms=5)
            ticks.append((place, name))
            place -= 1
    axes.set_yticks([at for at, _ in ticks], [name for _, name in ticks])
    axes.set_ylim(place + 0.4, 0.7)
    axes.set_xlabel(label)
    if percent:
        axes.set_xlim(-2, 102)
    axes.grid(axis="x", color=FAINT, alpha=0.25, lw=0.6)
    return figure


@styled
def profile_figure(taus: np.ndarray, shares: Mapping[str, np.ndarray], label: str) -> Figure:
    """Return performance profiles: a step line a solver, over the ratio to the best one."""
    figure, grid = new_figure(4.6, 2.9)
    axes = grid[0, 0]
    end = max(2.0, 1.15 * float(taus[-1]))
    for i, (name, share) in enumerate(shares.items()):
        x, y = np.append(taus, end), np.append(share, share[-1])
        axes.step(x, y, where="post", color=colour(i), label=name)
    axes.set_xscale("log")
    axes.set(
        xlabel=f"{label}, times the best solver's", ylabel="share of problems", ylim=(-0.03, 1.05)
    )
    axes.set_xlim(1, end)
    axes.legend(loc="lower right")
    return figure


@styled
def scatter_figure(points: Mapping[str, Sequence[tuple[float, float]]], title: str) -> Figure:
    """Return the re-simulated objective over the solver's seconds, a dot a run."""
    figure, grid = new_figure(4.6, 2.9)
    axes = grid[0, 0]
    for i, (name, pairs) in enumerate(points.items()):
        x, y = np.array(pairs, float).reshape(-1, 2).T
        axes.scatter(x, y, s=22, color=colour(i), label=name, alpha=0.85, lw=0)
    axes.set_xscale("log")
    values = np.array([y for pairs in points.values() for _, y in pairs])
    if len(values) and values.min() > 0 and values.max() > 20 * values.min():
        axes.set_yscale("log")
    axes.set(xlabel="seconds of the solver", ylabel="objective, re-simulated")
    axes.set_title(title, loc="left")
    axes.legend(loc="best")
    return figure


@styled
def endings_figure(shares: Mapping[str, Mapping[str, float]]) -> Figure:
    """Return how episodes end: a bar a method, its parts the endings."""
    figure, grid = new_figure(6.4, 0.8 + 0.28 * len(shares))
    axes = grid[0, 0]
    places = -np.arange(len(shares))
    left = np.zeros(len(shares))
    for ending, shade in _ENDINGS.items():
        width = 100 * np.array([share.get(ending, 0.0) for share in shares.values()])
        if width.any():
            axes.barh(places, width, left=left, height=0.7, color=shade, label=ending, lw=0)
        left += width
    axes.set_yticks(places, list(shares))
    axes.set(xlabel="of all episodes that were asked for (%)", xlim=(0, 100))
    figure.legend(loc="outside upper left", ncols=5)
    return figure


@styled
def moving_figure(
    curves: Mapping[str, Sequence[tuple[float, float, float, float]]], title: str
) -> Figure:
    """Return success over the speed of obstacles (the paper's Fig. 6): (speed, centre, low, high) by method."""
    figure, grid = new_figure(4.6, 2.8)
    axes = grid[0, 0]
    for i, (name, points) in enumerate(curves.items()):
        speed, centre, low, high = np.array(points, float).T
        axes.fill_between(speed, 100 * low, 100 * high, color=colour(i), alpha=0.15, lw=0)
        axes.plot(speed, 100 * centre, color=colour(i), marker="o", ms=4, label=name)
    axes.set(xlabel="speed of the obstacles (m/s)", ylabel="success (%)", ylim=(-2, 103))
    axes.set_title(title, loc="left")
    axes.legend(loc="lower left")
    return figure


@styled
def robot_figure(body: Body, name: str) -> Figure:
    """Return a picture of a robot: its surface at rest."""
    figure, grid = new_figure(3.0, 2.1)
    axes = grid[0, 0]
    draw_surface(axes, body.vertices, body.faces, view(-60, 22))
    axes.set_title(name, color=INK)
    return figure
