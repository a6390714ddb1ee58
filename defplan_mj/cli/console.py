"""What a command shows: results on stdout, progress and messages on stderr; with --json one object only."""

from __future__ import annotations

import contextlib
import json
import os
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from types import TracebackType
from typing import TYPE_CHECKING, Any

from defplan_mj.base.errors import DefplanError
from defplan_mj.base.printable import printable
from defplan_mj.cli import streams

if TYPE_CHECKING:
    from defplan_mj.base.progress import Progress

PLAIN_SECONDS = 5.0  # a plain progress line at most this often
BAR_SECONDS = 0.1


class Console:
    """The two output streams of one command.

    With `json`, everything that anybody prints to stdout, C libraries included, goes to stderr
    while the command runs, so that stdout holds the one object of `result`.
    """

    def __init__(self, json: bool = False, quiet: bool = False) -> None:
        self.json = json
        self.quiet = quiet
        self._stdout: int | None = None
        self._redirected = contextlib.redirect_stdout(sys.stderr)

    def __enter__(self) -> Console:
        if self.json:
            sys.stdout.flush()
            self._stdout = os.dup(1)
            os.dup2(2, 1)  # for C libraries
            self._redirected.__enter__()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._stdout is not None:
            self._redirected.__exit__(kind, error, trace)
            os.dup2(self._stdout, 1)
            os.close(self._stdout)
            self._stdout = None
        elif kind is None:
            sys.stdout.flush()  # here, where a full disk is still an error and not a warning

    def say(self, text: str) -> None:
        """Print a message for the user (stderr), unless --quiet."""
        if not self.quiet:
            print(printable(text, lines=True), file=sys.stderr, flush=True)

    def result(self, data: Mapping[str, Any], text: str) -> None:
        """Print the result: `data` as one JSON object with --json, else `text`."""
        if streams.is_closed(1):
            raise DefplanError("stdout is closed: the work is done, its result cannot be printed")
        if self._stdout is not None:
            from defplan_mj.base import files  # NumPy is loaded only when there is a result

            line = json.dumps(data, default=files.plain, allow_nan=False) + "\n"
            with open(os.dup(self._stdout), "w", encoding="utf-8") as stream:
                stream.write(line)
        else:
            print(printable(text, lines=True))

    def asker(self) -> Callable[[str], bool] | None:
        """Return what asks the user a question; None if nobody is there to answer."""
        there = sys.stdin is not None and sys.stdin.isatty() and sys.stderr.isatty()
        return None if self.json or self.quiet or not there else _ask

    @contextlib.contextmanager
    def progress(self) -> Iterator[Progress]:
        """Yield a `Progress`: bars on a terminal, plain lines otherwise, nothing with --quiet."""
        if self.quiet:
            yield lambda message, fraction: None
        elif sys.stderr.isatty():
            with _bars() as show:
                yield show
        else:
            yield _PlainLines()


def _ask(question: str) -> bool:
    """Return whether the user answers yes; no answer is no."""
    print(f"{printable(question, lines=True)} [y/N] ", end="", file=sys.stderr, flush=True)
    return sys.stdin.readline().strip().lower() in ("y", "yes")


class _PlainLines:
    """Progress for a file or a pipe: a line when the message changes and every few seconds."""

    def __init__(self) -> None:
        from defplan_mj.base.progress import TimeLeft

        self.message = ""
        self.next = 0.0
        self.left = TimeLeft(time.monotonic)

    def __call__(self, message: str, fraction: float) -> None:
        now, left = time.monotonic(), self.left(message, fraction)
        if message == self.message and now < self.next:
            return
        self.message, self.next = message, now + PLAIN_SECONDS
        line = f"{printable(message)} {100 * fraction:3.0f}%{_told(left)}"
        print(line, file=sys.stderr, flush=True)


def _told(seconds: float | None) -> str:
    """Return how long it still takes, to be put behind a percentage; nothing if that is not known."""
    from defplan_mj.base.progress import duration

    return "" if seconds is None else f", about {duration(seconds)} left"


@contextlib.contextmanager
def _bars() -> Iterator[Progress]:
    """Yield a Progress that shows one bar; what is done stays above it as a line."""
    from rich.console import Console as RichConsole
    from rich.progress import BarColumn, TaskProgressColumn, TextColumn, TimeElapsedColumn
    from rich.progress import Progress as RichProgress

    from defplan_mj.base.progress import TimeLeft

    columns = (
        TextColumn("{task.description:<34}", markup=False),
        BarColumn(),
        TaskProgressColumn(),
        TimeElapsedColumn(),
        TextColumn("{task.fields[left]}"),
    )
    bars, started = RichProgress(*columns, console=RichConsole(stderr=True)), False
    try:
        shown: dict[str, Any] = {}
        last, time_left = 0.0, TimeLeft(time.monotonic)

        def show(message: str, fraction: float) -> None:
            nonlocal last, started
            if not started:  # not before: a question may be asked first
                bars.start()
                started = True
            now, seconds = time.monotonic(), time_left(message, fraction)
            if message in shown and fraction < 1 and now - last < BAR_SECONDS:
                return
            last = now
            if message not in shown:
                for earlier in shown.values():  # what came before is done
                    bars.update(earlier, completed=1.0, left="")
                shown[message] = bars.add_task(printable(message), total=1.0, left="")
            done = min(max(fraction, 0.0), 1.0)
            bars.update(shown[message], completed=done, left=_told(seconds).lstrip(", "))

        yield show
    finally:
        if started:
            bars.stop()


def table(columns: Sequence[str], rows: Sequence[Sequence[Any]], title: str = "") -> str:
    """Return a plain-text table: first column to the left, the others to the right."""
    text = [[printable(str(cell)) for cell in row] for row in rows]
    width = [max(len(c), *(len(r[i]) for r in text), 0) for i, c in enumerate(columns)]

    def line(cells: Sequence[str]) -> str:
        padded = [cells[0].ljust(width[0])]
        padded += [c.rjust(w) for c, w in zip(cells[1:], width[1:], strict=True)]
        return "  ".join(padded).rstrip()

    rule = "  ".join("-" * w for w in width)
    return "\n".join([*([title] if title else []), line(list(columns)), rule, *map(line, text)])
