"""Feedback `ilqg`: Riccati and dense solutions of linear problems, derivatives, monotony, and what it mends."""

from __future__ import annotations

import pickle
from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import solve_discrete_are
from scipy.optimize import lsq_linear

from defplan_mj import registry
from defplan_mj.dynamics import tangent
from defplan_mj.dynamics.reduced import ReducedDynamics
from defplan_mj.feedback import OpenLoop, drive
from defplan_mj.gait.gait import Gait
from defplan_mj.gait.switching import heading, wrap
from defplan_mj.host.navigation import navigation_environment
from defplan_mj.task import Navigation
from defplan_solvers.feedback import ilqg
from defplan_solvers.feedback.ilqg import BodyModel, Ilqg, Options
from defplan_solvers.feedback.ilqg_step import Cost, Guide, box_minimum, cost_to_go, optimise
from tests.samples.host import scene


@pytest.fixture(scope="module")
def feedback(fish_dynamics: ReducedDynamics, fish_gait: Gait) -> Ilqg:
    return Ilqg(fish_dynamics, fish_gait)


class Linear:
    """x_next = A x + B u."""

    def __init__(self, rng: np.random.Generator, n: int = 6, r: int = 3, size: float = 1.1):
        a = rng.normal(size=(n, n))
        self.a = size * a / np.abs(np.linalg.eigvals(a)).max()  # not stable by itself
        self.b = rng.normal(size=(n, r))

    def step(self, x, u, near=None):
        return self.a @ x + self.b @ u

    def jacobian(self, x, u, x_next):
        return self.a, self.b

    def difference(self, x, origin):
        return x - origin

    def difference_jacobian(self, x, origin):
        return np.broadcast_to(np.eye(x.shape[-1]), (*x.shape, x.shape[-1]))

    def changed(self, x, z):
        return x + z


def weight(rng: np.random.Generator, n: int) -> np.ndarray:
    root = rng.normal(size=(n, n))
    return root @ root.T / n + 0.1 * np.eye(n)


def test_a_linear_quadratic_problem_is_solved_as_by_the_riccati_equation():
    rng = np.random.default_rng(0)
    model, q, effort = Linear(rng), weight(rng, 6), rng.uniform(0.5, 2, 3)
    p = solve_discrete_are(model.a, model.b, q, np.diag(effort))
    gain = np.linalg.solve(np.diag(effort) + model.b.T @ p @ model.b, model.b.T @ p @ model.a)
    cost = Cost(np.zeros((5, 6)), np.array([q] * 4 + [p]), np.zeros((5, 3)), effort)
    x0 = rng.normal(size=6)
    plan = optimise(model, cost, x0, rng.normal(size=(5, 3)), np.full(3, 1e3), 1)
    for x, u in zip(plan.states, plan.controls, strict=False):
        np.testing.assert_allclose(u, -gain @ x, atol=1e-9)
    np.testing.assert_allclose(plan.gains, np.broadcast_to(-gain, (5, 3, 6)), atol=1e-9)
    assert plan.costs[-1] + x0 @ q @ x0 / 2 == pytest.approx(x0 @ p @ x0 / 2)


def dense(model: Linear, cost: Cost, x0: np.ndarray, bound: np.ndarray) -> np.ndarray:
    """The same problem as one least-squares problem over all controls, by another solver."""
    n, r = cost.controls.shape
    rows, right = [], []
    by, x = np.zeros((len(x0), n * r)), x0
    for i in range(n):
        by = model.a @ by
        by[:, i * r : (i + 1) * r] += model.b
        x = model.a @ x
        root = np.linalg.cholesky(cost.weights[i]).T
        rows.append(root @ by)
        right.append(root @ (cost.states[i] - x))
    root = np.tile(np.sqrt(cost.effort), n)
    rows.append(np.diag(root))
    right.append(root * cost.controls.ravel())
    limit = np.tile(bound, n)
    a, b = np.vstack(rows), np.concatenate(right)
    return lsq_linear(a, b, (-limit, limit), method="bvls", tol=1e-14).x.reshape(n, r)


