"""A sensor of one's own: which way the nearest obstacle is, and how far away its surface.

[project.entry-points."defplan_mj.sensors"]
nearest-obstacle = "sensor:SENSOR"
"""

from __future__ import annotations

import numpy as np

from defplan_mj.planning.sensors.sensor import View
from defplan_mj.task import Navigation


class NearestObstacle:
    """Reads the unit vector e (d,) towards the nearest obstacle, then the distance s of its surface, m."""

    name = "nearest-obstacle"
    summary = "direction of the nearest obstacle and its distance"
    spaces = ("planar", "spatial")

    def labels(self, navigation: Navigation) -> list[str]:
        """Return what the d + 1 numbers are."""
        return [*"xyz"[: navigation.dimension], "range"]

    def measure(self, view: View, navigation: Navigation) -> np.ndarray:
        """Return e and s (..., d + 1): s = min over obstacles of |c| - radius, at most the range."""
        centres, radii = view.obstacles()
        nothing = np.append(np.eye(navigation.dimension)[0], navigation.laser_range)
        reading = np.broadcast_to(nothing, (*radii.shape[:-1], len(nothing))).copy()
        if radii.shape[-1]:
            away = np.linalg.norm(centres, axis=-1)
            gap = np.where(radii > 0, away - radii, np.inf)
            nearest = gap.argmin(-1)[..., None]
            s = np.take_along_axis(gap, nearest, -1)
            c = np.take_along_axis(centres, nearest[..., None], -2)[..., 0, :]
            e = c / np.maximum(np.linalg.norm(c, axis=-1, keepdims=True), 1e-9)
            seen = np.concatenate([e, np.maximum(s, 0)], -1)
            reading = np.where(s < navigation.laser_range, seen, reading)
        return reading

    def points(self, readings: np.ndarray, navigation: Navigation) -> tuple[np.ndarray, np.ndarray]:
        """Return the one point s e (..., 1, d) that a reading tells of, and whether it is there (..., 1)."""
        s = readings[..., -1:]
        return (s * readings[..., :-1])[..., None, :], s < navigation.laser_range

    def features(self, readings: np.ndarray, navigation: Navigation) -> np.ndarray:
        """Return e, and s by the range."""
        return readings / np.append(np.ones(navigation.dimension), navigation.laser_range)


SENSOR = NearestObstacle()
