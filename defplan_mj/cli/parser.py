"""The grammar of the command line: commands, options, their types and their help."""

from __future__ import annotations

import argparse
import difflib
import math
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NoReturn

from defplan_mj.base.places import PLACES
from defplan_mj.base.printable import printable
from defplan_mj.cli import body, commands, logs, new, study
from defplan_mj.planning.outcome import SCENES

_AXES = ("x", "-x", "y", "-y", "z", "-z")

RENAMED = {"--rival": "--compare-with", "--solver": "--gait-solver"}
"""Names that options had in earlier versions."""


class Parser(argparse.ArgumentParser):
    """An ArgumentParser whose errors are one sentence."""

    def error(self, message: str) -> NoReturn:
        hint = "" if message.endswith("?") else f"; see {self.prog} --help"
        self.exit(2, f"{self.prog}: {printable(message)}{hint}\n")

    def _print_message(self, message: str, file: Any = None) -> None:
        """Write help, or an error; argparse itself says nothing of what could not be written."""
        if message:
            print(message, end="", file=file or sys.stderr, flush=True)

    def refuse(self, rest: Sequence[str]) -> NoReturn:
        """Stop with a sentence on the first of the arguments that nothing here takes."""
        options = [word.partition("=")[0] for word in rest if word.startswith("-")]
        if not options:
            self.error(f"there is nothing to be done with {rest[0]}")
        option, known = options[0], list(self._option_string_actions)
        if RENAMED.get(option) in known:
            self.error(f"the option {option} is called {RENAMED[option]}")
        close = difflib.get_close_matches(option, known, n=1)
        guess = f", did you mean {close[0]}?" if close else ""
        self.error(f"there is no option {option}{guess}")

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        """Name the commands that exist and the one that was probably meant."""
        if action.choices is not None and value not in action.choices:
            known = [str(choice) for choice in action.choices]
            close = difflib.get_close_matches(str(value), known, n=1)
            guess = f", did you mean {close[0]}?" if close else ";"
            raise argparse.ArgumentError(
                action, f"there is no {value}{guess} choose from {', '.join(known)}"
            )


_SCENES = (*SCENES, *PLACES)


class _Version(argparse.Action):
    """Says what is installed; the kernel is looked at only when it is asked for."""

    def __call__(
        self,
        parser: argparse.ArgumentParser,
        namespace: argparse.Namespace,
        values: Any,
        option: str | None = None,
    ) -> NoReturn:
        from defplan_mj.cli.version import version_text

        print(version_text(), flush=True)
        parser.exit()


def parse(argv: Sequence[str] | None) -> argparse.Namespace:
    """Parse `argv`; the function that runs the command is in `command`."""
    words = _joined(sys.argv[1:] if argv is None else argv)
    arguments, rest = build().parse_known_args(words)
    if rest:
        arguments.parser.refuse(rest)
    return arguments


def _joined(argv: Sequence[str]) -> list[str]:
    """Return words of which '--up -x' is one: argparse would take the axis for an option."""
    words: list[str] = []
    for word in argv:
        if words and words[-1] in ("--up", "--forward") and word in _AXES:
            words[-1] += f"={word}"
        else:
            words.append(word)
    return words


