"""Logs as tables: a row for each step, cycle or episode, in columns that say what they are and in which unit."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from defplan_mj.base import files
from defplan_mj.base.errors import DefplanError
from defplan_mj.base.progress import Progress, no_progress
from defplan_mj.log.columns import TABLES
from defplan_mj.log.reader import EpisodeLog, read_log

Logs = str | Path | EpisodeLog | Iterable[str | Path | EpisodeLog]
"""A log, a folder of logs, or several of them."""

FORMATS = (".parquet", ".csv")
"""How the name of a table's file ends."""


def find_logs(places: str | Path | Iterable[str | Path]) -> list[Path]:
    """Return the logs that places name: files as they are, of folders all `.mcap` files inside, sorted.

    Raises:
        DefplanError: there is no such place, or a folder holds none.
    """
    paths = [places] if isinstance(places, str | Path) else list(places)
    logs: list[Path] = []
    for path in map(Path, paths):
        if not path.exists():
            raise DefplanError(f"log {path} does not exist")
        inside = sorted(path.rglob("*.mcap")) if path.is_dir() else [path]
        if not inside:
            raise DefplanError(f"there is no log (.mcap) in {path}")
        logs += inside
    return list(dict.fromkeys(logs))


def steps(logs: Logs) -> dict[str, np.ndarray]:
    """Return the table of steps, column by column: see `columns.STEPS` and `table`."""
    return table("steps", logs)


def cycles(logs: Logs) -> dict[str, np.ndarray]:
    """Return the table of gait cycles, column by column: see `columns.CYCLES` and `table`."""
    return table("cycles", logs)


def episodes(logs: Logs) -> dict[str, np.ndarray]:
    """Return the table of episodes, column by column: see `columns.EPISODES` and `table`."""
    return table("episodes", logs)


def table(name: str, logs: Logs, progress: Progress = no_progress) -> dict[str, np.ndarray]:
    """Return one of the `columns.TABLES`, column by column; what takes a dict of arrays makes a frame of it.

    Logs of different bodies or gaits go together: what a log has no column for is NaN in its rows.

    Args:
        logs: a log, a folder of logs, or several of them.

    Raises:
        DefplanError: a log cannot be read.
    """
    given = [logs] if isinstance(logs, str | Path | EpisodeLog) else list(logs)
    sources: list[Path | EpisodeLog] = []
    for one in given:
        sources += [one] if isinstance(one, EpisodeLog) else find_logs(one)
    parts = []
    for number, one in enumerate(sources):
        progress(f"reading logs: {name}", number / len(sources))
        log = one if isinstance(one, EpisodeLog) else read_log(one)
        columns = [field.columns(log) for field in TABLES[name]]
        parts.append({k: v for part in columns for k, v in part.items()})
    progress(f"reading logs: {name}", 1.0)
    return _joined(parts, [field.name for field in TABLES[name]])


def _joined(parts: list[dict[str, np.ndarray]], order: list[str]) -> dict[str, np.ndarray]:
    """Return the columns of all parts one below the other, families beside each other."""
    places = {name: i for i, name in enumerate(dict.fromkeys(k for part in parts for k in part))}
    family = {name: next(i for i, f in enumerate(order) if _is_of(name, f)) for name in places}
    names = sorted(places, key=lambda name: (family[name], places[name]))
    sizes = [len(part["log"]) for part in parts]
    return {
        name: np.concatenate(
            [part.get(name, np.full(n, np.nan)) for part, n in zip(parts, sizes, strict=True)]
        )
        for name in names
    }


def _is_of(name: str, field: str) -> bool:
    """Whether a column belongs to a field."""
    head, star, tail = field.partition("*")
    return name == field or bool(star) and name.startswith(head) and name.endswith(tail)


def check_target(path: str | Path) -> None:
    """Raise DefplanError if no table can be written at `path`; to be asked before long work."""
    if Path(path).suffix.lower() not in FORMATS:
        raise DefplanError(f"cannot write a table as {path}: end its name in .parquet or .csv")
    if Path(path).suffix.lower() == ".parquet":
        _arrow()
    files.check_writable(path)


def write_table(columns: dict[str, np.ndarray], path: str | Path) -> None:
    """Write a table as Parquet or CSV, atomically; the name's ending says which.

    In CSV, numbers have all digits that are needed to read the same bits again, and what is not known
    (NaN) is empty.

    Raises:
        DefplanError: another ending, Parquet without pyarrow, or the file cannot be written.
    """
    check_target(path)
    if Path(path).suffix.lower() == ".csv":
        stream = io.StringIO()
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(columns)
        writer.writerows(zip(*map(_text, columns.values()), strict=True))
        files.write_text(path, stream.getvalue())
        return
    arrow, parquet = _arrow()
    sink = io.BytesIO()
    parquet.write_table(arrow.table({k: arrow.array(v) for k, v in columns.items()}), sink)
    files.write_bytes(path, sink.getvalue())


def _arrow() -> tuple[Any, Any]:
    try:
        import pyarrow
        from pyarrow import parquet
    except ImportError as error:
        raise DefplanError(
            "Parquet needs pyarrow (pip install 'defplan[parquet]'): install it, or write .csv"
        ) from error
    return pyarrow, parquet


def _text(values: np.ndarray) -> list[str]:
    """Return a column as CSV has it."""
    if values.dtype.kind == "f":
        return ["" if np.isnan(v) else repr(v) for v in values.tolist()]
    if values.dtype.kind == "b":
        return ["true" if v else "false" for v in values.tolist()]
    return [str(v) for v in values.tolist()]
