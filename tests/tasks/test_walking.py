"""The walkers' domain files: their TaskSpecs, the suite's walk task, gaits by shooting, falls."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
import pytest

from defplan_mj import registry, suite
from defplan_mj.base.errors import DefplanError
from defplan_mj.dynamics.reduced import ReducedDynamics
from defplan_mj.dynamics.terrain import Terrain, TerrainGeom
from defplan_mj.dynamics.world import tilt
from defplan_mj.gait.friction import Sliding
from defplan_mj.gait.gait import Gait
from defplan_mj.gait.problem import GaitProblem
from defplan_mj.gait.switching import evaluate_switching, measure_cycles, roll_cycles
from defplan_mj.kernel.contact_points import contact_points
from defplan_solvers.gait import shooting_walk
from defplan_solvers.gait.shooting import Shooting
from defplan_solvers.gait.shooting_walk import Trace, Walking, hardest, random_tasks
from defplan_tasks import environments, quadruped, tee, walking
from tests.samples import host as samples
from tests.samples.bodies import built

SPECS = {"quadruped": quadruped.WALK, "tee": tee.WALK}
BODIES = {"quadruped": samples.walker, "tee": samples.tee}
PACKAGED = {
    "quadruped": (
        lambda: environments.packaged_body("quadruped_walker_body"),
        lambda: environments.packaged_gait("quadruped_walker_gait"),
    ),
    "tee": (
        lambda: environments.packaged_body("tee_body"),
        lambda: environments.packaged_gait("tee_gait"),
    ),
}
SLIP = {"quadruped": 0.3, "tee": 0.35}  # of the way walked, at most
STAGES = Walking(starts=3, alone=((2, 12, 2), (3, 8, 1)), rounds=((2, 4, 20),), repairs=0)
QUICK = Shooting(walking=STAGES)


@pytest.fixture(scope="module")
def problem() -> GaitProblem:
    """Return the 4-legged walker's problem, forward and left only."""
    spec = quadruped.WALK
    dynamics = ReducedDynamics(samples.walker(), spec.timestep, spec.terrain)
    tasks = [spec.gait_tasks[0], spec.gait_tasks[2]]
    return GaitProblem(dynamics, tasks, spec.steps_per_cycle, weights=spec.weights)


@pytest.fixture(scope="module")
def gait(problem: GaitProblem) -> Gait:
    # with this much training seeds 0 to 3 walk; a shorter one hung on the last bits of the body
    return QUICK.solve(problem, seed=1)


@pytest.mark.parametrize("domain", SPECS)
def test_task_is_registered_as_the_paper_has_it(domain):
    spec = registry.get_task(f"{domain}-walk")
    assert spec is SPECS[domain] and spec.mesh.is_file()
    assert spec.body.vertices == {"quadruped": 1054, "tee": 3121}[domain]
    assert spec.body.modes == 10 and spec.gait_steps == 400 and spec.steps_per_cycle == 46
    assert [task.name for task in spec.gait_tasks] == ["forward", "back", "left", "right"]
    assert spec.navigation.k2 == 10 and spec.navigation.space == "planar"
    assert spec.terrain is not None and spec.body.medium.gravity == -9.81


def test_the_four_gaits_go_the_four_ways_in_which_they_are_called():
    forward, back, left, right = np.array([task.move for task in walking.walking_tasks(0.4)])
    np.testing.assert_allclose([forward, left], [[0.4, 0, 0], [0, 0.4, 0]])
    np.testing.assert_allclose([back, right], [-forward, -left])


def test_what_tasks_want_can_be_held_back(problem):
    slow = problem.at_most(0.1)
    for task, before in zip(slow.tasks, problem.tasks, strict=True):
        assert task.advance == pytest.approx(0.1) and task.name == before.name
        np.testing.assert_allclose(task.direction, before.direction)
        assert task.turn == before.turn
    assert problem.at_most(0.4) is problem and slow.at_most(0.2) is slow
    assert (slow.weights, slow.space, slow.cycles) == (
        problem.weights,
        problem.space,
        problem.cycles,
    )


def test_the_fast_task_is_the_walk_but_for_what_it_wants_and_may_slide():
    run, random_tasks = registry.get_task("quadruped-run"), quadruped.WALK
    assert [task.advance for task in run.gait_tasks] == [1.0] * 4
    assert run.weights.slip < random_tasks.weights.slip
    assert (run.feedback, random_tasks.feedback) == ("ilqg", "none")
    changed = {"name", "description", "gait_tasks", "weights", "feedback", "shipped"}
    for field in dataclasses.fields(random_tasks):
        assert field.name in changed or getattr(run, field.name) == getattr(
            random_tasks, field.name
        )


@pytest.mark.parametrize("domain", SPECS)
def test_the_body_stands_on_the_ground_without_sagging_much(domain):
    spec, body = SPECS[domain], BODIES[domain]()
    dynamics = ReducedDynamics(body, spec.timestep, spec.terrain)
    rest = dynamics.rest_state()
    tall, standing = np.ptp(body.vertices[:, 2]), np.ptp(dynamics.surface(rest)[:, 2])
    assert 0.9 * tall < standing < 1.02 * tall
    contacts = dynamics.contacts(rest)
    np.testing.assert_allclose(
        contacts.total, [0, 0, 9.81 * body.mass], atol=1e-3 * 9.81 * body.mass
    )
    assert contacts.depths.max() < 0.01 * tall


