"""`make soak`: a million steps of each robot, 10,000 bad inputs, 100 stops, kept in docs/reliability.md.

Each part ends when it is through or its share of the time is over; what was done is told beside what was
asked for. The exit code is 1 if anything was at fault.
"""

from __future__ import annotations

import argparse
import contextlib
import datetime
import functools
import io
import platform
import random
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from defplan_mj import __version__, cli
from defplan_mj.base import files
from tests.samples import hostile, stopping
from tests.samples.paths import ROOT

PAGE = ROOT / "docs" / "reliability.md"
BEGIN, END = "<!-- soak: begin -->", "<!-- soak: end -->"
ROBOTS = {
    ("fish", "swim"): 0.05,
    ("quadruped", "swim"): 0.12,
    ("quadruped", "walk"): 0.06,
    ("tee", "walk"): 0.06,
}
"""Domain and task, and their shares of the time: a swimmer in space takes the longest."""
AT_ONCE = 250
"""Robots that a thread steps together."""
MOST_GROWTH = 32 << 20
"""Bytes that memory may grow by after the first tenth of the steps."""


@dataclass
class Part:
    """What a part of the endurance test has shown.

    Attributes:
        name: what was done.
        asked, done: how often.
        note: what was measured.
        faults: what was wrong.
        seconds: wall time.
    """

    name: str
    asked: int
    done: int = 0
    note: str = ""
    faults: list[str] = field(default_factory=list)
    seconds: float = 0.0


def memory() -> int:
    """Return the memory of this process, bytes."""
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith("VmRSS"):
            return int(line.split()[1]) << 10
    raise RuntimeError("no VmRSS in /proc/self/status")


