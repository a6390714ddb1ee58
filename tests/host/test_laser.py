"""The laser against circles and spheres on paper."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from defplan_mj.planning.frames import attitude_frames, turns
from defplan_mj.planning.sensors.laser import beam_directions
from defplan_mj.planning.surrogate_env import scan as surrogate_scan
from tests.samples import host as samples

CIRCLES = [(4.0, 1.0, 1.0), (-3.0, 2.0, 0.7), (1.0, -6.0, 2.0), (7.0, 8.0, 1.5)]
SPHERES = [(4.0, 1.0, 1.0, 1.0), (-3.0, 2.0, -4.0, 0.7), (1.0, -6.0, 2.0, 2.0), (0.5, 0.3, 6.0, 1.5),
           (-1.0, -2.0, -5.0, 1.2), (-5.0, -4.0, 3.0, 2.0)]  # fmt: skip


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


def _analytic_spheres(position, rotation, spheres, beams=64, laser_range=10.0):
    """Return the distance along each beam to the first sphere, from three sides of a triangle."""
    result = np.full(beams, laser_range)
    for k, beam in enumerate(beam_directions(beams, "spatial")):
        direction = rotation @ beam
        for *centre, radius in spheres:
            offset = np.array(centre) - position
            along = offset @ direction
            across = np.linalg.norm(np.cross(offset, direction))
            if across < radius and along > 0:
                result[k] = min(result[k], along - np.sqrt(radius**2 - across**2))
    return result


def _spatial(spheres, **kwargs):
    physics = samples.physics(8, space="spatial", **kwargs)
    with physics.reset_context():
        physics.set_scene(samples.spheres(spheres))
    return physics


def _scan_at(physics, quaternion, position=(0.0, 0.0, 0.0)) -> np.ndarray:
    physics.data.qpos[:3], physics.data.qpos[3:7] = position, quaternion
    physics.forward()
    return physics.laser()


def test_spherical_laser_equals_spheres_on_paper_at_all_attitudes():
    physics = _spatial(SPHERES)
    generator = np.random.default_rng(0)
    seen = np.zeros(64, bool)
    for quaternion in samples.attitudes(60):
        position = generator.uniform(-1, 1, 3)
        laser = _scan_at(physics, quaternion, position)
        rotation = Rotation.from_quat(quaternion, scalar_first=True).as_matrix()
        assert laser == pytest.approx(_analytic_spheres(position, rotation, SPHERES), abs=1e-9)
        assert (laser < 10).any() and (laser == 10).any()
        seen |= laser < 10
    assert seen.all()


def test_spherical_laser_turns_with_the_body_and_the_world():
    """Turning the world and the body alike changes nothing; turning the body alone does."""
    centres = np.array(SPHERES)
    plain = _scan_at(_spatial(SPHERES), [1.0, 0.0, 0.0, 0.0])
    for quaternion in samples.attitudes(6, seed=1):
        turned = centres.copy()
        turned[:, :3] = Rotation.from_quat(quaternion, scalar_first=True).apply(centres[:, :3])
        assert _scan_at(_spatial(turned), quaternion) == pytest.approx(plain, abs=1e-9)
        assert np.abs(_scan_at(_spatial(SPHERES), quaternion) - plain).max() > 1


def test_laser_equals_circles_on_paper():
    physics = samples.physics()
    with physics.reset_context():
        physics.set_scene(samples.scene(CIRCLES))
    generator = np.random.default_rng(0)
    for _ in range(12):
        yaw = generator.uniform(-np.pi, np.pi)
        position = generator.uniform(-1.5, 1.5, 3)
        state = np.zeros(13 + 3 * physics.n_modes)
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
    surrogate = surrogate_scan(
        np.zeros((1, 2)),
        turns(np.array([[0.4]])),
        circles[None, :, :2],
        circles[None, :, 2],
        beam_directions(64, "planar"),
        10.0,
    )
    assert physics.laser() == pytest.approx(surrogate[0], abs=1e-4)


def test_in_space_too_the_laser_sees_as_the_planners_surrogate_does():
    attitude = samples.attitudes(1, seed=3)
    physics = samples.physics(max_obstacles=len(SPHERES), beams=128, space="spatial")
    with physics.reset_context():
        physics.set_scene(samples.spheres(SPHERES))
        physics.data.qpos[3:7] = attitude[0]
    balls = np.array(SPHERES)
    surrogate = surrogate_scan(
        physics.com()[None],
        attitude_frames(attitude, 3),
        balls[None, :, :3],
        balls[None, :, 3],
        beam_directions(128, "spatial"),
        10.0,
    )
    assert physics.laser() == pytest.approx(surrogate[0], abs=1e-4)
    assert np.sum(surrogate < 10) > 10


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
