"""The beams' directions: even on the circle and on the sphere."""

import numpy as np
import pytest
from scipy.spatial import SphericalVoronoi

from defplan_mj.base.errors import DefplanError
from defplan_mj.planning.sensors.laser import beam_directions
from defplan_mj.task import Navigation


def test_planar_beams_go_round_to_the_left():
    beams = beam_directions(4, "planar")
    np.testing.assert_allclose(beams, [[1, 0], [0, 1], [-1, 0], [0, -1]], atol=1e-15)


@pytest.mark.parametrize("beams", [64, 128, 200])
def test_spatial_beams_share_the_sphere_evenly(beams):
    directions = beam_directions(beams, "spatial")
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1, atol=1e-15)
    assert np.linalg.norm(directions.mean(0)) < 0.01
    # each beam's cell of the sphere, by Voronoi: within a fifth of the same solid angle
    areas = SphericalVoronoi(directions).calculate_areas() * beams / (4 * np.pi)
    assert areas.min() > 0.8 and areas.max() < 1.2


def test_a_navigation_names_its_space():
    assert Navigation().dimension == 2
    assert Navigation(space="spatial").dimension == 3
    with pytest.raises(DefplanError, match="'flat' to navigate in: take planar or spatial"):
        Navigation(space="flat")
