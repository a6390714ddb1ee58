"""`defplan study`: many runs by one file, their table and their page."""

from __future__ import annotations

import argparse
import time
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from defplan_mj.cli.console import Console, table
from defplan_mj.cli.workers import check_workers, cluster

if TYPE_CHECKING:
    from defplan_mj.base.progress import Progress
    from defplan_mj.study.engines import Engine
    from defplan_mj.study.matrix import Cell
    from defplan_mj.study.spec import Study


def study(arguments: argparse.Namespace, console: Console) -> int:
    """Carry out a study, or say what there would be to do."""
    from defplan_mj.study.conduct import conduct, keep_file, write_tables
    from defplan_mj.study.matrix import cells as cells_of
    from defplan_mj.study.page import write_page
    from defplan_mj.study.spec import find_study

    check_workers(arguments)
    spec = find_study(arguments.study, arguments.quick)
    cells = cells_of(spec)
    root = arguments.logs / spec.name
    if arguments.dry_run:
        return _say_outlook(spec, cells, root, arguments.logs, console)
    began = time.perf_counter()
    with (
        console.progress() as progress,
        _engine(arguments, console, progress) as engine,
    ):
        rows = conduct(cells, root, engine, remake=arguments.remake, progress=progress)
        paths = write_tables(root, cells, rows)
        keep_file(root, spec.file)
        page = write_page(spec, rows, root, progress)
    failed = [row for row in rows if row["failed"]]
    data: dict[str, Any] = {
        "rows": len(rows),
        "failed": len(failed),
        "seconds": time.perf_counter() - began,
        "files": {**paths, "page": page},
    }
    errors = [f"{row['folder']}: {row['error']}" for row in failed]
    console.result(data, "\n".join([*errors, _summary(data)]))
    return 0


def _summary(data: dict[str, Any]) -> str:
    files = data["files"]
    return (
        f"{data['rows']} runs, {data['failed']} failed, {data['seconds']:.1f} s\n"
        f"table   {files['table']}, {files['csv']}\npage    {files['page']}"
    )


def _engine(
    arguments: argparse.Namespace, console: Console, progress: Progress
) -> AbstractContextManager[Engine]:
    from defplan_mj.study.engines import cluster_engine, local_engine

    if (client := cluster(arguments, console)) is None:
        return local_engine(arguments.jobs or 1, progress)
    return cluster_engine(client)


def _say_outlook(spec: Study, cells: list[Cell], root: Path, logs: Path, console: Console) -> int:
    """Say what is there and what is to be made, and how long that takes; make nothing."""
    from defplan_mj.study.outlook import prospects

    outlook = prospects(cells, root, logs)
    known = [p.seconds for p in outlook if p.seconds is not None]
    unknown = sum(p.seconds is None for p in outlook)
    counts = {state: sum(p.state == state for p in outlook) for state in _STATES}
    runs = [
        {
            "folder": str(p.cell.folder),
            "state": p.state,
            "missing": list(p.missing),
            "seconds": p.seconds,
        }
        for p in outlook
    ]
    data = {
        "study": spec.name,
        "runs": runs,
        "counts": counts,
        "seconds": sum(known),
        "unknown": unknown,
    }
    rows = [
        [run["folder"], run["state"], ", ".join(run["missing"]) or "-", _time(run["seconds"])]  # type: ignore[arg-type]
        for run in runs
    ]
    states = ", ".join(f"{counts[state]} {state}" for state in _STATES)
    sentence = (
        f"{spec.name}: {len(outlook)} runs: {states}; about {_time(sum(known))} by one process"
    )
    if unknown:
        sentence += f", and {unknown} runs of which nothing is known yet"
    console.result(data, f"{table(['run', 'is', 'to be made', 'about'], rows)}\n{sentence}")
    return 0


_STATES = ("there", "begun", "to be made")


def _time(seconds: float | None) -> str:
    if seconds is None:
        return "?"
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"
