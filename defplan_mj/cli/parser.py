"""The grammar of the command line: its commands, in one list, and what is said of wrong use."""

from __future__ import annotations

import argparse
import difflib
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NoReturn

from defplan_mj.base.printable import printable
from defplan_mj.cli import body, commands, logs, new, options, shared_options, study
from defplan_mj.cli.shared_options import AXES

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
        if words and words[-1] in ("--up", "--forward") and word in AXES:
            words[-1] += f"={word}"
        else:
            words.append(word)
    return words


@dataclass(frozen=True)
class Command:
    """A command.

    Attributes:
        name: what it is called.
        run: does it, and returns the exit code.
        options: adds its options.
        help: one line.
        draws: whether it may need a screen.
    """

    name: str
    run: Callable[..., int]
    options: Callable[[argparse.ArgumentParser], None]
    help: str
    draws: bool = False


def all_commands() -> tuple[Command, ...]:
    """Return the commands in the order of `defplan --help`."""
    return (
        Command(
            "list",
            commands.list_installed,
            shared_options.common,
            "name the tasks, solvers, sensors, studies and suite tasks that are installed",
        ),
        Command(
            "run",
            commands.run,
            options.run,
            "do everything: mesh, gaits, planner, evaluation, log, report",
            draws=True,
        ),
        Command(
            "study",
            study.study,
            options.study,
            "carry out many runs by one file: their table, their page",
            draws=True,
        ),
        Command(
            "new",
            new.new,
            options.new,
            "write a task file, guessed from a mesh or copied from a task",
        ),
        Command("body", body.body, options.body, "build a soft body from a mesh file"),
        Command("gait", commands.gait, options.gait, "optimise a task's gaits"),
        Command(
            "surrogate",
            commands.surrogate,
            options.surrogate,
            "fit the rigid surrogate to a task's gaits",
        ),
        Command("planner", commands.planner, options.planner, "train a planner on the surrogate"),
        Command(
            "evaluate",
            commands.evaluate,
            options.evaluate,
            "let a planner steer the reduced dynamics",
        ),
        Command(
            "bound",
            commands.bound,
            options.bound,
            "judge planners against one that knows all that moves where",
        ),
        Command(
            "noise",
            commands.noise,
            options.noise,
            "count successes with bad sensing, other mass, other drag",
        ),
        Command(
            "robustness",
            commands.robustness,
            options.robustness,
            "count a task's falls among pushes, slopes and so on",
        ),
        Command(
            "check",
            commands.check,
            options.check,
            "play a task's gaits with finer steps and in the full FEM",
        ),
        Command(
            "bench",
            commands.bench,
            options.bench,
            "time the step, its peers, the surrogate and the laser",
        ),
        Command(
            "compare",
            logs.compare,
            options.compare,
            "compare the surrogate with the truth, from logs",
        ),
        Command(
            "replay", logs.replay, options.replay, "simulate a log again, to the bit", draws=True
        ),
        Command("logs", logs.logs, options.logs, "say how the episodes of many logs ended"),
        Command("export", logs.export, options.export, "write logs as a table, or for Rerun"),
        Command(
            "view",
            commands.view,
            options.view,
            "watch a task in MuJoCo's viewer, or live in Foxglove",
            draws=True,
        ),
    )


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
    for command in all_commands():
        sub = subparsers.add_parser(
            command.name, help=command.help, description=command.help, allow_abbrev=False
        )
        sub.set_defaults(command=command.run, draws=command.draws, parser=sub)
        command.options(sub)
    return parser
