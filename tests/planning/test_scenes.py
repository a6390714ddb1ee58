"""Scenes: what the generators promise, and the batch form."""

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from defplan_mj.base.errors import DefplanError
from defplan_mj.base.rotations import quaternion_heading
from defplan_mj.planning.places import POST
from defplan_mj.planning.scene import SceneBatch
from defplan_mj.planning.scenes import (
    k2_scenes,
    novel_scenes,
    training_scenes,
    validation_scenes,
    validation_targets,
)
from defplan_mj.task import Navigation

NAVIGATION = Navigation()
SPATIAL = Navigation(space="spatial", beams=128, k2=30)
BOTH = pytest.mark.parametrize("navigation", [NAVIGATION, SPATIAL], ids=["planar", "spatial"])


def same(first, second) -> bool:
    fields = [field.name for field in dataclasses.fields(first)]
    return all(np.array_equal(getattr(first, f), getattr(second, f)) for f in fields if f != "meta")


def test_k2_targets_are_evenly_spread_with_two_obstacles_on_the_straight_way():
    scenes = k2_scenes(NAVIGATION, seed=3)
    bearing = np.array([np.arctan2(s.target[1], s.target[0]) for s in scenes])
    assert np.allclose(np.mod(bearing, 2 * np.pi), 2 * np.pi * np.arange(10) / 10)
    for scene in scenes:
        assert np.isclose(np.linalg.norm(scene.target), 20)
        assert np.array_equal(scene.orientation, [1, 0, 0, 0])
        assert len(scene.radii) == 2
        along = scene.target[:2] / 20
        assert np.all(scene.centres[:, :2] @ along < 20)
        assert np.all(np.abs(scene.centres[:, :2] @ [-along[1], along[0]]) <= 1.5)


def test_k2_targets_in_space_are_a_poisson_disk_sample_of_the_seed():
    scenes = k2_scenes(SPATIAL, seed=3)
    assert len(scenes) == 30
    directions = np.array([scene.target / 20 for scene in scenes])
    assert np.allclose(np.linalg.norm(directions, axis=1), 1)
    apart = np.arccos((directions @ directions.T - 2 * np.eye(30)).max())
    assert apart > 0.5 * np.sqrt(8 * np.pi / (np.sqrt(3) * 30))  # half of a hexagonal packing's
    for scene, along in zip(scenes, directions, strict=True):
        assert np.array_equal(scene.orientation, [1, 0, 0, 0])
        assert scene.shape == "sphere" and len(scene.radii) == 2
        forward = scene.centres @ along
        beside = np.linalg.norm(scene.centres - forward[:, None] * along, axis=1)
        assert np.all(forward < 20) and np.all(beside <= 1.5)
    crowded = k2_scenes(SPATIAL, seed=3, obstacles=9)
    assert np.array_equal([scene.target for scene in crowded], [scene.target for scene in scenes])
    other = k2_scenes(SPATIAL, seed=4)
    assert not np.allclose(other[0].target, scenes[0].target)


def test_where_a_task_navigates_in_tunnels_all_its_scenes_are_tunnels_and_no_two_kinds_share_one():
    tunnel = Navigation(scenes="tunnel", room=0.6)
    kinds = [
        SceneBatch.of(k2_scenes(tunnel, 0)),
        SceneBatch.of(novel_scenes(tunnel, 4, 0)),
        training_scenes(tunnel, 4, 0),
        validation_scenes(tunnel, 4, 0),
        validation_targets(tunnel, 4, 0),
    ]
    for batch in kinds:
        real = batch.radii > 0
        assert np.all(batch.radii[real] == POST) and np.all(real.sum(1) > 30)
        assert not batch.velocities.any()
        heading = quaternion_heading(batch.orientations)
        bearing = np.arctan2(batch.targets[:, 1], batch.targets[:, 0])
        assert np.allclose(np.cos(heading - bearing), 1)  # along the tunnel
        clear = np.linalg.norm(batch.centres, axis=2) - batch.radii
        assert clear.min() > 0.6
    ways = [tuple(np.round(np.linalg.norm(b.centres[0], axis=1)[:9], 6)) for b in kinds]
    assert len(set(ways)) == len(ways)
    for told in ({"obstacles": 3}, {"obstacle_speed": 1.0}):
        with pytest.raises(DefplanError, match="obstacles of their own"):
            novel_scenes(tunnel, 1, 0, **told)
    with pytest.raises(DefplanError, match="no scenes 'swamp'"):
        Navigation(scenes="swamp")
    with pytest.raises(DefplanError, match="navigates in space"):
        Navigation(scenes="maze", space="spatial")


