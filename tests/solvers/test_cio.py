"""Contact-invariant optimisation: its derivatives, problems whose answer is known, and a walker's gaits."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.spatial import Delaunay

from defplan_mj.base.errors import DefplanError
from defplan_mj.body.model import Body, Medium
from defplan_mj.dynamics.reduced import ReducedDynamics
from defplan_mj.dynamics.terrain import Terrain
from defplan_mj.gait.problem import GaitProblem
from defplan_mj.gait.switching import measure_cycles
from defplan_mj.task import BodyOptions, GaitTask
from defplan_mj.task import Weights as Objective
from defplan_solvers.cio import newton as cio_newton
from defplan_solvers.cio import solver as cio
from defplan_solvers.cio.model import pads, walker_of
from defplan_solvers.cio.newton import ContactInvariant, Iterate
from defplan_solvers.cio.start import PATTERNS, foot_forces, starts
from defplan_solvers.cio.terms import Weights
from defplan_solvers.gait import shooting
from defplan_solvers.gait.shooting_walk import Walking, solvable
from defplan_tasks.environments import ASSETS
from tests.samples.bodies import built
from tests.samples.toy_walker import MASS, STAND, toy_walker

GRAVITY = 9.81
DIRECTIONS = ((0.15, 0, 0), (0, 0.15, 0))


def toy_problem(tasks=DIRECTIONS, steps: int = 10, cycles: int = 2) -> GaitProblem:
    body = SimpleNamespace(n_modes=12, amplitude=np.ones(12), mass=MASS)
    dynamics: Any = SimpleNamespace(nu=12, nx=49, timestep=0.03, body=body)
    gait_tasks = [GaitTask(f"task{i}", move=move) for i, move in enumerate(tasks)]
    weights = Objective(drift=2.0, effort=0.05)
    return GaitProblem(dynamics, gait_tasks, steps, steps * cycles, elements=4, weights=weights)


def toy(joint: bool, **kwargs) -> tuple[ContactInvariant, Iterate]:
    problem, walker = toy_problem(**kwargs), toy_walker()
    tasks = list(range(problem.n_tasks))
    optimised = ContactInvariant(walker, problem, tasks, problem.cycles, joint=joint)
    rng = np.random.default_rng(0)
    walk = starts(walker, problem, tasks, ["trot"] * len(tasks), problem.cycles, rng)
    return optimised, replace(walk, shapes=optimised.dmp(walk.w))


def displaced(
    optimised: ContactInvariant, walk: Iterate, seed: int, size: float
) -> tuple[Iterate, tuple[np.ndarray, ...]]:
    """Walks that obey nothing, and a direction."""
    rng, local = np.random.default_rng(seed), 3 * optimised.walker.n_feet
    local += 0 if optimised.joint else optimised.walker.nu
    free = optimised.alone[0].n_w - optimised.alone[0].n_phases
    steps = optimised.count, optimised.steps
    ends = optimised.count, free if optimised.joint else 0
    shapes: list[tuple[int, ...]] = [(*steps, optimised.nt), (*steps, local), ends]
    away, direction = (tuple(rng.normal(size=shape) for shape in shapes) for _ in range(2))
    return optimised.moved(walk, tuple(size * d for d in away)), direction


@pytest.fixture
def long_steps(monkeypatch):
    monkeypatch.setattr(cio_newton, "_LONGEST", np.inf)


@pytest.mark.parametrize("joint", [True, False])
def test_gradient_is_that_of_finite_differences(joint, long_steps):
    optimised, walk = toy(joint)
    walk, direction = displaced(optimised, walk, 1, 0.03)
    weights = Weights(1.3, 2.0, dmp=0.0 if joint else 0.7, objective=0.8)
    slope = 2 * optimised.system(walk, weights).slope(direction)
    step = 1e-6
    ahead, back = (
        optimised.cost(optimised.moved(walk, tuple(s * step * d for d in direction)), weights)
        for s in (1, -1)
    )
    assert slope == pytest.approx((ahead - back) / (2 * step), rel=1e-5)


@pytest.mark.parametrize("joint", [True, False])
def test_a_step_solves_the_normal_equations(joint, long_steps):
    """The block elimination against one dense matrix of residuals' finite differences."""
    optimised, walk = toy(joint, tasks=DIRECTIONS[:1], steps=3)
    walk, direction = displaced(optimised, walk, 2, 0.02)
    weights = Weights(1.0, 1.0, dmp=0.0 if joint else 0.5)
    damping = np.array([0.3])
    shapes, sizes = [d.shape for d in direction], [d.size for d in direction]

    def residuals(z):
        parts = np.split(z, np.cumsum(sizes)[:-1])
        step = tuple(p.reshape(s) for p, s in zip(parts, shapes, strict=True))
        return np.concatenate(
            [a.ravel() for a in optimised.residuals(optimised.moved(walk, step), weights)]
        )

    n, e = sum(sizes), 1e-6
    jacobian = np.array([residuals(e * row) - residuals(-e * row) for row in np.eye(n)]).T / (2 * e)
    metric = [
        np.tile(optimised.metric, optimised.steps),
        np.tile(optimised.local_metric, optimised.steps),
        np.full(sizes[2], cio_newton.W_METRIC),
    ]
    normal = jacobian.T @ jacobian + np.diag(damping * np.concatenate(metric))
    right = jacobian.T @ residuals(np.zeros(n))
    if joint:
        gradient, hessian = optimised.of_w(walk.w[0])
        normal[-sizes[2] :, -sizes[2] :] += 0.5 * hessian
        right[-sizes[2] :] += 0.5 * gradient
    wanted = np.linalg.solve(normal, -right)
    step = optimised.system(walk, weights).solve(damping, optimised.metric, optimised.local_metric)
    assert np.concatenate([d.ravel() for d in step]) == pytest.approx(wanted, abs=2e-6, rel=1e-4)


