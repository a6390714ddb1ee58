"""Scenes: what the generators promise, and the batch form."""

import dataclasses

import numpy as np
import pytest

from defplan_mj.errors import DefplanError
from defplan_mj.planning.scenes import (
    SceneBatch,
    k2_scenes,
    novel_scenes,
    training_scenes,
    validation_scenes,
)
from defplan_mj.task import Navigation

NAVIGATION = Navigation()


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


@pytest.mark.parametrize("seed", range(5))
def test_novel_scenes_hold_all_obstacles_and_leave_start_and_target_clear(seed):
    for scene in novel_scenes(NAVIGATION, 50, seed):
        assert len(scene.radii) == 10
        assert np.all((scene.radii >= 0.5) & (scene.radii <= 2))
        assert np.all(np.linalg.norm(scene.centres, axis=1) >= scene.radii + 3)
        assert np.all(np.linalg.norm(scene.centres - scene.target, axis=1) >= scene.radii + 2)
        assert not scene.velocities.any()


def test_obstacles_move_at_the_given_speed_in_different_directions():
    scene = novel_scenes(NAVIGATION, 1, 0, obstacles=6, obstacle_speed=0.7)[0]
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


def test_training_scenes_vary_in_distance_heading_and_number_of_obstacles():
    batch = training_scenes(NAVIGATION, 2000, 0)
    distance = np.linalg.norm(batch.targets, axis=1)
    counts = (batch.radii > 0).sum(1)
    assert 6 <= distance.min() < 7 and 21 < distance.max() <= 22
    assert counts.min() == 0 and counts.max() == 10
    assert batch.yaw.min() < -3 and batch.yaw.max() > 3


def test_a_batch_gives_back_its_scenes():
    scenes = [novel_scenes(NAVIGATION, 1, i, obstacles=i, obstacle_speed=i)[0] for i in range(4)]
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
