"""Stop a tiny run at random moments, look what is left, and compare what it becomes with an undisturbed one."""

from __future__ import annotations

import fcntl
import math
import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from defplan_mj.pipeline.store import stage_seconds
from tests.samples.leftovers import left_in
from tests.samples.paths import ROOT
from tests.samples.processes import heed_ctrl_c
from tests.samples.tiny_run import listens, said_by

CODES = {signal.SIGINT: 130, signal.SIGTERM: 143}
PATIENCE = 60.0
"""Seconds after which a stop counts as lost."""


@dataclass
class Stopped:
    """What stops of a run have shown.

    Attributes:
        stops: how many were sent while the run was at work.
        faults: sentences on what was wrong.
        slowest: seconds that the slowest stop took, and `during` which stage that was.
        early: how many of them came while Python itself still started; they end it as any Python program.
        compared: resumed runs that came to their end and were compared.
    """

    compared: int = 0
    early: int = 0
    stops: int = 0
    faults: list[str] = field(default_factory=list)
    slowest: float = 0.0
    during: str = "none"


def start(logs: Path, temporary: Path) -> subprocess.Popen[str]:
    """Start a tiny run whose temporary files go to a folder of their own."""
    temporary.mkdir(parents=True, exist_ok=True)
    return subprocess.Popen(
        [sys.executable, "-m", "tests.samples.tiny_run", str(logs), "--quiet"],
        cwd=ROOT,
        env={**os.environ, "TMPDIR": str(temporary), "OMP_NUM_THREADS": "1"},
        preexec_fn=heed_ctrl_c,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )


def undisturbed(folder: Path) -> tuple[dict, float]:
    """Do a tiny run; return what its files say, and its seconds."""
    began = time.monotonic()
    process = start(folder / "logs", folder / "tmp")
    _, told = process.communicate()
    if process.returncode != 0:
        raise RuntimeError(told)
    return said_by(folder / "logs" / "fish-swim-seed0"), time.monotonic() - began


def stop_at_random(
    folder: Path, stops: int, wanted: dict, seconds: float, seed: int, until: float = math.inf
) -> Stopped:
    """Stop tiny runs at random moments, and go on with them, until `stops` have been sent.

    Args:
        wanted, seconds: of `undisturbed`.
        until: time (`time.monotonic`) after which no further stop is sent.
    """
    found, chance, number = Stopped(), random.Random(seed), 0
    while found.stops < stops and time.monotonic() < until:
        logs, temporary = folder / f"{number}" / "logs", folder / f"{number}" / "tmp"
        number += 1
        done = False
        while not done:
            still = found.stops < stops and time.monotonic() < until
            wait = chance.uniform(0.0, seconds) if still else None
            number_of = chance.choice(list(CODES))
            done = _once(logs, temporary, wait, number_of, found)
            found.faults += [f"{fault} (stop {found.stops})" for fault in _left(logs, temporary)]
            if len(found.faults) > 20:
                return found
        for name, said in said_by(logs / "fish-swim-seed0").items():
            if wanted.get(name) != said:
                found.faults.append(f"{name} of a resumed run differs")
        if set(wanted) != set(said_by(logs / "fish-swim-seed0")):
            found.faults.append("a resumed run has other files")
        found.compared += 1
    return found


def _once(logs: Path, temporary: Path, wait: float | None, number: int, found: Stopped) -> bool:
    """Go on with a run, and stop it after `wait` seconds; return whether it came to its end."""
    listens(logs).unlink(missing_ok=True)
    process = start(logs, temporary)
    try:
        _, told = process.communicate(timeout=wait)
    except subprocess.TimeoutExpired:
        began, early = time.monotonic(), not listens(logs).exists()
        process.send_signal(number)
        found.stops, found.early = found.stops + 1, found.early + early
        try:
            _, told = process.communicate(timeout=PATIENCE)
        except subprocess.TimeoutExpired:
            process.kill()
            process.communicate()
            found.faults.append(f"signal {number} after {wait:.1f} s was lost")
            return False
        if process.returncode == 0:
            return True  # it had just finished
        if (took := time.monotonic() - began) > found.slowest:
            found.slowest, found.during = took, f"after {_last_stage(logs)}"
        if early:
            return False
        if process.returncode != CODES[signal.Signals(number)]:
            found.faults.append(
                f"signal {number} after {wait:.1f} s: exit {process.returncode}: {told}"
            )
        if "Traceback" in told or "mistake" in told:
            found.faults.append(f"signal {number} after {wait:.1f} s: {told}")
        return False
    if process.returncode != 0:
        found.faults.append(f"exit code {process.returncode}: {told}")
    return process.returncode == 0


def _last_stage(logs: Path) -> str:
    """Return the stage that was finished last before a run was stopped."""
    return list(stage_seconds(logs / "fish-swim-seed0") or {"the start": 0.0})[-1]


def _left(logs: Path, temporary: Path) -> Iterator[str]:
    """Yield what a stopped run has left: children, locks, temporary files."""
    time.sleep(0.2)
    for entry in Path("/proc").glob("[0-9]*/environ"):
        try:
            if f"TMPDIR={temporary}\0".encode() in entry.read_bytes():
                command = (entry.parent / "cmdline").read_bytes().replace(b"\0", b" ").decode()
                yield f"a child is left: {command[:80]}"
        except OSError:
            continue
    for name in left_in(temporary):
        yield f"{name} is left among the temporary files"
    folder = logs / "fish-swim-seed0"
    if not folder.is_dir():
        return
    for path in folder.glob(".*"):
        if path.name != ".lock":
            yield f"{path.name} is left in the run's folder"
            continue
        with open(path) as lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                yield "the run's folder is still locked"