@pytest.mark.parametrize("seed", range(4))
def test_bounded_controls_are_those_of_a_dense_bounded_least_squares_solver(seed):
    rng = np.random.default_rng(seed)
    model, bound = Linear(rng), np.full(3, 0.4)
    weights = np.array([weight(rng, 6) for _ in range(5)])
    wanted, controls = rng.normal(size=(5, 6)), 0.3 * rng.normal(size=(5, 3))
    cost = Cost(wanted, weights, controls, rng.uniform(0.5, 2, 3))
    x0 = rng.normal(size=6)
    plan = optimise(model, cost, x0, controls, bound, 60)
    best = dense(model, cost, x0, bound)
    assert (np.abs(best) > 0.4 - 1e-9).sum() >= 2  # the bounds matter here
    np.testing.assert_allclose(plan.controls, best, atol=1e-5)
    assert np.abs(plan.controls).max() <= 0.4


@pytest.mark.parametrize("seed", range(6))
def test_the_least_value_in_a_box_is_that_of_another_solver(seed):
    rng = np.random.default_rng(seed)
    h, g = weight(rng, 8), 3 * rng.normal(size=8)
    low, high = -rng.uniform(0, 1, 8), rng.uniform(0, 1, 8)
    low[0] = 0.0
    x, free = box_minimum(h, g, low, high)
    root = np.linalg.cholesky(h)
    best = lsq_linear(root.T, -np.linalg.solve(root, g), (low, high), method="bvls", tol=1e-14).x
    np.testing.assert_allclose(x, best, atol=1e-8)
    inside = (best > low + 1e-9) & (best < high - 1e-9)
    assert (free == inside).all()


def test_the_cost_of_going_on_is_that_of_the_algebraic_riccati_equation():
    rng = np.random.default_rng(3)
    steps, q = [Linear(rng) for _ in range(3)], np.array([weight(rng, 6) for _ in range(3)])
    effort, turn = rng.uniform(0.5, 2, 3), np.linalg.qr(rng.normal(size=(6, 6)))[0]
    a, b = np.array([s.a for s in steps]), np.array([s.b for s in steps])
    found = cost_to_go(a, b, q, effort, turn, cycles=200, tolerance=1e-14)[0]
    # the same cycle as one step with all its controls at once
    by_x, by_u = np.eye(6), np.zeros((6, 9))
    qq, rr, s = np.zeros((6, 6)), np.kron(np.eye(3), np.diag(effort)), np.zeros((6, 9))
    for i in range(3):
        qq, s = qq + by_x.T @ q[i] @ by_x, s + by_x.T @ q[i] @ by_u
        rr = rr + by_u.T @ q[i] @ by_u
        by_x, by_u = a[i] @ by_x, a[i] @ by_u
        by_u[:, 3 * i : 3 * i + 3] += b[i]
    wanted = solve_discrete_are(turn @ by_x, turn @ by_u, qq, rr, s=s)
    np.testing.assert_allclose(found, wanted, rtol=1e-8, atol=1e-8)


def pushed(feedback: Ilqg, seed: int) -> np.ndarray:
    """A state beside the mean cycle of gait 1."""
    rng = np.random.default_rng(seed)
    z = rng.normal(size=27) * np.r_[np.full(6, 0.2), np.full(5, 0.3), np.full(11, 0.3), np.zeros(5)]
    return tangent.retract(feedback.follower.cycles[1].states[0], z)


def problem(feedback: Ilqg) -> Cost:
    track = feedback.follower.tracks[1]
    weights = np.concatenate([track.weights[1:5], track.onward[5:6]])
    return Cost(track.states[1:6], weights, track.controls[:5], feedback.follower.effort)


def test_the_derivative_of_the_cost_is_that_of_finite_differences(feedback):
    model, cost, x0 = feedback.model, problem(feedback), pushed(feedback, 0)
    rng = np.random.default_rng(1)
    u, direction = 0.5 * rng.normal(size=(5, 5)), rng.normal(size=(5, 5))
    x = model.dynamics.rollout(x0, u)
    off, slope, wanted = cost.expanded(model, x[1:])[0], np.zeros(27), 0.0
    for i in range(4, -1, -1):
        a, b = model.jacobian(x[i], u[i], x[i + 1])
        slope = slope + off[i]
        wanted += (cost.effort * (u[i] - cost.controls[i]) + b.T @ slope) @ direction[i]
        slope = a.T @ slope

    def value(e: float) -> float:
        v = u + e * direction
        return cost.value(model, model.dynamics.rollout(x0, v)[1:], v)

    e = 1e-4
    assert (value(e) - value(-e)) / (2 * e) == pytest.approx(wanted, rel=1e-4)


