"""Where the runs of a study are done: a process that dies, here or in a cluster, costs no row and no bit."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any, cast

import pytest

from defplan_mj.base.errors import DefplanError
from defplan_mj.study import engines
from defplan_mj.study.build import build_of, differences, require_same
from defplan_mj.study.conduct import conduct
from defplan_mj.study.engines import TRIES, Cluster, Processes, require_workers
from defplan_mj.study.run import Job
from defplan_mj.study.table import csv_text
from tests.samples.paths import ROOT
from tests.samples.study import BEGUN, Straight, slow_toy_job, toy_cells


@pytest.fixture
def straight(tmp_path):
    """Return the table of the toy study as it is done without a stop, without wall times."""
    rows = conduct(toy_cells(), tmp_path / "straight", Straight())
    return csv_text(rows, timed=False)


def kill_one(root: Path, killed: list[int]) -> None:
    """Kill the first process that has begun the last stage of a run in `root`."""
    if process := wait_for(lambda: next(iter(pids(root)), 0)):
        os.kill(process, signal.SIGKILL)
        killed.append(process)


def conduct_with_a_kill(root: Path, engine) -> str:
    """Return the table of the toy study whose first busy process is killed, without wall times."""
    killed: list[int] = []
    thread = threading.Thread(target=kill_one, args=(root, killed))
    thread.start()
    rows = conduct(toy_cells(), root, engine)
    thread.join()
    assert killed and killed[0] != os.getpid()
    return csv_text(rows, timed=False)


def test_a_dask_worker_that_is_killed_in_the_middle_changes_no_bit_of_the_table(tmp_path, straight):
    import dask.config
    from distributed import Client, LocalCluster

    with (
        dask.config.set({"temporary-directory": str(tmp_path)}),  # its own stays
        LocalCluster(
            n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None
        ) as cluster,
        Client(cluster) as client,
    ):
        told = require_workers(client, "here")
        assert told.startswith("2 workers, all with defplan")
        assert conduct_with_a_kill(tmp_path / "dask", Cluster(client, slow_toy_job)) == straight


def test_a_process_of_this_machine_that_is_killed_changes_no_bit_of_the_table(tmp_path, straight):
    engine = Processes(2, slow_toy_job)
    try:
        assert conduct_with_a_kill(tmp_path / "local", engine) == straight
    finally:
        engine.close(kill=True)


def die(job: Job):
    """Die as a process does that the system kills."""
    os.kill(os.getpid(), signal.SIGKILL)


def test_a_run_that_kills_its_process_every_time_is_a_row_with_a_sentence(tmp_path):
    engine = Processes(1, die)
    try:
        rows = conduct(toy_cells(1, 1, 1), tmp_path, engine)
    finally:
        engine.close(kill=True)
    assert rows[0]["failed"] and f"died, {TRIES} times" in rows[0]["error"]


def test_what_differs_between_machines_is_named_and_refused(monkeypatch):
    here = dict(build_of())
    assert differences(here, dict(here)) == []
    require_same(here)
    other = {
        **here,
        "processor's arithmetic": "X86_V3 BLAS Haswell older",
        "compiled kernel": "0" * 16,
        "plugins": here["plugins"].replace("none ", "none 0"),
    }
    told = differences(here, other)
    assert told[0].startswith("processor's arithmetic is X86_V3 BLAS Haswell older there")
    assert told[1] == f"compiled kernel is {'0' * 16} there, {here['compiled kernel']} here"
    assert told[2] == "plugins differ: none"
    with pytest.raises(
        DefplanError, match="would not give the same results: processor's arithmetic"
    ):
        require_same(other)


class FakeClient:
    """A cluster's client with workers as they are described."""

    def __init__(self, workers, builds):
        self.workers, self.builds = workers, builds

    def wait_for_workers(self, n, timeout):
        if not self.workers:
            raise TimeoutError

    def scheduler_info(self, n_workers=5):
        return {"workers": self.workers}

    def run(self, function):
        return self.builds


@pytest.mark.parametrize(
    ("workers", "builds", "sentence"),
    [
        ({}, {}, "has no workers"),
        ({"tcp://a": {"nthreads": 4}}, {}, "has 4 threads: start it with --nthreads 1"),
        ({"tcp://a": {"nthreads": 1}}, {"tcp://a": {}}, "would not give the same results"),
        ({"tcp://a": {"nthreads": 1}}, {"tcp://a": "ImportError: no"}, "cannot load defplan"),
    ],
)
def test_a_cluster_that_cannot_give_the_same_results_is_refused(workers, builds, sentence):
    with pytest.raises(DefplanError, match=sentence):
        require_workers(cast(Any, FakeClient(workers, builds)), "there")


def test_a_scheduler_that_is_not_there_is_one_sentence(tmp_path):
    with (
        pytest.raises(DefplanError, match="the scheduler's file .* does not exist"),
        engines.connected(None, tmp_path / "none.json", print),
    ):
        pass


PARENT = """
import sys
from pathlib import Path
from defplan_mj.study.conduct import conduct
from defplan_mj.study.engines import Processes
from tests.samples.paths import ROOT
from tests.samples.study import sleepy_toy_job, toy_cells
if __name__ == "__main__":
    conduct(toy_cells(), Path(sys.argv[1]), Processes(1, sleepy_toy_job))
"""


def test_processes_end_when_the_one_that_waits_for_them_is_killed(tmp_path):
    (tmp_path / "parent.py").write_text(PARENT)
    command = [sys.executable, str(tmp_path / "parent.py"), str(tmp_path / "study")]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    with subprocess.Popen(command, env=environment) as parent:
        child = wait_for(lambda: next(iter(pids(tmp_path / "study")), 0))
        parent.kill()
    assert wait_for(lambda: not Path(f"/proc/{child}").exists())


def pids(root: Path) -> list[int]:
    """Return the processes that have begun the last stage of a run in `root`."""
    return [int(text) for p in root.glob(f"*/*/{BEGUN}") if (text := p.read_text())]


def wait_for(look):
    """Return what `look` finds, once it finds something; None after two minutes."""
    deadline = time.monotonic() + 120
    while time.monotonic() < deadline:
        if found := look():
            return found
        time.sleep(0.02)
    return None
