"""What a planner's network sees: a laser scan and a target, as features of about unit size."""

from __future__ import annotations

import numpy as np

from defplan_mj.planning.beams import beam_directions
from defplan_mj.task import Navigation


def target_features(dimension: int) -> int:
    """Return how many of the features speak of the target: direction (d) and distance (3)."""
    return dimension + 3


def features(laser: np.ndarray, target: np.ndarray, laser_range: float) -> np.ndarray:
    """Return (..., beams + d + 3) float32 features of laser scans and targets.

    A beam becomes its proximity 1 - distance / range. The target, in the robot's frame, becomes its
    direction (a unit vector) and three views of its distance r (m): log(1 + r) / 3, r / 20 and
    exp(-r / 2), so that near and far are both told apart.

    Args:
        laser: (..., beams) m.
        target: (..., d) m; the first d components of an observation's.
        laser_range: m.
    """
    beams, d = laser.shape[-1], target.shape[-1]
    distance = np.sqrt(np.einsum("...d,...d->...", target, target))
    inverse = 1.0 / np.maximum(distance, 1e-6)
    out = np.empty((*laser.shape[:-1], beams + target_features(d)), np.float32)
    out[..., :beams] = 1.0 - laser / laser_range
    out[..., beams : beams + d] = target * inverse[..., None]
    out[..., -3] = np.log1p(distance) / 3
    out[..., -2] = distance / 20
    out[..., -1] = np.exp(-0.5 * distance)
    return out


def laser_points(laser: np.ndarray, navigation: Navigation) -> np.ndarray:
    """Return the (p, d) points that a scan of `beams` distances hit, in the robot's frame, m.

    A distance of the range is a miss.
    """
    hit = laser < navigation.laser_range * (1 - 1e-6)
    return laser[hit][:, None] * beam_directions(len(laser), navigation.space)[hit]
