"""How long work says how far it is: a function that is called now and then."""

from __future__ import annotations

from collections.abc import Callable

Progress = Callable[[str, float], None]
"""Called with what is being done and the fraction done (0 to 1)."""


def no_progress(message: str, fraction: float) -> None:
    """Show nothing."""
