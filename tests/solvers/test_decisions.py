"""Planners that choose the gait more than once a cycle."""

from dataclasses import replace

import numpy as np
import pytest

from defplan_mj.base.errors import DefplanError
from defplan_mj.base.progress import no_progress
from defplan_mj.dynamics.rigid import RigidDynamics
from defplan_mj.planning.outcome import SUCCESS
from defplan_mj.planning.shield import Shield
from defplan_mj.planning.surrogate_env import SurrogateEnv, run_all
from defplan_mj.planning.tracking import Balls
from defplan_mj.task import Navigation
from defplan_solvers.dql import paper
from defplan_solvers.dql.dql import SOLVER, DqlPlanner
from defplan_solvers.dql.training import Recipe, train
from defplan_solvers.search import astar, astar_map, foresight, greedy, oracle, rrt
from defplan_solvers.search.manoeuvres import Manoeuvres
from defplan_solvers.search.outlook import Outlook
from defplan_solvers.search.space_time import SpaceTime
from tests.samples import planning as samples
from tests.solvers.test_oracle import gaps

TWICE = Navigation(decisions_per_cycle=2)
HALVES = samples.in_parts(samples.surrogate(scatter=0.01), 2)


def places(surrogate, plan, before):
    """Return the places (n + 1, 2) of a way."""
    dynamics, x = RigidDynamics(surrogate), RigidDynamics(surrogate).rest_state()
    found = [x[:2]]
    for gait in plan:
        x = dynamics.step(x, int(gait), before)
        before = surrogate.past.then[before, gait]
        found.append(x[:2])
    return np.array(found)


@pytest.mark.parametrize("decisions", [2, 4])
@pytest.mark.parametrize("seed", range(3))
def test_a_way_of_parts_keeps_clear_of_what_moves_and_ends_at_the_target(decisions, seed):
    generator = np.random.default_rng(seed)
    surrogate = samples.in_parts(samples.surrogate(), decisions)
    centres = generator.uniform([3, -6], [14, 6], (10, 2))
    drift = generator.uniform(-0.5, 0.5, (10, 2)) / decisions
    balls = Balls(centres, generator.uniform(0.3, 1.0, 10), drift)
    search = SpaceTime(surrogate, Navigation(decisions_per_cycle=decisions))
    before, target = surrogate.past.kept(1)[seed], np.array([15.0, 1.0])  # a cycle was begun
    plan, arrives = search.way(balls, target, before, 0.2)
    way = places(surrogate, plan, before)
    assert arrives and np.linalg.norm(way[-1] - target) <= 1.0
    assert gaps(way, balls).min() >= surrogate.radius + 0.2 - 1e-3
    later = plan[decisions - 1 :]  # after the first cycle's end, gaits are kept for whole ones
    assert np.all(np.diff(later[: len(later) // decisions * decisions].reshape(-1, decisions)) == 0)


def test_manoeuvres_end_where_their_parts_lead_and_their_cycle_ends():
    for whole, space in ((samples.surrogate(), "planar"), (samples.swimmer(), "spatial")):
        surrogate = samples.in_parts(whole, 2)
        past, motions = surrogate.past, surrogate.switched_motions(space)
        heading = Outlook(surrogate.cycle_motions(space), 1.0).axes[0]
        steps = Manoeuvres(motions, heading, past.kept(1)[0], past)
        assert np.all(past.phase[steps.final] == 0)
        assert np.allclose(steps.cycles % 1, 0.5) and steps.cycles.min() == 0.5
        index = int(np.flatnonzero(steps.cycles == 0.5)[-1])
        ways, turns = motions.translations, motions.rotations
        assert np.allclose(
            steps.motions.translations[index], ways[past.kept(1)[0], steps.first[index]]
        )
        assert np.allclose(
            steps.motions.rotations[index], turns[past.kept(1)[0], steps.first[index]]
        )


def test_the_outlook_takes_the_swing_of_a_cycle_out():
    for decisions in (2, 4):
        surrogate = samples.in_parts(samples.surrogate(), decisions)
        outlook = Outlook(surrogate.cycle_motions("planar"), 1.0)
        whole = Outlook(samples.surrogate().motions("planar"), 1.0)
        assert np.isclose(outlook.advance, whole.advance)
        assert np.isclose(outlook.per_radian, whole.per_radian)
        for phase in range(decisions):
            ahead = 10 * outlook.axes_at[phase, 0]
            assert np.isclose(
                outlook.cycles(ahead, phase), whole.cycles(np.array([10.0, 0])), atol=0.1
            )


@pytest.mark.parametrize("decisions", [2, 4])
@pytest.mark.parametrize("make", [astar.AstarPlanner, foresight.ForesightPlanner, greedy.GreedyPlanner,
                                  oracle.OraclePlanner, astar_map.AstarMapPlanner])  # fmt: skip
def test_planners_arrive(make, decisions):
    navigation = Navigation(decisions_per_cycle=decisions)
    surrogate = samples.in_parts(samples.surrogate(scatter=0.01), decisions)
    scene = samples.scene([(5.0, 0.4, 0.8)], target=(10.0, 2.0))
    env = SurrogateEnv(
        surrogate, navigation, samples.batch(scene), None, np.random.default_rng(0), 1.0
    )
    planner = Shield(make(surrogate, navigation), surrogate, navigation)
    planner.reset()

    def act(sight, _):
        offset = (env.centres[0] - env.position[0]) @ env.frames[0]
        told = np.hstack([offset, env.radii[0][:, None], np.zeros((1, 2))])
        seen = {"laser": sight.laser[0], "target": sight.target[0].astype(float), "obstacles": told}
        return np.array([planner.values(seen).argmax()])

    runs = run_all(env, act)
    assert runs.rate(SUCCESS) == 1 and runs.cycles[0] < 30 * decisions


def test_planners_that_decide_once_a_cycle_say_so(tmp_path):
    for refuse in (
        lambda: rrt.RrtPlanner(HALVES, TWICE),
        lambda: paper.SOLVER.train(HALVES, TWICE, 0),
        lambda: paper.SOLVER.load(tmp_path / "none.npz", HALVES, TWICE),
    ):
        with pytest.raises(DefplanError, match="decides once a gait cycle"):
            refuse()


def test_dql_trains_on_parts_and_its_file_is_of_as_many(tmp_path):
    recipe = Recipe(transitions=1200, scenes=50, checkpoints=1, targets=4, standing=4, moving=4)
    network, curves, meta = train(HALVES, TWICE, 0, recipe, float("inf"), no_progress)
    planner = DqlPlanner(network, HALVES, TWICE, meta)
    assert len(curves["k2_success"]) == 2
    SOLVER.save(planner, tmp_path / "policy.npz")
    again = SOLVER.load(tmp_path / "policy.npz", HALVES, TWICE)
    seen = {"laser": np.full(64, 10.0), "target": np.array([9.0, 1.0, 0.0])}
    for one in (planner, again):
        one.reset()
    for _ in range(3):
        assert np.array_equal(planner.values(seen), again.values(seen))
    once = replace(HALVES, switching=None, decisions_per_cycle=1)
    with pytest.raises(DefplanError, match="train the planner anew"):
        SOLVER.load(tmp_path / "policy.npz", once, Navigation())
