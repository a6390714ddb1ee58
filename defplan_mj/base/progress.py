"""How long work says how far it is: a function that is called now and then."""

from __future__ import annotations

import time
from collections.abc import Callable

Progress = Callable[[str, float], None]
"""Called with what is being done and the fraction done (0 to 1)."""


def no_progress(message: str, fraction: float) -> None:
    """Show nothing."""


class TimeLeft:
    """How long work will still take, if it goes on as fast as it has: a guess from the fractions told.

    Messages of one stage ('stage: detail') share their fraction; another stage begins anew.

    Args:
        clock: seconds from anywhere.
    """

    LEAST = 0.02
    """Done since the beginning before anything is guessed."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._stage = ""
        self._begun = self._from = self._last = 0.0

    def __call__(self, message: str, fraction: float) -> float | None:
        """Return the seconds left in a stage; None: it cannot be said yet."""
        now, stage = self._clock(), message.partition(":")[0]
        if stage != self._stage or fraction < self._last:
            self._stage, self._begun, self._from = stage, now, fraction
        self._last = fraction
        done = fraction - self._from
        if done < self.LEAST or fraction >= 1:
            return None
        return (now - self._begun) * (1 - fraction) / done


def duration(seconds: float) -> str:
    """Return a time for people, no more exact than a guess is: '40 s', '3 min', '1 h 20 min'."""
    if seconds < 55:
        return f"{max(5 * round(seconds / 5), 5)} s"
    minutes = round(seconds / 60)
    if minutes < 60:
        return f"{minutes} min"
    return f"{minutes // 60} h {5 * (minutes % 60 // 5)} min"
