"""Run `python -m tests.samples.peak LOG NAME...`: read bombs one after the other, print what each took."""

from __future__ import annotations

import contextlib
import json
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from defplan_mj.base.errors import DefplanError
from defplan_mj.body.model import Body
from defplan_mj.gait.gait import Gait
from defplan_mj.log.reader import read_log
from tests.samples import hostile


def peak() -> int:
    """Return the most memory this process has had since `forget`, bytes."""
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith("VmHWM"):
            return int(line.split()[1]) << 10
    raise RuntimeError("no VmHWM in /proc/self/status")


def forget() -> None:
    """Start measuring anew."""
    Path("/proc/self/clear_refs").write_text("5")


def read(path: Path) -> None:
    """Read all of a log or of an archive."""
    if path.suffix == ".npz":
        for kind in (Body, Gait):
            with contextlib.suppress(DefplanError):
                kind.load(path)
        return
    log = read_log(path)
    for part in ("terrain", "body", "gait", "surrogate"):
        with contextlib.suppress(DefplanError):
            getattr(log, part)
    if "gait.npz" in log.attachments:
        with contextlib.suppress(DefplanError):
            log.gait.table()


def tell(
    makers: Mapping[str, Callable[[], bytes]], read: Callable[[Path], object], names: Sequence[str]
) -> None:
    """Print what reading each bomb that is named (none: each) took, a JSON object a line."""
    with tempfile.TemporaryDirectory() as folder:
        for name in names or makers:
            path = Path(folder) / f"bomb{Path(name).suffix}"
            path.write_bytes(makers[name]())
            size, said = path.stat().st_size, ""
            forget()
            began = time.process_time()
            try:
                read(path)
            except DefplanError as error:
                said = str(error)
            told = {"name": name, "size": size, "seconds": time.process_time() - began}
            print(json.dumps({**told, "peak": peak(), "said": said}), flush=True)


def main() -> None:
    """Print it of logs and archives."""
    log = Path(sys.argv[1]).read_bytes()
    makers = {f"{name}.mcap": make for name, make in hostile.log_bombs(log).items()}
    makers |= {f"{name}.npz": make for name, make in hostile.archive_bombs().items()}
    tell(makers, read, sys.argv[2:])


if __name__ == "__main__":
    main()
