"""`python -m tests.samples.stage_memory ARGUMENTS`: run `defplan ARGUMENTS`, say what memory each stage took.

Resident memory at its highest, MiB: of the command, and of it with its children (what they share counts
twice).
"""

from __future__ import annotations

import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from tests.samples.peak import forget, peak

PERIOD = 0.1
"""Seconds between two looks at the children."""


def main() -> int:
    """Run the command; print a line a stage to stderr."""
    from defplan_mj import cli
    from defplan_mj.pipeline.store import RunFolder

    stage, watch = RunFolder.stage, _Watch()

    def measured(folder: RunFolder, name: str, *args: Any, **kwargs: Any) -> Any:
        forget()
        watch.most = 0
        try:
            return stage(folder, name, *args, **kwargs)
        finally:
            alone = peak() / 2**20
            told = (
                f"{name}: {alone:.0f} MiB, with children {max(alone, watch.most / 2**20):.0f} MiB"
            )
            print(told, file=sys.stderr, flush=True)

    RunFolder.stage = measured  # type: ignore[assignment, method-assign]
    return cli.main(sys.argv[1:])


class _Watch(threading.Thread):
    """Looks, over and over, what this process and its children have."""

    def __init__(self) -> None:
        super().__init__(daemon=True)
        self.most, self._over = 0, threading.Event()
        self.start()

    def run(self) -> None:
        while not self._over.wait(PERIOD):
            self.most = max(self.most, sum(_memory(each) for each in _family(Path("/proc/self"))))


def _family(process: Path) -> Iterator[Path]:
    yield process
    for thread in process.glob("task/*/children"):
        try:
            for child in thread.read_text().split():
                yield from _family(Path("/proc") / child)
        except OSError:  # it has ended
            continue


def _memory(process: Path) -> int:
    try:
        for line in (process / "status").read_text().splitlines():
            if line.startswith("VmRSS"):
                return int(line.split()[1]) << 10
    except OSError:
        pass
    return 0


if __name__ == "__main__":
    sys.exit(main())