@pytest.mark.parametrize("seed", range(5))
def test_no_iteration_raises_the_cost_and_some_lower_it(feedback, seed):
    cost, x0 = problem(feedback), pushed(feedback, seed)
    plan = optimise(feedback.model, cost, x0, cost.controls, feedback.follower.bound, 8)
    assert len(plan.costs) == 9
    assert (np.diff(plan.costs) <= 0).all() and plan.costs[-1] < 0.95 * plan.costs[0]
    again = feedback.model.dynamics.rollout(x0, plan.controls)
    np.testing.assert_allclose(again, plan.states, atol=1e-6)
    assert plan.costs[-1] == pytest.approx(cost.value(feedback.model, again[1:], plan.controls))
    assert (np.abs(plan.controls) <= feedback.follower.bound).all()


def test_a_step_is_guessed_to_second_order_and_guesses_change_nothing(feedback):
    model, cost, x0 = feedback.model, problem(feedback), pushed(feedback, 2)
    guide = optimise(model, cost, x0, cost.controls, feedback.follower.bound, 1).guide
    assert len(guide.before) == 4
    for i in range(4):
        after = model.step(guide.before[i], guide.controls[i])
        np.testing.assert_allclose(guide.after[i], after, atol=1e-6)
    x, z, errors = guide.before, np.random.default_rng(2).normal(size=32), []
    pairs = zip(*map(model.jacobian, x, guide.controls, guide.after), strict=True)
    about = Guide(x, guide.after, guide.controls, *pairs)
    for size in (1e-2, 1e-3):
        beside, u = tangent.retract(x[1], size * z[:27]), guide.controls[1] + size * z[27:]
        guess = about.guess(model, 1, tangent.difference(beside, x[1]), u)
        errors.append(np.abs(guess - model.step(beside, u)).max())
    assert errors[1] < 0.02 * errors[0] and errors[0] < 0.05
    second = replace(cost, states=feedback.follower.tracks[1].states[2:7])
    found = [
        optimise(
            model, second, guide.before[0], cost.controls, feedback.follower.bound, 1, given
        ).controls
        for given in (None, guide)
    ]
    np.testing.assert_allclose(found[1], found[0], atol=1e-5)


def test_a_body_on_the_mean_cycle_nearly_plays_the_dmp_as_it_is(feedback, fish_gait):
    for task, cycle in enumerate(feedback.follower.cycles):
        feedback.reset()
        _, shapes = drive(feedback.model.dynamics, feedback, [task], 32, cycle.states[0])
        more = (shapes - fish_gait.table()[task]) / fish_gait.amplitude
        assert np.abs(more).max() < 0.12


def test_a_decision_does_not_depend_on_place_and_heading(fish_dynamics, fish_gait, feedback):
    x = pushed(feedback, 3)
    frame = tangent.Frame(np.array([3.0, -2.0, 1.0]), np.array([np.cos(1.3), 0, 0, np.sin(1.3)]))
    shapes = []
    for start in (x, frame.outside(x)):
        feedback.reset()
        shapes.append(drive(fish_dynamics, feedback, [1, 2], 32, start)[1])
    np.testing.assert_allclose(shapes[0], shapes[1], atol=1e-4)


def test_in_space_a_decision_does_not_depend_on_any_attitude(fish_dynamics, fish_gait):
    free = replace(fish_dynamics.body.medium, righting_height=0.0)
    weightless = ReducedDynamics(replace(fish_dynamics.body, medium=free), fish_gait.timestep)
    feedback = Ilqg(weightless, fish_gait, "spatial")
    x = pushed(feedback, 3)
    attitude = np.array([0.3, -0.5, 0.7, 0.4])
    frame = tangent.Frame(np.array([3.0, -2.0, 1.0]), attitude / np.linalg.norm(attitude))
    runs = []
    for start in (x, frame.outside(x)):
        feedback.reset()
        runs.append(drive(weightless, feedback, [1, 2], 32, start))
    np.testing.assert_allclose(runs[0][1], runs[1][1], atol=1e-4)
    # and it turns a body that was struck on its way back into its course
    cycle, off = feedback.follower.cycles[1], []
    spin = np.zeros(27)
    spin[14:17] = 1.0, -1.0, 1.0
    for one in (OpenLoop(fish_gait), feedback):
        one.reset()
        end = drive(
            weightless, one, [1] * 4, 32, cycle.states[0],
            lambda i, x: tangent.retract(x, spin) if i == 14 else x,
        )[0][-1]  # fmt: skip
        wanted = cycle.unrolled(128)[-1]
        off.append(np.linalg.norm(tangent.difference(end, wanted)[3:6]))
    assert off[1] < 0.3 * off[0]


