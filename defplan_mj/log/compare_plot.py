"""The figure of a comparison: where cycles end, how large the errors are, where chaining leads."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from defplan_mj.log.compare import SETTLING, Comparison, gaits_used
from defplan_mj.log.plotting import FAINT, INK, PATH, SERIES, new_figure, styled

Panel = Callable[[Axes, Comparison], None]


@styled
def comparison_figure(comparison: Comparison) -> Figure:
    """Return the figure that `defplan compare` writes."""
    figure, axes = new_figure(9.5, 6.2, 2, 2)
    for panel, place in zip(PANELS, axes.flat, strict=True):
        panel(place, comparison)
    return figure


@styled
def comparison_figures(comparison: Comparison) -> list[Figure]:
    """Return the same, a figure a panel."""
    figures = []
    for panel in PANELS:
        figure, axes = new_figure(4.6, 3.0)
        panel(axes[0, 0], comparison)
        figures.append(figure)
    return figures


def draw_displacements(axes: Axes, comparison: Comparison) -> None:
    """Draw where the body is after each cycle, seen from its start: truth, and prediction."""
    for k in gaits_used(comparison):
        colour, name = SERIES[k % len(SERIES)], comparison.task_names[k]
        some = comparison.gait == k
        for which, face in ((comparison.settled, colour), (~comparison.settled, "none")):
            truth = comparison.truth[some & which]
            label = name if face == colour else None
            axes.scatter(
                -truth[:, 1],
                truth[:, 0],
                s=9,
                c=face,
                edgecolors=colour,
                lw=0.6,
                alpha=0.6,
                label=label,
            )
        predicted = comparison.predicted[some].mean(0)
        axes.scatter(-predicted[1], predicted[0], s=70, marker="+", color=colour, lw=1.8)
    axes.scatter([], [], s=9, c="none", edgecolors=INK, lw=0.6, label=f"first {SETTLING} cycles")
    axes.scatter([0], [0], s=24, marker="o", color=INK, zorder=3)
    axes.scatter([], [], s=50, marker="+", color=INK, label="surrogate")
    axes.set(xlabel="to the right (m)", ylabel="forward (m)", title="Displacement in one cycle")
    axes.set_aspect("equal", adjustable="datalim")
    axes.legend(loc="best")


def draw_chained(axes: Axes, comparison: Comparison) -> None:
    """Draw the first log's true path beside the surrogate's own, chained from the start."""
    episode = comparison.episodes[0]
    axes.plot(*episode.truth[:, :2].T, color=PATH, marker="o", ms=2.5, label="reduced dynamics")
    axes.plot(*episode.chained[:, :2].T, color=INK, ls="--", lw=1.1, label="surrogate, chained")
    ends = np.stack([episode.truth[-1, :2], episode.chained[-1, :2]])
    axes.plot(*ends.T, color=FAINT, lw=0.8, label=f"drift {episode.drift:.2f} m")
    axes.set(xlabel="x (m)", ylabel="y (m)", title=f"Path of {episode.path.stem}")
    axes.set_aspect("equal", adjustable="datalim")
    axes.legend(loc="best")


def draw_position_errors(axes: Axes, comparison: Comparison) -> None:
    """Draw the distances between prediction and truth after one cycle."""
    _draw_errors(axes, comparison, comparison.position, "position error (m)")


def draw_heading_errors(axes: Axes, comparison: Comparison) -> None:
    """Draw the heading errors after one cycle."""
    _draw_errors(axes, comparison, comparison.heading, "heading error (rad)")


def _draw_errors(axes: Axes, comparison: Comparison, errors: np.ndarray, label: str) -> None:
    """Draw the distribution of an error, gait by gait: every cycle a dot, the box its quartiles."""
    used = gaits_used(comparison)
    samples = [errors[comparison.gait == k] for k in used]
    axes.boxplot(
        samples,
        orientation="horizontal",
        widths=0.5,
        showfliers=False,
        medianprops={"color": INK, "lw": 1.6},
        boxprops={"color": FAINT},
        whiskerprops={"color": FAINT},
        capprops={"color": FAINT},
    )
    rng = np.random.default_rng(0)  # only to keep the dots apart
    for row, (k, sample) in enumerate(zip(used, samples, strict=True), 1):
        height = row + rng.uniform(-0.18, 0.18, len(sample))
        colour = SERIES[k % len(SERIES)]
        settled = comparison.settled[comparison.gait == k]
        for which, face in ((settled, colour), (~settled, "none")):
            axes.scatter(
                sample[which], height[which], s=9, c=face, edgecolors=colour, lw=0.6, alpha=0.5
            )
    names = [f"{comparison.task_names[k]} ({len(s)})" for k, s in zip(used, samples, strict=True)]
    axes.set_yticks(range(1, len(used) + 1), names)
    axes.invert_yaxis()
    axes.axvline(0, color=FAINT, lw=0.8)
    axes.set(xlabel=label)


PANELS: tuple[Panel, ...] = (
    draw_displacements,
    draw_chained,
    draw_position_errors,
    draw_heading_errors,
)
