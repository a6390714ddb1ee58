"""The report's section on what the run was asked for, and what made it."""

from __future__ import annotations

from defplan_mj.report.content import Code, Missing, Section, Table, Text
from defplan_mj.report.material import Material

_OPTIONS = (
    "gait_solver planner feedback solver_seeds pairs training_seconds episodes moving".split()
)


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
