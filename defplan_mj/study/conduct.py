"""Carries out a study: run after run, those that share gaits after the one that makes them."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from defplan_mj.base import files
from defplan_mj.base.progress import Progress, no_progress
from defplan_mj.study.build import build_of
from defplan_mj.study.engines import TRIES, Engine, Lost
from defplan_mj.study.matrix import Cell, Lenders
from defplan_mj.study.run import Job, episode_rows, failed_row
from defplan_mj.study.table import EPISODE_COLUMNS, Row, write_csv, write_parquet

TABLE_FILE, CSV_FILE, EPISODES_FILE = "runs.parquet", "runs.csv", "episodes.parquet"


@dataclass
class _Queue:
    """Runs in their order; those with the gaits of one that is at work wait for it."""

    due: deque[Cell]
    waiting: dict[tuple[Any, ...], list[Cell]] = field(default_factory=dict)
    made: set[tuple[Any, ...]] = field(default_factory=set)

    def next(self) -> Cell | None:
        """Return a run that can begin; None: there is none, now."""
        while self.due:
            cell = self.due.popleft()
            if cell.gaits in self.made:
                return cell
            if cell.gaits not in self.waiting:
                self.waiting[cell.gaits] = []
                return cell
            self.waiting[cell.gaits].append(cell)
        return None

    def ended(self, cell: Cell) -> None:
        """Let those begin that waited for a run."""
        if cell.gaits not in self.made:
            self.made.add(cell.gaits)
            self.due.extendleft(reversed(self.waiting.pop(cell.gaits, [])))


def conduct(
    cells: Sequence[Cell],
    root: Path,
    engine: Engine,
    *,
    remake: bool = False,
    progress: Progress = no_progress,
) -> list[Row]:
    """Carry out runs; return their rows in the order of the cells.

    Args:
        root: the study's folder.
        engine: that does them.
        remake: finished stages may be made anew for other options.
    """
    root = root.absolute()
    root.mkdir(parents=True, exist_ok=True)
    lenders = Lenders(cells)
    build: Mapping[str, str] = build_of() if engine.asks else {}
    queue = _Queue(deque(cells))
    rows: dict[Path, Row] = {}
    running: dict[Future[Row], Cell] = {}
    began, failed = time.perf_counter(), 0
    while True:
        room = engine.room()
        while len(running) < room and (cell := queue.next()) is not None:
            job = Job(cell, root, lenders.of(cell), remake, engine.processes, build)
            running[engine.submit(job)] = cell
        if not running:
            break
        for future in wait(running, return_when=FIRST_COMPLETED).done:
            cell = running.pop(future)
            rows[cell.folder] = _row(future, cell)
            failed += bool(rows[cell.folder]["failed"])
            queue.ended(cell)
            progress(_told(len(rows), len(cells), failed, began), len(rows) / len(cells))
    return [rows[cell.folder] for cell in cells]


def _row(future: Future[Row], cell: Cell) -> Row:
    try:
        return future.result()
    except Lost:
        sentence = f"its process died, {TRIES} times: is there enough memory?"
        return failed_row(cell, sentence, "process")


def _told(done: int, count: int, failed: int, began: float) -> str:
    rest = (time.perf_counter() - began) / done * (count - done)
    left = f", about {rest / 60:.0f} min left" if rest > 90 else ""
    return f"study: {done} of {count} runs, {failed} failed{left}"


def write_tables(root: Path, cells: Sequence[Cell], rows: Sequence[Row]) -> dict[str, Path]:
    """Write the table of runs (Parquet and CSV) and that of episodes; return their paths by name."""
    return {
        "table": write_parquet(root / TABLE_FILE, [rows]),
        "csv": write_csv(root / CSV_FILE, rows),
        "episodes": write_parquet(
            root / EPISODES_FILE, (episode_rows(root, cell) for cell in cells), EPISODE_COLUMNS
        ),
    }


def keep_file(root: Path, file: Path) -> None:
    """Keep the study's file in its folder as it was."""
    if file.is_file() and file.resolve() != (root / "study.toml").resolve():
        files.copy_file(file, root / "study.toml")
