"""Options that several commands have, and the types of their values."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

AXES = ("x", "-x", "y", "-y", "z", "-z")


def guessing(sub: argparse.ArgumentParser) -> None:
    """Add what a task is guessed from, besides its mesh."""
    sub.add_argument("--medium", choices=("water", "ground"), help="what a mesh moves in, or on")
    sub.add_argument("--length", type=positive, metavar="M", help="longest extent (default: 1 m)")
    sub.add_argument("--up", choices=AXES, help="axis of the mesh file (default: guessed)")
    sub.add_argument("--forward", choices=AXES, help="axis of the mesh file (default: guessed)")
    preview(sub)


def preview(sub: argparse.ArgumentParser) -> None:
    sub.add_argument(
        "--preview", type=Path, metavar="FILE.png", help="picture of which way the mesh looks"
    )


def training(sub: argparse.ArgumentParser) -> None:
    sub.add_argument(
        "--training-seconds",
        type=positive,
        metavar="S",
        help="cut the training short after this wall time (default: never)",
    )


def solver(sub: argparse.ArgumentParser, name: str) -> None:
    sub.add_argument(f"--{name}", metavar="NAME", help="(default: the run's or task's)")


def feedback(sub: argparse.ArgumentParser) -> None:
    sub.add_argument(
        "--feedback", metavar="NAME", help="see `defplan list` (default: the run's or task's)"
    )


def task(sub: argparse.ArgumentParser) -> None:
    sub.add_argument(
        "task", metavar="TASK", help="e.g. fish-swim, see `defplan list`; or a task file (.toml)"
    )


def stage(sub: argparse.ArgumentParser) -> None:
    """Add the options of commands that work in a run's folder."""
    sub.add_argument("--seed", type=natural, default=0, help="(default: 0)")
    sub.add_argument("--logs", type=Path, default=Path("logs"), metavar="DIR",
                     help="where the runs lie (default: logs)")  # fmt: skip
    sub.add_argument("--fresh", action="store_true", help="use nothing made before")
    remake(sub)


def remake(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("--remake", action="store_true",
                     help="make finished stages anew if they were made with other options")  # fmt: skip


def workers(sub: argparse.ArgumentParser, what: str = "episodes", most: str = "the cores") -> None:
    """Add where many of something are done at a time."""
    sub.add_argument(
        "--jobs",
        type=count,
        metavar="N",
        help=f"{what} at a time, each in a process (default: {most})",
    )
    sub.add_argument(
        "--scheduler", metavar="ADDRESS", help=f"of a Dask cluster that does the {what}"
    )
    sub.add_argument(
        "--scheduler-file", type=Path, metavar="FILE", help="that `dask scheduler` has written"
    )


def common(sub: argparse.ArgumentParser) -> None:
    """Add the options of every command."""
    sub.add_argument("--json", action="store_true", help="print one JSON object and nothing else")
    sub.add_argument("--quiet", action="store_true", help="no progress and no messages")
    sub.add_argument("--debug", action="store_true", help="show the traceback of an error")


def natural(text: str) -> int:
    return _number(text, int, lambda n: n >= 0, "a whole number, 0 or more")


def count(text: str) -> int:
    return _number(text, int, lambda n: n >= 1, "a whole number, 1 or more")


def port(text: str) -> int:
    return _number(text, int, lambda n: 0 <= n < 2**16, "a port, 1 to 65535; 0: a free one")


def positive(text: str) -> float:
    return _number(text, float, lambda x: 0 < x < math.inf, "a positive number")


def not_negative(text: str) -> float:
    return _number(text, float, lambda x: 0 <= x < math.inf, "a number, 0 or more")


def poisson(text: str) -> float:
    return _number(text, float, lambda x: 0 <= x < 0.5, "a number from 0 to below 0.5")


def size(text: str) -> tuple[int, int]:
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
