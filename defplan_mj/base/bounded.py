"""Work on what others have written, by code of others, within bounds of memory and time."""

from __future__ import annotations

import contextlib
import resource
import signal
import threading
from collections.abc import Iterator
from pathlib import Path
from types import FrameType

AGAIN_SECONDS = 0.5
"""How long after the time was up it is looked whether somebody has swallowed that."""


class TooLong(BaseException):
    """The time was up; no `Exception`, which libraries drop."""


@contextlib.contextmanager
def bounded(memory: int, seconds: float) -> Iterator[None]:
    """Let this process take `memory` further bytes and `seconds` of CPU time within the block.

    What it takes from the system counts, whether it uses it or not, and all its threads do. The time is
    bounded in the main thread only, and in Python, not within a call of C. Where the system does not tell
    how much a process has (no Linux), memory is not bounded.

    Raises:
        MemoryError: there is no more; by whatever asks for it.
        TooLong: the time is up.
    """
    with _memory(memory), _time(seconds):
        yield


@contextlib.contextmanager
def _memory(most: int) -> Iterator[None]:
    size = _size()
    before, hard = resource.getrlimit(resource.RLIMIT_AS)
    limit = size + most
    if size == 0 or (before != resource.RLIM_INFINITY and before <= limit):
        yield
        return
    resource.setrlimit(resource.RLIMIT_AS, (limit, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (before, hard))


def _size() -> int:
    """Return the bytes that this process has from the system; 0: unknown."""
    try:
        return int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    except (OSError, ValueError, IndexError):
        return 0


@contextlib.contextmanager
def _time(seconds: float) -> Iterator[None]:
    free = signal.getsignal(signal.SIGVTALRM) is signal.SIG_DFL
    if threading.current_thread() is not threading.main_thread() or not free:
        yield
        return
    signal.signal(signal.SIGVTALRM, _up)
    try:
        signal.setitimer(signal.ITIMER_VIRTUAL, seconds, AGAIN_SECONDS)
        yield
    finally:
        signal.setitimer(signal.ITIMER_VIRTUAL, 0.0)
        signal.signal(signal.SIGVTALRM, signal.SIG_DFL)


def _up(number: int, frame: FrameType | None) -> None:
    raise TooLong
