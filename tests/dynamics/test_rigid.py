"""f_fit as dynamics."""

import mujoco
import numpy as np
import pytest

from defplan_mj.base.errors import DefplanError
from defplan_mj.dynamics.rigid import RigidDynamics
from defplan_mj.planning.frames import attitude_frames, random_attitudes
from tests.samples import planning as samples


def test_a_step_is_the_rigid_motion_of_the_gait_in_the_body_frame():
    dynamics = RigidDynamics(samples.surrogate())
    x = dynamics.rollout(dynamics.rest_state(), np.array([1, 1, 0]))
    assert np.allclose(x[1, :2], [0.42, 0.1])
    assert np.isclose(2 * np.arctan2(x[2, 6], x[2, 3]), 1.2)
    assert np.allclose(x[3, :2] - x[2, :2], 0.65 * np.array([np.cos(1.2), np.sin(1.2)]))


def test_poses_are_those_of_homogeneous_matrices_by_mujocos_conversions():
    surrogate = samples.surrogate()
    x = np.array([1.0, 2.0, 3.0, 0.9, 0.1, -0.2, 0.3])
    x[3:] /= np.linalg.norm(x[3:])
    for gait in range(3):
        motion = np.eye(4)
        motion[:3, :3], motion[:3, 3] = surrogate.rotations[gait], surrogate.translations[gait]
        after = RigidDynamics(surrogate).step(x, gait)
        assert np.allclose(_homogeneous(after), _homogeneous(x) @ motion, atol=1e-14)


def test_motions_of_many_robots_are_those_of_their_poses_in_the_plane_and_in_space():
    for space, surrogate in (("planar", samples.surrogate()), ("spatial", samples.swimmer())):
        rng, gaits = np.random.default_rng(0), np.array([0, 2, 1, 1])
        d = {"planar": 2, "spatial": 3}[space]
        attitudes = random_attitudes(rng, 4, d)
        places = np.zeros((4, 3))
        places[:, :d] = rng.normal(size=(4, d))
        ends, frames = (
            surrogate.motions(space).of(gaits).after(places[:, :d], attitude_frames(attitudes, d))
        )
        for i, gait in enumerate(gaits):
            pose = np.concatenate([places[i], attitudes[i]])
            after = _homogeneous(RigidDynamics(surrogate).step(pose, gait))
            assert np.allclose(ends[i], after[:d, 3], atol=1e-14)
            assert np.allclose(frames[i], after[:d, :d], atol=1e-14)


def _homogeneous(pose):
    matrix, out = np.empty(9), np.eye(4)
    mujoco.mju_quat2Mat(matrix, pose[3:7])
    out[:3, :3], out[:3, 3] = matrix.reshape(3, 3), pose[:3]
    return out


def test_an_unknown_gait_is_refused():
    dynamics = RigidDynamics(samples.surrogate())
    with pytest.raises(DefplanError, match="no gait 3; the surrogate has forward, left, right"):
        dynamics.step(dynamics.rest_state(), 3)
