"""More decisions than one a cycle: pasts, parts of cycles, and that one a cycle is what it was."""

import dataclasses
import itertools

import numpy as np
import pytest

from defplan_mj.base.errors import DefplanError
from defplan_mj.base.rotations import angle
from defplan_mj.dynamics import tangent
from defplan_mj.dynamics.rigid import RigidDynamics
from defplan_mj.planning.fit import fit_surrogate
from defplan_mj.planning.motion_tree import MotionTree, lookahead, motion_trees
from defplan_mj.planning.observation import Senses
from defplan_mj.planning.odometry import Odometry
from defplan_mj.planning.outcome import TIMEOUT
from defplan_mj.planning.past import MOST_PASTS, past_of
from defplan_mj.planning.scene import SceneBatch
from defplan_mj.planning.shield import Shield
from defplan_mj.planning.surrogate import Surrogate
from defplan_mj.planning.surrogate_env import SurrogateEnv
from defplan_mj.planning.tracking import Tracker
from defplan_mj.task import Navigation
from defplan_solvers.search.greedy import GreedyPlanner
from defplan_tasks.fish import SWIM
from tests.samples import host
from tests.samples import planning as samples

TWICE = Navigation(decisions_per_cycle=2)
MANY = [(3, 1), (3, 2), (3, 4), (5, 2), (5, 4), (4, 2), (3, 8), (1, 2)]


@pytest.mark.parametrize("gaits", [1, 3, 5])
def test_with_one_decision_a_cycle_the_past_is_the_gait_before(gaits):
    past = past_of(gaits)
    assert past.rest == gaits and np.array_equal(past.segment, np.arange(gaits + 1))
    assert np.array_equal(past.then, np.tile(np.arange(gaits), (gaits + 1, 1)))
    assert not past.phase.any()


@pytest.mark.parametrize(("gaits", "decisions"), MANY)
def test_a_past_is_the_phase_and_the_last_gaits(gaits, decisions):
    past, generator = past_of(gaits, decisions), np.random.default_rng(0)
    assert past.rest < MOST_PASTS and 1 <= past.memory <= decisions
    seen: dict[int, tuple] = {}
    for _ in range(30):
        now = past.rest
        played: list[int] = []
        for i in range(6 * decisions):
            assert past.phase[now] == i % decisions
            last = played[-1] + gaits * ((i - 1) % decisions) if played else gaits * decisions
            assert past.segment[now] == last
            told = (i % decisions, *played[-past.memory :])
            assert seen.setdefault(now, told) == told
            recent = np.array([([0] * past.memory + played)[-past.memory :]])
            assert past.row(np.array([i % decisions]), recent, np.array([i]))[0] == now
            played.append(int(generator.integers(gaits)))
            now = past.then[now, played[-1]]
    assert len(set(seen.values())) == len(seen)
    now = past.rest
    for _ in range(2 * decisions):
        now = past.then[now, gaits - 1]
    assert past.kept(0)[gaits - 1] == now


def test_a_cycle_without_so_many_equal_parts_is_refused():
    with pytest.raises(DefplanError, match="11 steps has no 2 equal parts"):
        fit_surrogate(host.dynamics(), host.gait(), 4, decisions=2)
    dataclasses.replace(SWIM, navigation=Navigation(decisions_per_cycle=4))
    for wrong in (3, 0, 64):
        with pytest.raises(DefplanError, match="equal parts: set navigation.decisions_per_cycle"):
            dataclasses.replace(SWIM, navigation=Navigation(decisions_per_cycle=wrong))


@pytest.fixture(scope="module")
def parts(fish_dynamics, fish_gait) -> dict[int, Surrogate]:
    """Return surrogates of the packaged fish's gaits by decisions a cycle."""
    return {m: fit_surrogate(fish_dynamics, fish_gait, 60, decisions=m) for m in (1, 2)}


def test_table_3_is_the_same_however_often_a_cycle_is_decided(parts):
    one, two = parts[1], parts[2]
    for name in ("rotations", "translations", "rotation_sd", "translation_mean"):
        assert np.array_equal(getattr(one, name), getattr(two, name))
    assert two.plain.decisions_per_cycle == 1 and two.plain.rest == 3
    assert two.decision_seconds == one.cycle_seconds / 2


def test_parts_of_cycles_predict_chains_that_were_not_fitted(parts):
    told = parts[2].switching.held_out
    assert told["cycles"] == 3 * 2 * 60 // 5
    assert told["place_m"] < 0.5 * told["plain_place_m"]
    assert told["turn_rad"] < 0.5 * told["plain_turn_rad"]


def test_the_parts_of_a_cycle_make_that_cycle(parts, fish_dynamics, fish_gait):
    """From rest exactly, as all gaits of a cycle are told apart; later within what single cycles scatter."""
    one, two = (RigidDynamics(parts[m]) for m in (1, 2))
    scatter = zip(parts[1].scatter(), parts[2].scatter(), strict=True)
    turn, way = (4 * np.sqrt(a.max() ** 2 + 2 * b.max() ** 2) for a, b in scatter)
    start, table = fish_dynamics.rest_state(), fish_gait.table()
    for gaits in itertools.product(range(3), repeat=2):
        halves = two.rollout(start, np.array(gaits))
        mixed = np.concatenate([table[gaits[0], :16], table[gaits[1], 16:]])
        end = fish_dynamics.rollout(start, mixed)[-1]
        off = tangent.difference(np.append(halves[2], 0), np.append(end[:7], 0))
        assert np.allclose(off, 0, atol=1e-6)
    ends = parts[2].cycle_motions("spatial").of(0)
    kept = one.surrogate.switched_motions("spatial").of((np.arange(3), np.arange(3)))
    assert np.all(np.linalg.norm(ends.translations - kept.translations, axis=1) < way)
    assert np.all(angle(np.swapaxes(kept.rotations, 1, 2) @ ends.rotations) < np.sqrt(3) * turn)


