"""The table of a study: a row a run, its columns with units; as Parquet and CSV. And a row an episode."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from defplan_mj.base import files
from defplan_mj.pipeline.evaluation import SPEEDS
from defplan_mj.planning.outcome import ENDINGS, SCENES

Row = dict[str, Any]


@dataclass(frozen=True)
class Column:
    """A column of a table.

    Attributes:
        name: of the column.
        kind: 'text', 'whole', 'number' or 'truth'.
        unit: '' for a pure number.
        text: what it is.
        timing: it is wall time, or follows from it: the only columns that differ between reruns.
    """

    name: str
    kind: str
    unit: str
    text: str
    timing: bool = False


def _scene_columns() -> Iterable[Column]:
    """Yield how episodes end, in each kind of scenes, with and without the collision check."""
    for scenes, label in SCENES.items():
        for check, words in (("", "with the collision check"), ("_unchecked", "without it")):
            name = f"{scenes}{check}"
            yield Column(f"{name}_episodes", "whole", "", f"episodes in {label}, {words}")
            for ending in ENDINGS:
                text = f"share of them that ended in {ending}"
                yield Column(f"{name}_{ending}", "number", "", text)
            text = "gait cycles of the successful ones, mean"
            yield Column(f"{name}_cycles", "number", "cycles", text)
        text = f"a planner's decision in {label}, median"
        yield Column(f"{scenes}_decision", "number", "ms", text, timing=True)
        text = f"simulated seconds a second of decision and physics in {label}"
        yield Column(f"{scenes}_real_time", "number", "", text, timing=True)


STAGES = ("body", "gait", "surrogate", "planner", "evaluation", "moving")


def moving_name(speed: float) -> str:
    """Return the column of success among obstacles of a speed, m/s: 'moving_0.25_success'."""
    return f"moving_{speed:g}_success"


COLUMNS: tuple[Column, ...] = (
    Column("task", "text", "", "the task"),
    Column("seed", "whole", "", "of everything random"),
    Column("gait_solver", "text", "", "made the gaits"),
    Column("planner", "text", "", "chose among them; empty if the runs end before"),
    Column("feedback", "text", "", "played them; likewise"),
    Column("variant", "text", "", "options, by their name in the study's file"),
    Column("folder", "text", "", "of the run, from the study's folder on"),
    Column("failed", "truth", "", "the run ended with a sentence"),
    Column("error", "text", "", "the sentence"),
    Column("failed_in", "text", "", "the stage that it ended in"),
    Column("vertices", "whole", "", "of the tetrahedral mesh"),
    Column("modes", "whole", "", "modal coordinates"),
    Column("gaits", "whole", "", "number of gaits"),
    Column("steps_per_cycle", "whole", "steps", "control steps of a gait cycle"),
    Column("objective", "number", "", "of the gaits, as their solver has it"),
    Column(
        "resimulated", "number", "", "the same by rollouts, over task sequences that no solver saw"
    ),
    Column("iterations", "whole", "", "of the gait solver on the way to its result, if it says"),
    Column("evaluations", "whole", "", "of its objective, likewise"),
    Column(
        "advance", "number", "m", "a cycle of the gaits that are to go farthest, while switched"
    ),
    Column("turn", "number", "rad", "a cycle of the gaits that are to turn, while switched"),
    Column("slip", "number", "m/m", "what a walker's loaded feet slide, of the way"),
    Column("gait_cycles", "whole", "cycles", "that the gaits were switched for"),
    Column("gait_falls", "whole", "cycles", "of these that failed"),
    Column("pairs", "whole", "", "behind each gait of the surrogate"),
    Column("rotation_sd", "number", "rad", "of a cycle's rotation, mean of the gaits (Table III)"),
    Column("translation_sd", "number", "m", "of a cycle's translation, mean of the gaits"),
    Column("cut_short", "truth", "", "a limit of wall time ended the training"),
    *_scene_columns(),
    *(
        Column(moving_name(s), "number", "", f"success among obstacles that move at {s:g} m/s")
        for s in SPEEDS
    ),
    Column("moving_episodes", "whole", "", "at each of these speeds"),
    Column(
        "guess_seconds",
        "number",
        "s",
        "wall time of guessing a mesh's task, if this run did it",
        timing=True,
    ),
    *(
        Column(f"{stage}_seconds", "number", "s", f"wall time of the stage {stage}", timing=True)
        for stage in STAGES
    ),
    Column("solver_seconds", "number", "s", "wall time of the gait solver alone", timing=True),
    Column("total_seconds", "number", "s", "wall time of all stages of the run", timing=True),
)
"""Of the table of runs. A stage that several runs share counts with its time in each of them."""

EPISODE_COLUMNS: tuple[Column, ...] = (
    *COLUMNS[:6],
    Column("scenes", "text", "", "k2: training targets; novel: unseen scenes"),
    Column("checked", "truth", "", "with the collision check"),
    Column(
        "index", "whole", "", "of the scene: the same number is the same scene for the same seed"
    ),
    Column("outcome", "text", "", "how it ended"),
    Column("cycles", "whole", "cycles", "gait cycles begun"),
    Column("seconds", "number", "s", "simulated"),
    Column("distance", "number", "m", "from the target at the end"),
    Column("closest", "number", "m", "smallest clearance to an obstacle, at most 1"),
    Column("reward", "number", "", "Eq. 2, summed"),
    Column("path", "number", "m", "way of the centre of mass"),
    Column("tilt", "number", "rad", "largest at the end of a cycle"),
    Column("decision", "number", "s", "of a decision, mean", timing=True),
    Column("wall", "number", "s", "of decisions and physics", timing=True),
)
"""Of the table of episodes."""

KEYS = tuple(column.name for column in COLUMNS[:6])


def complete(row: Mapping[str, Any], columns: Sequence[Column] = COLUMNS) -> Row:
    """Return a row with all columns in their order; what is missing or no finite number is None.

    Raises:
        KeyError: it has a column that there is not.
    """
    if unknown := set(row) - {column.name for column in columns}:
        raise KeyError(f"there is no column {', '.join(sorted(unknown))}")
    return {column.name: _value(row.get(column.name), column.kind) for column in columns}


def _value(value: Any, kind: str) -> Any:
    if value is None:
        return "" if kind == "text" else None
    value = _KINDS[kind](value)
    return None if kind == "number" and not math.isfinite(value) else value


_KINDS: dict[str, type] = {"text": str, "whole": int, "number": float, "truth": bool}


def csv_text(
    rows: Iterable[Mapping[str, Any]], columns: Sequence[Column] = COLUMNS, timed: bool = True
) -> str:
    """Return rows as CSV: RFC 4180, a point in numbers, nothing for what is missing.

    Args:
        timed: with the columns that differ between reruns.
    """
    kept = [column for column in columns if timed or not column.timing]
    stream = io.StringIO(newline="")
    writer = csv.writer(stream, lineterminator="\r\n")
    writer.writerow(column.name for column in kept)
    for row in rows:
        writer.writerow(_text(row[column.name]) for column in kept)
    return stream.getvalue()


def _text(value: Any) -> str:
    if value is None:
        return ""
    if isinstance(value, bool):
        return str(value).lower()
    return repr(value) if isinstance(value, float) else str(value)


def write_csv(path: Path, rows: Sequence[Row]) -> Path:
    """Write the table of runs as CSV, atomically."""
    files.write_bytes(path, csv_text(rows).encode())
    return path


def write_parquet(
    path: Path, groups: Iterable[Sequence[Row]], columns: Sequence[Column] = COLUMNS
) -> Path:
    """Write groups of rows as Parquet, atomically; each field's metadata have 'unit' and 'description'."""
    import pyarrow
    import pyarrow.parquet

    schema = _schema(columns)
    with (
        files.atomic_path(path) as temporary,
        pyarrow.parquet.ParquetWriter(temporary, schema, compression="zstd") as writer,
    ):
        for group in groups:
            if group:
                writer.write_table(pyarrow.Table.from_pylist(list(group), schema))
    return path


def _schema(columns: Sequence[Column]) -> Any:
    import pyarrow

    kinds = {
        "text": pyarrow.string(),
        "whole": pyarrow.int64(),
        "number": pyarrow.float64(),
        "truth": pyarrow.bool_(),
    }
    return pyarrow.schema(
        [
            pyarrow.field(
                column.name,
                kinds[column.kind],
                metadata={"unit": column.unit, "description": column.text},
            )
            for column in columns
        ]
    )


def read_parquet(path: Path) -> list[Row]:
    """Return the rows of a table of `write_parquet`."""
    import pyarrow.parquet

    return pyarrow.parquet.read_table(path).to_pylist()
