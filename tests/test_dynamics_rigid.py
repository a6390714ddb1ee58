"""f_fit as dynamics."""

import numpy as np
import planning_samples as samples
import pytest

from defplan_mj.base.errors import DefplanError
from defplan_mj.dynamics.rigid import RigidDynamics
from defplan_mj.log.poses import predict


def test_a_step_is_the_rigid_motion_of_the_gait_in_the_body_frame():
    dynamics = RigidDynamics(samples.surrogate())
    x = dynamics.rollout(dynamics.rest_state(), np.array([1, 1, 0]))
    assert np.allclose(x[1, :2], [0.42, 0.1])
    assert np.isclose(2 * np.arctan2(x[2, 6], x[2, 3]), 1.2)
    assert np.allclose(x[3, :2] - x[2, :2], 0.65 * np.array([np.cos(1.2), np.sin(1.2)]))


def test_it_agrees_with_the_prediction_of_the_logs():
    surrogate = samples.surrogate()
    x = np.array([1.0, 2.0, 3.0, 0.9, 0.1, -0.2, 0.3])
    x[3:] /= np.linalg.norm(x[3:])
    for gait in range(3):
        assert np.allclose(RigidDynamics(surrogate).step(x, gait), predict(surrogate, x, gait))


def test_an_unknown_gait_is_refused():
    dynamics = RigidDynamics(samples.surrogate())
    with pytest.raises(DefplanError, match="no gait 3; the surrogate has forward, left, right"):
        dynamics.step(dynamics.rest_state(), 3)