def test_objective_of_the_residuals_is_the_problems():
    optimised, walk = toy(True)
    walk, _ = displaced(optimised, walk, 3, 0.05)
    stage, cycle = optimised.residuals(walk, Weights(0, 0, 0, 0, 0, 0))
    tilt = stage[:, optimised.n * optimised.settle :]  # only judged cycles count in the problem
    for b in range(optimised.count):
        alone, states = optimised.alone[b], walk.states[b].T
        cost = alone.trajectory_cost([0] * optimised.cycles)(states[:, 0], states[:, 1:])
        assert (cycle[b] ** 2).sum() + (tilt[b] ** 2).sum() == pytest.approx(float(cost), rel=1e-9)


def standing(optimised: ContactInvariant, walk: Iterate) -> Iterate:
    """Without a start that knows the answer: no forces, a body at rest."""
    states = np.tile(optimised.walker.rest, (*walk.states.shape[:2], 1))
    return Iterate(states, 0 * walk.forces, walk.shapes, walk.w)


def test_standing_takes_the_weight():
    optimised, walk = toy(True, tasks=((0, 0, 0),))
    weights = Weights(3.0, 1.0, force=1e-3)
    walk = replace(standing(optimised, walk), w=np.zeros_like(walk.w))
    walk, _ = optimised.minimise(walk, weights, 40, np.full(1, 1e-2))
    forces = walk.forces.reshape(optimised.steps, 4, 3)[2:-2]
    assert forces[..., 2].sum(1) == pytest.approx(1.0, abs=5e-3)
    assert forces[..., 2] == pytest.approx(0.25, abs=1e-2)
    assert np.abs(forces[..., :2]).max() < 5e-3
    assert walk.states[0, :, 2] == pytest.approx(STAND, abs=2e-3)


def test_a_body_thrown_up_flies_freely_and_lands_on_its_impulse():
    """Started as if it stood: it has to find that no foot reaches the ground while it flies."""
    optimised, walk = toy(False, tasks=((0, 0, 0),), steps=15, cycles=2)
    up, steps, h = 2.5, optimised.steps, optimised.walker.timestep
    states = walk.states.copy()
    states[:, 0, 7 + 12 + 2] = up
    forces = np.tile(np.ravel([[0, 0, 0.25]] * 4), (1, steps, 1))
    walk = Iterate(states, forces, 0 * walk.shapes, 0 * walk.w)
    for physics, contact in ((0.3, 0.3), (1.0, 3.0), (3.0, 10.0), (30.0, 10.0)):
        weights = Weights(physics, contact, dmp=0.01)
        walk, _ = optimised.minimise(walk, weights, 100, np.full(1, 1e-2))
    vertical = walk.forces[0].reshape(steps, 4, 3)[..., 2].sum(1)
    speed, height = walk.states[0, :, 7 + 12 + 2], walk.states[0, :, 2]
    time = h * np.arange(steps + 1)
    thrown = STAND + up * time - GRAVITY * time * (time + h) / 2  # as the step sums it
    out_of_reach = np.flatnonzero(thrown > STAND + 0.13)  # a foot extends by 10 cm
    assert len(out_of_reach) >= 8
    assert np.abs(vertical[out_of_reach - 1]).max() < 0.05
    flight = slice(0, out_of_reach[-1] + 1)
    assert height[flight] == pytest.approx(thrown[flight], abs=0.02)
    # the impulse of the feet over any time is that of gravity and the change of momentum
    for first, last in ((0, steps), (7, 25)):
        impulse = h * GRAVITY * (vertical[first:last].sum() - (last - first))
        assert speed[last] - speed[first] == pytest.approx(impulse, abs=0.05)
    assert height[-1] < STAND + 0.11, "it is back on its feet"


