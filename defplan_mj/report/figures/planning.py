"""Figures of the second stage: training curves (the paper's Fig. 5) and logged episodes (Fig. 6)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from matplotlib.ticker import EngFormatter, MaxNLocator

from defplan_mj.dynamics.reduced import ReducedDynamics
from defplan_mj.log.plotting import (
    FAINT,
    INK,
    OBSTACLE,
    PATH,
    SERIES,
    TARGET,
    label_of,
    new_figure,
    styled,
)
from defplan_mj.log.reader import EpisodeLog
from defplan_mj.planning.outcome import SCENES
from defplan_mj.report.figures.gaits import draw_bodies, draw_path, states_along
from defplan_mj.report.figures.views import PICTURES, View, episode_views

_ABSCISSAE = {"transitions": "transitions", "iterations": "iterations", "seconds": "time (s)"}
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
    axes.set(xlabel=label, ylabel="reward of an episode (m$^2$)", xlim=(0, None))
    _few_ticks(axes)
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
        text = label_of(SCENES.get(text, text))
        axes.plot(x, 100 * curves[name], color=SERIES[i % len(SERIES)], label=text)
    axes.set(xlabel=label, ylabel="episodes that succeed (%)", ylim=(-2, 103))
    axes.set_xlim(0, None)
    _few_ticks(axes)
    axes.legend(loc="lower right")
    return figure


def _few_ticks(axes: Axes) -> None:
    """Label so few numbers along x that they do not overlap, large ones as 20k or 1M."""
    axes.xaxis.set_major_locator(MaxNLocator(6))
    axes.xaxis.set_major_formatter(EngFormatter(sep=""))


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
        # not clipped: whole at 100%, too
        axes.scatter([100 * rate], [row], s=36, color=PATH, zorder=3, clip_on=False)
    axes.set_yticks(range(len(rates)), [label for label, *_ in rates])
    axes.invert_yaxis()
    axes.set(xlabel="success (%)", xlim=(min(50, *(100 * r[2][0] - 2 for r in rates)), 101))
    axes.grid(axis="x", color=FAINT, alpha=0.3, lw=0.6)
    return figure


@styled
def episode_figures(log: EpisodeLog, dynamics: ReducedDynamics) -> list[Figure]:
    """Return one episode from above, or in space from four sides; see `views.episode_views`.

    Path green, obstacles blue, target red, bodies on the way.
    """
    cycles = f", {len(log.gait_index)} cycles" if log.outcome else ""
    title = f"{log.path.stem}: {log.outcome or log.fault}{cycles}"
    bodies = states_along(log.states, 1.8 * dynamics.body.length, log.space)
    views = episode_views(log.states[0, :3], log.scene.target, log.space)
    way = float(np.linalg.norm(log.scene.target - log.states[0, :3]))
    figures = []
    for view in views:
        figure, grid = new_figure(4.6, 2.9)
        axes = grid[0, 0]
        draw_scene(axes, log, view)
        draw_path(axes, view.place(log.states[:, :3]))
        draw_bodies(axes, dynamics, bodies, view, INK)
        hit = view.place(log.states[1:, :3][log.clearance < 0])
        if len(hit):
            axes.scatter(hit[0, 0], hit[0, 1], s=60, marker="x", color=TARGET, zorder=6)
        axes.set_title(label_of(title) if view is views[0] else view.name, loc="left")
        view.finish(axes, 0.15 * way)
        figures.append(figure)
    return figures


def draw_scene(axes: Axes, log: EpisodeLog, view: View, faint: bool = False) -> None:
    """Draw target and obstacles; moving ones where they are at the end, with their way as a line.

    Seen in parallel, a sphere is a circle from everywhere; a cylinder is one from above only.
    """
    scene, end = log.scene, float(log.time[-1])
    place, solid = view.place, PICTURES[log.space].solid
    x, y = place(scene.target)
    if not view.labels:  # an oblique view: where the target's foot is, level with the start
        foot = np.append(scene.target[:2], log.states[0, 2])
        lines = place(np.stack([log.states[0, :3], foot, scene.target]))
        axes.plot(*lines.T, color=FAINT, lw=0.6, ls=":", zorder=1)
    axes.add_patch(Circle((x, y), scene.goal_radius, color=TARGET, alpha=0.25, lw=0))
    axes.scatter(x, y, s=22, color=TARGET, zorder=5)
    first, last = place(scene.centres), place(scene.centres + scene.velocities * end)
    for a, b, radius, velocity in zip(first, last, scene.radii, scene.velocities, strict=True):
        alpha = 0.45 * solid if faint else solid
        axes.add_patch(Circle((b[0], b[1]), radius, color=OBSTACLE, alpha=alpha, lw=0))
        if velocity.any() and not faint:
            axes.add_patch(Circle((a[0], a[1]), radius, fill=False, ec=OBSTACLE, lw=0.7, ls=":"))
            axes.plot([a[0], b[0]], [a[1], b[1]], color=OBSTACLE, lw=0.7, ls=":")


@styled
def overview_figures(logs: Sequence[EpisodeLog]) -> list[Figure]:
    """Return many episodes in one picture a view: how the paths fan out to their targets."""
    figures = []
    farthest = max(float(np.linalg.norm(log.scene.target)) for log in logs)
    views = PICTURES[logs[0].space].world
    for view in views:
        figure, grid = new_figure(4.6, 4.2)
        axes = grid[0, 0]
        for log in logs:
            draw_scene(axes, log, view, faint=True)
        for log in logs:
            draw_path(axes, view.place(log.states[:, :3]))
        x, y = view.place(logs[0].states[0, :3])
        axes.scatter(x, y, s=18, color=INK, zorder=6)
        if len(views) > 1:
            axes.set_title(view.name, loc="left")
        view.finish(axes, 0.3 * farthest)
        figures.append(figure)
    return figures


@styled
def moving_figure(rows: Sequence[Mapping[str, Any]]) -> Figure:
    """Return the success rate over the obstacles' speed, with 95% intervals (the paper's Fig. 6)."""
    figure, grid = new_figure(4.6, 2.8)
    axes = grid[0, 0]
    speed = np.array([row["speed"] for row in rows])
    rate = 100 * np.array([row["success"] for row in rows])
    low, high = 100 * np.array([row["interval"]["success"] for row in rows]).T
    axes.fill_between(speed, low, high, color=PATH, alpha=0.2, lw=0, label="95% interval")
    axes.plot(speed, rate, color=PATH, marker="o", ms=4, label="success")
    axes.set(xlabel="speed of the obstacles (m/s)", ylabel="success (%)", ylim=(-2, 103))
    axes.set_xlim(-0.03 * speed.max(), 1.03 * speed.max())
    axes.xaxis.set_major_locator(MaxNLocator(6))
    axes.legend(loc="lower left")
    return figure
