"""The evolution strategy makes gaits better, the same ones for the same seed, and says what it claims."""

from __future__ import annotations

import numpy as np
import pytest

from defplan_mj.body.model import Body
from defplan_mj.dynamics.reduced import ReducedDynamics
from defplan_mj.gait.problem import GaitProblem
from defplan_solvers.gait.cma_es import CmaEs
from defplan_tasks.fish import SWIM

SHORT = CmaEs(evaluations=160)


@pytest.fixture(scope="module")
def problem(small_fish: Body) -> GaitProblem:
    dynamics = ReducedDynamics(small_fish)
    return GaitProblem(dynamics, SWIM.gait_tasks[:1], 11, gait_steps=44, weights=SWIM.weights)


def test_the_objective_falls_and_is_what_the_simulation_gives(problem):
    gait = SHORT.solve(problem, seed=1)
    sequences = problem.switching_sequences(np.random.default_rng(1))
    again = float(problem.objective(sequences)(problem.w_of(gait)))
    over = (
        np.abs(np.array(problem.dmp(problem.w_of(gait)))) / problem.dynamics.body.amplitude[:, None]
    )
    penalty = SHORT.excess * np.mean(np.maximum(over - 1, 0) ** 2)
    assert gait.meta["objective"] == pytest.approx(again + penalty, rel=1e-9)
    assert gait.meta["objective"] == min(gait.meta["history"])
    assert gait.meta["objective"] < gait.meta["history"][0]
    assert 160 <= gait.meta["stages"][0]["evaluations"] < 200


def test_a_seed_gives_one_gait_to_the_bit_and_leaves_others_numbers_alone(problem):
    np.random.seed(5)  # noqa: NPY002
    expected = np.random.random()  # noqa: NPY002
    np.random.seed(5)  # noqa: NPY002
    one = SHORT.solve(problem, seed=3)
    assert np.random.random() == expected  # noqa: NPY002
    other = SHORT.solve(problem, seed=3)
    for name in ("mu", "alpha", "beta"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    assert not np.array_equal(one.alpha, SHORT.solve(problem, seed=4).alpha)
