"""Feedback `lqr`: the gains of the periodic Riccati equation, and what they mend."""

from __future__ import annotations

import pickle
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.linalg import solve_discrete_are

from defplan_mj import registry
from defplan_mj.dynamics import tangent
from defplan_mj.dynamics.reduced import ReducedDynamics
from defplan_mj.feedback import OpenLoop, drive
from defplan_mj.gait.gait import Gait
from defplan_mj.gait.switching import heading, wrap
from defplan_solvers.feedback.ilqg import Ilqg, Options
from defplan_solvers.feedback.ilqg_step import cost_to_go
from defplan_solvers.feedback.lqr import Lqr, gains


@pytest.fixture(scope="module")
def feedback(fish_dynamics: ReducedDynamics, fish_gait: Gait) -> Lqr:
    return Lqr(fish_dynamics, fish_gait)


def test_on_a_linear_system_the_gain_is_that_of_the_algebraic_riccati_equation():
    rng = np.random.default_rng(0)
    a, b = rng.normal(size=(5, 5)), rng.normal(size=(5, 2))
    q, effort = np.eye(5), np.array([0.5, 2.0])
    n = 3
    value = cost_to_go(
        np.repeat(a[None], n, 0), np.repeat(b[None], n, 0), np.repeat(q[None], n, 0), effort,
        np.eye(5), cycles=200, tolerance=1e-13,
    )  # fmt: skip
    track = SimpleNamespace(onward=np.concatenate([value, value[:1]]))
    cycle = SimpleNamespace(a=np.repeat(a[None], n, 0), b=np.repeat(b[None], n, 0))
    exact = solve_discrete_are(a, b, q, np.diag(effort))
    wanted = np.linalg.solve(np.diag(effort) + b.T @ exact @ b, b.T @ exact @ a)
    for gain in gains(cycle, track, effort):
        np.testing.assert_allclose(gain, wanted, rtol=1e-8)


def test_a_body_on_its_mean_cycle_is_told_the_dmp_as_it_is(feedback, fish_gait):
    for task, cycle in enumerate(feedback.follower.cycles):
        feedback.reset()
        feedback.begin(task, cycle.states[0])
        for i, shape in enumerate(fish_gait.table()[task]):
            more = (feedback.shape(cycle.states[i]) - shape) / fish_gait.amplitude
            assert np.abs(more).max() < 0.01  # the mean of the starts' frames is not quite a frame


def test_a_little_off_it_does_what_ilqg_does(fish_dynamics, fish_gait, feedback):
    slow = Ilqg(fish_dynamics, fish_gait, options=Options(effort=10.0))
    rng, size = np.random.default_rng(1), fish_gait.amplitude
    for task, cycle in enumerate(feedback.follower.cycles):
        x = tangent.retract(cycle.states[0], 1e-3 * rng.normal(size=len(cycle.states[0]) - 1))
        told = []
        for one in (feedback, slow):
            one.reset()
            one.begin(task, x)
            told.append(one.shape(x))
            one.reset()
            one.begin(task, cycle.states[0])
            told.append(one.shape(cycle.states[0]))
        linear, full = (told[0] - told[1]) / size, (told[2] - told[3]) / size
        # about the mean cycle in place of the motion from here, which the mean is not quite
        assert np.linalg.norm(linear - full) < 0.3 * np.linalg.norm(full)


def test_heading_is_kept_better_than_in_open_loop(fish_dynamics, fish_gait, feedback):
    rng = np.random.default_rng(0)
    tasks, n = rng.integers(0, 3, 25), fish_gait.steps_per_cycle
    at = {n * i + int(rng.integers(n)): rng.normal(size=3) for i in range(25)}

    def push(step, x):
        x = x.copy()
        x[12:15] += 0.3 * at[step] * [1, 1, 0.3] if step in at else 0.0
        return x

    wanted = np.array(
        [2 * np.arcsin(cycle.motion.quaternion[3]) for cycle in feedback.follower.cycles]
    )
    errors = []
    for one in (OpenLoop(fish_gait), feedback):
        one.reset()
        states, shapes = drive(fish_dynamics, one, list(tasks), n, fish_dynamics.rest_state(), push)
        assert (np.abs(shapes) <= fish_gait.amplitude).all()
        turn = wrap(np.diff(heading(states[::n])) - wanted[tasks])
        errors.append(np.sqrt((turn[2:] ** 2).mean()))
    assert errors[1] < 0.65 * errors[0]


def test_the_plugin_is_installed_and_can_be_sent_to_other_processes(fish_dynamics, fish_gait):
    solver = registry.get_solver("lqr", "feedback")
    copy = pickle.loads(pickle.dumps(solver))
    assert copy == solver and repr(copy) == repr(solver)
    assert isinstance(solver.prepare(fish_dynamics, fish_gait), Lqr)
