"""Makes what docs/meshes.md shows of a study of meshes: `python docs/images/strangers.py STUDY_FOLDER`.

Prints the table, and writes `meshes-NAME.png`, a picture of each body at rest, beside this file.
"""

from __future__ import annotations

import sys
from pathlib import Path

from matplotlib.figure import Figure

from defplan_mj.base.errors import DefplanError
from defplan_mj.body.model import Body
from defplan_mj.log.plotting import INK, new_figure, save_figure, view
from defplan_mj.pipeline.making import BODY_FILE
from defplan_mj.report.figures.drawing import draw_surface
from defplan_mj.study.conduct import TABLE_FILE
from defplan_mj.study.table import Row, read_parquet

COLUMNS = 4
HEAD = (
    "| mesh | vertices / modes / gaits | m, rad a cycle | training targets | unseen scenes"
    " | without the check | all of it, wall | what failed |"
)


def main() -> None:
    """Print the table of a study, and draw its bodies."""
    root = Path(sys.argv[1])
    rows = read_parquet(root / TABLE_FILE)
    print(HEAD)
    print("| --- " * (HEAD.count("|") - 1) + "|")
    for row in rows:
        print(line(row))
    bodies = {row["task"]: body for row in rows if (body := body_of(root, row)) is not None}
    if bodies:
        save_figure(sheet(bodies), Path(__file__).with_name(f"meshes-{root.name}.png"))


def line(row: Row) -> str:
    """Return the table's line of a run."""
    size = " / ".join(
        str(row[n] if row[n] is not None else "–") for n in ("vertices", "modes", "gaits")
    )
    moves = ", ".join(f"{row[n]:.2f}" for n in ("advance", "turn") if row[n] is not None)
    names = ("k2", "novel", "novel_unchecked")
    shares = [
        "–"
        if row[f"{n}_success"] is None
        else f"{row[f'{n}_success']:.0%} of {row[f'{n}_episodes']}"
        for n in names
    ]
    seconds = (row["total_seconds"] or 0.0) + (row["guess_seconds"] or 0.0)
    wall = f"{seconds / 60:.1f} min" if row["total_seconds"] else "–"
    fault = f"{row['failed_in']}: {row['error']}" if row["failed"] else ""
    return f"| {row['task']} | {size} | {moves or '–'} | {' | '.join(shares)} | {wall} | {fault} |"


def body_of(root: Path, row: Row) -> Body | None:
    """Return the body of a run; None: it has none."""
    try:
        return Body.load(root / row["folder"] / BODY_FILE)
    except DefplanError:
        return None


def sheet(bodies: dict[str, Body]) -> Figure:
    """Return a drawing of bodies side by side."""
    lines = -(-len(bodies) // COLUMNS)
    figure, grid = new_figure(2.2 * COLUMNS, 1.7 * lines, lines, COLUMNS)
    for axes, (name, body) in zip(grid.flat, bodies.items(), strict=False):
        draw_surface(axes, body.vertices, body.faces, view(-60, 22))
        axes.set_title(name, color=INK)
    for axes in grid.flat[len(bodies) :]:
        axes.set_axis_off()
    return figure


if __name__ == "__main__":
    main()
