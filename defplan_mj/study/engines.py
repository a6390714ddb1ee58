"""What carries out the runs of a study: this process, processes of this machine, or a Dask cluster."""

from __future__ import annotations

import contextlib
import os
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool, ProcessPoolExecutor
from contextlib import AbstractContextManager
from multiprocessing import get_context, parent_process
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from defplan_mj.base import threads
from defplan_mj.base.errors import DefplanError
from defplan_mj.base.progress import Progress
from defplan_mj.study.build import build_of, differences
from defplan_mj.study.run import Job, run_job
from defplan_mj.study.table import Row

if TYPE_CHECKING:
    from distributed import Client

TRIES = 3
"""How often a run is begun whose process dies: by itself it may be what kills it."""
WAIT_FOR_WORKERS = 60.0


class Lost(Exception):
    """A run's process died, as often as it was tried."""


class Engine(Protocol):
    """What runs are given to.

    Attributes:
        processes: that each run may use for its episodes.
        asks: whether a run asks if its machine is as this one.
    """

    processes: int
    asks: bool

    def room(self) -> int:
        """Return how many runs it can have at a time."""

    def submit(self, job: Job) -> Future[Row]:
        """Begin a run; its future raises `Lost` if its process dies."""


class Here:
    """One run after the other in this process, which shows how far each is."""

    asks = False

    def __init__(self, progress: Progress, work: Callable[..., Row] = run_job) -> None:
        self.progress, self.work = progress, work
        self.processes = threads.available_processes()

    def room(self) -> int:
        return 1

    def submit(self, job: Job) -> Future[Row]:
        future: Future[Row] = Future()
        future.set_result(self.work(job, self._named(job)))
        return future

    def _named(self, job: Job) -> Progress:
        name = f"{job.cell.task}, seed {job.cell.seed}, {job.cell.method}"
        return lambda message, fraction: self.progress(f"{name}: {message}", fraction)


class Processes:
    """Several processes of this machine, each a pool of its own: one that dies takes no other run along."""

    processes, asks = 1, False

    def __init__(self, jobs: int, work: Callable[[Job], Row] = run_job) -> None:
        self.jobs, self.work = jobs, work
        self._idle: list[ProcessPoolExecutor] = []
        self._busy: dict[Future[Row], ProcessPoolExecutor] = {}
        self._closed = False

    def room(self) -> int:
        return self.jobs

    def submit(self, job: Job) -> Future[Row]:
        outer: Future[Row] = Future()
        self._begin(job, outer, TRIES)
        return outer

    def _begin(self, job: Job, outer: Future[Row], tries: int) -> None:
        pool = self._idle.pop() if self._idle else self._new()
        inner = pool.submit(self.work, job)
        self._busy[inner] = pool
        inner.add_done_callback(lambda done: self._ended(done, job, outer, tries))

    def _new(self) -> ProcessPoolExecutor:
        return ProcessPoolExecutor(1, get_context("spawn"), initializer=_quiet)

    def _ended(self, inner: Future[Row], job: Job, outer: Future[Row], tries: int) -> None:
        pool = self._busy.pop(inner)
        if inner.cancelled():
            outer.cancel()
            return
        error = inner.exception()
        if error is None:
            self._idle.append(pool)
            outer.set_result(inner.result())
        elif isinstance(error, BrokenProcessPool):
            if tries > 1 and not self._closed:
                self._begin(job, outer, tries - 1)
            else:
                outer.set_exception(Lost())
        else:
            self._idle.append(pool)
            outer.set_exception(error)

    def close(self, kill: bool) -> None:
        """End all processes; those at work, too, if they are to be killed."""
        self._closed = True
        for pool in [*self._idle, *self._busy.values()]:
            for process in list((pool._processes or {}).values()) if kill else ():
                process.kill()
            pool.shutdown(wait=not kill, cancel_futures=True)


