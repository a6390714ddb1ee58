"""`defplan compare`, `replay`, `logs` and `export`: what can be learnt from logs alone."""

from __future__ import annotations

import argparse
from collections import Counter
from pathlib import Path
from typing import Any

from defplan_mj.base.errors import DefplanError
from defplan_mj.cli.console import Console, table


def compare(arguments: argparse.Namespace, console: Console) -> int:
    """Compare surrogate and reduced dynamics over the logs; optionally draw it."""
    from defplan_mj.log.compare import DRIFT_COLUMNS, compare_logs

    comparison = compare_logs(arguments.log)
    for episode in comparison.episodes:
        if episode.fault:
            console.say(f"defplan: log {episode.path} is {episode.fault}: used up to there")
    data = comparison.to_json()
    if arguments.output:
        comparison.plot(arguments.output)
        data["plot"] = str(arguments.output)
    text = [
        table(
            comparison.columns, comparison.table(), "Surrogate against reduced dynamics, per cycle"
        ),
        table(DRIFT_COLUMNS, comparison.drift_rows(), "Logs"),
    ]
    console.result(data, "\n\n".join(text))
    return 0


def replay(arguments: argparse.Namespace, console: Console) -> int:
    """Simulate a log again; the exit code is 0 only if every bit is the same."""
    from defplan_mj.log.reader import read_log
    from defplan_mj.log.replay import replay_log, write_video

    if arguments.video:
        from defplan_mj.host.render import check_video

        check_video(arguments.video, arguments.camera)  # before any work
    log = read_log(arguments.log)
    with console.progress() as progress:
        result = replay_log(log, progress)
        data = result.to_json()
        if arguments.video:
            write_video(
                log,
                arguments.video,
                arguments.size,
                arguments.fps,
                camera=arguments.camera,
                progress=progress,
                seconds=(arguments.since, arguments.until),
            )
            data["video"] = str(arguments.video)
    console.result(data, result.sentence())
    return 0 if result.identical else 1


def logs(arguments: argparse.Namespace, console: Console) -> int:
    """Say how the episodes of many logs ended; one that cannot be read is a row, too."""
    from defplan_mj.log.tables import episodes, find_logs

    rows: list[dict[str, Any]] = []
    paths = find_logs(arguments.log)
    with console.progress() as progress:
        for number, path in enumerate(paths):
            progress("reading logs", number / len(paths))
            try:
                columns = episodes(path)
            except DefplanError as error:
                rows.append({"log": str(path), "outcome": "", "fault": str(error)})
            else:
                rows.append({name: _plain(values[0]) for name, values in columns.items()})
        progress("reading logs", 1.0)
    counts = dict(sorted(Counter(row["outcome"] or "unknown" for row in rows).items()))
    console.result({"logs": rows, "outcomes": counts}, logs_text(rows, counts))
    return 0


def logs_text(rows: list[dict[str, Any]], counts: dict[str, int]) -> str:
    """Return a row for each log, and how many ended in which way."""
    from defplan_mj.log.compare import clearance_text

    columns = ["log", "task", "planner", "outcome", "cycles", "time, s", "way, m", "left, m"]
    columns += ["clearance, m", "fault"]
    cells = [
        [
            row["log"],
            row.get("task", "-"),
            row.get("planner") or "-",
            row["outcome"] or "-",
            str(row.get("cycles", "-")),
            *(_figure(row.get(k)) for k in ("duration_s", "way_m", "end_distance_m")),
            clearance_text(row.get("clearance_min_m") or float("nan")),
            row["fault"],
        ]
        for row in rows
    ]
    ways = ", ".join(f"{number} {outcome}" for outcome, number in counts.items())
    return f"{table(columns, cells)}\n{len(rows)} logs: {ways}"


def _figure(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"


def _plain(value: Any) -> Any:
    """Return a table's cell as JSON has it: what is not known is null."""
    value = value.item() if hasattr(value, "item") else value
    return None if isinstance(value, float) and not abs(value) < float("inf") else value


def export(arguments: argparse.Namespace, console: Console) -> int:
    """Write logs as a table (Parquet, CSV), or one of them for a viewer (Rerun; a layout for Foxglove)."""
    from defplan_mj.log import tables

    targets = (arguments.output, arguments.rerun, arguments.layout)
    if sum(target is not None for target in targets) != 1:
        raise DefplanError(
            "say where to, once: -o FILE.parquet, -o FILE.csv, --rerun FILE.rrd or --layout FILE.json"
        )
    paths = tables.find_logs(arguments.log)
    if arguments.rerun is not None:
        return _export_rerun(paths, arguments.rerun, console)
    if arguments.layout is not None:
        return _export_layout(paths, arguments.layout, console)
    tables.check_target(arguments.output)  # before any work
    with console.progress() as progress:
        columns = tables.table(arguments.table, paths, progress)
        tables.write_table(columns, arguments.output)
    count = len(columns["log"])
    data = {
        "file": str(arguments.output),
        "table": arguments.table,
        "logs": len(paths),
        "rows": count,
        "columns": list(columns),
    }
    text = f"{arguments.output}: {count} {arguments.table} of {len(paths)} logs, {len(columns)} columns"
    console.result(data, text)
    return 0


def _export_rerun(paths: list[Path], target: Path, console: Console) -> int:
    from defplan_mj.log.rerun_export import check_rerun, write_rerun

    check_rerun(target)
    log = _only(paths)
    with console.progress() as progress:
        write_rerun(log, target, progress)
    console.result({"file": str(target), "log": str(log)}, f"{target}: {log} for Rerun")
    return 0


def _export_layout(paths: list[Path], target: Path, console: Console) -> int:
    from defplan_mj.base import files
    from defplan_mj.log import foxglove_layout
    from defplan_mj.log.reader import read_log

    files.check_writable(target)
    log = _only(paths)
    files.write_text(target, foxglove_layout.text(foxglove_layout.layout_of(read_log(log))))
    console.result(
        {"file": str(target), "log": str(log)},
        f"{target}: a layout for {log}, to be imported in Foxglove or Lichtblick",
    )
    return 0


def _only(paths: list[Path]) -> Path:
    if len(paths) > 1:
        raise DefplanError(f"this is made of one log, and these are {len(paths)}: name one")
    return paths[0]
