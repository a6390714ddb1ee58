"""Runs of studies that take no time: stages of numbers in an ordinary folder, and an engine in this process."""

from __future__ import annotations

import json
import os
import time
from concurrent.futures import Future
from functools import partial
from pathlib import Path

import numpy as np

from defplan_mj.pipeline.store import RunFolder
from defplan_mj.study.matrix import Cell
from defplan_mj.study.run import Job, keys_of
from defplan_mj.study.table import Row, complete

BEGUN = "begun"
"""File of a run's folder that holds the process that began its last stage."""


def toy_cells(tasks: int = 2, seeds: int = 2, planners: int = 2) -> list[Cell]:
    """Return runs of tasks that are only names."""
    return [
        Cell(f"toy-{t}", f"toy-{t}", seed, "wave", f"planner-{p}", "none")
        for t in range(tasks)
        for seed in range(seeds)
        for p in range(planners)
    ]


def toy_job(job: Job, seconds: float = 0.0) -> Row:
    """Make two stages of numbers drawn from the seed, the second one slowly; return the row."""
    cell = job.cell
    with RunFolder(job.root / cell.folder, {}) as folder:

        def make(name: str, wait: float) -> list[Path]:
            if wait:
                (folder.path / BEGUN).write_text(str(os.getpid()))
                time.sleep(wait)
            key = [cell.seed, *cell.task.encode(), *cell.planner.encode(), *name.encode()]
            path = folder.file(f"{name}.json")
            path.write_text(json.dumps(float(np.random.default_rng(key).normal())))
            return [path]

        for name, wait in (("gait", 0.0), ("toy", seconds)):
            folder.stage(name, {"seed": cell.seed}, partial(make, name, wait))
        told = {n: json.loads(folder.file(f"{n}.json").read_text()) for n in ("gait", "toy")}
        figures = {"resimulated": told["gait"], "novel_cycles": told["toy"]}
        times = {"total_seconds": sum(folder.seconds(name) for name in told)}
    return complete({**keys_of(cell), "failed": False, **figures, **times})


def slow_toy_job(job: Job) -> Row:
    """Do a toy run that takes long enough to be killed in."""
    return toy_job(job, 0.4)


def sleepy_toy_job(job: Job) -> Row:
    """Do a toy run that takes longer than any test."""
    return toy_job(job, 600.0)


class Straight:
    """An engine that does runs at once, in this process, and keeps in which order."""

    processes, asks = 1, False

    def __init__(self, room: int = 1, work=toy_job) -> None:
        self.rooms, self.work = room, work
        self.jobs: list[Job] = []

    def room(self) -> int:
        return self.rooms

    def submit(self, job: Job) -> Future:
        self.jobs.append(job)
        future: Future = Future()
        try:
            future.set_result(self.work(job))
        except Exception as error:
            future.set_exception(error)
        return future
