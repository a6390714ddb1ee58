"""Policy files of planners without parameters: they hold the planner's name and nothing else."""

from __future__ import annotations

from pathlib import Path

from defplan_mj import files
from defplan_mj.errors import DefplanError

FORMAT_VERSION = 1


def save_nothing(name: str, path: Path) -> None:
    """Write a policy file that holds only the planner's name, atomically."""
    files.save_archive(path, "policy", FORMAT_VERSION, {}, {"planner": name})


def load_nothing(name: str, path: Path) -> None:
    """Read a file of `save_nothing`.

    Raises:
        DefplanError: the file is missing, damaged, of another version or of another planner.
    """
    _, meta, _ = files.load_archive(path, "policy", FORMAT_VERSION)
    if meta.get("planner") != name:
        raise DefplanError(f"{path} holds a policy of {meta.get('planner')}, not of {name}")
