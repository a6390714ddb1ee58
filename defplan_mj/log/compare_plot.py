"""The figure of a comparison: where cycles end, how large the errors are, where chaining leads."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from defplan_mj.base.space import PLANE, SPACE, SPACES
from defplan_mj.log.compare import SETTLING, Comparison, gaits_used
from defplan_mj.log.plotting import (
    FAINT,
    INK,
    PATH,
    SERIES,
    draw_triad,
    label_of,
    new_figure,
    styled,
    view,
)

Panel = Callable[[Axes, Comparison], None]


@styled
def comparison_figure(comparison: Comparison) -> Figure:
    """Return the figure that `defplan compare` writes."""
    panels = PANELS[comparison.space]
    figure, axes = new_figure(9.5, 3.1 * -(-len(panels) // 2), -(-len(panels) // 2), 2)
    for place in axes.flat[len(panels) :]:
        place.set_axis_off()
    for panel, place in zip(panels, axes.flat, strict=False):
        panel(place, comparison)
    return figure


@styled
def comparison_figures(comparison: Comparison) -> list[Figure]:
    """Return the same, a figure a panel."""
    figures = []
    for panel in PANELS[comparison.space]:
        figure, axes = new_figure(4.6, 3.0)
        panel(axes[0, 0], comparison)
        figures.append(figure)
    return figures


def draw_from_above(axes: Axes, comparison: Comparison) -> None:
    """Draw the displacements of planar cycles, forward being up."""
    draw_displacements(axes, comparison, np.array([[0, -1, 0], [1, 0, 0]]))
    axes.set(xlabel="to the right (m)", ylabel="forward (m)", title="Displacement in one cycle")


def draw_along_y(axes: Axes, comparison: Comparison) -> None:
    """Draw the displacements of spatial cycles in the body frame's x and z."""
    draw_displacements(axes, comparison, np.array([[1, 0, 0], [0, 0, 1]]))
    axes.set(xlabel="body x (m)", ylabel="body z (m)", title="Displacement in one cycle: x, z")


def draw_along_x(axes: Axes, comparison: Comparison) -> None:
    """Draw the displacements of spatial cycles in the body frame's y and z."""
    draw_displacements(axes, comparison, np.array([[0, 1, 0], [0, 0, 1]]))
    axes.set(xlabel="body y (m)", ylabel="body z (m)", title="Displacement in one cycle: y, z")


def draw_displacements(axes: Axes, comparison: Comparison, plane: np.ndarray) -> None:
    """Draw where the body is after each cycle, seen from its start: truth, and prediction.

    Args:
        plane: (2, 3) what of a displacement goes to the right and up.
    """
    for k in gaits_used(comparison):
        colour, name = SERIES[k % len(SERIES)], label_of(comparison.task_names[k])
        some = comparison.gait == k
        for which, face in ((comparison.settled, colour), (~comparison.settled, "none")):
            truth = comparison.truth[some & which] @ plane.T
            label = name if face == colour else None
            axes.scatter(
                truth[:, 0],
                truth[:, 1],
                s=9,
                c=face,
                edgecolors=colour,
                lw=0.6,
                alpha=0.6,
                label=label,
            )
        predicted = plane @ comparison.predicted[some].mean(0)
        axes.scatter(predicted[0], predicted[1], s=70, marker="+", color=colour, lw=1.8)
    axes.scatter([], [], s=9, c="none", edgecolors=INK, lw=0.6, label=f"first {SETTLING} cycles")
    axes.scatter([0], [0], s=24, marker="o", color=INK, zorder=3)
    axes.scatter([], [], s=50, marker="+", color=INK, label="surrogate")
    axes.set_aspect("equal", adjustable="datalim")
    axes.legend(loc="best")


def draw_chained(axes: Axes, comparison: Comparison) -> None:
    """Draw the first log's true path beside the surrogate's own, chained from the start."""
    episode = comparison.episodes[0]
    spatial = not SPACES[comparison.space].level
    seen = view() if spatial else np.eye(3)
    truth, chained = ((p[:, :3] - episode.truth[0, :3] * spatial) @ seen[:2].T
                      for p in (episode.truth, episode.chained))  # fmt: skip
    axes.plot(*truth.T, color=PATH, marker="o", ms=2.5, label="reduced dynamics")
    axes.plot(*chained.T, color=INK, ls="--", lw=1.1, label="surrogate, chained")
    ends = np.stack([truth[-1], chained[-1]])
    axes.plot(*ends.T, color=FAINT, lw=0.8, label=f"drift {episode.drift:.2f} m")
    axes.set(xlabel="x (m)", ylabel="y (m)", title=f"Path of {label_of(episode.path.stem)}")
    axes.set_aspect("equal", adjustable="datalim")
    if spatial:
        draw_triad(axes, seen, 0.25 * float(np.ptp(truth, axis=0).max()))
    axes.legend(loc="best")


def draw_position_errors(axes: Axes, comparison: Comparison) -> None:
    """Draw the distances between prediction and truth after one cycle."""
    _draw_errors(axes, comparison, comparison.position, "position error (m)")


def draw_turning_errors(axes: Axes, comparison: Comparison) -> None:
    """Draw the errors of heading or attitude after one cycle."""
    _draw_errors(axes, comparison, comparison.turning, f"{comparison.turning_name} error (rad)")


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
    names = [
        f"{label_of(comparison.task_names[k])} ({len(s)})"
        for k, s in zip(used, samples, strict=True)
    ]
    axes.set_yticks(range(1, len(used) + 1), names)
    axes.invert_yaxis()
    axes.axvline(0, color=FAINT, lw=0.8)
    axes.set(xlabel=label)


_ERRORS: tuple[Panel, ...] = (draw_chained, draw_position_errors, draw_turning_errors)
PANELS: dict[str, tuple[Panel, ...]] = {
    PLANE.name: (draw_from_above, *_ERRORS),
    SPACE.name: (draw_along_y, draw_along_x, *_ERRORS),
}
"""Space -> what the figure shows."""
