"""One self-contained page about a run, from what lies in its folder."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from jinja2 import Environment, PackageLoader, StrictUndefined

from defplan_mj.base import files
from defplan_mj.base.progress import Progress, no_progress
from defplan_mj.report.check_section import check_section
from defplan_mj.report.content import Code, Fact, Missing, Section, Table, Text, duration, percent
from defplan_mj.report.material import Material, gather
from defplan_mj.report.planning_sections import (
    comparison_section,
    episodes,
    evaluations,
    interval,
    rate,
    success_section,
    training_section,
    trajectory_section,
)
from defplan_mj.report.robustness_section import robustness_section
from defplan_mj.report.sections import (
    body_section,
    gait_section,
    surrogate_section,
    time_section,
)

REPORT_FILE = "report.html"
_OPTIONS = (
    "gait_solver planner feedback solver_seeds pairs training_seconds episodes moving".split()
)


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
        sections.append(make(material))
    environment = Environment(
        loader=PackageLoader("defplan_mj.report", "."),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    page = environment.get_template("report.html").render(
        title=material.task,
        seed=material.config.get("seed", _seed_of(material.folder)),
        description=material.spec.description if material.spec else "",
        facts=summary(material),
        sections=sections,
    )
    path = material.folder / REPORT_FILE
    files.write_text(path, page)
    progress("report", 1.0)
    return path


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


def making_section(material: Material) -> Section:
    """Return what the run was asked for and what made it."""
    section = Section("making", "How this was made")
    run = material.documents.get("run", {})
    if not run:
        section.blocks.append(Missing("run.json is missing: nothing says how this was made."))
        return section
    section.blocks += [Text("This makes it again:"), Code(command(material))]
    versions = run.get("versions", {})
    section.blocks.append(Table(["version", ""], [[str(k), str(v)] for k, v in versions.items()]))
    hashes = []
    if material.body is not None:
        hashes.append(["body", material.body.hash[:16]])
    if material.gait is not None:
        hashes.append(["the gaits' body", material.gait.body_hash[:16]])
    if hashes:
        section.blocks.append(Table(["content hash", ""], hashes))
    return section


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


def command(material: Material) -> str:
    """Return the command line that a run was asked for with."""
    config = material.config
    words = ["defplan", "run", material.task, "--seed", str(config.get("seed", 0))]
    for name in config.get("rivals") or ():
        words += ["--compare-with", str(name)]
    for option in _OPTIONS:
        if config.get(option) is not None:
            words += [f"--{option.replace('_', '-')}", str(config[option])]
    return " ".join([*words, "--fresh"])


def _seed_of(folder: Path) -> str:
    return folder.name.rpartition("-seed")[2] if "-seed" in folder.name else "–"