def test_a_surrogate_of_parts_survives_its_file_and_that_of_cycles_does_not_tell_of_parts(
    parts, tmp_path
):
    parts[2].save(tmp_path / "two.npz")
    again = Surrogate.load(tmp_path / "two.npz")
    assert again.switching is not None and parts[2].switching is not None
    assert again.decisions_per_cycle == 2 and again.rest == parts[2].rest
    assert np.array_equal(again.switching.translations, parts[2].switching.translations)
    parts[1].save(tmp_path / "one.npz")
    assert b"decisions" not in (tmp_path / "one.npz").read_bytes()
    broken = dataclasses.replace(parts[2], decisions_per_cycle=4)
    broken.save(tmp_path / "four.npz")
    with pytest.raises(DefplanError, match="must be finite numbers of shape"):
        Surrogate.load(tmp_path / "four.npz")


def test_a_surrogate_of_another_number_of_decisions_is_refused():
    surrogate = samples.surrogate()
    batch = SceneBatch.of([samples.scene()])
    for make in (
        lambda: SurrogateEnv(surrogate, TWICE, batch),
        lambda: Odometry(surrogate, TWICE),
        lambda: Tracker(samples.in_parts(surrogate, 2), Navigation()),
    ):
        with pytest.raises(DefplanError, match="fit the surrogate for this task"):
            make()


@pytest.mark.parametrize("decisions", [2, 4])
def test_cycles_kept_whole_move_the_robots_as_one_decision_a_cycle_does(decisions):
    whole = samples.surrogate()
    scenes = SceneBatch.of([samples.scene(target=(50.0, 0), velocities=None) for _ in range(5)])
    once = SurrogateEnv(whole, Navigation(), scenes)
    often = SurrogateEnv(
        samples.in_parts(whole, decisions), Navigation(decisions_per_cycle=decisions), scenes
    )
    gaits = np.random.default_rng(0).integers(0, 3, (12, 5))
    heading = None
    for chosen in gaits:
        once.step(chosen)
        for _ in range(decisions):
            often.step(chosen)
        swing = np.swapaxes(once.frames, 1, 2) @ often.frames  # the same at the end of every cycle
        heading = swing if heading is None else heading
        assert np.allclose(swing, heading, atol=1e-4)
    away, here = (np.linalg.norm(env.position, axis=1) for env in (once, often))
    assert np.allclose(away, here, atol=1e-3)


def test_time_outs_come_after_so_many_cycles():
    scenes = SceneBatch.of([samples.scene(target=(500.0, 0), max_cycles=3)])
    env = SurrogateEnv(samples.in_parts(samples.surrogate(), 2), TWICE, scenes)
    ended = [env.step(np.zeros(1, int)).outcome[0] == TIMEOUT for _ in range(6)]
    assert ended == [False] * 5 + [True]


def test_a_tree_of_pasts_ends_where_the_rigid_dynamics_does():
    surrogate = samples.in_parts(samples.surrogate(), 2)
    past, dynamics = surrogate.past, RigidDynamics(surrogate)
    before = past.then[past.rest, 1]  # half of a left turn was played
    tree = MotionTree(surrogate.switched_motions("planar"), (1, 2), before, past)
    for branch in range(9):
        x, now = dynamics.rest_state(), before
        for gait in (branch // 3, branch % 3, branch % 3):
            x = dynamics.step(x, gait, now)
            now = past.then[now, gait]
        assert np.allclose(tree.end[3 + 9 + branch], x[:2], atol=1e-6)
    assert not tree.in_place.any()


def test_what_can_follow_a_choice_can_still_follow_it_a_decision_later():
    surrogate = samples.in_parts(samples.surrogate(), 4)
    trees = motion_trees(surrogate.switched_motions("planar"), (1, 1), surrogate.past)
    for phase in range(4):
        past = surrogate.past.kept(phase)[0]
        assert trees[past].holds == (4 - phase, 4)
    alike = motion_trees(surrogate.switched_motions("planar"), lookahead(3), surrogate.past, False)
    assert {tree.holds for tree in alike} == {(4, 4, 8, 12)}


def test_the_shield_lets_no_part_of_a_cycle_into_a_wall():
    surrogate = samples.in_parts(samples.surrogate(), 2)
    shield = Shield(GreedyPlanner(surrogate, TWICE), surrogate, TWICE)
    y = np.arange(-8, 8, 0.1)
    for before in (surrogate.rest, *surrogate.past.kept(1)):
        near = np.column_stack([np.full(len(y), 1.2), y])  # no room to go on straight for a cycle
        assert not shield.safe(near, before=before)[0]
        far = near + [30, 0]
        assert shield.safe(far, before=before).all()


def test_features_tell_the_gait_before_and_its_part_of_the_cycle():
    surrogate = samples.in_parts(samples.surrogate(), 2)
    senses, past = Senses(surrogate, TWICE), surrogate.past
    laser, target = np.full(64, 10.0), np.array([5.0, 1.0])
    plain = Senses(samples.surrogate(), Navigation())
    assert senses.size == plain.size + 3
    told = {senses(laser, target, before).tobytes() for before in range(past.rest + 1)}
    assert len(told) == len(np.unique(past.segment)) == 7
