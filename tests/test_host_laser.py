"""The laser against circles on paper."""

from __future__ import annotations

import host_samples as samples
import numpy as np
import pytest

from defplan_mj.planning.surrogate_env import scan as planar_scan

CIRCLES = [(4.0, 1.0, 1.0), (-3.0, 2.0, 0.7), (1.0, -6.0, 2.0), (7.0, 8.0, 1.5)]


def _analytic(position, yaw, circles, beams=64, laser_range=10.0):
    """Return the distance along each beam to the first circle, by the quadratic formula."""
    result = np.full(beams, laser_range)
    for k in range(beams):
        angle = yaw + 2 * np.pi * k / beams
        direction = np.array([np.cos(angle), np.sin(angle)])
        for x, y, radius in circles:
            offset = np.array([x, y]) - position[:2]
            along = offset @ direction
            discriminant = along**2 - offset @ offset + radius**2
            if discriminant > 0 and along > 0:
                result[k] = min(result[k], along - np.sqrt(discriminant))
    return result


def test_laser_equals_circles_on_paper():
    physics = samples.physics()
    with physics.reset_context():
        physics.set_scene(samples.scene(CIRCLES))
    generator = np.random.default_rng(0)
    for _ in range(12):
        yaw = generator.uniform(-np.pi, np.pi)
        position = generator.uniform(-1.5, 1.5, 3)
        state = np.zeros(13 + 2 * physics.n_modes)
        state[:3], state[3], state[6] = position, np.cos(yaw / 2), np.sin(yaw / 2)
        physics.set_reduced_state(state)
        physics.forward()
        assert physics.yaw() == pytest.approx(yaw, abs=1e-12)
        laser = physics.laser()
        assert laser == pytest.approx(_analytic(position, yaw, CIRCLES), abs=1e-9)
        assert (laser < 10).any() and (laser == 10).any()


def test_laser_stays_level_when_the_body_tilts():
    physics = samples.physics()
    with physics.reset_context():
        physics.set_scene(samples.scene(CIRCLES))
    samples.place(physics)
    level = physics.laser()
    with physics.reset_context():
        physics.set_scene(samples.scene(CIRCLES))
        physics.data.qpos[3:7] = [np.cos(0.3), 0.0, np.sin(0.3), 0.0]  # pitch keeps the yaw
    assert physics.laser() == pytest.approx(level, abs=1e-9)


def test_laser_sees_as_the_planners_surrogate_does():
    physics = samples.physics()
    with physics.reset_context():
        physics.set_scene(samples.scene(CIRCLES, yaw=0.4))
        physics.data.qpos[3:7] = [np.cos(0.2), 0.0, 0.0, np.sin(0.2)]
    circles = np.array(CIRCLES)
    surrogate = planar_scan(
        np.zeros((1, 2)), np.array([0.4]), circles[None, :, :2], circles[None, :, 2], 64, 10.0
    )
    assert physics.laser() == pytest.approx(surrogate[0], abs=1e-4)


def test_hits_beyond_the_range_count_as_misses():
    physics = samples.physics(laser_range=5.0, beams=8)
    with physics.reset_context():
        physics.set_scene(samples.scene([(5.9, 0.0, 1.0), (0.0, 6.1, 1.0)]))
    laser = physics.laser()
    assert laser[0] == pytest.approx(4.9) and laser[2] == 5.0
    assert (laser[[1, 3, 4, 5, 6, 7]] == 5.0).all()


def test_laser_does_not_see_robot_target_or_sea_bed():
    physics = samples.physics()
    with physics.reset_context():
        physics.set_scene(samples.scene([], target=(2.0, 0.0, 0.0)))
        physics.data.qpos[2] = -3.9  # the sea bed is at -4 m
    assert (physics.laser() == 10.0).all()


def test_laser_sees_moving_obstacles_where_they_are():
    physics = samples.physics()
    with physics.reset_context():
        physics.set_scene(samples.scene([(6.0, 0.0, 1.0)], velocities=[(-1.0, 0.0, 0.0)]))
    for _ in range(25):
        physics.step()
        expected = 6.0 - physics.time() - 1.0 - physics.com()[0]
        assert physics.laser()[0] == pytest.approx(expected, abs=1e-3)


def test_scans_share_no_memory():
    physics = samples.physics()
    assert not np.may_share_memory(physics.laser(), physics.laser())
