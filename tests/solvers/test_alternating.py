"""The alternating gait solver: its derivatives, its two half steps, and what it makes of a small problem."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from defplan_mj.body.model import Body
from defplan_mj.dynamics.reduced import ReducedDynamics
from defplan_mj.gait.problem import GaitProblem
from defplan_mj.task import GaitTask, Weights
from defplan_solvers.gait.alternating import SOLVER, Fit
from defplan_solvers.gait.trajectories import Trajectories

SEQUENCES = [[0, 1, 0], [1, 1, 0]]
PHYSICS, DMP = 30.0, 0.7


@pytest.fixture(scope="module")
def problem(small_fish: Body) -> GaitProblem:
    tasks = (
        GaitTask("forward", move=(0.5, 0, 0)),
        GaitTask("left", turn=(0, 0, 0.6), move=(0.3, 0, 0)),
    )
    return GaitProblem(
        ReducedDynamics(small_fish),
        tasks,
        6,
        18,
        elements=3,
        weights=Weights(effort=0.15, style="sideways"),
    )


@pytest.fixture(scope="module")
def trajectories(problem: GaitProblem) -> Trajectories:
    return Trajectories(problem, SEQUENCES, settle=1, threads=1)


def random_w(problem: GaitProblem, rng: np.random.Generator) -> np.ndarray:
    d, r, k = problem.elements, problem.dynamics.nu, problem.n_tasks
    alpha = 0.15 * rng.normal(size=(k, d, r))
    return problem.join(rng.uniform(0, 6, (d, r)), alpha, 1 + 0.3 * rng.normal(size=(k, d, r)))


def displaced(trajectories: Trajectories, problem: GaitProblem, seed: int):
    """States that do not obey the dynamics, target shapes that are not the DMP's, and the DMP's."""
    rng = np.random.default_rng(seed)
    wanted = trajectories.dmp(random_w(problem, rng))
    states = trajectories.simulate(wanted)
    step = 0.03 * rng.normal(size=trajectories.size)
    return *trajectories.move(states, wanted, step), wanted


def test_on_simulated_trajectories_only_the_objective_is_left(problem, trajectories):
    w = random_w(problem, np.random.default_rng(0))
    shapes = trajectories.dmp(w)
    states = trajectories.simulate(shapes)
    physics, objective, dmp = trajectories.parts(states, shapes, shapes)
    regular = float(problem.objective(SEQUENCES, settle=1)(w)) - objective
    start, n = problem.dynamics.rest_state(), len(states) // 2
    wanted = np.mean(
        [
            float(problem.trajectory_cost(sequence, 1)(start, part.T))
            for sequence, part in zip(SEQUENCES, (states[:n], states[n:]), strict=True)
        ]
    )
    assert physics < 1e-20
    assert dmp == 0.0
    assert objective == pytest.approx(wanted, rel=1e-12)
    assert regular >= 0.0  # what the objective has of w alone


def test_states_off_the_dynamics_cost_their_distance_from_the_step(problem, trajectories):
    rng = np.random.default_rng(1)
    shapes = trajectories.dmp(random_w(problem, rng))
    states = trajectories.simulate(shapes)
    last = states.copy()
    last[-1, :3] += [0.3, 0.0, 0.4]  # nothing follows: one residual, of half a metre
    physics, _, _ = trajectories.parts(last, shapes, shapes)
    assert physics == pytest.approx(0.25 / len(states), rel=1e-9)


def test_gradient_equals_finite_differences(problem, trajectories):
    states, shapes, wanted = displaced(trajectories, problem, 2)
    gradient, _ = trajectories.system(states, shapes, wanted, PHYSICS, DMP)
    rng = np.random.default_rng(3)
    weights = np.array([PHYSICS, 1.0, DMP])

    def energy(step: np.ndarray) -> float:
        return float(weights @ trajectories.parts(*trajectories.move(states, shapes, step), wanted))

    for _ in range(5):
        direction = rng.normal(size=trajectories.size)
        eps = 1e-5
        difference = (energy(eps * direction) - energy(-eps * direction)) / (2 * eps)
        assert gradient @ direction == pytest.approx(difference, rel=1e-6)


def test_newtons_matrix_is_the_hessian_where_the_dynamics_hold(problem, trajectories):
    """Gauss-Newton leaves out what is multiplied by residuals: nothing on simulated trajectories."""
    rng = np.random.default_rng(4)
    wanted = trajectories.dmp(random_w(problem, rng))
    states = trajectories.simulate(wanted)
    weights = np.array([PHYSICS, 1.0, DMP])

    def energy(step: np.ndarray) -> float:
        return float(weights @ trajectories.parts(*trajectories.move(states, wanted, step), wanted))

    _, entries = trajectories.system(states, wanted, wanted, PHYSICS, DMP)
    hessian = trajectories.matrix(entries, np.zeros(trajectories.size))
    assert abs(hessian - hessian.T).max() < 1e-12
    for _ in range(5):
        direction, eps = rng.normal(size=trajectories.size), 1e-4
        second = energy(eps * direction) + energy(-eps * direction) - 2 * energy(0 * direction)
        assert direction @ (hessian @ direction) == pytest.approx(second / eps**2, rel=1e-4)


def test_only_neighbours_in_time_and_the_ends_of_a_cycle_are_coupled(problem, trajectories):
    width = trajectories.nt + trajectories.r
    _, entries = trajectories.system(*displaced(trajectories, problem, 8), PHYSICS, DMP)
    pattern = trajectories.matrix(entries, np.ones(trajectories.size)).tocoo()
    apart = np.abs(pattern.row // width - pattern.col // width)
    assert set(np.unique(apart)) <= {0, 1, trajectories.n}


def test_newton_finds_a_cheaper_trajectory_that_obeys_the_dynamics(problem, trajectories):
    wanted = trajectories.dmp(random_w(problem, np.random.default_rng(5)))
    states = trajectories.simulate(wanted)
    _, before, _ = trajectories.parts(states, wanted, wanted)
    moved, shapes, parts, _ = trajectories.newton(states, wanted, wanted, 1e6, 0.1, 8, 1.0)
    assert parts[1] + 0.1 * parts[2] < 0.9 * before
    # what it claims is what the target shapes really give
    truth = trajectories.parts(trajectories.simulate(shapes), shapes, wanted)[1]
    assert truth == pytest.approx(parts[1], rel=0.05)
    assert np.abs(moved - states).max() > 0.01


def test_fit_returns_to_the_dmp_the_shapes_came_from(problem, trajectories):
    rng = np.random.default_rng(6)
    w = random_w(problem, rng)
    shapes = trajectories.dmp(w)
    fit = Fit(trajectories.problem, SEQUENCES, bound=4.0, iterations=300)
    start = w + 0.1 * rng.normal(size=w.shape)
    before = np.abs(trajectories.dmp(start) - shapes).max()
    value = trajectories.dmp(fit(start, shapes, dmp=1e4))
    assert np.abs(value - shapes).max() < 0.2 * before


def test_fit_keeps_to_the_bodys_amplitude(problem, trajectories):
    fit = Fit(trajectories.problem, SEQUENCES, bound=4.0, iterations=100)
    far = 3.0 * np.ones((trajectories.total, trajectories.r))
    w = fit(random_w(problem, np.random.default_rng(7)), far, dmp=1.0)
    shapes = np.abs(trajectories.dmp(w))
    amplitude = problem.dynamics.body.amplitude
    assert (shapes <= amplitude + 1e-4).all()
    assert (shapes.max(0) > 0.9 * amplitude).all()


@pytest.fixture(scope="module")
def quick():
    return replace(SOLVER, starts=1, start_cycles=3, start_rounds=1, rounds=3, fit_iterations=30)


def test_the_gait_is_better_than_its_start_and_what_is_reported_is_simulated(problem, quick):
    shown: list[float] = []
    gait = quick.solve(problem, seed=0, progress=lambda message, fraction: shown.append(fraction))
    sequences = problem.switching_sequences(np.random.default_rng(0))
    cost = float(problem.objective(sequences, settle=1)(problem.w_of(gait)))
    assert gait.meta["resimulated"] == pytest.approx(cost, rel=1e-12)
    assert gait.meta["history"][-1] == gait.meta["resimulated"] < 0.95 * gait.meta["history"][0]
    assert np.isfinite(gait.meta["objective"])
    assert gait.task_names == ("forward", "left")
    assert shown == sorted(shown)
    assert shown[-1] == pytest.approx(1.0)


def test_a_seed_gives_one_gait_whatever_the_threads(problem, quick):
    first, second = (
        replace(quick, threads=threads, rounds=1).solve(problem, seed=3) for threads in (1, 2)
    )
    np.testing.assert_array_equal(first.alpha, second.alpha)
    np.testing.assert_array_equal(first.mu, second.mu)
    other = replace(quick, rounds=1).solve(problem, seed=4)
    assert np.abs(first.alpha - other.alpha).max() > 1e-3
