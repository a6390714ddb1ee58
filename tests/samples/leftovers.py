"""What is left among the temporary files."""

from __future__ import annotations

from multiprocessing import process
from pathlib import Path

KEPT = ("torchinductor_",)
"""Starts of names of what is meant to stay: torch's own folder, one for a user, to be used again."""


def left_in(folder: Path) -> list[str]:
    """Return the names of what lies in a folder of temporary files and is not meant to stay."""
    # this process may use its own to its end
    own = Path(getattr(process.current_process(), "_config", {}).get("tempdir") or "-").name
    return sorted(
        path.name
        for path in folder.iterdir()
        if path.name != own and not path.name.startswith(KEPT)
    )
