"""Where the runs of a study are done: a process that dies, here or in a cluster, costs no row and no bit."""

from __future__ import annotations

import os
import signal
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
from tests.samples.study import BEGUN, Straight, slow_toy_job, toy_cells


@pytest.fixture
def straight(tmp_path):
    """Return the table of the toy study as it is done without a stop, without wall times."""
    rows = conduct(toy_cells(), tmp_path / "straight", Straight())
    return csv_text(rows, timed=False)


def kill_one(root: Path, killed: list[int]) -> None:
    """Kill the first process that has begun the last stage of a run in `root`."""
    deadline = time.monotonic() + 120
    while time.monotonic() < deadline:
        for path in root.glob(f"*/*/{BEGUN}"):
            if text := path.read_text():
                os.kill(int(text), signal.SIGKILL)
                killed.append(int(text))
                return
        time.sleep(0.01)


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
    from distributed import Client, LocalCluster

    with (
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
        "compiled kernel": "0" * 16,
        "plugins": here["plugins"].replace("none ", "none 0"),
    }
    told = differences(here, other)
    assert told[0] == f"compiled kernel is {'0' * 16} there, {here['compiled kernel']} here"
    assert told[1] == "plugins differ: none"
    with pytest.raises(DefplanError, match="would not give the same results: compiled kernel is"):
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
        engines.cluster_engine(None, tmp_path / "none.json", print),
    ):
        pass
