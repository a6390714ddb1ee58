"""Gaits as data, the measure of switching, and the gait problem against independent truths."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from defplan_mj.base.errors import DefplanError
from defplan_mj.base.space import PLANE
from defplan_mj.body.model import Body
from defplan_mj.dynamics.reduced import ReducedDynamics
from defplan_mj.gait import switching
from defplan_mj.gait.gait import Gait
from defplan_mj.gait.problem import GaitProblem, balanced_sequence
from defplan_mj.gait.style import pulse_share, sideways_share
from defplan_mj.gait.trials import try_tasks
from defplan_mj.task import GaitTask, Weights
from defplan_tasks.fish import SWIM

AHEAD = np.array([1.0, 0.0, 0.0])
TASKS, WEIGHTS = SWIM.gait_tasks, SWIM.weights


@pytest.fixture(scope="module")
def problem(small_fish: Body) -> GaitProblem:
    return GaitProblem(ReducedDynamics(small_fish), TASKS, 11, gait_steps=33, weights=WEIGHTS)


@pytest.fixture(scope="module")
def unknowns(problem: GaitProblem) -> np.ndarray:
    """An undulation: the lateral modes beat."""
    rng = np.random.default_rng(3)
    d, r, k = problem.elements, problem.dynamics.nu, problem.n_tasks
    share = sideways_share(problem.dynamics.body, AHEAD)
    alpha = 0.3 * share * rng.normal(size=(k, d, r))
    return problem.join(rng.uniform(0, 6, (d, r)), alpha, 1 + 0.3 * rng.normal(size=(k, d, r)))


def test_the_symbolic_dmp_is_the_papers_sum(problem: GaitProblem, unknowns: np.ndarray) -> None:
    mu, alpha, beta = problem.split(unknowns)
    shapes = np.array(problem.dmp(unknowns)).T.reshape(3, 11, -1)
    tau = 2 * np.pi / (11 * problem.dynamics.timestep)
    for task in range(3):
        for i in range(11):
            time = (i + 1) * problem.dynamics.timestep
            wanted = sum(
                alpha[task, k] * np.exp(beta[task, k] * np.cos(tau * time - mu[k]))
                for k in range(5)
            )
            np.testing.assert_allclose(shapes[task, i], wanted, rtol=1e-12, atol=1e-12)


def test_a_gaits_table_is_its_dmp_within_the_amplitude(
    problem: GaitProblem, unknowns: np.ndarray
) -> None:
    gait = problem.gait(unknowns, {})
    amplitude = problem.dynamics.body.amplitude
    shapes = np.array(problem.dmp(unknowns)).T.reshape(3, 11, -1)
    np.testing.assert_allclose(gait.table(), np.clip(shapes, -amplitude, amplitude), atol=1e-12)
    np.testing.assert_array_equal(problem.w_of(gait), unknowns)


def test_a_saved_gait_reads_back_to_the_bit(
    problem: GaitProblem, unknowns: np.ndarray, tmp_path: Path
) -> None:
    gait = problem.gait(unknowns, {"solver": "none"})
    gait.save(tmp_path / "gait.npz")
    again = Gait.load(tmp_path / "gait.npz")
    np.testing.assert_array_equal(again.table(), gait.table())
    assert again.meta == gait.meta and again.task_names == gait.task_names
    with pytest.raises(DefplanError, match="does not exist"):
        Gait.load(tmp_path / "other.npz")


def test_the_objective_is_the_cost_of_the_simulated_cycles(
    problem: GaitProblem, unknowns: np.ndarray
) -> None:
    sequence = [0, 1, 2, 0]
    value = float(problem.objective([sequence])(unknowns))
    dynamics, weights = problem.dynamics, problem.weights
    shapes = np.array(problem.dmp(unknowns)).T.reshape(3, 11, -1)
    x = dynamics.rollout(dynamics.rest_state(), np.concatenate([shapes[j] for j in sequence]))
    costs = []
    for cycle in range(1, 4):  # the first cycle is not judged
        steps = x[cycle * 11 : cycle * 11 + 12]
        turns = Rotation.from_quat(steps[:, [4, 5, 6, 3]])
        forward = turns.apply([1.0, 0, 0])
        yaw = np.diff(np.unwrap(np.arctan2(forward[[0, -1], 1], forward[[0, -1], 0])))[0]
        heading = forward[0, :2] / np.linalg.norm(forward[0, :2])
        move = steps[-1, :3] - steps[0, :3]
        tilt2 = 2 * (1 - turns.apply([0, 0, 1.0])[1:, 2])
        task = TASKS[sequence[cycle]]
        costs.append(
            weights.turn * (yaw - task.turn[2]) ** 2
            + weights.move * max(0, task.move[0] - heading @ move[:2]) ** 2
            + weights.tilt * tilt2.mean()
            + weights.upright * (np.maximum(0, tilt2 - np.radians(15) ** 2) ** 2).mean()
            + weights.sink * move[2] ** 2
        )
    _, _, beta = problem.split(unknowns)
    share, amplitude = sideways_share(dynamics.body, AHEAD), dynamics.body.amplitude
    effort = ((shapes / amplitude) ** 2).mean((0, 1)) @ (1 - share)
    wanted = np.mean(costs) + weights.effort * effort + weights.sharpness * (beta**2).mean()
    assert value == pytest.approx(wanted, rel=1e-9)


def test_the_objectives_gradient_is_exact(problem: GaitProblem, unknowns: np.ndarray) -> None:
    cost = problem.objective([[0, 1, 2], [2, 1, 0]], threads=2)
    w = ca.MX.sym("w", problem.n_w)
    gradient = np.array(ca.Function("g", [w], [ca.gradient(cost(w), w)])(unknowns)).ravel()
    rng = np.random.default_rng(0)
    for _ in range(3):
        direction = rng.normal(size=problem.n_w)
        h = 1e-5
        slope = (cost(unknowns + h * direction) - cost(unknowns - h * direction)) / (2 * h)
        assert float(slope) == pytest.approx(gradient @ direction, rel=2e-5)


def test_every_transition_is_used_about_equally_often() -> None:
    sequence = balanced_sequence(3, 28, np.random.default_rng(1))
    counts = np.zeros((3, 3))
    np.add.at(counts, (sequence[:-1], sequence[1:]), 1)
    assert counts.sum() == 27 and counts.min() >= 2


def test_the_lateral_share_tells_sideways_bending_from_the_rest(small_fish: Body) -> None:
    share = sideways_share(small_fish, AHEAD)
    assert ((share >= 0) & (share <= 1)).all()
    # whole-body sway along y is lateral, along z is not
    sway = np.zeros((len(small_fish.vertices), 3, 2))
    sway[:, 1, 0] = sway[:, 2, 1] = small_fish.vertices[:, 0]
    np.testing.assert_allclose(
        sideways_share(dataclasses.replace(small_fish, modes=sway), AHEAD), [1, 0], atol=0.01
    )


def test_the_pulse_share_tells_opening_all_around_from_the_rest(small_fish: Body) -> None:
    rng = np.random.default_rng(0)
    radius, angle = np.sqrt(rng.uniform(0.01, 1, 4000)), rng.uniform(0, 2 * np.pi, 4000)
    x, y, z = radius * np.cos(angle), radius * np.sin(angle), rng.uniform(-0.1, 0.1, 4000)
    modes = np.zeros((4000, 3, 4))
    modes[:, :2, 0] = np.column_stack([x, y])  # opens
    modes[:, 2, 1] = radius**2  # bends up all around
    modes[:, :2, 2] = np.column_stack([x, -y])  # opens here, closes there
    modes[:, :2, 3] = np.column_stack([-y, x])  # turns
    disc = dataclasses.replace(
        small_fish, vertices=np.column_stack([x, y, z]), vertex_mass=np.ones(4000), modes=modes
    )
    share = pulse_share(disc, np.array([0.0, 0.0, 1.0]))
    np.testing.assert_allclose(share, [1, 1, 0, 0], atol=0.08)


def test_an_unknown_style_is_the_users_mistake(small_fish: Body) -> None:
    weights = Weights(style="sidewise")
    with pytest.raises(DefplanError, match="'sidewise'.*sideways, pulse"):
        _ = GaitProblem(ReducedDynamics(small_fish), TASKS, 11, weights=weights).style


def test_switching_measures_cycles_in_the_frame_of_their_start(
    problem: GaitProblem, unknowns: np.ndarray
) -> None:
    gait, dynamics = problem.gait(unknowns, {}), problem.dynamics
    measured = switching.evaluate_switching(problem, gait, cycles=12, seed=5)
    x = dynamics.rollout(dynamics.rest_state(), gait.table()[measured.task].reshape(132, -1))[::11]
    for cycle in range(12):
        start = Rotation.from_quat(x[cycle, [4, 5, 6, 3]])
        yaw = start.as_euler("ZYX")[0]
        move = Rotation.from_euler("z", -yaw).apply(x[cycle + 1, :3] - x[cycle, :3])
        np.testing.assert_allclose(move, measured.move[cycle], atol=1e-12)
        np.testing.assert_allclose(move[0], measured.advance[cycle], atol=1e-12)
        np.testing.assert_allclose(abs(move[1]), measured.drift[cycle], atol=1e-12)
    again = switching.evaluate_switching(problem, gait, cycles=12, seed=5)
    np.testing.assert_array_equal(again.turn, measured.turn)


def test_a_tilted_or_backward_cycle_is_a_fall() -> None:
    measured = switching.Switching(
        tasks=TASKS[:1],
        place=PLANE,
        length=1.0,
        task=np.zeros(4, int),
        move=np.outer([-1.0, 1.0, -0.1, 1.0], [1, 0, 0]),  # the first cycles start from rest
        turn=np.zeros((4, 3)),
        tilt=np.radians([0, 0, 0, 31.0]),
        down=np.zeros(4, bool),
    )
    assert measured.falls == 2


# --- in space

AXIS = np.array([0.0, 0.0, 1.0])
SPATIAL = (
    GaitTask("ahead", move=(0, 0, 0.3)),
    GaitTask("over", turn=(0.2, 0.4, 0), move=(0, 0, 0)),
)
IN_SPACE = Weights(drift=3.0, roll=0.7)


@pytest.fixture(scope="module")
def spatial(small_fish: Body) -> GaitProblem:
    return GaitProblem(
        ReducedDynamics(small_fish),
        SPATIAL,
        11,
        33,
        space="spatial",
        weights=IN_SPACE,
        axis=AXIS,
    )


def test_in_space_a_cycle_costs_the_papers_orientation_error_roll_and_displacement(
    spatial: GaitProblem, unknowns: np.ndarray
) -> None:
    rng = np.random.default_rng(4)
    for task, column in zip(SPATIAL, spatial.goals.T, strict=True):
        start, end = Rotation.random(rng=rng), Rotation.from_rotvec(0.3 * rng.normal(size=3))
        x = rng.normal(size=(12, spatial.dynamics.nx))
        x[0, 3:7], x[-1, 3:7] = (a.as_quat(scalar_first=True) for a in (start, start * end))
        cost = float(spatial.cycle_cost(x[0], x[1:].T, column))
        target = Rotation.from_rotvec(task.turn)
        paper = ((end.apply(AXIS) - target.apply(AXIS)) ** 2).sum()
        roll = 4 * ((target.inv() * end).as_quat()[:3] @ AXIS) ** 2
        move = start.inv().apply(x[-1, :3] - x[0, :3])
        along = move @ task.direction
        drift = ((move - along * np.array(task.direction)) ** 2).sum()
        wanted = IN_SPACE.move * max(0, task.advance - along) ** 2 + IN_SPACE.drift * drift
        assert cost == pytest.approx(IN_SPACE.turn * paper + IN_SPACE.roll * roll + wanted)


def test_in_space_the_gradient_is_exact_and_the_start_attitude_does_not_matter(
    spatial: GaitProblem,
) -> None:
    rng = np.random.default_rng(5)
    d, r, k = spatial.elements, spatial.dynamics.nu, spatial.n_tasks
    w0 = spatial.join(
        rng.uniform(0, 6, (d, r)), 0.2 * rng.normal(size=(k, d, r)), rng.normal(size=(k, d, r))
    )
    cost = spatial.objective([[0, 1, 1], [1, 0, 1]], threads=2)
    w = ca.MX.sym("w", spatial.n_w)
    gradient = np.array(ca.Function("g", [w], [ca.gradient(cost(w), w)])(w0)).ravel()
    for _ in range(3):
        direction, h = rng.normal(size=spatial.n_w), 1e-5
        slope = (cost(w0 + h * direction) - cost(w0 - h * direction)) / (2 * h)
        assert float(slope) == pytest.approx(gradient @ direction, rel=2e-5)
    # a fish that is not righted: all attitudes are alike
    fish = spatial.dynamics.body
    body = dataclasses.replace(fish, medium=dataclasses.replace(fish.medium, righting_height=0.0))
    dynamics = ReducedDynamics(body)
    shapes = np.array(spatial.dmp(w0)).T.reshape(k, 11, r)[[0, 1, 1]].reshape(33, r)
    values = []
    for attitude in (Rotation.identity(), Rotation.from_euler("xyz", [2.0, -1.2, 3.0])):
        start = dynamics.rest_state()
        start[:3], start[3:7] = rng.normal(size=3), attitude.as_quat(scalar_first=True)
        x = dynamics.rollout(start, shapes)
        values.append(float(spatial.trajectory_cost([0, 1, 1])(x[0], x[1:].T)))
    assert values[0] == pytest.approx(values[1], rel=1e-6)
    assert values[0] > 0.1


def test_in_space_switching_is_measured_about_the_tasks_axis_in_the_body_frame(
    spatial: GaitProblem,
) -> None:
    rng = np.random.default_rng(6)
    d, r, k = spatial.elements, spatial.dynamics.nu, spatial.n_tasks
    w = spatial.join(
        rng.uniform(0, 6, (d, r)), 0.2 * rng.normal(size=(k, d, r)), np.ones((k, d, r))
    )
    gait = spatial.gait(w, {})
    measured = switching.evaluate_switching(spatial, gait, cycles=10, seed=1)
    x = spatial.dynamics.rollout(
        spatial.dynamics.rest_state(), gait.table()[measured.task].reshape(110, -1)
    )[::11]
    axis = np.array([1.0, 2.0, 0]) / np.sqrt(5)
    for cycle in range(10):
        before, after = (Rotation.from_quat(q[[4, 5, 6, 3]]) for q in x[cycle : cycle + 2])
        turn = (before.inv() * after).as_rotvec()
        move = before.as_matrix().T @ (x[cycle + 1, :3] - x[cycle, :3])
        np.testing.assert_allclose(measured.move[cycle], move, atol=1e-12)
        if measured.task[cycle]:
            assert measured.angle[cycle] == pytest.approx(turn @ axis)
            assert measured.stray[cycle] == pytest.approx(
                np.linalg.norm(turn - (turn @ axis) * axis)
            )
            assert measured.advance[cycle] == 0
        else:
            assert measured.advance[cycle] == pytest.approx(move[2])
            assert measured.drift[cycle] == pytest.approx(np.hypot(move[0], move[1]))
        wrong = measured.angle[cycle] <= 0 if measured.task[cycle] else move[2] <= 0
        assert measured.wrong_way[cycle] == (wrong and cycle >= 2)


def test_a_short_trial_tells_what_a_body_can_do(problem: GaitProblem) -> None:
    done = try_tasks(problem).trials
    forward, left, right = done
    assert forward.advance > 0.03 and left.turn > 0.05 and right.turn > 0.05
    assert max(trial.advance for trial in done) < 1.0