def switched(dynamics, gait, feedback, cycles=25):
    """Play gaits at random while the fish is pushed once a cycle."""
    rng = np.random.default_rng(0)
    tasks, n = rng.integers(0, 3, cycles), gait.steps_per_cycle
    at = {n * i + int(rng.integers(n)): rng.normal(size=3) for i in range(cycles)}

    def push(step, x):
        x = x.copy()
        x[12:15] += 0.3 * at[step] * [1, 1, 0.3] if step in at else 0.0
        return x

    feedback.reset()
    states, shapes = drive(dynamics, feedback, tasks, n, dynamics.rest_state(), push)
    return tasks, states[::n], shapes


def test_heading_is_kept_many_times_better_than_in_open_loop(fish_dynamics, fish_gait, feedback):
    wanted = np.array(
        [2 * np.arcsin(cycle.motion.quaternion[3]) for cycle in feedback.follower.cycles]
    )
    errors = []
    for one in (OpenLoop(fish_gait), feedback):
        tasks, at, _ = switched(fish_dynamics, fish_gait, one)
        turn = wrap(np.diff(heading(at)) - wanted[tasks])
        errors.append(np.sqrt((turn[2:] ** 2).mean()))
    assert errors[1] < 0.4 * errors[0]


def test_the_environment_plays_a_feedback_as_the_dynamics_alone_does(
    fish_dynamics, fish_gait, feedback
):
    env = navigation_environment(
        fish_dynamics.body, fish_gait, Navigation(), lambda random: scene([]), feedback=feedback
    )
    env.reset()
    x = env.physics.reduced_state()
    for task in (1, 0, 2):
        env.step(task)
    end = env.physics.reduced_state()
    feedback.reset()
    states, shapes = drive(fish_dynamics, feedback, [1, 0, 2], fish_gait.steps_per_cycle, x)
    assert (states[-1] == end).all()
    assert not (shapes == fish_gait.table()[[1, 0, 2]].reshape(shapes.shape)).all()


def test_the_same_run_is_the_same_to_the_bit(fish_dynamics, fish_gait, feedback):
    first = switched(fish_dynamics, fish_gait, feedback, 6)
    other = Ilqg(fish_dynamics, fish_gait)
    again = switched(fish_dynamics, fish_gait, other, 6)
    assert (first[2] == again[2]).all() and (first[1] == again[1]).all()


def test_target_shapes_stay_within_the_gaits_amplitude(fish_dynamics, fish_gait):
    eager = Ilqg(fish_dynamics, fish_gait, options=Options(effort=0.01, heading=100.0))
    _, _, shapes = switched(fish_dynamics, fish_gait, eager, 6)
    assert (np.abs(shapes) <= fish_gait.amplitude).all()
    assert (np.abs(shapes) == fish_gait.amplitude).any()


def test_the_plugins_are_installed_and_can_be_sent_to_other_processes(fish_dynamics, fish_gait):
    none, full = (registry.get_solver(name, "feedback") for name in ("none", "ilqg"))
    for solver in (none, full):
        copy = pickle.loads(pickle.dumps(solver))
        assert copy == solver and repr(copy) == repr(solver)
    assert isinstance(none.prepare(fish_dynamics, fish_gait), OpenLoop)
    assert isinstance(full.prepare(fish_dynamics, fish_gait), Ilqg)
    assert repr(full) != repr(replace(full, options=Options(horizon=7)))
    assert (
        isinstance(ilqg.SOLVER.options, Options)
        and BodyModel(fish_dynamics).dynamics is fish_dynamics
    )
