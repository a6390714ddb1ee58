"""Figures without a screen: one look for all plots, and atomic writing."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from defplan_mj.base import files
from defplan_mj.base.errors import DefplanError
from defplan_mj.base.printable import printable

INK, FAINT = "#2b2f33", "#9aa1a8"
PATH, OBSTACLE, TARGET, BODY = "#2e8b57", "#4a6fb5", "#c8392b", "#1f7a8c"
"""Paths are green, obstacles blue, targets red, as in the paper's Fig. 6."""
SERIES = ("#3b5b92", "#d98a1f", "#8a4f9e", "#3f9b6c", "#b5443c", "#5a6b7a")
"""Colours of gaits or modal coordinates, in their order."""

STYLE: Any = {
    "font.size": 9,
    "axes.titlesize": 9,
    "axes.labelsize": 9,
    "axes.edgecolor": FAINT,
    "axes.labelcolor": INK,
    "axes.linewidth": 0.8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "xtick.color": INK,
    "ytick.color": INK,
    "text.color": INK,
    "legend.frameon": False,
    "legend.fontsize": 8,
    "lines.linewidth": 1.4,
    "figure.facecolor": "white",
    "axes.facecolor": "white",
    "savefig.facecolor": "white",
    "svg.hashsalt": "defplan",  # the same figure gives the same file
}


def label_of(text: str) -> str:
    """Return a name as matplotlib can draw it, whatever is in it: no formula, nothing that steers."""
    return printable(text).replace("\\", "\\\\").replace("$", r"\$")


styled = matplotlib.rc_context(STYLE)
"""Decorator of functions that draw: they do it in our style."""


@styled
def new_figure(
    width: float, height: float, rows: int = 1, columns: int = 1, **kwargs: Any
) -> tuple[Figure, Any]:
    """Return a figure of a size in inches and its axes, (rows, columns) of them.

    Drawn without pyplot, so that no screen is asked for.
    """
    figure = Figure(figsize=(width, height), layout="constrained")
    return figure, figure.subplots(rows, columns, squeeze=False, **kwargs)


def view(azimuth: float = -55.0, elevation: float = 25.0) -> np.ndarray:
    """Return the (3, 3) rotation whose rows are the view's right, up and towards the viewer.

    Args:
        azimuth: of the viewer, degrees from +x (the body's front) to +y (its left).
        elevation: of the viewer above the horizon, degrees.
    """
    a, e = np.deg2rad([azimuth, elevation])
    right = np.array([-np.sin(a), np.cos(a), 0.0])
    towards = np.array([np.cos(a) * np.cos(e), np.sin(a) * np.cos(e), np.sin(e)])
    return np.stack([right, np.cross(towards, right), towards])


def draw_triad(
    axes: Axes, rotation: np.ndarray, length: float, names: tuple[str, ...] = ("x", "y", "z")
) -> None:
    """Say what an oblique view shows: the world's axes from the origin, `length` long (m)."""
    axes.set_axis_off()
    axes.set_aspect("equal", adjustable="datalim")
    for name, (x, y) in zip(names, length * rotation[:2].T, strict=True):
        axes.plot([0, x], [0, y], color=FAINT, lw=1.0, zorder=1)
        axes.text(1.12 * x, 1.12 * y, name, color=FAINT, ha="center", va="center", fontsize=8)


def note(axes: Axes, text: str) -> None:
    """Write a sentence where a plot would be."""
    axes.text(0.5, 0.5, text, ha="center", va="center", color=FAINT, transform=axes.transAxes)


@styled
def render_figure(
    figure: Figure, kind: str = "png", dpi: int = 150, transparent: bool = False
) -> bytes:
    """Return a figure as the bytes of a PNG, SVG or PDF, on white or on nothing."""
    stream = BytesIO()
    dates = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}
    figure.savefig(stream, format=kind, dpi=dpi, metadata=dates.get(kind), transparent=transparent)
    return stream.getvalue()


def save_figure(figure: Figure, path: str | Path) -> None:
    """Write a figure to `path`, atomically; the name's ending says the format.

    Raises:
        DefplanError: an ending that is not PNG, SVG or PDF, or the file cannot be written.
    """
    kind = Path(path).suffix.lower().lstrip(".")
    if kind not in ("png", "svg", "pdf"):
        raise DefplanError(f"cannot write a figure as {path}: end its name in .png, .svg or .pdf")
    files.write_bytes(path, render_figure(figure, kind))
