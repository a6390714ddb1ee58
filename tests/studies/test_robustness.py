"""Robustness: worlds are what they say, falls are falls, and the same seed gives the same walk."""

from __future__ import annotations

import numpy as np
import pytest

from defplan_mj import registry
from defplan_mj.body.build import build_body
from defplan_mj.body.model import Body, Material, Medium
from defplan_mj.dynamics.reduced import ReducedDynamics
from defplan_mj.dynamics.tangent import Frame
from defplan_mj.dynamics.terrain import Terrain
from defplan_mj.dynamics.world import WATER
from defplan_mj.gait.gait import Gait
from defplan_mj.studies.robustness import (
    CALM,
    Condition,
    PerturbedWalk,
    conditions,
    heavier,
    measure_robustness,
    perturbed_walk,
    real_dynamics,
)
from defplan_mj.task import BodyOptions
from defplan_solvers.feedback.open_loop import SOLVER as NONE
from tests.samples.paths import ASSETS

PACKAGED = {
    "quadruped-walk": ("quadruped_walker_body", "quadruped_walker_gait"),
    "tee-walk": ("tee_body", "tee_gait"),
}
AIR = Medium(name="air", density=1.2, gravity=-9.81, righting_height=0.0)


@pytest.fixture(scope="module")
def standing() -> ReducedDynamics:
    """A 4-legged body on the ground."""
    options = BodyOptions(
        vertices=400, modes=6, basis=16, samples=8, amplitude=1.0, length=1.0, medium=AIR,
        material=Material(youngs_modulus=1e6, damping=0.02),
    )  # fmt: skip
    return ReducedDynamics(build_body(ASSETS / "quadruped.obj", options), 0.03, Terrain())


def still(body: Body, size: float = 0.0) -> Gait:
    """A gait that keeps one shape."""
    alpha = np.full((1, 1, body.n_modes), size)
    nothing = np.zeros_like(alpha)
    return Gait(body.hash, ("stand",), 0.03, 10, alpha, nothing, nothing[0], body.amplitude)


def test_a_heavier_body_has_the_same_shapes_and_the_energies_of_its_mass(fish_dynamics):
    light = fish_dynamics
    heavy = ReducedDynamics(heavier(light.body, 1.3), light.timestep)
    x = light.rollout(light.rest_state(), 0.5 * np.random.default_rng(0).normal(size=(8, 5)))[-1]
    np.testing.assert_allclose(heavy.surface(x), light.surface(x), atol=1e-12)
    assert heavy.body.mass == pytest.approx(1.3 * light.body.mass)
    one, other = light.energy(x), heavy.energy(x)
    assert other["kinetic"] == pytest.approx(1.3 * one["kinetic"], rel=1e-9)
    assert other["elastic"] == pytest.approx(one["elastic"], rel=1e-9)
    np.testing.assert_allclose(other["angular_momentum"], 1.3 * one["angular_momentum"], rtol=1e-7)


def test_a_body_stands_on_a_slope_of_the_said_angle(standing):
    slope = Condition("slope", slope=np.radians(5.0))
    real, weight = real_dynamics(standing, slope), standing.body.mass * 9.81
    half = 0.5 * slope.slope
    ground = Frame(np.zeros(3), np.array([np.cos(half), 0.0, -np.sin(half), 0.0]))
    uphill = ground.matrix[:, 0]
    assert uphill[2] == pytest.approx(np.sin(slope.slope)) and uphill[0] > 0
    x = real.rollout(ground.outside(standing.rest_state()), np.zeros((60, standing.nu)))[-1]
    np.testing.assert_allclose(real.contacts(x).total, [0.0, 0.0, weight], atol=0.02 * weight)
    gaps = real.surface(x) @ ground.matrix[:, 2]
    assert -0.005 < gaps.min() < 0.01
    assert not perturbed_walk(standing, still(standing.body), NONE, slope, cycles=4).fell.any()


def test_friction_and_mass_are_those_of_the_condition_and_the_ground_stays_as_stiff(standing):
    real = real_dynamics(standing, Condition("both", friction=0.7, mass=1.2))
    assert real.terrain is not None and standing.terrain is not None
    assert real.terrain.friction == pytest.approx(0.7 * standing.terrain.friction)
    assert real.body.mass == pytest.approx(1.2 * standing.body.mass)
    # packed: friction, stiffness and thickness, after their length
    assert real.terrain.stiffness == pytest.approx(
        standing.body.mass * 9.81 / (0.01 * standing.body.length) ** 2
    )
    x = real.rest_state()
    assert real.contacts(x).total[2] == pytest.approx(1.2 * standing.body.mass * 9.81, rel=1e-3)


