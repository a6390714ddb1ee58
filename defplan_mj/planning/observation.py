"""What a planner's network sees: a laser scan and a target, as features of about unit size."""

from __future__ import annotations

import numpy as np

TARGET_FEATURES = 5


def features(laser: np.ndarray, target: np.ndarray, laser_range: float) -> np.ndarray:
    """Return (..., beams + 5) float32 features of laser scans and targets.

    A beam becomes its proximity 1 - distance / range. The target, in the body's yaw frame, becomes
    its direction (cosine, sine) and three views of its distance d (m): log(1 + d) / 3, d / 20 and
    exp(-d / 2), so that near and far are both told apart.

    Args:
        laser: (..., beams) m.
        target: (..., 2 or 3) m; only forward and left are used.
        laser_range: m.
    """
    x, y = target[..., 0], target[..., 1]
    distance = np.hypot(x, y)
    inverse = 1.0 / np.maximum(distance, 1e-6)
    out = np.empty((*laser.shape[:-1], laser.shape[-1] + TARGET_FEATURES), np.float32)
    out[..., :-5] = 1.0 - laser / laser_range
    out[..., -5] = x * inverse
    out[..., -4] = y * inverse
    out[..., -3] = np.log1p(distance) / 3
    out[..., -2] = distance / 20
    out[..., -1] = np.exp(-0.5 * distance)
    return out


def laser_points(laser: np.ndarray, laser_range: float) -> np.ndarray:
    """Return the (p, 2) points that a scan of `beams` distances hit, in the body's yaw frame, m.

    Beam k points 2 pi k / beams to the left of forward; a distance of the range is a miss.
    """
    hit = laser < laser_range * (1 - 1e-6)
    angle = 2 * np.pi * np.flatnonzero(hit) / len(laser)
    return laser[hit][:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
