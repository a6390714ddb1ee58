"""Named scenes: what each promises, and that there is a way for the robot in all of them."""

import numpy as np
import pytest

from defplan_mj.base.errors import DefplanError
from defplan_mj.base.places import PLACES
from defplan_mj.planning.places import place_scenes
from defplan_mj.planning.tracking import Balls
from defplan_mj.task import Navigation
from defplan_solvers.search.space_time import SpaceTime
from tests.samples import planning as samples

NAVIGATION = Navigation()
RADIUS = 0.6


@pytest.mark.parametrize("name", PLACES)
def test_every_place_has_a_way_for_the_robot_that_the_bound_finds(name):
    surrogate = samples.surrogate(radius=RADIUS)
    search = SpaceTime(surrogate, NAVIGATION, nodes=200_000)
    for scene in place_scenes(name, NAVIGATION, 3, 0, RADIUS):
        heading = 2 * np.arctan2(scene.orientation[3], scene.orientation[0])
        frame = np.array([[np.cos(heading), -np.sin(heading)], [np.sin(heading), np.cos(heading)]])
        centres = scene.centres[:, :2] @ frame
        balls = Balls(centres, scene.radii, np.zeros_like(centres))
        assert np.linalg.norm(centres, axis=1).min() > RADIUS + 0.2
        _, arrives = search.way(balls, scene.target[:2] @ frame, surrogate.rest, 0.05)
        assert arrives
        assert np.linalg.norm(scene.target) == pytest.approx(20)


def test_gates_are_as_wide_as_the_robot_and_a_half_and_walls_have_no_other_gap():
    for scene in place_scenes("gates", NAVIGATION, 4, 1, RADIUS):
        ahead = scene.target[:2] / 20
        along, across = scene.centres[:, :2] @ ahead, scene.centres[:, :2] @ [-ahead[1], ahead[0]]
        for wall in (7.0, 14.0):
            row = np.sort(across[np.isclose(along, wall)])
            gap = np.sort(np.diff(row) - 2 * scene.radii[0])
            assert gap[-1] == pytest.approx(1.5 * 2 * RADIUS) and gap[-2] < 0.1


def test_the_same_seed_gives_the_same_places_and_other_seeds_and_names_others():
    first, again = (place_scenes("field-20", NAVIGATION, 2, 5, RADIUS) for _ in range(2))
    other = place_scenes("field-20", NAVIGATION, 2, 6, RADIUS)
    assert np.array_equal(first[1].centres, again[1].centres)
    assert len(first[0].radii) == 20 and not np.array_equal(first[0].centres, other[0].centres)


@pytest.mark.parametrize(
    ("name", "navigation", "n", "said"),
    [
        ("swamp", NAVIGATION, 1, "no scenes 'swamp': take field-20"),
        ("maze", Navigation(space="spatial", beams=128), 1, "are of the plane"),
        ("maze", NAVIGATION, 0, "at least 1 episode"),
    ],
)
def test_places_that_are_not_there_are_one_sentence(name, navigation, n, said):
    with pytest.raises(DefplanError, match=said):
        place_scenes(name, navigation, n, 0, RADIUS)
