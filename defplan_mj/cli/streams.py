"""The standard streams of a process that may have been started with closed, full or ASCII ones."""

from __future__ import annotations

import contextlib
import io
import os
import sys
from typing import Any

_closed: set[int] = set()


def prepare() -> None:
    """Make stdin, stdout and stderr such that what is shown to people never stops the work.

    A closed descriptor is opened on /dev/null: the next file would get its number, and what is printed
    would land in it. A character that a stream cannot encode is written out; what stderr cannot take
    is lost. Streams that a program has put in place of the process' own stay.
    """
    for number, flags in ((0, os.O_RDONLY), (1, os.O_WRONLY), (2, os.O_WRONLY)):
        try:
            os.fstat(number)
        except OSError:
            _closed.add(number)
            opened = os.open(os.devnull, flags)
            if opened != number:
                os.dup2(opened, number)
                os.close(opened)
    if sys.stdin is None:
        sys.stdin = open(0, closefd=False)  # noqa: SIM115  as long as the process
    if sys.stdout is None:
        sys.stdout = open(1, "w", closefd=False)  # noqa: SIM115
    elif sys.stdout is sys.__stdout__ and isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")
    if sys.stderr is None or (sys.stderr is sys.__stderr__ and not _is_lossy(sys.stderr)):
        encoding = getattr(sys.stderr, "encoding", None) or "utf-8"
        sys.stderr = io.TextIOWrapper(
            io.BufferedWriter(_Lossy(), 1 << 13),
            encoding=encoding,
            errors="backslashreplace",
            line_buffering=True,
        )


def is_closed(number: int) -> bool:
    """Return whether the process was started with a descriptor closed."""
    return number in _closed


class _Lossy(io.RawIOBase):
    """Stderr, of which what it cannot take is lost: a full disk there is no reason to stop."""

    def writable(self) -> bool:
        return True

    def fileno(self) -> int:
        return 2

    def isatty(self) -> bool:
        return os.isatty(2)

    def write(self, data: Any) -> int:
        view = memoryview(data).cast("B")
        done = 0
        with contextlib.suppress(OSError):
            while done < len(view):
                done += os.write(2, view[done:])
        return len(view)


def _is_lossy(stream: object) -> bool:
    buffer = getattr(stream, "buffer", None)
    return isinstance(getattr(buffer, "raw", None), _Lossy)