def steps(domain: str, task: str, asked: int, seconds: float) -> Part:
    """Step robots that wave in two threads of Python; memory has to stay flat."""
    from defplan_mj.rl.many import KernelVectorEnv

    part = Part(f"steps of {domain} {task}", asked)
    until, lock, marks = time.monotonic() + seconds, threading.Lock(), []

    def work(seed: int) -> None:
        try:
            env = KernelVectorEnv(domain, task, AT_ONCE, workers=1)
            rng = np.random.default_rng(seed)
            env.reset(seed=seed)
            phases, turn = rng.uniform(0.0, 2 * np.pi, env.action_space.shape), 0.0
            while True:
                with lock:
                    if part.done >= asked or time.monotonic() > until:
                        break
                    part.done += AT_ONCE
                turn += 0.3
                actions = 0.5 * np.sin(turn + phases).astype(np.float32)
                observation, reward, *_ = env.step(actions)
                if not (np.isfinite(observation).all() and np.isfinite(reward).all()):
                    part.faults.append("an observation or a reward is not finite")
                    break
                with lock:
                    marks.append(memory())
            env.close()
        except Exception as error:
            part.faults.append(f"{type(error).__name__}: {error}")

    threads = [threading.Thread(target=work, args=(seed,)) for seed in (0, 1)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    if marks:
        growth = max(marks) - max(marks[: max(len(marks) // 10, 1)])
        part.note = f"memory grew by {max(growth, 0) / 2**20:.1f} MiB after the first tenth"
        if growth > MOST_GROWTH:
            part.faults.append(part.note)
    return part


def bad_inputs(folder: Path, asked: int, seconds: float) -> Part:
    """Give damaged and senseless files to the commands; each is a sentence, or is read rightly."""
    part = Part("bad inputs", asked)
    told = kept = 0
    inputs = _inputs(folder)
    until = time.monotonic() + seconds
    for argv in inputs:
        if part.done >= asked or time.monotonic() > until:
            break
        part.done += 1
        out, err = io.StringIO(), io.StringIO()
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            code = cli.main([*argv, "--quiet"])
        said = err.getvalue()
        sentence = said.startswith(f"defplan {argv[0]}: ") and said.count("\n") == 1
        if code not in (0, 1) or "mistake" in said or (code == 1 and said and not sentence):
            part.faults.append(f"{argv[0]}: exit {code}: {said[:200]}")
        told, kept = told + (code == 1), kept + (code == 0)
    part.note = f"{told} refused or told to differ, {kept} read as far as they were whole"
    return part


def _inputs(folder: Path) -> Iterator[list[str]]:
    """Return command lines, each about a file that is written when it is asked for."""
    from tests.samples.bodies import pebble
    from tests.samples.logs import record_swim, swimming_files

    whole = folder / "whole.mcap"
    record_swim(whole, swimming_files(pebble()), cycles=2)
    return _each(folder, whole.read_bytes())


def _each(folder: Path, log: bytes) -> Iterator[list[str]]:
    path, chance = folder / "bad.mcap", random.Random(0)
    for command in ("replay", "compare"):
        for data in hostile.senseless_logs(log).values():
            path.write_bytes(data)
            yield [command, str(path)]
    task, text = folder / "bad.toml", _task_text()
    while True:
        kind = chance.randrange(3)
        if kind == 0:
            path.write_bytes(_damaged(log, chance))
            yield [chance.choice(("replay", "compare")), str(path)]
        elif kind == 1:
            task.write_bytes(_damaged(text, chance))
            yield ["new", "--from", str(task), "-o", str(folder / "copy.toml"), "--overwrite"]
        else:
            archive = _damaged(hostile.gait_archive(), chance)
            path.write_bytes(hostile.edited(log, attachments={"gait.npz": archive}))
            yield ["replay", str(path)]


def _task_text() -> bytes:
    from defplan_mj import registry
    from defplan_mj.taskfile.write import task_text

    with tempfile.TemporaryDirectory() as folder:
        return task_text(registry.get_task("fish-swim"), Path(folder) / "fish.toml").encode()


def _damaged(data: bytes, chance: random.Random) -> bytes:
    """Return data that is cut, has bytes changed, a part left out or doubled."""
    content, kind = bytearray(data), chance.randrange(4)
    place = chance.randrange(len(content))
    size = chance.randrange(1, 64)
    if kind == 0:
        del content[place:]
    elif kind == 1:
        for _ in range(chance.randrange(1, 8)):
            content[chance.randrange(len(content))] = chance.randrange(256)
    elif kind == 2:
        del content[place : place + size]
    else:
        content[place:place] = content[place : place + size]
    return bytes(content)


def stops(folder: Path, asked: int, seconds: float) -> Part:
    """Stop tiny runs at random moments and compare what they become with an undisturbed one."""
    part = Part("stops of a run (Ctrl-C and SIGTERM)", asked)
    wanted, whole = stopping.undisturbed(folder / "undisturbed")
    until = time.monotonic() + max(seconds - whole, 0.0) + 1.0  # one stop at the least
    found = stopping.stop_at_random(folder, asked, wanted, whole, seed=0, until=until)
    part.done, part.faults = found.stops, found.faults
    part.note = (
        f"{found.early} before the command was loaded; {found.compared} resumed runs equal to the bit,"
        f" slowest stop {found.slowest:.1f} s ({found.during})"
    )
    return part


def table(parts: list[Part], form: str) -> str:
    """Return the result as Markdown."""
    now = datetime.datetime.now(datetime.UTC).date().isoformat()
    lines = [
        f"{form}, {now}, defplan {__version__}, Python {platform.python_version()}:",
        "",
        "| what | asked | done | at fault | seconds | |",
        "| --- | ---: | ---: | ---: | ---: | --- |",
    ]
    for part in parts:
        numbers = f"{part.asked} | {part.done} | {len(part.faults)} | {part.seconds:.0f}"
        lines.append(f"| {part.name} | {numbers} | {part.note} |")
    return "\n".join(lines)


def keep(text: str) -> None:
    """Write the result into the page."""
    page = PAGE.read_text(encoding="utf-8")
    head, rest = page.split(BEGIN)
    files.write_text(PAGE, f"{head}{BEGIN}\n{text}\n{END}{rest.split(END)[1]}")


def main() -> int:
    """Run all parts; return the exit code: 1 if something is at fault, 2 if the time was too short for all."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=30.0, help="in all, at most (30)")
    parser.add_argument("--short", action="store_true", help="a fiftieth of everything, to try it")
    parser.add_argument(
        "--only", choices=("steps", "inputs", "stops"), help="this kind of part alone"
    )
    parser.add_argument("--stops", type=int, default=100, help="how many stops (100)")
    parser.add_argument(
        "--no-page", action="store_true", help="leave docs/reliability.md alone, as --only does"
    )
    options = parser.parse_args()
    share = 0.02 if options.short else 1.0
    minutes = min(options.minutes, 5.0) if options.short else options.minutes
    seconds, parts = 60.0 * minutes, []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        inputs, breaks = int(1e4 * share), max(int(options.stops * share), 2)
        work: list[tuple[str, float, Callable[[float], Part]]] = [
            *(("steps", shares, functools.partial(steps, *robot, int(1e6 * share)))
              for robot, shares in ROBOTS.items()),
            ("inputs", 0.22, lambda limit: bad_inputs(folder, inputs, limit)),
            ("stops", 0.49, lambda limit: stops(folder, breaks, limit)),
        ]  # fmt: skip
        work = [each for each in work if options.only in (None, each[0])]
        start = time.monotonic()
        for number, (_, part_of_time, do) in enumerate(work):
            began = time.monotonic()
            # what one part does not need is the others'
            rest = sum(shares for _, shares, _ in work[number:])
            part = do(part_of_time / rest * max(start + seconds - began, 0.0))
            part.seconds = time.monotonic() - began
            parts.append(part)
            print(f"{part.name}: {part.done} of {part.asked}, {len(part.faults)} at fault; {part.note}",
                  flush=True)  # fmt: skip
            for fault in part.faults[:10]:
                print(f"  {fault}", flush=True)
    if not (options.no_page or options.only):
        keep(table(parts, "Short form" if options.short else "Whole"))
    for part in parts:
        if part.done < part.asked:
            print(f"not all done in the time there was: {part.name}, {part.done} of {part.asked}")
    if any(part.faults for part in parts):
        return 1
    return 2 if any(part.done < part.asked for part in parts) else 0


if __name__ == "__main__":
    sys.exit(main())
