"""The options of each command: a function by its name that adds them."""

from __future__ import annotations

import argparse
import math
from pathlib import Path

from defplan_mj.base.places import PLACES
from defplan_mj.cli import shared_options as shared
from defplan_mj.planning.outcome import SCENES

_SCENES = (*SCENES, *PLACES)


def new(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("mesh", metavar="MESH", nargs="?", help="mesh file to guess a task for")
    sub.add_argument(
        "-o", "--output", type=Path, metavar="FILE", help="to write (default: NAME.toml)"
    )
    sub.add_argument("--from", dest="origin", metavar="TASK", help="copy this task instead")
    sub.add_argument("--overwrite", action="store_true", help="if the file is there")
    shared.guessing(sub)
    shared.common(sub)


def run(sub: argparse.ArgumentParser) -> None:
    sub.add_argument(
        "task",
        metavar="TASK",
        help="e.g. fish-swim, see `defplan list`; or a task file (.toml), or a mesh with --medium",
    )
    shared.guessing(sub)
    shared.stage(sub)
    shared.solver(sub, "gait-solver")
    shared.solver(sub, "planner")
    shared.feedback(sub)
    sub.add_argument(
        "--compare-with",
        metavar="NAME",
        action="append",
        help="gait solver that the report compares with; may be given more than once "
        "(default: the task's; none: do not)",
    )
    sub.add_argument(
        "--solver-seeds", type=shared.count, metavar="N", help="of that comparison (default: 1)"
    )
    sub.add_argument(
        "--pairs",
        type=shared.count,
        metavar="N",
        help="for the surrogate (default: 1000, of a mesh 300)",
    )
    shared.training(sub)
    sub.add_argument(
        "--episodes",
        type=shared.count,
        metavar="N",
        help="unseen scenes (default: 200, of a mesh 100)",
    )
    sub.add_argument(
        "--moving",
        type=shared.natural,
        metavar="N",
        help="episodes among moving obstacles, for each of four speeds (default: 40, of a mesh 0: none)",
    )
    shared.workers(sub)
    shared.common(sub)


def study(sub: argparse.ArgumentParser) -> None:
    sub.add_argument(
        "study", metavar="STUDY", help="a study file (.toml), or one that `defplan list` names"
    )
    sub.add_argument(
        "--dry-run",
        action="store_true",
        help="say what is there, what is to be made and about how long it takes; make nothing",
    )
    sub.add_argument("--quick", action="store_true", help="with the file's table [quick]")
    shared.workers(sub, "runs", "1")
    sub.add_argument("--logs", type=Path, default=Path("logs"), metavar="DIR",
                     help="where the study's folder lies (default: logs)")  # fmt: skip
    shared.remake(sub)
    shared.common(sub)


def body(sub: argparse.ArgumentParser) -> None:
    sub.add_argument(
        "mesh",
        metavar="MESH",
        help="a surface (STL, OBJ, PLY, OFF, glTF, 3MF, DAE, ...) or cells (.msh, .vtk, .vtu, "
        ".mesh, ...), or a TASK: its mesh and its options",
    )
    sub.add_argument(
        "-o", "--output", type=Path, metavar="FILE", help="body file to write (default: NAME.npz)"
    )
    sub.add_argument("--vertices", type=shared.count, metavar="N", help="of the tetrahedral mesh")
    sub.add_argument("--modes", type=shared.count, metavar="R", help="modal coordinates")
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
        type=shared.positive,
        metavar="M",
        help="scale the longest extent to M metres (default: the file's numbers are metres)",
    )
    sub.add_argument(
        "--up",
        choices=shared.AXES,
        metavar="AXIS",
        help="the file's axis that is up: x, y, z; --up=-z (default: a guess)",
    )
    sub.add_argument(
        "--forward",
        choices=shared.AXES,
        metavar="AXIS",
        help="the file's axis that the head points along",
    )
    shared.preview(sub)
    sub.add_argument(
        "--strict", action="store_true", help="refuse a mesh that would have to be repaired"
    )
    sub.add_argument("--density", type=shared.positive, metavar="RHO", help="kg/m^3")
    sub.add_argument("--youngs-modulus", type=shared.positive, metavar="E", help="Pa")
    sub.add_argument("--poissons-ratio", type=shared.poisson, metavar="NU", help="0 to below 0.5")
    sub.add_argument("--medium", choices=("water", "air"), help="what surrounds the body")
    sub.add_argument(
        "--check",
        action="store_true",
        help="print the errors of the reduction over the amplitudes that are used, and against the "
        "full FEM (takes longer)",
    )
    shared.stage(sub)
    shared.common(sub)


def gait(sub: argparse.ArgumentParser) -> None:
    shared.task(sub)
    shared.solver(sub, "gait-solver")
    shared.stage(sub)
    shared.common(sub)


def surrogate(sub: argparse.ArgumentParser) -> None:
    shared.task(sub)
    sub.add_argument(
        "--pairs", type=shared.count, metavar="N", help="(default: the run's, or 1000)"
    )
    shared.stage(sub)
    shared.common(sub)


