"""Where a command's work goes, as --jobs, --scheduler and --scheduler-file say."""

from __future__ import annotations

import argparse
import contextlib
from collections.abc import Iterator
from contextlib import AbstractContextManager
from typing import TYPE_CHECKING

from defplan_mj.base import parallel, threads
from defplan_mj.base.errors import DefplanError
from defplan_mj.cli.console import Console

if TYPE_CHECKING:
    from distributed import Client


def check_workers(arguments: argparse.Namespace) -> None:
    """Raise a DefplanError if the options do not go together."""
    if arguments.scheduler is not None and arguments.scheduler_file is not None:
        raise DefplanError("name the scheduler by --scheduler or --scheduler-file, not by both")
    if _elsewhere(arguments) and arguments.jobs is not None:
        raise DefplanError("--jobs is for this machine: a Dask cluster has its own workers")


def cluster(
    arguments: argparse.Namespace, console: Console
) -> AbstractContextManager[Client] | None:
    """Return what connects to the Dask cluster that is named; None if none is."""
    if not _elsewhere(arguments):
        return None
    from defplan_mj.study.engines import connected

    return connected(arguments.scheduler, arguments.scheduler_file, console.say)


@contextlib.contextmanager
def workers(arguments: argparse.Namespace, console: Console) -> Iterator[None]:
    """Let the episodes of a command be done where its options say, in the `with` block."""
    if not hasattr(arguments, "scheduler"):
        yield
        return
    check_workers(arguments)
    with contextlib.ExitStack() as stack:
        if arguments.jobs is not None:
            stack.callback(threads.limit_processes, None)
            threads.limit_processes(arguments.jobs)
        if (connection := cluster(arguments, console)) is not None:
            stack.enter_context(parallel.on_cluster(stack.enter_context(connection)))
        yield


def _elsewhere(arguments: argparse.Namespace) -> bool:
    return arguments.scheduler is not None or arguments.scheduler_file is not None