@pytest.mark.parametrize("joint", [True, False])
def test_walks_obey_cones_ground_and_dynamics(joint):
    optimised, walk = toy(joint, steps=12, cycles=2)
    for physics, contact in ((0.1, 0.3), (0.3, 1.0), (1.0, 3.0), (3.0, 10.0), (30.0, 10.0)):
        weights = Weights(physics, contact, dmp=0.1, objective=3.0)
        walk, _ = optimised.minimise(walk, weights, 25, np.full(2, 1e-2))
    forces = walk.forces.reshape(2, -1, 4, 3)
    sideways = np.linalg.norm(forces[..., :2], axis=-1)
    assert forces[..., 2].min() > -0.02
    assert (sideways - optimised.walker.friction * forces[..., 2]).max() < 0.05
    heights = np.array([[np.array(optimised.walker.feet(x))[2] for x in xs] for xs in walk.states])
    assert heights.min() > -0.01
    assert np.sqrt(optimised.parts(walk, weights)["physics"]).max() < 0.05  # g
    moved = walk.states[:, -1, :2] - walk.states[:, 0, :2]
    assert (moved * np.eye(2)).sum(1).min() > (0.05 if joint else 0.15), "of 0.3 m"


def test_a_cost_is_never_raised():
    optimised, walk = toy(True)
    weights = Weights(1.0, 1.0)
    costs, damping = [optimised.cost(walk, weights)], np.full(2, 1e-2)
    for _ in range(8):
        walk, damping = optimised.minimise(walk, weights, 1, damping)
        costs.append(optimised.cost(walk, weights))
    assert (np.diff(costs, axis=0) <= 0).all()
    assert (costs[-1] < 0.5 * costs[0]).all()


@pytest.mark.parametrize("pattern", PATTERNS)
def test_forces_at_the_start_carry_the_weight(pattern):
    walker = toy_walker()
    phases, duty = PATTERNS[pattern]
    forces = foot_forces(walker, np.array(phases), duty, 20, 60).reshape(60, 4, 3)
    assert forces[..., 2].min() >= 0
    if pattern != "pronk":  # which flies
        assert forces[..., 2].sum(1) == pytest.approx(1.0)
    assert forces[:4, :, 2] == pytest.approx(0.25)


# --- on a soft body, through the kernel


@pytest.fixture(scope="module")
def walking(small_walker: Body) -> GaitProblem:
    dynamics = ReducedDynamics(small_walker, 0.03, Terrain(slip_speed=0.03))
    tasks = (GaitTask("forward", move=(0.3, 0, 0)), GaitTask("left", move=(0, 0.3, 0)))
    weights = Objective(turn=1.0, move=8.0, drift=8.0, tilt=3.0)
    return GaitProblem(dynamics, tasks, 10, 20, elements=3, weights=weights)


QUICK = replace(
    cio.JOINT,
    stages=(cio.Stage(0.1, 0.3, 4), cio.Stage(1.0, 3.0, 4)),
    patterns=("trot", "random"),
    cycles=2,
    judged=3,
    threads=1,
)


def test_a_soft_body_stands_on_four_feet_that_carry_it(walking):
    walker = walker_of(walking)
    assert walker.n_feet == 4
    assert walker.carried.sum() == pytest.approx(1.0)
    assert walker.carried.min() > 0.1
    forces = np.zeros((3, 4))
    forces[2] = walker.weight * walker.carried
    fallen = np.array(walker.step(walker.rest, np.zeros(walker.nu), np.zeros((3, 4)))).ravel()
    carried = np.array(walker.step(walker.rest, np.zeros(walker.nu), forces)).ravel()
    up = 7 + walker.nu + 2
    assert fallen[up] == pytest.approx(-GRAVITY * walker.timestep, rel=0.01)
    assert abs(carried[up]) < 0.01 * abs(fallen[up])
    ground = walker.level - walker.give * np.sqrt(walker.carried)
    assert np.array(walker.feet(walker.rest))[2] == pytest.approx(ground)


def test_a_foot_as_wide_as_the_body_stands_on_its_ends():
    x, y = np.meshgrid(np.linspace(-0.5, 0.5, 21), np.linspace(-0.2, 0.2, 9))
    sole = np.column_stack([x.ravel(), y.ravel(), 0 * x.ravel()])
    points = np.vstack([sole, sole[::40] + [0, 0, 0.3]])
    faces = Delaunay(sole[:, :2]).simplices
    body = SimpleNamespace(vertices=points, surface=np.arange(len(points)), faces=faces, length=1.0)
    middles = np.array([points[group].mean(0) for group in pads(body).vertices])
    assert middles.shape == (4, 3)
    assert np.sort(middles[:, 0]) == pytest.approx([-0.375, -0.375, 0.375, 0.375], abs=0.03)
    assert np.sort(middles[:, 1]) == pytest.approx([-0.15, -0.15, 0.15, 0.15], abs=0.03)


