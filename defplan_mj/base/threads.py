"""Threads on purpose: the numeric libraries use as many as they are told, not one for every core."""

from __future__ import annotations

import math
import os
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

CGROUPS = Path("/sys/fs/cgroup")

_Result = TypeVar("_Result")

VARIABLES = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS",
    "NUMEXPR_NUM_THREADS",
)


def set_environment(n: int = 1) -> None:
    """Set the variables that BLAS and OpenMP read when they load; what the user has set stays.

    To be called before numpy is imported: afterwards it changes child processes only.
    """
    for name in VARIABLES:
        os.environ.setdefault(name, str(n))


def limit_threads(n: int) -> None:
    """Let BLAS, OpenMP and torch of this process use `n` threads from now on.

    The products here are small: more than one BLAS thread slows them down and takes the cores from
    the rollouts and environments that run in threads of their own.
    """
    if n < 1:
        raise ValueError(f"the number of threads must be at least 1, not {n}")
    from threadpoolctl import threadpool_limits

    threadpool_limits(limits=n)
    if "torch" in sys.modules:  # loading it only to limit it would cost seconds
        sys.modules["torch"].set_num_threads(n)


def available_cores() -> int:
    """Return the number of cores this process may use: by its affinity, its cgroup's quota and SLURM."""
    here = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    cores = os.environ.get("SLURM_CPUS_PER_TASK", "")  # SLURM need not bind what it has allotted
    allotted = int(cores) if cores.isascii() and cores.isdigit() and len(cores) < 9 else 0
    return max(1, math.ceil(min(here, allotted or here, _quota())))


def _quota() -> float:
    """Return the cores that the cgroups of this process, as containers have them, let it use; inf: all."""
    try:
        lines = Path("/proc/self/cgroup").read_text().splitlines()
    except OSError:  # no Linux
        return math.inf
    limits = [math.inf]
    for line in lines:
        _, kinds, inside = line.split(":", 2)
        if not kinds or "cpu" in kinds.split(","):
            root = CGROUPS / ("cpu" if kinds else "")
            folder = root / inside.lstrip("/")
            # within a container the path may be the host's: then only the root is there
            for place in (folder, *folder.parents):
                limits.append(_limit(place))
                if place == root:
                    break
    return min(limits)


def _limit(folder: Path) -> float:
    """Return the cores that one cgroup lets its processes use."""
    try:
        if (folder / "cpu.max").is_file():  # version 2
            most, period = (folder / "cpu.max").read_text().split()
        else:
            most = (folder / "cpu.cfs_quota_us").read_text()
            period = (folder / "cpu.cfs_period_us").read_text()
        return float(most) / float(period) if float(most) > 0 else math.inf
    except (OSError, ValueError, ZeroDivisionError):  # "max": no limit
        return math.inf


_processes: int | None = None


def limit_processes(n: int | None) -> None:
    """Let parallel work of this process use `n` processes from now on; None: one for each core."""
    global _processes
    if n is not None and n < 1:
        raise ValueError(f"the number of processes must be at least 1, not {n}")
    _processes = n


def available_processes() -> int:
    """Return how many processes parallel work may use: the cores, or as many as it is limited to."""
    return available_cores() if _processes is None else _processes


_abandoned: list[
    threading.Event
] = []  # not the threads: a `join` that is interrupted calls them dead


def interruptible(work: Callable[[], _Result]) -> _Result:
    """Return `work()`, done in a thread of its own, so that Ctrl-C is heard at once.

    CasADi swallows a KeyboardInterrupt that comes while one of its solvers runs. Here the main
    thread only waits; when it is interrupted, the other one is left behind (see `abandoned`).
    """
    result: list[_Result] = []
    failure: list[BaseException] = []

    def run() -> None:
        try:
            result.append(work())
        except BaseException as error:
            failure.append(error)
        finally:
            done.set()

    done = threading.Event()
    try:
        threading.Thread(target=run, daemon=True).start()
        while not done.wait(0.1):
            pass
    except BaseException:
        _abandoned.append(done)
        raise
    if failure:
        raise failure[0]
    return result[0]


def abandoned() -> bool:
    """Return whether work goes on that nobody waits for: the process must not wait for it either."""
    return not all(done.is_set() for done in _abandoned)
