"""One self-contained page about a study, from its rows and what lies in its folder."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from defplan_mj.base import files
from defplan_mj.base.progress import Progress, no_progress
from defplan_mj.report.content import Fact, Section, duration, percent
from defplan_mj.report.report import render_page
from defplan_mj.study import paper
from defplan_mj.study.findings import Findings
from defplan_mj.study.rows import rate
from defplan_mj.study.sections import SECTIONS, gait_solvers, moving
from defplan_mj.study.spec import Study
from defplan_mj.study.table import Row

PAGE_FILE = "study.html"


MakeSection = Callable[[Findings], Section | None]


def write_page(
    study: Study, rows: Sequence[Row], root: Path, progress: Progress = no_progress
) -> Path:
    """Write `study.html` into the study's folder, atomically; return its path.

    The page is one file that needs nothing else. Its sections are those of the study's kind of page.
    """
    findings = Findings(study, rows, root, progress)
    made = paper.sections(findings) if study.page == "paper" else []
    sections = _sections(study.page)
    for i, make in enumerate(sections):
        progress("page", i / len(sections))
        if (section := make(findings)) is not None:
            made.append(section)
    text = render_page(
        study.name,
        f"{len(rows)} runs",
        study.description,
        summary(findings),
        made,
    )
    files.write_text(root / PAGE_FILE, text)
    progress("page", 1.0)
    return root / PAGE_FILE


def _sections(page: str) -> Sequence[MakeSection]:
    """Return what makes the sections of a kind of page."""
    if page == "optimisers":
        others = [section for section in SECTIONS if section is not gait_solvers]
        return (gait_solvers, *others)
    if page == "paper":
        return [section for section in SECTIONS if section is not moving]  # it is Fig. 6
    return SECTIONS


def summary(findings: Findings) -> list[Fact]:
    """Return the figures that one wants first."""
    rows = findings.rows
    failed = len(rows) - len(findings.good)
    facts = [Fact(str(len(rows)), "runs", f"{failed} of them failed")]
    for scenes, label in (("k2", "training targets"), ("novel", "unseen scenes")):
        arrivals = rate(rows, f"{scenes}_success", f"{scenes}_episodes")
        if arrivals:
            detail = f"{label}, all runs; 95%: {100 * arrivals[1]:.0f} to {100 * arrivals[2]:.0f}%"
            facts.append(Fact(percent(arrivals[0]), "of episodes arrive", detail))
    seconds = sum(row["total_seconds"] or 0.0 for row in rows)
    facts.append(Fact(duration(seconds), "of computing", "stages that runs share count in each"))
    return facts
