"""`python -m tests.samples.tiny_run LOGS`: a whole run in seconds, with every stage, as the command does it."""

from __future__ import annotations

import dataclasses
import json
import sys
from pathlib import Path
from typing import Any

from defplan_mj.base import files
from defplan_mj.task import BodyOptions, Navigation
from tests.samples.solvers import Wave

SMALL = BodyOptions(vertices=300, modes=4, basis=12, samples=10, drag_points=24)
NAVIGATION = Navigation(
    distance=4.0, max_cycles=4, k2=2, k2_obstacles=1, novel_obstacles=2, beams=16
)


TIMES = ("seconds", "wall", "decision", "decision_ms", "real_time_factor")
"""Of a run's JSON, what the clock says."""


def listens(logs: Path) -> Path:
    """Return the file that says that the run with these logs hears stops."""
    return logs.parent / "listens"


def stand_in() -> None:
    """Put the small task, the wave and a short training in the place of the installed ones."""
    from defplan_mj import registry

    find_task, find_solver, wave = registry.get_task, registry.get_solver, Wave()
    small: dict[str, Any] = {
        "body": SMALL,
        "navigation": NAVIGATION,
        "gait_solver": "wave",
        "rivals": (),
    }

    def task(name: str) -> Any:
        return dataclasses.replace(find_task(name), **small)

    def solver(name: str, kind: str) -> Any:
        if name == "dql":
            import defplan_solvers.dql.training as training

            training.Recipe.__init__.__defaults__ = short(training.Recipe)
            _draw_once()  # here, not before the command: it loads a lot
        return wave if name == "wave" else find_solver(name, kind)

    registry.get_task, registry.get_solver = task, solver


def _draw_once() -> None:
    """Draw the page's first figure, and show it in the place of the others: they take a third of the run."""
    from defplan_mj.report import content

    draw: Any = content.render_figure
    if draw.__module__ == __name__:
        return
    drawn: list[bytes] = []

    def render(*args: Any, **kwargs: Any) -> bytes:
        if not drawn:
            drawn.append(draw(*args, **kwargs))
        return drawn[0]

    content.render_figure = render


def short(recipe: Any) -> tuple:
    """Return the defaults of a recipe that trains for a second."""
    held_out = {"targets": 10, "standing": 10, "moving": 10}
    shorter = {"transitions": 3000, "scenes": 100, "checkpoints": 2, **held_out}
    fields = [f for f in dataclasses.fields(recipe) if f.default is not dataclasses.MISSING]
    assert set(shorter) <= {f.name for f in fields}
    return tuple(shorter.get(f.name, f.default) for f in fields)


def said_by(folder: Path) -> dict[str, Any]:
    """Return what all files of a run's folder say, to the bit, apart from wall times and the page."""
    from defplan_mj.log.reader import read_log

    found: dict[str, Any] = {}
    for path in sorted(folder.glob("[!.]*")):
        if path.suffix == ".npz":
            found[path.name] = files.archive_hash(path)
        elif path.suffix == ".mcap":
            log = read_log(path)
            parts = (log.states, log.target_shapes, log.clearance, log.values, log.laser)
            found[path.name] = (log.fault, log.outcome, *(part.tobytes() for part in parts))
        elif path.suffix == ".json" and path.name != "run.json":
            found[path.name] = _without_times(json.loads(path.read_text()))
        else:
            found[path.name] = "there"
    return found


def _without_times(value: Any) -> Any:
    if isinstance(value, dict):
        return {name: _without_times(one) for name, one in value.items() if name not in TIMES}
    return [_without_times(one) for one in value] if isinstance(value, list) else value


def tell_when_it_listens(path: Path) -> None:
    """Make a file when the command hears stops: before that, it is loading, and ends as any program does."""
    from defplan_mj.cli.stops import Stops

    listen = Stops.listen

    def listening(stops: Stops) -> None:
        listen(stops)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()

    Stops.listen = listening  # type: ignore[assignment, method-assign]


if __name__ == "__main__":
    from defplan_mj import cli

    stand_in()
    tell_when_it_listens(listens(Path(sys.argv[1])))
    sys.argv[1:] = [
        *("run", "fish-swim", "--logs", sys.argv[1], "--pairs", "12", "--episodes", "3"),
        *("--moving", "1", *sys.argv[2:]),
    ]
    sys.exit(cli.main())