@pytest.mark.parametrize("domain", SPECS)
def test_walk_starts_on_the_ground_at_any_heading(domain):
    environment = suite.load(domain, "walk", task_kwargs={"random": 0, "body": BODIES[domain]()})
    physics, headings = environment.physics, []
    for _ in range(40):
        environment.reset()
        headings.append(physics.yaw())
        assert physics.upright() > 0.999
        assert abs(physics.surface()[:, 2].min()) < 0.01
    # of an even spread: no mean direction (4 sigma)
    assert np.abs(np.exp(1j * np.array(headings)).mean()) < 4 * np.sqrt(0.5 / 40)


def test_reward_is_speed_towards_the_target_while_standing():
    environment = suite.load(
        "quadruped", "walk", task_kwargs={"random": 0, "body": samples.walker()}
    )
    environment.reset()
    physics, task = environment.physics, environment.task
    ahead = physics.target() - physics.com()
    physics.data.qvel[:3] = 0.25 * ahead / np.linalg.norm(ahead)
    upright = (1 + physics.upright()) / 2
    assert task.get_reward(physics) == pytest.approx(0.5 * upright, rel=1e-6)
    physics.data.qvel[:3] *= 10
    assert task.get_reward(physics) == pytest.approx(upright, rel=1e-6)
    spec = quadruped.WALK
    rest = ReducedDynamics(samples.walker(), spec.timestep, spec.terrain).rest_state()
    physics.data.qpos[2] = 0.35 * rest[2]
    physics.forward()
    assert task.get_reward(physics) == pytest.approx(0.5 * upright, rel=1e-6)


def test_slip_costs_what_friction_takes_of_the_walk(problem: GaitProblem) -> None:
    """Against the kernel's own contact forces; the gradient against finite differences."""
    dynamics, spec = problem.dynamics, quadruped.WALK
    rng = np.random.default_rng(0)
    weights = dataclasses.replace(spec.weights, slip=1.0)
    sliding, plain = (
        GaitProblem(dynamics, problem.tasks, spec.steps_per_cycle, weights=given)
        for given in (weights, dataclasses.replace(weights, slip=0.0))
    )
    w = sliding.random_gait(rng)
    shapes = sliding.gait(w, {}).table()
    states = dynamics.rollout(dynamics.rest_state(), np.concatenate(shapes))
    work, points = 0.0, contact_points(dynamics.body)
    for before, after in itertools.pairwise(states):
        touching = dynamics.contacts(after)
        moved = (dynamics.surface(after) - dynamics.surface(before))[points[touching.which]]
        work -= (touching.forces * moved)[:, :2].sum()
    weight = dynamics.body.mass * 9.81
    assert dynamics.terrain is not None
    wanted = work / (dynamics.terrain.friction * weight) / 2  # m a cycle
    assert wanted > 1e-3
    found = [
        float(p.trajectory_cost([0, 1], settle=0)(states[0], states[1:].T))
        for p in (sliding, plain)
    ]
    # its load leaves the contact's damping out, its path is that of whole control steps
    assert found[0] - found[1] == pytest.approx(wanted, rel=0.02)
    objective = sliding.objective([[0]], settle=0)
    direction = rng.normal(size=w.shape)
    slope = float(objective.factory("g", ["w"], ["grad:cost:w"])(w).T @ direction)
    ahead, back = (float(objective(w + e * direction)) for e in (1e-6, -1e-6))
    assert slope == pytest.approx((ahead - back) / 2e-6, rel=1e-4)


def test_sliding_is_for_level_ground() -> None:
    body = samples.walker()
    for dynamics in (
        ReducedDynamics(body, 0.03),
        ReducedDynamics(body, 0.03, Terrain(geoms=(TerrainGeom("sphere", (9.0,)),))),
    ):
        with pytest.raises(DefplanError, match="level ground"):
            Sliding(dynamics)


def test_shooting_makes_the_walker_walk(problem: GaitProblem, gait: Gait) -> None:
    forward, left = problem.tasks
    found = measure_cycles(problem, gait, np.zeros(3, int))
    assert not found.down.any() and found.move[:, 0].sum() > 0.2
    found = measure_cycles(problem, gait, np.ones(3, int))
    assert not found.down.any() and found.move[:, 1].sum() > 0.2


def test_shooting_lowers_the_objective_in_every_iteration(gait: Gait) -> None:
    history = np.array(gait.meta["history"])
    assert len(history) > 3 and (np.diff(history) <= 1e-12).all()
    assert gait.meta["objective"] <= history[0]


def test_a_seed_gives_one_gait_to_the_bit(problem: GaitProblem, gait: Gait) -> None:
    again = QUICK.solve(problem, seed=1)
    for name in ("mu", "alpha", "beta"):
        np.testing.assert_array_equal(getattr(again, name), getattr(gait, name))