def test_a_body_that_stands_does_not_fall_and_one_that_is_struck_down_does(standing):
    gait = still(standing.body)
    calm = perturbed_walk(standing, gait, NONE, CALM, cycles=5)
    assert not calm.fell.any() and calm.counted.tolist() == [False, False, True, True, True]
    assert np.abs(calm.motion).max() < 1e-3
    struck = perturbed_walk(standing, gait, NONE, Condition("blow", push=6.0), cycles=8)
    assert struck.fell.sum() >= 2
    # it is put on its feet where it fell, and what comes next does not count
    assert not (struck.counted & struck.fell).any()
    assert np.isfinite(struck.motion).all()


def test_pushes_and_switches_are_the_same_for_each_feedback(fish_dynamics, fish_gait):
    first = perturbed_walk(
        fish_dynamics, fish_gait, NONE, Condition("p", push=0.3), cycles=6, seed=3
    )
    again = perturbed_walk(
        fish_dynamics, fish_gait, NONE, Condition("p", push=0.3), cycles=6, seed=3
    )
    other = perturbed_walk(
        fish_dynamics, fish_gait, NONE, Condition("p", push=0.3), cycles=6, seed=4
    )
    assert (first.motion == again.motion).all() and (first.task == again.task).all()
    assert not (first.motion == other.motion).all()
    held = perturbed_walk(
        fish_dynamics, fish_gait, registry.get_solver("ilqg", "feedback"), CALM, 6, 3
    )
    assert (held.task == first.task).all()


@pytest.mark.slow
@pytest.mark.parametrize("name", PACKAGED)
def test_a_walker_that_is_struck_falls_no_more_often_with_feedback_and_keeps_its_course(name):
    spec, (body_file, gait_file) = registry.get_task(name), PACKAGED[name]
    gait = Gait.load(ASSETS / f"{gait_file}.npz")
    body = Body.load(ASSETS / f"{body_file}.npz")
    dynamics = ReducedDynamics(body, gait.timestep, spec.terrain)
    solvers = [NONE, registry.get_solver("ilqg", "feedback")]
    wanted = [CALM, Condition("pushed", push=0.3), Condition("struck", push=1.8)]
    rows = measure_robustness(dynamics, gait, solvers, wanted, cycles=100)
    for alone, held in zip(rows[::2], rows[1::2], strict=True):
        assert held["falls"] <= alone["falls"]
        assert held["turn_rad"] < 0.5 * alone["turn_rad"]
        # cycles that fall do not count, and a robot that is struck and stays up is carried along
        assert held["place_m"] < alone["place_m"] or alone["falls"] > 10
    assert rows[1]["falls"] == 0 and rows[4]["falls"] > 0  # struck hard enough to tell


def test_drift_is_what_cycles_are_off_from_the_expected_ones():
    motion = np.array([[1.0, 0.0, 0.1], [1.0, 0.4, 0.1], [0.0, 0.0, 3.2], [5.0, 5.0, 5.0]])
    counted = np.array([True, True, True, False])
    found = PerturbedWalk(np.array([0, 0, 1, 1]), ~counted, counted, motion)
    np.testing.assert_allclose(found.means(2), [[1.0, 0.2, 0.1], [0.0, 0.0, 3.2]])
    expected = np.array([[1.0, 0.1, 0.0], [0.0, 0.0, -3.2]])
    place, turn = found.drift(expected)
    assert place == pytest.approx(np.sqrt((0.1**2 + 0.3**2 + 0) / 3))
    assert turn == pytest.approx(np.sqrt((0.1**2 * 2 + (6.4 - 2 * np.pi) ** 2) / 3))


def test_a_measurement_has_a_row_for_each_condition_and_feedback(fish_dynamics, fish_gait):
    solvers = [NONE, registry.get_solver("ilqg", "feedback")]
    wanted = conditions(0.3, WATER)[:2]
    rows = measure_robustness(fish_dynamics, fish_gait, solvers, wanted, cycles=8)
    names = [(row["condition"], row["feedback"]) for row in rows]
    assert names == [(c.name, s.name) for c in wanted for s in solvers]
    assert all(row["cycles"] == 8 and row["falls"] == 0 for row in rows)
    assert all(row["interval"][0] == 0.0 and 0.2 < row["interval"][1] < 0.4 for row in rows)
    # what iLQG is for: pushed or not, the course is kept
    assert rows[1]["turn_rad"] < 0.5 * rows[0]["turn_rad"]
    assert rows[3]["turn_rad"] < 0.5 * rows[2]["turn_rad"]
    assert rows[0]["way_m"] == pytest.approx(rows[1]["way_m"], rel=0.2)
    direct = perturbed_walk(fish_dynamics, fish_gait, NONE, wanted[1], cycles=8)
    place, turn = direct.drift(
        perturbed_walk(fish_dynamics, fish_gait, NONE, CALM, cycles=8).means(3)
    )
    assert (rows[2]["place_m"], rows[2]["turn_rad"]) == (place, turn)
