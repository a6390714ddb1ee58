"""One self-contained page about a run, from what lies in its folder."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TypeVar

from jinja2 import Environment, PackageLoader, StrictUndefined

from defplan_mj.base import files
from defplan_mj.base.errors import DefplanError
from defplan_mj.base.progress import Progress, no_progress
from defplan_mj.base.reading import first_line
from defplan_mj.report.content import Fact, Section, duration, percent
from defplan_mj.report.material import Material, gather
from defplan_mj.report.sections.body import body_section
from defplan_mj.report.sections.check import check_section
from defplan_mj.report.sections.comparison import comparison_section
from defplan_mj.report.sections.gaits import gait_section
from defplan_mj.report.sections.making import making_section
from defplan_mj.report.sections.robustness import robustness_section
from defplan_mj.report.sections.success import (
    episodes,
    evaluations,
    interval,
    rate,
    success_section,
)
from defplan_mj.report.sections.surrogate import surrogate_section
from defplan_mj.report.sections.time import time_section
from defplan_mj.report.sections.training import training_section
from defplan_mj.report.sections.trajectories import trajectory_section

REPORT_FILE = "report.html"
_Part = TypeVar("_Part")


def write_report(run_folder: str | Path, progress: Progress = no_progress) -> Path:
    """Write `report.html` into a run's folder, atomically; what is missing is named in it.

    The page is one file: pictures are inside, nothing is loaded from anywhere. The same folder gives
    the same page to the byte.

    Returns:
        its path.

    Raises:
        DefplanError: there is no such folder, or the page cannot be written.
    """
    material = gather(run_folder)
    sections = []
    for i, make in enumerate(SECTIONS):
        progress("report", i / len(SECTIONS))
        sections.append(_made(make, material))
    description = material.spec.description if material.spec else ""
    seed = material.config.get("seed", _seed_of(material.folder))
    page = render_page(
        material.task,
        f"seed {seed}",
        f"{description[:1].upper()}{description[1:]}. {_MADE}" if description else "",
        _made(summary, material),
        sections,
    )
    path = material.folder / REPORT_FILE
    files.write_text(path, page)
    progress("report", 1.0)
    return path


_MADE = "Everything below was made from one mesh file and is shown as measured in this run."


def render_page(
    title: str,
    subtitle: str,
    description: str,
    facts: Sequence[Fact],
    sections: Sequence[Section],
) -> str:
    """Return a page as one self-contained HTML text."""
    environment = Environment(
        loader=PackageLoader("defplan_mj.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template("page.html").render(
        title=title, subtitle=subtitle, description=description, facts=facts, sections=sections
    )


def _made(make: Callable[[Material], _Part], material: Material) -> _Part:
    """Make a part of the page; files whose content makes no sense are a sentence."""
    try:
        return make(material)
    except files.WRONG_FIELDS as error:
        raise DefplanError(
            f"the report of {material.folder} cannot be made: what its files say does not fit"
            f" {make.__name__} ({first_line(error)}): make the run anew with --fresh, --debug shows where"
        ) from error


def summary(material: Material) -> list[Fact]:
    """Return the figures that one wants first."""
    facts = []
    for label, result in evaluations(material.documents.get("evaluation")):
        n, success = episodes(result), rate(result, "success")
        low, high = interval(result)
        detail = f"{label}; 95%: {100 * low:.0f} to {100 * high:.0f}%"
        facts.append(Fact(percent(success), f"of {n} targets reached", detail))
    tasks = material.switching.get("tasks", [])
    if tasks:
        task = max(tasks, key=lambda task: task["advance_m"])
        facts.append(Fact(f"{task['advance_m']:.2f} m", "a cycle", f"gait '{task['name']}'"))
    if material.seconds:
        total = duration(sum(material.seconds.values()))
        facts.append(Fact(total, "of computing", "from the mesh to the evaluation"))
    return facts


SECTIONS: tuple[Callable[[Material], Section], ...] = (
    body_section,
    gait_section,
    check_section,
    robustness_section,
    surrogate_section,
    training_section,
    success_section,
    trajectory_section,
    comparison_section,
    time_section,
    making_section,
)
"""The page from top to bottom. A new section is a function that returns one, and its line here."""


def _seed_of(folder: Path) -> str:
    return folder.name.rpartition("-seed")[2] if "-seed" in folder.name else "–"
