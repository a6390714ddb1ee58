"""Threads: BLAS gets as many as it is told, and work in a thread can be interrupted."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from pathlib import Path

import pytest
from threadpoolctl import threadpool_info

from defplan_mj.base import threads
from tests.samples.processes import heed_ctrl_c


def test_limit_threads_limits_every_pool_that_is_loaded():
    import numpy as np

    np.ones((2, 2)) @ np.ones((2, 2))
    threads.limit_threads(1)
    assert [pool["num_threads"] for pool in threadpool_info()] == [1] * len(threadpool_info())
    with pytest.raises(ValueError, match="at least 1, not 0"):
        threads.limit_threads(0)


def test_the_environment_keeps_what_the_user_has_set(monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    monkeypatch.delenv("OPENBLAS_NUM_THREADS", raising=False)
    threads.set_environment(1)
    assert os.environ["OMP_NUM_THREADS"] == "7"
    assert os.environ["OPENBLAS_NUM_THREADS"] == "1"


@pytest.fixture
def machine(tmp_path, monkeypatch):
    """Return the folder of cgroups of a machine without limits and without SLURM, with 8 cores."""
    monkeypatch.setattr(threads, "CGROUPS", tmp_path)
    monkeypatch.setattr(os, "sched_getaffinity", lambda process: set(range(8)))
    monkeypatch.delenv("SLURM_CPUS_PER_TASK", raising=False)
    return tmp_path


@pytest.mark.parametrize(
    ("files", "cores"),
    [
        ({}, 8),
        ({"cpu.max": "max 100000"}, 8),
        ({"cpu.max": "200000 100000"}, 2),
        ({"cpu.max": "250000 100000"}, 3),
        ({"cpu.max": "10000 100000"}, 1),
        ({"cpu.max": "nonsense"}, 8),
        ({"cpu/cpu.cfs_quota_us": "300000", "cpu/cpu.cfs_period_us": "100000"}, 3),
        ({"cpu/cpu.cfs_quota_us": "-1", "cpu/cpu.cfs_period_us": "100000"}, 8),
        ({"cpu/cpu.cfs_quota_us": "300000", "cpu/cpu.cfs_period_us": "0"}, 8),
    ],
)
def test_a_cgroup_s_quota_limits_the_cores(machine, files, cores):
    for name, text in files.items():
        (machine / name).parent.mkdir(exist_ok=True)
        (machine / name).write_text(text + "\n")
    kinds = Path("/proc/self/cgroup").read_text()
    version = ":cpu" if any(name.startswith("cpu/") for name in files) else "::"
    if version in kinds:  # else this machine has cgroups of the other version only
        assert threads.available_cores() == cores


@pytest.mark.parametrize(
    ("told", "cores"), [("3", 3), ("1", 1), ("64", 8), ("", 8), ("0", 8), ("-2", 8), ("3(x2)", 8)]
)
def test_slurm_s_allotment_limits_the_cores(machine, monkeypatch, told, cores):
    monkeypatch.setenv("SLURM_CPUS_PER_TASK", told)
    assert threads.available_cores() == cores


def test_an_affinity_limits_the_cores():
    code = (
        "import os; os.sched_setaffinity(0, {min(os.sched_getaffinity(0))});"
        "from defplan_mj.base import threads;"
        "print(threads.available_cores(), threads.available_processes())"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.stdout == "1 1\n", done.stderr


def test_interruptible_work_runs_in_another_thread_and_gives_its_result_or_error():
    assert threads.interruptible(threading.get_ident) != threading.get_ident()
    with pytest.raises(ZeroDivisionError):
        threads.interruptible(lambda: 1 // 0)
    assert not threads.abandoned()


def test_ctrl_c_ends_a_wait_for_work_that_does_not_listen():
    code = """
import os, signal, sys, threading, time
from defplan_mj.base import threads

def deaf():
    threading.Timer(0.3, os.kill, (os.getpid(), signal.SIGINT)).start()
    time.sleep(60)

start = time.monotonic()
try:
    threads.interruptible(deaf)
except KeyboardInterrupt:
    print(threads.abandoned(), flush=True)
    os._exit(0 if time.monotonic() - start < 30 else 1)
"""
    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        timeout=60,
        preexec_fn=heed_ctrl_c,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout == "True\n"