def planner(sub: argparse.ArgumentParser) -> None:
    shared.task(sub)
    shared.solver(sub, "planner")
    shared.training(sub)
    shared.stage(sub)
    shared.common(sub)


def evaluate(sub: argparse.ArgumentParser) -> None:
    shared.task(sub)
    shared.solver(sub, "planner")
    shared.feedback(sub)
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
    sub.add_argument(
        "--obstacles", type=shared.natural, metavar="N", help="on the way to each target"
    )
    sub.add_argument("--episodes", type=shared.count, metavar="N", help="how many scenes")
    sub.add_argument(
        "--obstacle-speed",
        type=shared.not_negative,
        default=0.0,
        metavar="V",
        help="m/s (default: 0)",
    )
    sub.add_argument("--log", type=Path, metavar="DIR", help="log each episode (MCAP) into DIR")
    shared.stage(sub)
    shared.workers(sub)
    shared.common(sub)


def bound(sub: argparse.ArgumentParser) -> None:
    shared.task(sub)
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
        type=shared.not_negative,
        action="append",
        metavar="V",
        help="in k2 and novel, as often as you like, m/s (default: 0)",
    )
    sub.add_argument(
        "--episodes", type=shared.count, default=50, metavar="N", help="of each kind (default: 50)"
    )
    shared.stage(sub)
    shared.workers(sub)
    shared.common(sub)


def noise(sub: argparse.ArgumentParser) -> None:
    shared.task(sub)
    sub.add_argument(
        "--episodes",
        type=shared.count,
        default=50,
        metavar="N",
        help="of each strength (default: 50)",
    )
    shared.stage(sub)
    shared.workers(sub)
    shared.common(sub)


def check(sub: argparse.ArgumentParser) -> None:
    shared.task(sub)
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
        "--cycles",
        type=shared.count,
        default=50,
        metavar="N",
        help="that falls are counted in (50)",
    )
    sub.add_argument("--seed", type=shared.natural, default=0, metavar="S", help="(default: 0)")
    shared.common(sub)


def robustness(sub: argparse.ArgumentParser) -> None:
    shared.task(sub)
    sub.add_argument(
        "--feedback",
        metavar="NAME",
        action="append",
        help="to be measured, as often as you like (default: all that are installed)",
    )
    sub.add_argument("--cycles", type=shared.count, default=200, metavar="N", help="(default: 200)")
    sub.add_argument(
        "--push", type=shared.not_negative, default=0.3, metavar="V", help="m/s (default: 0.3)"
    )
    shared.stage(sub)
    shared.workers(sub, "walks")
    shared.common(sub)


def bench(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("task", metavar="TASK", nargs="?", default="fish-swim",
                     help="whose body is timed (default: fish-swim)")  # fmt: skip
    sub.add_argument(
        "--quick", action="store_true", help="fewer repeats: to try it, not to quote it"
    )
    shared.stage(sub)
    shared.common(sub)


def compare(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("log", nargs="+", type=Path, metavar="LOG", help="MCAP file")
    sub.add_argument(
        "-o", "--output", type=Path, metavar="FILE", help="write the plot (PNG, SVG or PDF)"
    )
    shared.common(sub)


def logs(sub: argparse.ArgumentParser) -> None:
    sub.add_argument(
        "log", nargs="+", type=Path, metavar="DIR", help="folder with logs, or a log (MCAP file)"
    )
    shared.common(sub)


def export(sub: argparse.ArgumentParser) -> None:
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
    shared.common(sub)


def replay(sub: argparse.ArgumentParser) -> None:
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
        type=shared.size,
        metavar="WxH",
        help="of the video in pixels (default: 480x270, of a picture 960x540)",
    )
    sub.add_argument(
        "--fps",
        type=shared.positive,
        default=25.0,
        metavar="N",
        help="frames a second (default: 25)",
    )
    sub.add_argument(
        "--since", type=shared.not_negative, default=0.0, metavar="S", help="draw from there on (s)"
    )
    sub.add_argument(
        "--until", type=shared.positive, default=math.inf, metavar="S", help="draw up to there (s)"
    )
    shared.common(sub)


def view(sub: argparse.ArgumentParser) -> None:
    shared.task(sub)
    shared.solver(sub, "planner")
    shared.feedback(sub)
    sub.add_argument(
        "--shield", action=argparse.BooleanOptionalAction, default=True, help="(default: with it)"
    )
    sub.add_argument(
        "--obstacles", type=shared.natural, metavar="N", help="on the way to the target"
    )
    sub.add_argument(
        "--live",
        action="store_true",
        help="stream to Foxglove or Lichtblick instead; needs no screen",
    )
    sub.add_argument(
        "--port", type=shared.port, default=8765, metavar="N", help="of that (default: 8765)"
    )
    sub.add_argument(
        "--episodes", type=shared.count, metavar="N", help="of that (default: until Ctrl-C)"
    )
    shared.stage(sub)
    shared.common(sub)