def test_the_hardest_sequences_end_where_the_walker_tilts_most(
    problem: GaitProblem, gait: Gait
) -> None:
    still = dataclasses.replace(gait, alpha=gait.alpha * np.array([0.0, 1.0])[:, None, None])
    assert measure_cycles(problem, still, np.ones(8, int)).tilt.min() > 1e-2  # stands, or walks
    w = problem.w_of(still)
    hard = hardest(problem, w, 4, 8, np.random.default_rng(0))
    assert len(hard) == 8 and all(len(sequence) == 4 for sequence in hard)
    task = random_tasks(2, 0.0, np.random.default_rng(0))
    states, _ = roll_cycles(problem.dynamics, problem.gait(w, {}).table()[task])
    worst = 3 + int(tilt(states).max(1)[3:].argmax())
    assert hard[0] == list(task[worst - 3 : worst + 1])


@pytest.mark.parametrize("counts", [[0], [2, 1, 0], [2, 3, 2, 2]])
def test_gaits_that_fall_go_on_and_are_taken_if_they_fall_less(
    problem: GaitProblem, gait: Gait, monkeypatch: pytest.MonkeyPatch, counts: list[int]
) -> None:
    told = iter(counts)
    monkeypatch.setattr(shooting_walk, "falls", lambda *_: next(told))
    monkeypatch.setattr(shooting_walk, "_WALK", 12)
    start, trace = problem.w_of(gait), Trace(lambda message, fraction: None, 1)
    walking = Walking(rounds=(), repair=(2, 3, 2), repairs=2)
    w, history, stages = walking.solve(problem, np.random.default_rng(0), trace, start, 1)
    assert next(told, None) is None  # it stops when nothing falls
    taken = [stage for stage in stages if stage["falls"][1] < stage["falls"][0]]
    assert len(taken) == (counts == [2, 1, 0]) and len(stages) == len(counts) // 2
    assert np.array_equal(w, start) == (not taken) == (not history)


def test_tasks_of_a_walk_are_kept_on_with_as_often_as_asked_for() -> None:
    for kept in (0.0, 0.6):
        tasks = random_tasks(4, kept)
        again = (tasks[1:] == tasks[:-1]).mean()
        assert again == pytest.approx(kept + (1 - kept) / 4, abs=0.08)
        assert set(tasks) == set(range(4))


def test_a_walker_that_comes_down_stands_up_for_the_next_cycle(
    problem: GaitProblem, gait: Gait
) -> None:
    wild = dataclasses.replace(gait, alpha=gait.alpha.copy())
    wild.alpha[1] = np.random.default_rng(0).normal(size=wild.alpha[1].shape)
    measured = measure_cycles(problem, wild, np.ones(8, int))
    down = np.flatnonzero(measured.down)
    assert len(down) >= 2 and measured.falls >= len(down)
    for cycle in down[down < 7] + 1:  # from rest, as the first one
        np.testing.assert_array_equal(measured.move[cycle], measured.move[0])
        assert not measured.counted[cycle]
    assert not measured.counted[down].any()


@pytest.mark.parametrize("domain", PACKAGED)
def test_the_packaged_gait_puts_its_feet_down_and_lifts_them(domain: str) -> None:
    spec, (body, gait) = SPECS[domain], (load() for load in PACKAGED[domain])
    problem = GaitProblem.of(spec, ReducedDynamics(body, spec.timestep, spec.terrain))
    measured = evaluate_switching(problem, gait, cycles=60, seed=7)
    assert measured.falls == 0
    for row in measured.rows():
        assert 0.33 <= row["advance_m"] <= 0.45
        assert abs(row["turn_rad"]) < 0.1
    check_footing(measured.footing, SLIP[domain])


def check_footing(found: dict[str, float], slip: float) -> None:
    """Feet hardly skate or sink, all else keeps clear of the ground."""
    assert found["slip_share"] <= slip
    assert found["penetration_share"] < 0.01
    assert found["torso_clearance_m"] >= 0.05
    assert found["belly_load"] == 0.0


# Minutes a seed: more of them are a study's. The T's seeds 2 and 4 slide too much or fall (docs/gaits.md): nothing
# is claimed of them.
STEADY_SEEDS = {"quadruped": (0, 1), "tee": (0, 3)}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("domain", "seed"), [(domain, seed) for domain in SPECS for seed in STEADY_SEEDS[domain]]
)
def test_every_steady_seed_walks_four_ways_without_a_fall(domain: str, seed: int) -> None:
    spec = SPECS[domain]
    body = built(spec.mesh, spec.body, spec.name)
    problem = GaitProblem.of(spec, ReducedDynamics(body, spec.timestep, spec.terrain))
    gait = registry.get_solver(spec.gait_solver, "gait").solve(problem, seed)
    for switching in range(3):
        measured = evaluate_switching(problem, gait, cycles=200, seed=switching)
        assert measured.falls == 0
        for row in measured.rows():
            assert row["advance_m"] >= 0.3
        check_footing(measured.footing, SLIP[domain])
