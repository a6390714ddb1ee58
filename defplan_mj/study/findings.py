"""What a study's page is made of."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from defplan_mj.base.progress import Progress, no_progress
from defplan_mj.study.spec import Study
from defplan_mj.study.table import Row


@dataclass(frozen=True)
class Findings:
    """What a page is made of.

    Attributes:
        study: what was asked for.
        rows: of its runs.
        root: its folder.
        progress: told what takes long.
    """

    study: Study
    rows: Sequence[Row]
    root: Path
    progress: Progress = no_progress

    @property
    def good(self) -> list[Row]:
        """The rows of runs that did not fail."""
        return [row for row in self.rows if not row["failed"]]

    @property
    def tasks(self) -> list[str]:
        """Names of the tasks, in their order."""
        return list(dict.fromkeys(row["task"] for row in self.rows))
