"""Ctrl-C and SIGTERM: heard wherever they come, once, and told apart from errors."""

from __future__ import annotations

import atexit
import contextlib
import os
import signal
import sys
from types import FrameType
from typing import Any

AGAIN_SECONDS = 1.0
"""How long after a stop it is looked whether somebody has swallowed it."""


class Terminated(KeyboardInterrupt):
    """SIGTERM; all that cleans up after Ctrl-C cleans up after it."""


class Stops:
    """Listens for SIGINT and SIGTERM while a command runs.

    A KeyboardInterrupt can get lost: code that is called back from C, destructors and careless
    libraries drop any exception. So it is raised again, as long as nothing is cleaning up after it.

    Attributes:
        received: the first signal that came; None: there was none.
    """

    def __init__(self) -> None:
        self.received: int | None = None
        self._before: dict[int, Any] = {}
        self._unraisable: Any = None

    @property
    def code(self) -> int:
        """The exit code that shells know for the signal: 130 or 143."""
        return 128 + (self.received or signal.SIGINT)

    def listen(self) -> None:
        """Take over the signals that would stop this process; those that are ignored stay so."""
        theirs = {signal.SIGINT: signal.default_int_handler, signal.SIGTERM: signal.SIG_DFL}
        try:
            for number, usual in theirs.items():
                if signal.getsignal(number) is usual:
                    self._before[number] = signal.signal(number, self._stop)
        except ValueError:  # not the main thread of a program that calls us
            self._before.clear()
        if self._before and signal.getsignal(signal.SIGALRM) is signal.SIG_DFL:
            self._before[signal.SIGALRM] = signal.signal(signal.SIGALRM, self._again)
        if self._before:
            self._unraisable, sys.unraisablehook = sys.unraisablehook, self._tell_unraisable

    def _tell_unraisable(self, lost: Any) -> None:
        """Tell of an exception that a destructor dropped, but not of a stop: it is raised again."""
        if not issubclass(lost.exc_type, KeyboardInterrupt):
            self._unraisable(lost)

    def end_with_code(self) -> None:
        """Let this process end with `code` after a stop, whatever it interrupted.

        CPython ends itself by SIGINT where a KeyboardInterrupt came out of an `exec` of text, as every
        dataclass has one, though it was caught (Py_RunMain, for `python -m`).
        """
        atexit.register(self._end)  # before others register: it is the last to be called

    def _end(self) -> None:
        if self.received is not None:
            for stream in (sys.stdout, sys.stderr):
                with contextlib.suppress(OSError, ValueError, AttributeError):
                    stream.flush()
            os._exit(self.code)

    def acknowledge(self) -> None:
        """Ignore all further stops: this one, or an error, is being told."""
        for number in self._before:
            signal.signal(number, signal.SIG_IGN)
        if signal.SIGALRM in self._before:
            signal.setitimer(signal.ITIMER_REAL, 0.0)

    def leave(self) -> None:
        """Give the signals back."""
        if signal.SIGALRM in self._before:
            signal.setitimer(signal.ITIMER_REAL, 0.0)
        for number, before in self._before.items():
            signal.signal(number, before)
        self._before.clear()
        if self._unraisable is not None:
            sys.unraisablehook, self._unraisable = self._unraisable, None

    def _stop(self, number: int, frame: FrameType | None) -> None:
        if self.received is None:
            self.received = number
            if signal.SIGALRM in self._before:
                signal.setitimer(signal.ITIMER_REAL, AGAIN_SECONDS, AGAIN_SECONDS)
        elif _is_cleaning_up():  # impatient, but half a cleaning leaves more behind than none
            return
        self._raise()

    def _again(self, number: int, frame: FrameType | None) -> None:
        if not _is_cleaning_up():
            self._raise()

    def _raise(self) -> None:
        if self.received == signal.SIGTERM:
            raise Terminated
        raise KeyboardInterrupt


def _is_cleaning_up() -> bool:
    """Return whether a stop is being handled: in an `except`, a `finally` or at the end of a `with`."""
    error = sys.exc_info()[1]
    while error is not None:
        if isinstance(error, KeyboardInterrupt):
            return True
        error = error.__context__
    return False