def test_obstacles_in_space_lie_all_around_the_way():
    batch = SceneBatch.of(novel_scenes(SPATIAL, 400, 0))
    along = batch.targets / 20
    beside = (
        batch.centres - np.einsum("nmd,nd->nm", batch.centres, along)[..., None] * along[:, None]
    )
    assert np.linalg.norm(beside, axis=2).max() <= 4
    # Seen along the way, in two directions across it, no side is preferred.
    first = np.cross(along, np.roll(along, 1, 1))
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    sides = [np.einsum("nmd,nd->nm", beside, a).ravel() for a in (first, np.cross(along, first))]
    assert np.abs(np.mean(sides, axis=1)).max() < 0.1
    assert np.isclose(np.std(sides[0]), np.std(sides[1]), rtol=0.05)


def test_start_attitudes_of_novel_scenes_in_space_are_any():
    batch = SceneBatch.of(novel_scenes(SPATIAL, 2000, 0))
    up = Rotation.from_quat(batch.orientations, scalar_first=True).apply([0, 0, 1])
    assert np.abs(up.mean(0)).max() < 0.07 and np.allclose(
        up.T @ up / 2000, np.eye(3) / 3, atol=0.03
    )


def test_cylinders_and_spheres_do_not_share_a_batch():
    with pytest.raises(DefplanError, match="not both"):
        SceneBatch.of([*novel_scenes(NAVIGATION, 1, 0), *novel_scenes(SPATIAL, 1, 0)])


@BOTH
@pytest.mark.parametrize("seed", range(5))
def test_novel_scenes_hold_all_obstacles_and_leave_start_and_target_clear(navigation, seed):
    for scene in novel_scenes(navigation, 50, seed):
        assert len(scene.radii) == 10
        assert np.all((scene.radii >= 0.5) & (scene.radii <= 2))
        assert np.all(np.linalg.norm(scene.centres, axis=1) >= scene.radii + 3)
        assert np.all(np.linalg.norm(scene.centres - scene.target, axis=1) >= scene.radii + 2)
        assert not scene.velocities.any()


@BOTH
def test_obstacles_move_at_the_given_speed_in_different_directions(navigation):
    scene = novel_scenes(navigation, 1, 0, obstacles=6, obstacle_speed=0.7)[0]
    assert np.allclose(np.linalg.norm(scene.velocities, axis=1), 0.7)
    assert len(np.unique(scene.velocities.round(6), axis=0)) == 6


def test_the_same_seed_gives_the_same_scenes_and_another_seed_others():
    first, again, other = (novel_scenes(NAVIGATION, 3, seed) for seed in (1, 1, 2))
    assert all(same(a, b) for a, b in zip(first, again, strict=True))
    assert not same(first[0], other[0])


def test_held_out_scenes_are_none_of_the_novel_ones():
    novel = SceneBatch.of(novel_scenes(NAVIGATION, 50, 0))
    held_out = validation_scenes(NAVIGATION, 50, 0)
    assert not np.isin(held_out.targets[:, 0], novel.targets[:, 0]).any()


def test_more_k2_episodes_go_round_the_targets_with_new_obstacles():
    scenes = k2_scenes(NAVIGATION, 0, episodes=12)
    assert np.allclose(scenes[10].target, scenes[0].target)
    assert not np.array_equal(scenes[10].centres, scenes[0].centres)


@BOTH
def test_training_scenes_vary_in_distance_attitude_and_number_of_obstacles(navigation):
    batch = training_scenes(navigation, 2000, 0)
    distance = np.linalg.norm(batch.targets, axis=1)
    counts = (batch.radii > 0).sum(1)
    assert 6 <= distance.min() < 7 and 21 < distance.max() <= 22
    assert counts.min() == 0 and counts.max() == 10
    turn = 2 * np.arccos(np.abs(batch.orientations[:, 0]))
    assert turn.min() < 0.3 and turn.max() > 3


@BOTH
def test_a_batch_gives_back_its_scenes(navigation):
    scenes = [novel_scenes(navigation, 1, i, obstacles=i, obstacle_speed=i)[0] for i in range(4)]
    batch = SceneBatch.join([SceneBatch.of(scenes[:2]), SceneBatch.of(scenes[2:])])
    assert all(same(a, b) for a, b in zip(batch.scenes(), scenes, strict=True))


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: novel_scenes(NAVIGATION, 0, 0), "at least 1 episode"),
        (lambda: novel_scenes(NAVIGATION, 1, 0, obstacles=-1), "must be 0 or more, not -1"),
        (lambda: k2_scenes(NAVIGATION, 0, obstacle_speed=-1.0), "0 m/s or more"),
        (lambda: k2_scenes(NAVIGATION, 0, obstacle_speed=float("nan")), "0 m/s or more"),
    ],
)
def test_impossible_scenes_are_refused_in_one_sentence(make, said):
    with pytest.raises(DefplanError, match=said):
        make()
