"""Figures of the second stage: training curves (the paper's Fig. 5) and logged episodes (Fig. 6)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from defplan_mj.dynamics.reduced import ReducedDynamics
from defplan_mj.log.plotting import FAINT, INK, OBSTACLE, PATH, SERIES, TARGET, new_figure, styled
from defplan_mj.log.reader import EpisodeLog
from defplan_mj.report.gait_figures import Place, draw_bodies, draw_path, flat

_ABSCISSAE = {"transitions": "transitions", "iterations": "iterations", "seconds": "seconds"}
_REWARD = "#c8392b"  # the paper's red mean, on grey from minimum to maximum


@styled
def reward_figure(curves: Mapping[str, np.ndarray]) -> Figure | None:
    """Return minimum, mean and maximum reward over the training; None if it was not kept."""
    mean = next((name for name in curves if name.endswith("reward_mean")), None)
    if mean is None:
        return None
    figure, grid = new_figure(4.6, 2.8)
    axes = grid[0, 0]
    x, label = _abscissa(curves, len(curves[mean]))
    low, high = (curves.get(mean.replace("_mean", end)) for end in ("_min", "_max"))
    if low is not None and high is not None:
        axes.fill_between(x, low, high, color=FAINT, alpha=0.35, lw=0, label="minimum to maximum")
    axes.plot(x, curves[mean], color=_REWARD, label="mean")
    axes.set(xlabel=label, ylabel="reward of an episode")
    axes.legend(loc="lower right")
    return figure


@styled
def success_figure(curves: Mapping[str, np.ndarray]) -> Figure | None:
    """Return the success rates over the training; None if they were not kept."""
    names = [name for name in curves if name.endswith("success")]
    if not names:
        return None
    figure, grid = new_figure(4.6, 2.8)
    axes = grid[0, 0]
    for i, name in enumerate(names):
        x, label = _abscissa(curves, len(curves[name]))
        text = name.removesuffix("success").strip("_").replace("_", " ") or "success"
        axes.plot(x, 100 * curves[name], color=SERIES[i % len(SERIES)], label=text)
    axes.set(xlabel=label, ylabel="episodes that succeed (%)", ylim=(-2, 103))
    axes.legend(loc="lower right")
    return figure


def _abscissa(curves: Mapping[str, np.ndarray], length: int) -> tuple[np.ndarray, str]:
    """Return what curves of a length are drawn over."""
    for name, label in _ABSCISSAE.items():
        if name in curves and len(curves[name]) == length:
            return curves[name], label
    return np.arange(length), "checkpoint"


@styled
def rates_figure(rates: Sequence[tuple[str, float, tuple[float, float]]]) -> Figure:
    """Return success rates as dots with their 95% intervals, from (label, rate, interval) each."""
    figure, grid = new_figure(4.6, 0.8 + 0.32 * len(rates))
    axes = grid[0, 0]
    for row, (_, rate, (low, high)) in enumerate(rates):
        axes.plot([100 * low, 100 * high], [row, row], color=PATH, lw=2.2, solid_capstyle="round")
        axes.scatter([100 * rate], [row], s=36, color=PATH, zorder=3)
    axes.set_yticks(range(len(rates)), [label for label, *_ in rates])
    axes.invert_yaxis()
    axes.set(xlabel="success (%)", xlim=(min(50, *(100 * r[2][0] - 2 for r in rates)), 101))
    axes.grid(axis="x", color=FAINT, alpha=0.3, lw=0.6)
    return figure


@styled
def episode_figure(log: EpisodeLog, dynamics: ReducedDynamics) -> Figure:
    """Return one episode from above, turned so that the way leads to the right.

    Path green, obstacles blue, target red, bodies on the way.
    """
    figure, grid = new_figure(4.6, 2.9)
    axes = grid[0, 0]
    start = log.states[0, :2]
    x, y = log.scene.target[:2] - start
    turn = np.array([[x, y], [-y, x]]) / np.hypot(x, y)

    def place(points: np.ndarray) -> np.ndarray:
        return (points[..., :2] - start) @ turn.T

    draw_scene(axes, log, place)
    draw_path(axes, place(log.states))
    draw_bodies(axes, dynamics, log.states, 1.8 * dynamics.body.length, INK, place)
    hit = place(log.states[1:][log.clearance < 0])
    if len(hit):
        axes.scatter(hit[0, 0], hit[0, 1], s=60, marker="x", color=TARGET, zorder=6)
    axes.set(xlabel="towards the target (m)", ylabel="to the left (m)")
    cycles = f", {len(log.gait_index)} cycles" if log.outcome else ""
    axes.set_title(f"{log.path.stem}: {log.outcome or log.fault}{cycles}", loc="left")
    axes.set_aspect("equal", adjustable="datalim")
    axes.autoscale_view()
    return figure


def draw_scene(axes: Axes, log: EpisodeLog, place: Place = flat, faint: bool = False) -> None:
    """Draw target and obstacles; moving ones where they are at the end, with their way as a line."""
    scene, end = log.scene, float(log.time[-1])
    x, y = place(scene.target)
    axes.add_patch(Circle((x, y), scene.goal_radius, color=TARGET, alpha=0.25, lw=0))
    axes.scatter(x, y, s=22, color=TARGET, zorder=5)
    first, last = place(scene.centres), place(scene.centres + scene.velocities * end)
    for a, b, radius, velocity in zip(first, last, scene.radii, scene.velocities, strict=True):
        alpha = 0.4 if faint else 0.85
        axes.add_patch(Circle((b[0], b[1]), radius, color=OBSTACLE, alpha=alpha, lw=0))
        if velocity.any() and not faint:
            axes.add_patch(Circle((a[0], a[1]), radius, fill=False, ec=OBSTACLE, lw=0.7, ls=":"))
            axes.plot([a[0], b[0]], [a[1], b[1]], color=OBSTACLE, lw=0.7, ls=":")


@styled
def overview_figure(logs: Sequence[EpisodeLog]) -> Figure:
    """Return many episodes in one picture: how the paths fan out to their targets."""
    figure, grid = new_figure(4.6, 4.2)
    axes = grid[0, 0]
    for log in logs:
        draw_scene(axes, log, faint=True)
    for log in logs:
        draw_path(axes, log.states[:, :2])
    x, y = logs[0].states[0, :2]
    axes.scatter(x, y, s=18, color=INK, zorder=6)
    axes.set(xlabel="x (m)", ylabel="y (m)")
    axes.set_aspect("equal", adjustable="datalim")
    axes.autoscale_view()
    return figure
