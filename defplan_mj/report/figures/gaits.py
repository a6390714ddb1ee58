"""Figures of gaits: target shapes over two cycles, and where the body goes (the paper's Fig. 4)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from defplan_mj.base.space import SPACES
from defplan_mj.dynamics.reduced import ReducedDynamics
from defplan_mj.gait.gait import Gait, dmp
from defplan_mj.log.plotting import FAINT, INK, PATH, SERIES, label_of, new_figure, styled, view
from defplan_mj.report.figures.drawing import draw_surface, silhouette
from defplan_mj.report.figures.views import PICTURES, View

_SHADOW = "#9cc6cd"

TOGETHER = 6  # curves that can be told apart in one pair of axes
SHOWN = 6  # bodies in a row


@styled
def controls_figure(gait: Gait, task: int) -> Figure:
    """Return the target shape of every modal coordinate over two cycles of a task.

    Many of them have a line each, one below the other, all at one scale.
    """
    time = np.linspace(0, 2 * gait.cycle_seconds, 300)
    shapes = dmp(gait.alpha[task], gait.beta[task], gait.mu, gait.tau, time)
    curves = np.clip(shapes, -gait.amplitude, gait.amplitude).T
    names = [f"$\\bar u_{{{i + 1}}}$" for i in range(len(curves))]
    apart = len(curves) > TOGETHER
    figure, grid = new_figure(4.6, 0.7 + 0.26 * len(curves) if apart else 2.5)
    axes = grid[0, 0]
    bound = float(np.max(gait.amplitude))
    for i, curve in enumerate(curves):
        colour = SERIES[i % len(SERIES)]
        base = -2.1 * bound * i if apart else 0.0
        if apart:
            axes.axhline(base, color=FAINT, lw=0.5)
            axes.fill_between(time, base, base + curve, color=colour, alpha=0.25, lw=0)
        axes.plot(time, base + curve, color=colour, lw=1.0 if apart else 1.4, label=names[i])
    axes.axvline(gait.cycle_seconds, color=FAINT, lw=0.7, ls=":")
    axes.set_xlim(0, 2 * gait.cycle_seconds)
    axes.set(xlabel="time (s)")
    title = label_of(gait.task_names[task])
    if apart:
        axes.set_yticks([-2.1 * bound * i for i in range(len(curves))], names)
        axes.tick_params(axis="y", length=0)
        axes.set_ylim(-2.1 * bound * (len(curves) - 0.4), 1.2 * bound)
        axes.set_title(f"{title}; lines are {2.1 * bound:.1f} apart", fontweight="bold", loc="left")
    else:
        axes.set(ylabel="target shape (1)", ylim=(-1.08 * bound, 1.08 * bound))
        axes.set_title(title, fontweight="bold", loc="left")
        figure.legend(loc="outside right center", handlelength=1.2)
    return figure


def play(gait: Gait, task: int, dynamics: ReducedDynamics, steps: int = 200) -> np.ndarray:
    """Return the states (steps + 1, nx) of a task that is repeated from rest."""
    cycles = -(-steps // gait.steps_per_cycle)
    shapes = np.tile(gait.table()[task], (cycles, 1))[:steps]
    return dynamics.rollout_count(dynamics.rest_state(), shapes)[0]


@styled
def path_figures(
    gait: Gait, task: int, dynamics: ReducedDynamics, states: np.ndarray, space: str
) -> list[Figure]:
    """Return the path of the centre of mass over states of `play`, with the body's silhouette.

    In the plane from above, in space from two sides.
    """
    bodies = states_along(states, 1.3 * dynamics.body.length, space)
    ends = states[:: gait.steps_per_cycle, :3]
    figures = []
    for seen in PICTURES[space].path:
        figure, grid = new_figure(4.6, 2.9)
        axes = grid[0, 0]
        # a body that turns where it is would hide all of its path
        draw_path(axes, seen.place(states[:, :3]), over=PICTURES[space].turning)
        draw_bodies(axes, dynamics, bodies, seen)
        axes.scatter(*seen.place(ends).T, s=5, color=INK, zorder=5)
        name = f"{label_of(gait.task_names[task])}: {len(states) - 1} steps from rest"
        axes.set_title(name if seen.name == "from above" else f"{name}, {seen.name}", loc="left")
        seen.finish(axes, dynamics.body.length)
        figures.append(figure)
    return figures


@styled
def strip_figure(
    gait: Gait, task: int, dynamics: ReducedDynamics, states: np.ndarray, space: str
) -> Figure:
    """Return the body within one steady cycle of states of `play`; in space also cycle by cycle."""
    n = gait.steps_per_cycle
    first = min(3 * n, len(states) - 1 - n)
    rows = {"steps of a cycle": [round(first + n * i / SHOWN) for i in range(SHOWN)]}
    if PICTURES[space].turning:
        rows["after cycles"] = [n * i for i in range(min(SHOWN, (len(states) - 1) // n + 1))]
    figure, grid = new_figure(4.6, 1.1 * len(rows) + 0.2, len(rows), 1)
    walks = dynamics.world.walks  # seen level, all standing feet are on the ground's line
    rotation = view(-70, 0 if walks else 12)
    for axes, (label, chosen) in zip(grid[:, 0], rows.items(), strict=True):
        bodies = [(dynamics.surface(states[i]) - states[i][:3]) for i in chosen]
        if walks:
            bodies = [body + [0, 0, states[i][2]] for body, i in zip(bodies, chosen, strict=True)]
            axes.axhline(0, color=FAINT, lw=0.7)
        seen = np.concatenate([body @ rotation.T for body in bodies])[:, :2]
        low, high = seen.min(0), seen.max(0)
        gap = 1.05 * (high - low)[0]
        for column, (i, points) in enumerate(zip(chosen, bodies, strict=True)):
            draw_surface(
                axes, points + column * gap * rotation[0], dynamics.body.surface_faces, rotation
            )
            number = i // n if label == "after cycles" else i - first
            axes.annotate(
                str(number), (column * gap, low[1]), xytext=(0, -4), textcoords="offset points",
                ha="center", va="top", fontsize=7, color=FAINT,
            )  # fmt: skip
        axes.set_xlim(low[0] - 0.05 * gap, high[0] + (SHOWN - 1) * gap + 0.05 * gap)
        axes.set_ylim(low[1] - 0.3 * gap, high[1] + 0.05 * gap)
        axes.set_title(f"{label_of(gait.task_names[task])}, {label}", loc="left", fontsize=8)
    return figure


@styled
def history_figure(history: Sequence[float]) -> Figure:
    """Return a solver's objective over its iterations."""
    figure, grid = new_figure(4.6, 2.4)
    axes = grid[0, 0]
    values = np.asarray(history, float)
    best = np.minimum.accumulate(values)
    axes.plot(values, color=SERIES[0], lw=1.0)
    axes.plot(best, color=INK, lw=0.9, ls=":")
    # line searches may try costs far above all others
    low, high = best[-1], np.percentile(values, 90)
    axes.set_ylim(low - 0.08 * (high - low) - 1e-9, high + 0.3 * (high - low) + 1e-9)
    axes.set(xlabel="iteration", ylabel="objective (1)")
    return figure


def draw_path(axes: Axes, path: np.ndarray, over: bool = False) -> None:
    """Draw the (n, 2) path of a centre of mass, below the bodies on it or over them."""
    axes.plot(*path.T, color=PATH, lw=1.6, zorder=4.8 if over else 4)


def states_along(states: np.ndarray, spacing: float, space: str) -> list[np.ndarray]:
    """Return the last state and others at least `spacing` (m) apart; in the plane, horizontally."""
    d = SPACES[space].dimension
    chosen = [states[-1]]
    for x in states:
        if min(np.linalg.norm(x[:d] - other[:d]) for other in chosen) >= spacing:
            chosen.append(x)
    return chosen


def draw_bodies(
    axes: Axes,
    dynamics: ReducedDynamics,
    states: Sequence[np.ndarray],
    seen: View,
    colour: str = _SHADOW,
) -> None:
    """Draw the body's silhouette in each of some states."""
    rows = dynamics.body.surface_faces
    for x in states:
        silhouette(axes, seen.place(dynamics.surface(x)), rows, colour)
    axes.autoscale_view()