def test_physics_is_met_by_a_simulation_under_given_forces(walking):
    """And its Jacobian, through the kernel, is that of finite differences."""
    walker, rng = walker_of(walking), np.random.default_rng(4)
    optimised = ContactInvariant(walker, walking, [0], 2, joint=False)
    forces = 0.25 + 0.05 * rng.normal(size=(1, optimised.steps, 12))
    shapes = 0.2 * rng.normal(size=(1, optimised.steps, walker.nu))
    states = [walker.rest]
    for force, u in zip(forces[0], shapes[0], strict=True):
        newtons = walker.weight * force.reshape(4, 3).T
        states.append(np.array(walker.step(states[-1], u, newtons)).ravel())
    w = np.zeros((1, optimised.alone[0].n_w))
    walk = Iterate(np.array([states]), forces, shapes, w)
    assert optimised.parts(walk, Weights(1.0, 1.0))["physics"] < 1e-20
    weights = Weights(1.0, 1.0, dmp=0.5)
    walk, direction = displaced(optimised, walk, 5, 0.01)
    slope, e = 2 * optimised.system(walk, weights).slope(direction), 1e-5
    ahead, back = (
        optimised.cost(optimised.moved(walk, tuple(s * e * d for d in direction)), weights)
        for s in (1, -1)
    )
    assert slope == pytest.approx((ahead - back) / (2 * e), rel=1e-4)


@pytest.mark.parametrize("joint", [True, False])
def test_one_seed_is_one_gait_and_its_meta_are_what_it_says(walking, joint):
    solver = replace(QUICK, joint=joint)
    if not joint:
        solver = replace(solver, stages=(cio.Stage(0.3, 1.0, 2, dmp=1.0, rounds=2),))
    first, again, other = (solver.solve(walking, seed) for seed in (3, 3, 4))
    assert np.array_equal(first.alpha, again.alpha) and np.array_equal(first.beta, again.beta)
    assert not np.array_equal(first.alpha, other.alpha)
    simulated = [
        float(walking.alone(j).objective([[0] * 3], settle=2)(w))
        for j, w in enumerate(cio.apart(walking, walking.w_of(first)))
    ]
    assert first.meta["resimulated"] == pytest.approx(np.mean(simulated))
    assert first.meta["objective"] > 0


def test_polishing_goes_on_from_the_walk(walking):
    walking_rounds = Walking(rounds=((2, 4, 5),), repairs=0)
    shoot = shooting.Shooting(walking=walking_rounds, threads=1)
    start = walking.w_of(QUICK.solve(walking, 0))
    polished = replace(QUICK, polish=shoot).solve(walking, 0)
    sequences = solvable(walking, start, 2, 4, np.random.default_rng(0))
    cost = walking.objective(sequences, settle=0)
    assert float(cost(walking.w_of(polished))) < float(cost(start))


def test_a_swimmer_is_refused(walking):
    swimmer = GaitProblem(ReducedDynamics(walking.dynamics.body, 0.03), walking.tasks, 10, 20)
    with pytest.raises(DefplanError, match="level ground"):
        cio.JOINT.solve(swimmer)


@pytest.mark.slow
def test_a_walk_is_what_it_was_believed_to_be():
    """The whole solver: four directions, as simulated with the real contact."""
    air = Medium(name="air", density=1.2, gravity=-GRAVITY, righting_height=0.0)
    options = BodyOptions(
        vertices=600, modes=10, basis=20, samples=12, drag_points=8, amplitude=1.0, medium=air
    )
    body = built(ASSETS / "quadruped.obj", options)
    dynamics = ReducedDynamics(body, 0.03, Terrain(slip_speed=0.03))
    sides = ((0.4, 0, 0), (-0.4, 0, 0), (0, 0.4, 0), (0, -0.4, 0))
    tasks = [GaitTask(f"side{i}", move=move) for i, move in enumerate(sides)]
    weights = Objective(turn=1.0, move=8.0, drift=8.0, tilt=3.0)
    problem = GaitProblem(dynamics, tasks, 23, 200, weights=weights)
    gait = cio.JOINT.solve(problem, 0)
    assert gait.meta["resimulated"] < gait.meta["objective"] + 0.1
    for task in range(4):
        cycles = measure_cycles(problem, gait, np.full(10, task))
        # 0.4 is wanted; what is reached hangs on the last bits (0.297 to 0.35 was seen)
        assert cycles.advance[2:].mean() > 0.25
        assert np.degrees(cycles.tilt.max()) < 20
