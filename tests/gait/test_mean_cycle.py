"""Mean cycles: the motion that switching shows, told by other code; repeated; without the cycles that fall."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from defplan_mj.dynamics import tangent
from defplan_mj.dynamics.reduced import ReducedDynamics
from defplan_mj.dynamics.world import tilt
from defplan_mj.gait.gait import Gait
from defplan_mj.gait.mean_cycle import MeanCycle, mean_cycles
from defplan_mj.gait.problem import GaitProblem
from defplan_mj.gait.switching import measure_cycles, roll_cycles
from defplan_mj.task import GaitTask
from defplan_tasks import quadruped
from tests.samples import host as samples


@pytest.mark.parametrize("space", ["planar", "spatial"])
def test_its_motion_is_the_mean_of_what_switching_measures(fish_dynamics, fish_gait, space):
    tasks = [GaitTask(name, turn=(0.0, 0.0, 1.0)) for name in fish_gait.task_names]
    problem = GaitProblem(fish_dynamics, tasks, fish_gait.steps_per_cycle, space=space)
    order = np.random.default_rng(4).permutation(np.repeat(np.arange(3), 8))
    measured = measure_cycles(problem, fish_gait, order)
    found = mean_cycles(fish_dynamics, fish_gait, level=space == "planar", cycles=8, seed=4)
    for task, cycle in enumerate(found):
        mine = measured.counted & (order == task)
        np.testing.assert_allclose(cycle.motion.position, measured.move[mine].mean(0), atol=1e-9)
        turn = Rotation.from_quat(cycle.motion.quaternion, scalar_first=True).as_rotvec()
        np.testing.assert_allclose(turn, measured.turn[mine].mean(0), atol=0.01)
        assert np.linalg.norm(turn) > 0.3 or task == 0
        np.testing.assert_array_equal(cycle.shapes, fish_gait.table()[task])


def test_cycles_that_are_all_alike_are_their_own_mean(fish_dynamics, fish_gait):
    straight = replace(
        fish_gait, task_names=("forward",), alpha=fish_gait.alpha[:1], beta=fish_gait.beta[:1]
    )
    (cycle,) = mean_cycles(fish_dynamics, straight, cycles=60)
    x = fish_dynamics.rollout(cycle.states[0], cycle.shapes)
    np.testing.assert_allclose(tangent.difference(x, cycle.states), 0, atol=0.02)
    for i in (0, 5, 10):
        a, b = tangent.step_jacobian(
            x[i], x[i + 1], *fish_dynamics.step_jacobian(x[i], cycle.shapes[i], x[i + 1])
        )
        np.testing.assert_allclose(cycle.a[i], a, atol=0.02 * np.abs(a).max())
        np.testing.assert_allclose(cycle.b[i], b, atol=0.02 * np.abs(b).max())


@pytest.mark.parametrize("level", [True, False])
def test_unrolled_each_cycle_begins_where_the_one_before_has_led(fish_dynamics, fish_gait, level):
    cycle = mean_cycles(fish_dynamics, fish_gait, level=level, cycles=4)[1]
    n = fish_gait.steps_per_cycle
    states = cycle.unrolled(2 * n + 3)
    assert len(states) == 2 * n + 4
    np.testing.assert_array_equal(states[: n + 1], cycle.states)
    turn = Rotation.from_quat(cycle.motion.quaternion, scalar_first=True)
    place, whole = np.zeros(3), Rotation.identity()
    for first in (0, n, 2 * n):
        part, own = states[first + 1 : first + n + 1], cycle.states[1:]
        own = own[: len(part)]
        np.testing.assert_allclose(part[:, :3], place + whole.apply(own[:, :3]), atol=1e-12)
        attitude = whole * Rotation.from_quat(own[:, 3:7], scalar_first=True)
        found = Rotation.from_quat(part[:, 3:7], scalar_first=True)
        assert (attitude.inv() * found).magnitude().max() < 1e-12
        np.testing.assert_allclose(part[:, 7:12], own[:, 7:12])
        place, whole = place + whole.apply(cycle.motion.position), whole * turn


def walker_cycles(gait: Gait) -> tuple[ReducedDynamics, tuple[MeanCycle, ...]]:
    spec = quadruped.WALK
    dynamics = ReducedDynamics(samples.walker(), spec.timestep, spec.terrain)
    return dynamics, mean_cycles(dynamics, gait, depth=False, cycles=6)


def test_a_walkers_mean_cycle_is_not_of_cycles_in_which_it_falls():
    wild = replace(samples.walker_gait(), alpha=samples.walker_gait().alpha.copy())
    wild.alpha[1] = np.random.default_rng(0).normal(size=wild.alpha[1].shape)
    dynamics, found = walker_cycles(wild)
    falling = roll_cycles(dynamics, wild.table()[np.ones(6, int)])[1]
    assert falling.any()
    rest = dynamics.rest_state()
    for task in (0, 2, 3):
        assert tilt(found[task].states).max() < np.radians(15)
        assert found[task].states[:, 2].min() > 0.9 * rest[2]
    assert np.isfinite(found[1].states).all()