def build() -> argparse.ArgumentParser:
    """Return the parser of the whole command line."""
    parser = Parser(
        prog="defplan",
        description="Motion planning for soft robots: from a mesh file to a planned, logged and "
        "reported run.",
        epilog="TASK is a task file (.toml, `defplan new` writes one) or 'domain-task', e.g. fish-swim;"
        " `defplan list` names all that are installed.",
        allow_abbrev=False,
    )
    parser.add_argument(
        "--version", action=_Version, nargs=0, help="show versions and the kernel's build"
    )
    subparsers = parser.add_subparsers(
        title="commands", metavar="COMMAND", required=True, parser_class=Parser
    )

    def add(
        name: str, run: Callable[..., int], help: str, draws: bool = False
    ) -> argparse.ArgumentParser:
        sub = subparsers.add_parser(name, help=help, description=help, allow_abbrev=False)
        sub.set_defaults(command=run, draws=draws, parser=sub)
        return sub

    _list(
        add(
            "list",
            commands.list_installed,
            "name the tasks, solvers, sensors, studies and suite tasks that are installed",
        )
    )
    _run(
        add(
            "run",
            commands.run,
            "do everything: mesh, gaits, planner, evaluation, log, report",
            True,
        )
    )
    _study(
        add("study", study.study, "carry out many runs by one file: their table, their page", True)
    )
    _new(add("new", new.new, "write a task file, guessed from a mesh or copied from a task"))
    _body(add("body", body.body, "build a soft body from a mesh file"))
    _gait(add("gait", commands.gait, "optimise a task's gaits"))
    _surrogate(add("surrogate", commands.surrogate, "fit the rigid surrogate to a task's gaits"))
    _planner(add("planner", commands.planner, "train a planner on the surrogate"))
    _evaluate(add("evaluate", commands.evaluate, "let a planner steer the reduced dynamics"))
    _bound(
        add("bound", commands.bound, "judge planners against one that knows all that moves where")
    )
    _noise(add("noise", commands.noise, "count successes with bad sensing, other mass, other drag"))
    _robustness(
        add(
            "robustness", commands.robustness, "count a task's falls among pushes, slopes and so on"
        )
    )
    _check(add("check", commands.check, "play a task's gaits with finer steps and in the full FEM"))
    _bench(add("bench", commands.bench, "time the step, its peers, the surrogate and the laser"))
    _compare(add("compare", logs.compare, "compare the surrogate with the truth, from logs"))
    _replay(add("replay", logs.replay, "simulate a log again, to the bit", True))
    _logs(add("logs", logs.logs, "say how the episodes of many logs ended"))
    _export(add("export", logs.export, "write logs as a table, or for Rerun"))
    _view(add("view", commands.view, "watch a task in MuJoCo's viewer, or live in Foxglove", True))
    return parser


def _list(sub: argparse.ArgumentParser) -> None:
    _common(sub)


