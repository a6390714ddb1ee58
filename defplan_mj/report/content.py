"""What a report is made of: sections of texts, tables and figures, as plain data for the template."""

from __future__ import annotations

import base64
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure as Drawing
from PIL import Image

from defplan_mj.log.plotting import FAINT, INK, OBSTACLE, PATH, SERIES, render_figure


@dataclass(frozen=True)
class Figure:
    """A picture inside the page.

    Attributes:
        source: data URI.
        caption: what one sees; '' inside `Figures`, which have one for all.
        alt: what this picture shows, for who does not see it.
    """

    source: str
    caption: str
    alt: str = ""
    kind: str = "figure"


@dataclass(frozen=True)
class Figures:
    """Figures side by side where there is room, with one caption."""

    figures: Sequence[Figure]
    caption: str
    kind: str = "figures"


@dataclass(frozen=True)
class Video:
    """A video inside the page.

    Attributes:
        source: data URI (MP4).
        caption: what one sees.
    """

    source: str
    caption: str
    kind: str = "video"


@dataclass(frozen=True)
class Table:
    """A table; the first column is text, the others numbers."""

    columns: Sequence[str]
    rows: Sequence[Sequence[str]]
    caption: str = ""
    kind: str = "table"


@dataclass(frozen=True)
class Text:
    """A paragraph."""

    text: str
    kind: str = "text"


@dataclass(frozen=True)
class Code:
    """A command line."""

    text: str
    kind: str = "code"


@dataclass(frozen=True)
class Missing:
    """What is not there yet, or cannot be read, and what mends it."""

    text: str
    kind: str = "missing"


Block = Figure | Figures | Video | Table | Text | Code | Missing


@dataclass
class Section:
    """A heading with what stands below it.

    Attributes:
        name: of its anchor.
        title: the heading.
        blocks: what stands below it, in this order.
        template: of `report/templates`, that draws it.
    """

    name: str
    title: str
    blocks: list[Block] = field(default_factory=list)
    template: str = "section.html"


@dataclass(frozen=True)
class Fact:
    """One of the large figures at the top."""

    value: str
    label: str
    detail: str = ""


def drawing(figure: Drawing, caption: str = "", shaded: bool = False) -> Figure:
    """Return a plot as a figure of the page: sharp lines without a background, for light and dark pages.

    Args:
        shaded: its surfaces are pictures of few colours inside; thousands of triangles would be too much.
    """
    if shaded:
        for axes in figure.axes:
            for surface in axes.collections:
                surface.set_rasterized(True)
    drawn = render_figure(figure, "svg", 140, transparent=True).decode()
    drawn = re.sub(r'(data:image/png;base64,)([^"]+)', _fewer_colours, drawn)
    opening = drawn.index(">", drawn.index("<svg")) + 1
    drawn = f"{drawn[:opening]}<style>{_DARK}</style>{drawn[opening:]}"
    return Figure(_uri(drawn.encode(), "image/svg+xml"), caption, describe(figure))


def describe(figure: Drawing) -> str:
    """Return what a plot shows, in words: its titles, axes and lines."""
    parts = [] if figure.get_suptitle() == "" else [figure.get_suptitle()]
    for axes in figure.axes:
        x, y = axes.get_xlabel(), axes.get_ylabel()
        parts += [title for title in (axes.get_title(), axes.get_title("left")) if title]
        if x and y and axes.axison:
            parts.append(f"{y} over {x}")
        elif x and axes.axison:
            parts.append(x)
        names = axes.get_legend_handles_labels()[1]
        if names:
            parts.append(", ".join(names))
    text = "; ".join(dict.fromkeys(parts))
    return text.replace("$", "").replace("\\bar ", "").replace("{", "").replace("}", "")


def video(path: Path, caption: str) -> Video:
    """Return an MP4 file as a video of the page."""
    return Video(_uri(path.read_bytes(), "video/mp4"), caption)


_DARK_COLOURS = {
    INK: "#e4e7e8",
    FAINT: "#8a9399",
    PATH: "#57c48a",
    OBSTACLE: "#6f93db",
    **dict(zip(SERIES, ("#82a4e6", "#e6a64a", "#c394d6", "#5fc18e", "#e2736a", "#a2b3c1"), strict=True)),
}  # fmt: skip
_DARK = (
    "@media (prefers-color-scheme: dark) {"
    + "".join(
        f'[style*="{what}: {light}"] {{ {what}: {dark} !important }}'
        for light, dark in _DARK_COLOURS.items()
        for what in ("fill", "stroke")
    )
    + "}"
)
"""Inside each drawing: on a dark page, its dark lines are light."""


def _fewer_colours(match: re.Match[str]) -> str:
    """Return an embedded PNG with at most 256 colours: a third of the size, and no difference to see."""
    stream = BytesIO()
    with Image.open(BytesIO(base64.b64decode(match[2]))) as image:
        few = image.convert("RGBA").quantize(256, method=Image.Quantize.FASTOCTREE)
        few.save(stream, "png", optimize=True)
    return match[1] + base64.b64encode(stream.getvalue()).decode()


def _uri(data: bytes, kind: str) -> str:
    return f"data:{kind};base64,{base64.b64encode(data).decode()}"


def number(value: float | None, digits: int = 3) -> str:
    """Return a number for a table; a dash if there is none."""
    if value is None or not np.isfinite(value):
        return "–"
    return f"{value:.{digits}f}"


def mean_sd(mean: float | None, sd: float | None, digits: int = 3) -> str:
    """Return 'mean ± sd'."""
    if mean is None or sd is None:
        return number(mean, digits)
    return f"{number(mean, digits)} ± {number(sd, digits)}"


def duration(seconds: float | None) -> str:
    """Return a time span in the unit that suits it."""
    if seconds is None:
        return "–"
    if seconds < 1:
        return f"{1000 * seconds:.3g} ms" if seconds >= 1e-3 else f"{1e6 * seconds:.3g} µs"
    if seconds < 600:
        return f"{seconds:.1f} s"
    return f"{seconds / 60:.0f} min" if seconds < 3600 else f"{seconds / 3600:.1f} h"


def percent(share: float) -> str:
    """Return a share as a percentage."""
    return f"{100 * share:.1f}%".replace(".0%", "%")
