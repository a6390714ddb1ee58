"""Threads on purpose: the numeric libraries use as many as they are told, not one for every core."""

from __future__ import annotations

import os
import sys

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
    """Return the number of cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
