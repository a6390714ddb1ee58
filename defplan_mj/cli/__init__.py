"""The command `defplan`: parse, run one command, turn every error into one sentence and an exit code."""

from __future__ import annotations

import argparse
import contextlib
import errno
import logging
import os
import sys
import traceback
from collections.abc import Sequence

from defplan_mj.base import threads
from defplan_mj.base.errors import DefplanError
from defplan_mj.base.printable import printable
from defplan_mj.cli import streams
from defplan_mj.cli.stops import Stops, Terminated

LONGEST = 2000
"""Letters of a sentence."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line `argv` (without the program's name; None: that of this process).

    Returns:
        0 if the command did what it was asked, 1 on an error, 2 on wrong usage, 130 on Ctrl-C, 143 on
        SIGTERM.
    """
    debug = "--debug" in (sys.argv if argv is None else argv)
    stops, program = Stops(), "defplan"
    try:
        if argv is None:  # the process is ours
            streams.prepare()
            stops.end_with_code()
        stops.listen()
        threads.set_environment(1)  # before anything loads numpy
        from defplan_mj.cli.parser import parse

        arguments = parse(argv)
        program = arguments.parser.prog
        return _run(arguments)
    except BaseException as error:
        stops.acknowledge()
        if isinstance(error, SystemExit) and stops.received is None:
            return _left(error)  # argparse: --help or wrong usage
        if debug:
            traceback.print_exc()
        return _report(error, stops, program)
    finally:
        if argv is None:
            stops.acknowledge()  # what was asked is done; Python would be interrupted while it leaves
        else:
            stops.leave()


def _run(arguments: argparse.Namespace) -> int:
    from defplan_mj.cli.console import Console
    from defplan_mj.cli.screen import choose_renderer

    choose_renderer(arguments.draws)
    # where HOME cannot be written it says so, twice; it does without
    logging.getLogger("matplotlib").setLevel(logging.ERROR)
    with Console(json=arguments.json, quiet=arguments.quiet) as console:
        return arguments.command(arguments, console)


def _left(stop: SystemExit) -> int:
    """Return the exit code of argparse; its text may not have got out."""
    code = stop.code if isinstance(stop.code, int) else 1
    try:
        if sys.stdout is not None:
            sys.stdout.flush()
        return code
    except OSError as error:
        return _report(error, Stops(), "defplan")


def _drop_output() -> None:
    """Throw away what stdout can no longer take: Python would complain of it again on leaving."""
    try:
        sys.stdout.flush()
    except OSError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _report(error: BaseException, stops: Stops, program: str) -> int:
    """Say `error` in one sentence on stderr, after the command's name; return the exit code."""
    if isinstance(error, KeyboardInterrupt) or stops.received is not None:
        # whatever else it looks like: C code and imports make other errors of an interrupt
        _say(program, "stopped; run it again to go on")
        code = 143 if isinstance(error, Terminated) else stops.code
        if threads.abandoned():
            # a solver still computes in C++: Python would crash when it takes the ground from under it
            os._exit(code)
        return code
    if isinstance(error, OSError):
        _drop_output()
    if isinstance(error, BrokenPipeError):  # the reader, e.g. `head`, has seen enough
        return 1
    if isinstance(error, DefplanError):
        _say(program, str(error))
    elif isinstance(error, OSError) and error.errno is not None:
        _say(program, _system_error(error))
    elif isinstance(error, MemoryError):
        _say(program, "the memory is used up: close other programs or use a smaller mesh")
    else:
        _say(
            program,
            f"this is a mistake in defplan: {type(error).__name__}: {error} (--debug shows where)",
        )
    return 1


def _system_error(error: OSError) -> str:
    """Return one sentence for an error of the operating system."""
    where = f" ({error.filename})" if error.filename else ""
    if error.errno in (errno.ENOSPC, errno.EDQUOT):
        return f"the disk is full{where}: free some space and run it again to go on"
    if error.errno in (errno.EACCES, errno.EPERM, errno.EROFS):
        return f"no permission{where}: {error.strerror}"
    return f"{error.strerror}{where}"


def _say(program: str, sentence: str) -> None:
    with contextlib.suppress(OSError, ValueError):  # stderr may be closed or on the full disk
        text = printable(sentence)
        if len(text) > LONGEST:  # a file may bring along a name without end
            text = f"{text[:LONGEST]} ..."
        print(f"{program}: {text}", file=sys.stderr, flush=True)
