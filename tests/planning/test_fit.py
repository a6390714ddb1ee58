"""The surrogate's fit against rigid fits of all vertices, and what it refuses."""

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from defplan_mj.base.errors import DefplanError
from defplan_mj.base.rotations import kabsch
from defplan_mj.body.rotation_strain import deformation
from defplan_mj.dynamics.reduced import ReducedDynamics
from defplan_mj.dynamics.rigid import RigidDynamics
from defplan_mj.gait.gait import Gait
from defplan_mj.planning.fit import Cycles, fit_surrogate, fit_switched, pair_moments
from defplan_mj.planning.past import past_of
from defplan_mj.planning.surrogate import Surrogate


@pytest.fixture(scope="module")
def dynamics(small_fish):
    return ReducedDynamics(small_fish, 0.04)


@pytest.fixture(scope="module")
def gait(small_fish):
    """Return three undulations, by hand: the tail beats, straight or bent to a side."""
    r = small_fish.n_modes
    alpha, beta = np.zeros((3, 5, r)), np.zeros((3, 5, r))
    mu = np.tile(2 * np.pi * np.arange(5)[:, None] / 5, (1, r))
    alpha[:, 0, 0], alpha[:, 2, 0] = 0.7, -0.7
    alpha[1, 4, 0], alpha[2, 4, 0] = 0.4, -0.4
    beta[:, :4, 0] = 1.0
    names = ("forward", "left", "right")
    return Gait(small_fish.hash, names, 0.04, 11, alpha, beta, mu, small_fish.amplitude)


def vertices(body, x):
    """Return the world positions of all vertices in a state."""
    q = x[7 : 7 + body.n_modes]
    z = body.feature_weights @ deformation(body.feature_map, q[None]).ravel()
    local = body.vertices + body.basis @ z
    return x[:3] + Rotation.from_quat(x[3:7], scalar_first=True).apply(local)


def states(dynamics, gait, cycles=6):
    shapes = gait.table()[np.arange(cycles) % 3].reshape(-1, dynamics.nu)
    return dynamics.rollout(dynamics.rest_state(), shapes)[:: gait.steps_per_cycle]


def test_each_pairs_rotation_is_the_mass_weighted_fit_of_all_vertices(small_fish, dynamics, gait):
    x = states(dynamics, gait)
    covariance, translation = pair_moments(small_fish, x[:-1], x[1:])
    rotations = kabsch(covariance)
    for i in range(len(rotations)):
        frame = Rotation.from_quat(x[i, 3:7], scalar_first=True).inv()
        before, after = (frame.apply(vertices(small_fish, x[j]) - x[i, :3]) for j in (i, i + 1))
        mass = small_fish.vertex_mass[:, None]
        centre = (mass * after).sum(0) / mass.sum()
        expected, _ = Rotation.align_vectors(after - centre, before, small_fish.vertex_mass)
        assert np.allclose(rotations[i], expected.as_matrix(), atol=1e-6)
        assert np.allclose(translation[i], centre, atol=1e-6)


def test_the_common_rotation_is_the_fit_of_all_pairs_at_once(small_fish, dynamics, gait):
    x = states(dynamics, gait)
    covariance, _ = pair_moments(small_fish, x[:-1], x[1:])
    before, after, mass = [], [], []
    for i in range(len(x) - 1):
        frame = Rotation.from_quat(x[i, 3:7], scalar_first=True).inv()
        before.append(frame.apply(vertices(small_fish, x[i]) - x[i, :3]))
        after.append(frame.apply(vertices(small_fish, x[i + 1]) - x[i + 1, :3]))
        mass.append(small_fish.vertex_mass)
    expected, _ = Rotation.align_vectors(
        np.concatenate(after), np.concatenate(before), np.concatenate(mass)
    )
    assert np.allclose(kabsch(covariance.sum(0)), expected.as_matrix(), atol=1e-6)


def test_a_reflected_covariance_still_gives_a_rotation():
    rotation = kabsch(np.diag([3.0, 2.0, -1.0]))
    assert np.allclose(rotation, np.eye(3)) and np.isclose(np.linalg.det(rotation), 1)


