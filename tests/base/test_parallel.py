"""Independent work in processes and on a Dask cluster gives what one process gives."""

from __future__ import annotations

import functools
import os

import pytest

from defplan_mj import registry
from defplan_mj.base import parallel, threads
from defplan_mj.studies.check import packaged_robot
from tests.samples import planning as samples


def labelled(base: int, item: int) -> tuple[int, int]:
    """Return the process that did the work, and its result."""
    return os.getpid(), base + item * item


@pytest.fixture
def unlimited():
    yield
    threads.limit_processes(None)


def test_one_place_is_this_process_and_others_are_not(unlimited):
    work = functools.partial(labelled, 1)
    here = list(parallel.each(work, range(5), workers=1))
    away = list(parallel.each(work, range(5), workers=2))
    assert {process for process, _ in here} == {os.getpid()}
    assert os.getpid() not in {process for process, _ in away}
    assert [result for _, result in here] == [result for _, result in away] == [1, 2, 5, 10, 17]
    unordered = parallel.each(work, range(5), workers=2, ordered=False)
    assert sorted(result for _, result in unordered) == [1, 2, 5, 10, 17]


def test_there_is_a_place_for_each_core_or_as_many_as_are_allowed(unlimited):
    assert parallel.places() == threads.available_cores()
    threads.limit_processes(7)
    assert parallel.places() == 7
    with pytest.raises(ValueError, match="at least 1, not 0"):
        threads.limit_processes(0)


def test_episodes_on_a_dask_cluster_are_those_of_this_process(tmp_path):
    import dask.config
    from distributed import Client, LocalCluster

    from defplan_mj.host.evaluation import evaluate
    from defplan_mj.task import Navigation
    from defplan_solvers.search import greedy

    spec = registry.get_task("fish-swim")
    robot, navigation, f_fit = packaged_robot(spec), Navigation(), samples.surrogate()
    planner = greedy.SOLVER.train(f_fit, navigation, 0).planner
    scenes = [samples.scene(target=(2.0, 0.3 * i), max_cycles=4) for i in range(6)]
    run = functools.partial(evaluate, robot, f_fit, navigation, planner, scenes)
    alone = run(workers=1).episodes
    with (
        dask.config.set({"temporary-directory": str(tmp_path)}),  # its own stays
        LocalCluster(
            n_workers=2,
            threads_per_worker=1,
            processes=True,
            dashboard_address=None,
        ) as cluster,
        Client(cluster, set_as_default=False) as client,
        parallel.on_cluster(client),
    ):
        assert parallel.places() == 2
        spread = run(workers=parallel.places()).episodes
    assert parallel.places() == threads.available_cores()
    for one, other in zip(alone, spread, strict=True):
        assert one.index == other.index and one.outcome == other.outcome
        assert (one.distance, one.path, one.closest) == (other.distance, other.path, other.closest)
