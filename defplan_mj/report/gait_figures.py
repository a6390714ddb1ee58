"""Figures of gaits: target shapes over two cycles, and where the body goes (the paper's Fig. 4)."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from defplan_mj.dynamics.reduced import ReducedDynamics
from defplan_mj.gait.gait import Gait, dmp
from defplan_mj.log.plotting import FAINT, INK, PATH, SERIES, new_figure, styled
from defplan_mj.report.body_figures import surface_rows
from defplan_mj.report.drawing import silhouette

_SHADOW = "#9cc6cd"

Place = Callable[[np.ndarray], np.ndarray]


@styled
def controls_figure(gait: Gait, task: int) -> Figure:
    """Return the target shape of every modal coordinate over two cycles of a task."""
    figure, grid = new_figure(4.6, 2.5)
    axes = grid[0, 0]
    time = np.linspace(0, 2 * gait.cycle_seconds, 300)
    shapes = dmp(gait.alpha[task], gait.beta[task], gait.mu, gait.tau, time)
    for i, curve in enumerate(np.clip(shapes, -gait.amplitude, gait.amplitude).T):
        axes.plot(time, curve, color=SERIES[i % len(SERIES)], label=f"$\\bar u_{{{i + 1}}}$")
    axes.axvline(gait.cycle_seconds, color=FAINT, lw=0.7, ls=":")
    bound = 1.08 * float(np.max(gait.amplitude))
    axes.set(xlabel="time (s)", ylabel="target shape", ylim=(-bound, bound))
    axes.set_xlim(0, 2 * gait.cycle_seconds)
    axes.set_title(gait.task_names[task], fontweight="bold", loc="left")
    figure.legend(loc="outside right center", handlelength=1.2)
    return figure


@styled
def path_figure(gait: Gait, task: int, dynamics: ReducedDynamics, steps: int = 200) -> Figure:
    """Return the path of the centre of mass from rest, with the body's silhouette along it."""
    cycles = -(-steps // gait.steps_per_cycle)
    shapes = np.tile(gait.table()[task], (cycles, 1))[:steps]
    states, _ = dynamics.rollout_count(dynamics.rest_state(), shapes)
    figure, grid = new_figure(4.6, 2.9)
    axes = grid[0, 0]
    draw_path(axes, states[:, :2])
    draw_bodies(axes, dynamics, states, 1.3 * dynamics.body.length)
    ends = states[:: gait.steps_per_cycle, :2]
    axes.scatter(*ends.T, s=5, color=INK, zorder=5)
    axes.set(xlabel="x (m)", ylabel="y (m)")
    axes.set_title(f"{gait.task_names[task]}: {steps} steps from rest", loc="left")
    axes.set_aspect("equal", adjustable="datalim")
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
    axes.set(xlabel="iteration", ylabel="objective")
    return figure


def draw_path(axes: Axes, path: np.ndarray) -> None:
    """Draw the (n, 2) path of a centre of mass."""
    axes.plot(*path.T, color=PATH, lw=1.6, zorder=4)


def flat(points: np.ndarray) -> np.ndarray:
    """Return x and y of points (..., 3)."""
    return points[..., :2]


def draw_bodies(
    axes: Axes,
    dynamics: ReducedDynamics,
    states: np.ndarray,
    spacing: float,
    colour: str = _SHADOW,
    place: Place = flat,
) -> None:
    """Draw silhouettes along a path, at least `spacing` (m) apart from each other, and the last one.

    Args:
        place: maps world points (..., 3) to the plane of the drawing (..., 2), without mirroring.
    """
    rows = surface_rows(dynamics.body)
    chosen = [states[-1]]
    for x in states:
        if min(np.linalg.norm(x[:2] - other[:2]) for other in chosen) >= spacing:
            chosen.append(x)
    for x in chosen:
        silhouette(axes, place(dynamics.surface(x)), rows, colour)
    axes.autoscale_view()