def test_the_surrogate_holds_every_tasks_motion_and_is_the_same_in_a_rerun(
    dynamics, gait, tmp_path
):
    first, again = (fit_surrogate(dynamics, gait, pairs=12, seed=5) for _ in range(2))
    other = fit_surrogate(dynamics, gait, pairs=12, seed=6)
    assert first.task_names == gait.task_names and first.pairs == 12
    assert first.gait_hash == gait.hash and first.body_hash == dynamics.body.hash
    assert np.array_equal(first.rotations, again.rotations)
    assert np.array_equal(first.translations, again.translations)
    assert not np.array_equal(first.translations, other.translations)
    turn = first.motions("planar").rotations
    _, left, right = np.arctan2(turn[:, 1, 0], turn[:, 0, 0])
    assert left * right < 0 and abs(left) > 0.05  # the bends turn to opposite sides
    assert 0.4 < first.radius < 0.9  # the fish is 1 m long
    first.save(tmp_path / "surrogate.npz")
    loaded = Surrogate.load(tmp_path / "surrogate.npz")
    assert np.array_equal(loaded.rotations, first.rotations) and loaded.radius == first.radius


def test_a_motion_for_each_gait_before_is_nearer_to_switching_that_was_held_out(dynamics, gait):
    surrogate = fit_surrogate(dynamics, gait, pairs=60, seed=0)
    assert surrogate.switching is not None
    held_out = surrogate.switching.held_out
    assert held_out["cycles"] == 36  # every fifth of twenty chains
    assert held_out["place_m"] < 0.9 * held_out["plain_place_m"]
    assert held_out["turn_rad"] < 0.9 * held_out["plain_turn_rad"]
    assert surrogate.plain.switching is None


def test_the_first_cycle_from_rest_is_the_one_that_the_dynamics_does(small_fish, dynamics, gait):
    surrogate = fit_surrogate(dynamics, gait, pairs=12, seed=0)
    rigid = RigidDynamics(surrogate)
    for j, shapes in enumerate(gait.table()):
        truth = dynamics.rollout(dynamics.rest_state(), shapes)[-1]
        assert np.allclose(rigid.step(dynamics.rest_state(), j)[:3], truth[:3], atol=1e-9)


def test_a_file_keeps_the_motions_by_the_gait_before(dynamics, gait, tmp_path):
    surrogate = fit_surrogate(dynamics, gait, pairs=12, seed=0)
    surrogate.save(tmp_path / "surrogate.npz")
    surrogate.plain.save(tmp_path / "plain.npz")
    loaded, plain = (Surrogate.load(tmp_path / f"{n}.npz") for n in ("surrogate", "plain"))
    assert loaded.switching is not None and surrogate.switching is not None
    for name in ("rotations", "translations", "rotation_sd", "translation_sd"):
        wanted = getattr(surrogate.switching, name)
        assert np.array_equal(getattr(loaded.switching, name), wanted)
    assert loaded.switching.held_out == surrogate.switching.held_out and plain.switching is None


def test_a_pair_of_gaits_that_never_occurred_has_its_gait_s_plain_motion():
    turn = np.eye(3)[None] * [1.0, 1.0, 1.0]
    before, task = np.array([0, 1, 0, 0]), np.array([0, 0, 1, 1])
    ways = np.array([[1.0, 0, 0], [2.0, 0, 0], [3.0, 0, 0], [5.0, 0, 0]])
    cycles = Cycles(np.arange(4), before, task, turn.repeat(4, 0), ways)
    none = cycles.some(np.zeros(4, bool))
    switched = fit_switched(cycles, none, past_of(2))
    expected = np.array([[1, 4], [2, 4], [1.5, 4]])
    assert np.allclose(switched.translations[:, :, 0], expected)


def test_table_iii_is_the_spread_of_the_single_pairs(small_fish, dynamics, gait):
    surrogate = fit_surrogate(dynamics, gait, pairs=40, seed=0)
    # The common translation is the mean vector, so not longer than the mean length.
    lengths = np.linalg.norm(surrogate.translations, axis=1)
    assert np.all(lengths <= surrogate.translation_mean + 1e-12)
    assert np.all(surrogate.translation_sd > 0)
    assert np.all(surrogate.rotation_sd < 0.5)


@pytest.mark.parametrize(
    ("change", "pairs", "said"),
    [
        ({}, 0, "at least 1 pair"),
        ({"body_hash": "0" * 64}, 10, "another body"),
        ({"timestep": 0.02}, 10, "time step 0.02 s"),
    ],
)
def test_a_gait_that_does_not_fit_is_refused(dynamics, gait, change, pairs, said):
    with pytest.raises(DefplanError, match=said):
        fit_surrogate(dynamics, dataclasses.replace(gait, **change), pairs)
