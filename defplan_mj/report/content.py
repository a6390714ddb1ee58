"""What a report is made of: sections of texts, tables and figures, as plain data for the template."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass, field
from io import BytesIO

import numpy as np
from matplotlib.figure import Figure as Drawing
from PIL import Image

from defplan_mj.log.plotting import render_figure


@dataclass(frozen=True)
class Figure:
    """A picture inside the page.

    Attributes:
        source: data URI.
        caption: what one sees; '' inside `Figures`, which have one for all.
    """

    source: str
    caption: str
    kind: str = "figure"


@dataclass(frozen=True)
class Figures:
    """Figures side by side where there is room, with one caption."""

    figures: Sequence[Figure]
    caption: str
    kind: str = "figures"


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


Block = Figure | Figures | Table | Text | Code | Missing


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
    """Return a plot as a figure of the page: sharp lines, or a PNG of few colours if it is shaded."""
    if not shaded:
        return Figure(_uri(render_figure(figure, "svg"), "svg+xml"), caption)
    return Figure(_uri(_palette(render_figure(figure, "png", 140)), "png"), caption)


def _palette(png: bytes) -> bytes:
    """Return a PNG of at most 256 colours: a third of the size, and no difference to see."""
    stream = BytesIO()
    with Image.open(BytesIO(png)) as image:
        image.convert("RGB").quantize(256, dither=Image.Dither.NONE).save(
            stream, "png", optimize=True
        )
    return stream.getvalue()


def _uri(data: bytes, kind: str) -> str:
    return f"data:image/{kind};base64,{base64.b64encode(data).decode()}"


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