def _new(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("mesh", metavar="MESH", nargs="?", help="mesh file to guess a task for")
    sub.add_argument(
        "-o", "--output", type=Path, metavar="FILE", help="to write (default: NAME.toml)"
    )
    sub.add_argument("--from", dest="origin", metavar="TASK", help="copy this task instead")
    sub.add_argument("--overwrite", action="store_true", help="if the file is there")
    _guessing(sub)
    _common(sub)


def _guessing(sub: argparse.ArgumentParser) -> None:
    """Add what a task is guessed from, besides its mesh."""
    sub.add_argument("--medium", choices=("water", "ground"), help="what a mesh moves in, or on")
    sub.add_argument("--length", type=_positive, metavar="M", help="longest extent (default: 1 m)")
    sub.add_argument("--up", choices=_AXES, help="axis of the mesh file (default: guessed)")
    sub.add_argument("--forward", choices=_AXES, help="axis of the mesh file (default: guessed)")
    _preview(sub)


def _preview(sub: argparse.ArgumentParser) -> None:
    sub.add_argument(
        "--preview", type=Path, metavar="FILE.png", help="picture of which way the mesh looks"
    )


def _run(sub: argparse.ArgumentParser) -> None:
    sub.add_argument(
        "task",
        metavar="TASK",
        help="e.g. fish-swim, see `defplan list`; or a task file (.toml), or a mesh with --medium",
    )
    _guessing(sub)
    _stage(sub)
    sub.add_argument("--gait-solver", metavar="NAME", help="(default: the run's or task's)")
    sub.add_argument("--planner", metavar="NAME", help="(default: the run's or task's)")
    _feedback(sub)
    sub.add_argument(
        "--compare-with",
        metavar="NAME",
        action="append",
        help="gait solver that the report compares with; may be given more than once "
        "(default: the task's; none: do not)",
    )
    sub.add_argument(
        "--solver-seeds", type=_count, metavar="N", help="of that comparison (default: 1)"
    )
    sub.add_argument(
        "--pairs", type=_count, metavar="N", help="for the surrogate (default: 1000, of a mesh 300)"
    )
    _training(sub)
    sub.add_argument(
        "--episodes", type=_count, metavar="N", help="unseen scenes (default: 200, of a mesh 100)"
    )
    sub.add_argument(
        "--moving",
        type=_natural,
        metavar="N",
        help="episodes among moving obstacles, for each of four speeds (default: 40, of a mesh 0: none)",
    )
    _workers(sub)
    _common(sub)


def _study(sub: argparse.ArgumentParser) -> None:
    sub.add_argument(
        "study", metavar="STUDY", help="a study file (.toml), or one that `defplan list` names"
    )
    sub.add_argument(
        "--dry-run",
        action="store_true",
        help="say what is there, what is to be made and about how long it takes; make nothing",
    )
    sub.add_argument("--quick", action="store_true", help="with the file's table [quick]")
    _workers(sub, "runs", "1")
    sub.add_argument("--logs", type=Path, default=Path("logs"), metavar="DIR",
                     help="where the study's folder lies (default: logs)")  # fmt: skip
    sub.add_argument("--remake", action="store_true",
                     help="make finished stages anew if they were made with other options")  # fmt: skip
    _common(sub)


def _body(sub: argparse.ArgumentParser) -> None:
    sub.add_argument(
        "mesh",
        metavar="MESH",
        help="a surface (STL, OBJ, PLY, OFF, glTF, 3MF, DAE, ...) or cells (.msh, .vtk, .vtu, "
        ".mesh, ...), or a TASK: its mesh and its options",
    )
    sub.add_argument(
        "-o", "--output", type=Path, metavar="FILE", help="body file to write (default: NAME.npz)"
    )
    sub.add_argument("--vertices", type=_count, metavar="N", help="of the tetrahedral mesh")
    sub.add_argument("--modes", type=_count, metavar="R", help="modal coordinates")
    sub.add_argument(
        "--shapes",
        choices=("rotation-strain", "elastic"),
        help="what the reduction comes near to; elastic: where the full FEM rests, minutes to build",
    )
    sub.add_argument(
        "--moved",
        type=float,
        metavar="SHARE",
        help="pass over modes that move less than this share of the mass, such as 0.01: ears, horns",
    )
    sub.add_argument(
        "--length",
        type=_positive,
        metavar="M",
        help="scale the longest extent to M metres (default: the file's numbers are metres)",
    )
    sub.add_argument(
        "--up",
        choices=_AXES,
        metavar="AXIS",
        help="the file's axis that is up: x, y, z; --up=-z (default: a guess)",
    )
    sub.add_argument(
        "--forward",
        choices=_AXES,
        metavar="AXIS",
        help="the file's axis that the head points along",
    )
    _preview(sub)
    sub.add_argument(
        "--strict", action="store_true", help="refuse a mesh that would have to be repaired"
    )
    sub.add_argument("--density", type=_positive, metavar="RHO", help="kg/m^3")
    sub.add_argument("--youngs-modulus", type=_positive, metavar="E", help="Pa")
    sub.add_argument("--poissons-ratio", type=_poisson, metavar="NU", help="0 to below 0.5")
    sub.add_argument("--medium", choices=("water", "air"), help="what surrounds the body")
    sub.add_argument(
        "--check",
        action="store_true",
        help="print the errors of the reduction over the amplitudes that are used, and against the "
        "full FEM (takes longer)",
    )
    _stage(sub)
    _common(sub)


def _gait(sub: argparse.ArgumentParser) -> None:
    _task(sub)
    sub.add_argument("--gait-solver", metavar="NAME", help="(default: the run's or task's)")
    _stage(sub)
    _common(sub)


def _surrogate(sub: argparse.ArgumentParser) -> None:
    _task(sub)
    sub.add_argument("--pairs", type=_count, metavar="N", help="(default: the run's, or 1000)")
    _stage(sub)
    _common(sub)


def _planner(sub: argparse.ArgumentParser) -> None:
    _task(sub)
    sub.add_argument("--planner", metavar="NAME", help="(default: the run's or task's)")
    _training(sub)
    _stage(sub)
    _common(sub)


def _evaluate(sub: argparse.ArgumentParser) -> None:
    _task(sub)
    sub.add_argument("--planner", metavar="NAME", help="(default: the run's or task's)")
    _feedback(sub)
    sub.add_argument(
        "--shield",
        action=argparse.BooleanOptionalAction,
        default=True,
        help="check the planner's choice for collisions (default: with it)",
    )
    sub.add_argument(
        "--scenes",
        choices=_SCENES,
        metavar="NAME",
        default="novel",
        help=f"k2 (training targets), novel (unseen scenes, default) or {', '.join(_SCENES[2:])}",
    )
    sub.add_argument("--obstacles", type=_natural, metavar="N", help="on the way to each target")
    sub.add_argument("--episodes", type=_count, metavar="N", help="how many scenes")
    sub.add_argument(
        "--obstacle-speed", type=_not_negative, default=0.0, metavar="V", help="m/s (default: 0)"
    )
    sub.add_argument("--log", type=Path, metavar="DIR", help="log each episode (MCAP) into DIR")
    _stage(sub)
    _workers(sub)
    _common(sub)


def _bound(sub: argparse.ArgumentParser) -> None:
    _task(sub)
    sub.add_argument(
        "--planner",
        metavar="NAME",
        action="append",
        help="to be judged, as often as you like (default: the run's)",
    )
    sub.add_argument(
        "--scenes",
        choices=_SCENES,
        metavar="NAME",
        action="append",
        help=f"as often as you like: {', '.join(_SCENES)} (default: all but k2 and novel)",
    )
    sub.add_argument(
        "--obstacle-speed",
        type=_not_negative,
        action="append",
        metavar="V",
        help="in k2 and novel, as often as you like, m/s (default: 0)",
    )
    sub.add_argument(
        "--episodes", type=_count, default=50, metavar="N", help="of each kind (default: 50)"
    )
    _stage(sub)
    _workers(sub)
    _common(sub)


def _noise(sub: argparse.ArgumentParser) -> None:
    _task(sub)
    sub.add_argument(
        "--episodes", type=_count, default=50, metavar="N", help="of each strength (default: 50)"
    )
    _stage(sub)
    _workers(sub)
    _common(sub)


def _check(sub: argparse.ArgumentParser) -> None:
    _task(sub)
    sub.add_argument(
        "--run", type=Path, metavar="DIR", help="of a run's body and gaits (default: the packaged)"
    )
    sub.add_argument(
        "--no-full", dest="full", action="store_false", help="leave the full FEM out: seconds"
    )
    sub.add_argument(
        "--bodies",
        action="store_true",
        help="also bodies with more modes, a larger basis, more drag points: minutes",
    )
    sub.add_argument(
        "--cycles", type=_count, default=50, metavar="N", help="that falls are counted in (50)"
    )
    sub.add_argument("--seed", type=_natural, default=0, metavar="S", help="(default: 0)")
    _common(sub)


def _robustness(sub: argparse.ArgumentParser) -> None:
    _task(sub)
    sub.add_argument(
        "--feedback",
        metavar="NAME",
        action="append",
        help="to be measured, as often as you like (default: all that are installed)",
    )
    sub.add_argument("--cycles", type=_count, default=200, metavar="N", help="(default: 200)")
    sub.add_argument(
        "--push", type=_not_negative, default=0.3, metavar="V", help="m/s (default: 0.3)"
    )
    _stage(sub)
    _workers(sub, "walks")
    _common(sub)


def _bench(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("task", metavar="TASK", nargs="?", default="fish-swim",
                     help="whose body is timed (default: fish-swim)")  # fmt: skip
    sub.add_argument(
        "--quick", action="store_true", help="fewer repeats: to try it, not to quote it"
    )
    _stage(sub)
    _common(sub)


def _compare(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("log", nargs="+", type=Path, metavar="LOG", help="MCAP file")
    sub.add_argument(
        "-o", "--output", type=Path, metavar="FILE", help="write the plot (PNG, SVG or PDF)"
    )
    _common(sub)


def _logs(sub: argparse.ArgumentParser) -> None:
    sub.add_argument(
        "log", nargs="+", type=Path, metavar="DIR", help="folder with logs, or a log (MCAP file)"
    )
    _common(sub)


def _export(sub: argparse.ArgumentParser) -> None:
    sub.add_argument(
        "log", nargs="+", type=Path, metavar="LOG", help="MCAP file, or a folder with some"
    )
    sub.add_argument(
        "-o", "--output", type=Path, metavar="FILE", help="table to write: .parquet or .csv"
    )
    sub.add_argument(
        "--table",
        choices=("steps", "cycles", "episodes"),
        default="steps",
        help="which: a row for each physics step (default), gait cycle or episode",
    )
    sub.add_argument(
        "--rerun", type=Path, metavar="FILE", help="recording to write: .rrd, of one log"
    )
    sub.add_argument(
        "--layout",
        type=Path,
        metavar="FILE",
        help="layout to write (JSON) for Foxglove and Lichtblick, with the names of one log's numbers",
    )
    _common(sub)


def _replay(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("log", type=Path, metavar="LOG", help="MCAP file")
    sub.add_argument(
        "--video",
        type=Path,
        metavar="FILE",
        help="draw it as a video (MP4, WebP, GIF) or as a picture of its end (PNG)",
    )
    sub.add_argument(
        "--camera",
        metavar="NAME",
        default="chase",
        help="of the video: chase, side, top, map (all of the way), overview (default: chase)",
    )
    sub.add_argument(
        "--size",
        type=_size,
        metavar="WxH",
        help="of the video in pixels (default: 480x270, of a picture 960x540)",
    )
    sub.add_argument(
        "--fps", type=_positive, default=25.0, metavar="N", help="frames a second (default: 25)"
    )
    sub.add_argument(
        "--since", type=_not_negative, default=0.0, metavar="S", help="draw from there on (s)"
    )
    sub.add_argument(
        "--until", type=_positive, default=math.inf, metavar="S", help="draw up to there (s)"
    )
    _common(sub)


def _view(sub: argparse.ArgumentParser) -> None:
    _task(sub)
    sub.add_argument("--planner", metavar="NAME", help="(default: the run's or task's)")
    _feedback(sub)
    sub.add_argument(
        "--shield", action=argparse.BooleanOptionalAction, default=True, help="(default: with it)"
    )
    sub.add_argument("--obstacles", type=_natural, metavar="N", help="on the way to the target")
    sub.add_argument(
        "--live",
        action="store_true",
        help="stream to Foxglove or Lichtblick instead; needs no screen",
    )
    sub.add_argument(
        "--port", type=_port, default=8765, metavar="N", help="of that (default: 8765)"
    )
    sub.add_argument("--episodes", type=_count, metavar="N", help="of that (default: until Ctrl-C)")
    _stage(sub)
    _common(sub)


def _training(sub: argparse.ArgumentParser) -> None:
    sub.add_argument(
        "--training-seconds",
        type=_positive,
        metavar="S",
        help="cut the training short after this wall time (default: never)",
    )


def _feedback(sub: argparse.ArgumentParser) -> None:
    sub.add_argument(
        "--feedback", metavar="NAME", help="see `defplan list` (default: the run's or task's)"
    )


def _task(sub: argparse.ArgumentParser) -> None:
    sub.add_argument(
        "task", metavar="TASK", help="e.g. fish-swim, see `defplan list`; or a task file (.toml)"
    )


def _stage(sub: argparse.ArgumentParser) -> None:
    """Add the options of commands that work in a run's folder."""
    sub.add_argument("--seed", type=_natural, default=0, help="(default: 0)")
    sub.add_argument("--logs", type=Path, default=Path("logs"), metavar="DIR",
                     help="where the runs lie (default: logs)")  # fmt: skip
    sub.add_argument("--fresh", action="store_true", help="use nothing made before")
    sub.add_argument("--remake", action="store_true",
                     help="make finished stages anew if they were made with other options")  # fmt: skip


def _workers(sub: argparse.ArgumentParser, what: str = "episodes", most: str = "the cores") -> None:
    """Add where many of something are done at a time."""
    sub.add_argument(
        "--jobs",
        type=_count,
        metavar="N",
        help=f"{what} at a time, each in a process (default: {most})",
    )
    sub.add_argument(
        "--scheduler", metavar="ADDRESS", help=f"of a Dask cluster that does the {what}"
    )
    sub.add_argument(
        "--scheduler-file", type=Path, metavar="FILE", help="that `dask scheduler` has written"
    )


def _common(sub: argparse.ArgumentParser) -> None:
    """Add the options of every command."""
    sub.add_argument("--json", action="store_true", help="print one JSON object and nothing else")
    sub.add_argument("--quiet", action="store_true", help="no progress and no messages")
    sub.add_argument("--debug", action="store_true", help="show the traceback of an error")


def _natural(text: str) -> int:
    return _number(text, int, lambda n: n >= 0, "a whole number, 0 or more")


def _count(text: str) -> int:
    return _number(text, int, lambda n: n >= 1, "a whole number, 1 or more")


def _port(text: str) -> int:
    return _number(text, int, lambda n: 0 <= n < 2**16, "a port, 1 to 65535; 0: a free one")


def _positive(text: str) -> float:
    return _number(text, float, lambda x: 0 < x < math.inf, "a positive number")


def _not_negative(text: str) -> float:
    return _number(text, float, lambda x: 0 <= x < math.inf, "a number, 0 or more")


def _poisson(text: str) -> float:
    return _number(text, float, lambda x: 0 <= x < 0.5, "a number from 0 to below 0.5")


def _size(text: str) -> tuple[int, int]:
    what = "a size like 640x360, of 16 to 4096 pixels"
    sides = [_number(side, int, lambda n: 16 <= n <= 4096, what) for side in text.split("x", 1)]
    if len(sides) != 2:
        raise argparse.ArgumentTypeError(f"{text} is not {what}")
    return sides[0] - sides[0] % 2, sides[1] - sides[1] % 2  # codecs want even ones


def _number(text: str, kind: type, fits: Callable[[Any], bool], description: str) -> Any:
    try:
        value = kind(text)
    except ValueError:
        value = None
    if value is None or not fits(value):
        raise argparse.ArgumentTypeError(f"{text} is not {description}")
    return value
