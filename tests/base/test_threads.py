"""Threads: BLAS gets as many as it is told, and work in a thread can be interrupted."""

from __future__ import annotations

import os
import subprocess
import sys
import threading

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
