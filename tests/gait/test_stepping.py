"""Gaits that step: the patterns of the feet, and shapes that move them so."""

from __future__ import annotations

import numpy as np
import pytest

from defplan_mj.dynamics.feet import lowest_feet
from defplan_mj.dynamics.reduced import ReducedDynamics
from defplan_mj.gait import stepping
from defplan_mj.gait.problem import GaitProblem
from defplan_mj.gait.stepping import (
    SHARES,
    as_gait,
    foot_phases,
    stepping_gaits,
    swept,
)
from defplan_mj.gait.trials import asking_much, try_tasks
from defplan_mj.task import GaitTask
from defplan_tasks import quadruped
from tests.samples import host as samples

FOUR = np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]])  # front left, hind left, ...


@pytest.fixture(scope="module")
def dynamics() -> ReducedDynamics:
    return ReducedDynamics(samples.walker(), quadruped.WALK.timestep, quadruped.WALK.terrain)


def problem(dynamics: ReducedDynamics, *tasks: GaitTask) -> GaitProblem:
    weights = quadruped.WALK.weights
    return GaitProblem(dynamics, tasks, quadruped.WALK.steps_per_cycle, weights=weights)


def test_feet_take_turns_as_the_patterns_say():
    phases = foot_phases(FOUR)
    assert phases["trot"][0] == phases["trot"][2] != phases["trot"][1] == phases["trot"][3]
    assert list(phases["bound"]) == [0, 0.5, 0.5, 0] and list(phases["pace"]) == [0, 0, 0.5, 0.5]
    assert sorted(phases["crawl"]) == [0, 0.25, 0.5, 0.75]
    angles = 2 * np.pi * (np.arange(6) + 0.5) / 6
    six = foot_phases(np.stack([np.cos(angles), np.sin(angles)], axis=1))
    assert list(six["trot"][::2]) != list(six["trot"][1::2]) and len(set(six["trot"][::2])) == 1


def test_a_foot_is_swept_back_on_the_ground_and_brought_forward_above_it():
    heading = np.array([0.6, 0.8])
    way = swept(np.linspace(0, 1, 101), np.tile(heading, (101, 1)))
    along, height = way[:, :2] @ heading, way[:, 2]
    assert (np.diff(along[:51]) < 0).all() and np.allclose(height[:50], 0)
    assert (np.diff(along[51:]) > 0).all() and (height[52:-2] > 0).all()
    assert np.allclose(way[0], way[-1]) and np.ptp(along) == pytest.approx(1.0)
    assert np.allclose(way[:, :2] - along[:, None] * heading, 0)


def test_shapes_that_a_gait_can_have_are_met(dynamics):
    alone = problem(dynamics, GaitTask("forward")).alone(0)
    random = np.random.default_rng(0).normal(0, 0.02, (5, dynamics.nu))
    mu, alpha, _ = alone.split(as_gait(alone, np.zeros((alone.steps_per_cycle, dynamics.nu))))
    assert not alpha.any()
    w = alone.join(mu, random[None], np.ones((1, 5, dynamics.nu)))
    shapes = alone.gait(w, {}).table()[0]
    assert np.allclose(alone.split(as_gait(alone, shapes))[1][0], random, atol=1e-9)


@pytest.mark.parametrize("heading", [(1.0, 0.0), (0.0, -1.0)])
def test_the_feet_of_a_body_go_where_the_pattern_has_them(dynamics, heading):
    move = (0.4 * heading[0], 0.4 * heading[1], 0.0)
    alone = problem(dynamics, GaitTask("one", move=move)).alone(0)
    gaits = list(stepping_gaits(alone))
    assert len(gaits) == 4 * len(SHARES)
    body = dynamics.body
    feet = lowest_feet(body, 0.06).vertices
    motion = np.array([body.modes[foot].mean(0) for foot in feet])  # (feet, 3, r)
    where = np.array([body.vertices[foot].mean(0)[:2] for foot in feet])
    steps = np.arange(1, alone.steps_per_cycle + 1) / alone.steps_per_cycle
    ways = np.tile(heading, (len(feet), 1))
    trot = swept(steps[:, None] - foot_phases(where)["trot"], ways)
    shapes = alone.gait(gaits[1], {}).table()[0]
    assert np.abs(shapes / body.amplitude).max() <= 1.0
    feet_go = np.einsum("fir,nr->nfi", motion, shapes)[..., :2] @ heading
    wanted = trot[..., :2] @ heading
    assert np.corrcoef(feet_go.ravel(), wanted.ravel())[0, 1] > 0.7


def test_who_wants_to_turn_sweeps_one_side_back_and_the_other_forth(dynamics):
    alone = problem(dynamics, GaitTask("turn", turn=(0, 0, 0.5), move=(0.0, 0.0, 0.0))).alone(0)
    body, feet = dynamics.body, lowest_feet(dynamics.body, 0.06).vertices
    where = np.array([body.vertices[foot].mean(0)[:2] for foot in feet])
    motion = np.array([body.modes[foot].mean(0) for foot in feet])
    shapes = alone.gait(list(stepping_gaits(alone))[1], {}).table()[0]
    ahead = np.einsum("fr,nr->nf", motion[:, 0], shapes)
    trot = swept(np.arange(1, len(shapes) + 1)[:, None] / len(shapes) - foot_phases(where)["trot"],
                 np.stack([-where[:, 1], where[:, 0]], axis=1))  # fmt: skip
    assert np.corrcoef(ahead.ravel(), trot[..., 0].ravel())[0, 1] > 0.6


def test_who_wants_to_go_nowhere_does_not_step(dynamics):
    still = GaitTask("stay", move=(0.0, 0.0, 0.0))
    assert not list(stepping_gaits(problem(dynamics, still).alone(0)))


def test_trials_ask_for_the_same_whatever_is_wanted(dynamics):
    small, large = (
        problem(dynamics, GaitTask("forward", move=(x, 0, 0)), GaitTask("left", move=(0, x, 0)))
        for x in (0.1, 0.7)
    )
    assert asking_much(small).tasks == asking_much(large).tasks
    assert asking_much(small).tasks[1].move == pytest.approx(
        (0, 0.2 * dynamics.body.length, 0), abs=1e-8
    )


@pytest.mark.slow
def test_a_walker_learns_to_step_in_a_trial(dynamics, monkeypatch):
    monkeypatch.setattr(stepping, "_ITERATIONS", (3, 8))
    monkeypatch.setattr(stepping, "_TOGETHER", 2)
    tried = try_tasks(problem(dynamics, GaitTask("forward", move=(0.4, 0, 0))))
    assert tried.trials[0].advance > 0.05