def _quiet() -> None:
    """Let Ctrl-C be heard by the process that waits for this one, which then ends it; end when that is gone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    if (parent := parent_process()) is not None:
        parent.join()
        os._exit(1)


class Cluster:
    """A Dask cluster: its scheduler gives a run whose worker died to another one."""

    processes, asks = 1, True

    def __init__(self, client: Client, work: Callable[[Job], Row] = run_job) -> None:
        self.client, self.work = client, work
        self._held: set[Any] = set()  # the scheduler drops what nobody holds

    def room(self) -> int:
        workers = self.client.scheduler_info(n_workers=-1)["workers"]
        return max(2 * len(workers), 2)  # one more than each does: none waits for us

    def submit(self, job: Job) -> Future[Row]:
        outer: Future[Row] = Future()
        folder = job.cell.folder.as_posix()
        inner = self.client.submit(_on_worker, self.work, job, pure=False)
        self._held.add(inner)
        inner.add_done_callback(lambda done: self._ended(done, outer, folder))
        return outer

    def _ended(self, inner: Any, outer: Future[Row], folder: str) -> None:
        self._held.discard(inner)
        _hand_over(inner, outer, folder)


def _on_worker(work: Callable[[Job], Row], job: Job) -> Row:
    if not job.root.is_dir():
        raise DefplanError(
            f"the machine {os.uname().nodename} does not see the study's folder {job.root}"
        )
    return work(job)


def _hand_over(inner: Any, outer: Future[Row], folder: str) -> None:
    from distributed import KilledWorker

    if inner.status == "finished":
        outer.set_result(inner.result())
    elif inner.status == "error":
        error = inner.exception()
        outer.set_exception(Lost() if isinstance(error, KilledWorker) else error)
    else:  # cancelled or lost: the scheduler is gone
        outer.set_exception(DefplanError(f"the scheduler was lost while it had {folder}"))


@contextlib.contextmanager
def local_engine(jobs: int, progress: Progress) -> Iterator[Engine]:
    """Yield what does `jobs` runs at a time on this machine."""
    if jobs == 1:
        yield Here(progress)
        return
    engine = Processes(jobs)
    try:
        yield engine
    except BaseException:
        engine.close(kill=True)
        raise
    engine.close(kill=False)


@contextlib.contextmanager
def connected(
    address: str | None, file: Path | None, say: Callable[[str], None]
) -> Iterator[Client]:
    """Yield a client of the Dask scheduler at an address or of a file; say what its workers have in common.

    Raises:
        DefplanError: it cannot be reached, has no workers, or one that would give other results.
    """
    from distributed import Client

    where = address or str(file)
    if file is not None and not file.is_file():
        raise DefplanError(
            f"the scheduler's file {file} does not exist: `dask scheduler --scheduler-file {file}`"
            " writes it"
        )
    try:
        named = {"address": address} if file is None else {"scheduler_file": str(file)}
        client = Client(**named, timeout=20, set_as_default=False)
    except (OSError, TimeoutError, ValueError) as error:
        raise DefplanError(f"there is no Dask scheduler at {where}: {error}") from error
    with client:
        say(require_workers(client, where))
        yield client


@contextlib.contextmanager
def cluster_engine(connection: AbstractContextManager[Client]) -> Iterator[Engine]:
    """Yield the engine of a Dask cluster that `connected` leads to."""
    with connection as client:
        yield Cluster(client)


def require_workers(client: Client, where: str) -> str:
    """Return a sentence on the workers of a cluster, which have to be as this machine.

    Raises:
        DefplanError: there is none, one does several runs at a time, or would give other results.
    """
    try:
        client.wait_for_workers(1, timeout=WAIT_FOR_WORKERS)
    except TimeoutError as error:
        raise DefplanError(f"the scheduler at {where} has no workers: start some") from error
    workers = client.scheduler_info(n_workers=-1)["workers"]
    for address, worker in workers.items():
        if worker["nthreads"] != 1:
            raise DefplanError(
                f"the worker {address} has {worker['nthreads']} threads: start it with --nthreads 1,"
                " and several with --nworkers"
            )
    here = build_of()
    for address, build in client.run(_build).items():
        if isinstance(build, str):
            raise DefplanError(f"the worker {address} cannot load defplan: {build}")
        if clauses := differences(here, build):
            raise DefplanError(
                f"the worker {address} would not give the same results as this machine:"
                f" {'; '.join(clauses)}"
            )
    return (
        f"{len(workers)} workers, all with defplan {here['defplan']}, the compiled kernel"
        f" {here['compiled kernel']}, and the same versions of {len(here) - 2} other things"
    )


def _build() -> dict[str, str] | str:
    """Return what a worker has installed, or why that cannot be told."""
    try:
        return dict(build_of())
    except Exception as error:
        return f"{type(error).__name__}: {error}"
