"""What a planner's network sees: a laser scan, a target and each gait's room, as features of about unit size."""

from __future__ import annotations

import numpy as np

from defplan_mj.planning.motion_tree import MotionTree
from defplan_mj.planning.sensors.sensor import reading_size, sensor_of
from defplan_mj.planning.surrogate import Surrogate
from defplan_mj.task import Navigation

NARROW, WIDE = 0.2, 1.0
"""Scales at which the room of a gait is told, m."""


class Senses:
    """The features of one robot's scans and targets.

    Whether the next cycle hits something hangs on a few centimetres of a laser whose range is many
    metres: too little for a network to tell from the distances alone. The robot knows how its gaits
    move it, so the features also say how much room each of them has: the distance of the points that
    the laser sees from the way of the cycle, less the robot's radius.

    Args:
        surrogate: of the robot: its gaits' motions and its radius.
        navigation: for the laser and the space.

    Attributes:
        size: the number of features, those of a reading + d + 3 + 2 K.
    """

    def __init__(self, surrogate: Surrogate, navigation: Navigation) -> None:
        self.navigation, self.radius = navigation, np.float32(surrogate.radius)
        self.sensor, self.readings = sensor_of(navigation), reading_size(navigation)
        self.ways = MotionTree(surrogate.motions(navigation.space), 1)
        self.size = self.readings + navigation.dimension + 3 + 2 * self.ways.gaits

    def __call__(self, laser: np.ndarray, target: np.ndarray) -> np.ndarray:
        """Return (..., size) float32 features of laser scans and targets.

        A reading becomes what its sensor says (a beam its proximity). The target, in the robot's frame, becomes
        its direction (a unit vector) and three views of its distance r (m): log(1 + r) / 3, r / 20
        and exp(-r / 2), so that near and far are both told apart. The room c of a gait becomes
        tanh(c / 0.2) and, from c = -0.5 on, exp(-c).

        Args:
            laser: (..., readings) of the sensor.
            target: (..., d) m; the first d components of an observation's.
        """
        n, d, gaits = self.readings, target.shape[-1], self.ways.gaits
        distance = np.sqrt(np.einsum("...d,...d->...", target, target))
        inverse = 1.0 / np.maximum(distance, 1e-6)
        out = np.empty((*laser.shape[:-1], self.size), np.float32)
        out[..., :n] = self.sensor.features(laser, self.navigation)
        out[..., n : n + d] = target * inverse[..., None]
        out[..., n + d] = np.log1p(distance) / 3
        out[..., n + d + 1] = distance / 20
        out[..., n + d + 2] = np.exp(-0.5 * distance)
        room = self.room(laser)
        out[..., -2 * gaits : -gaits] = np.tanh(room / NARROW)
        out[..., -gaits:] = np.exp(-np.maximum(room, -0.5) / WIDE)
        return out

    def room(self, laser: np.ndarray) -> np.ndarray:
        """Return (..., K) how far scans (..., readings) stay clear of the robot in a cycle, m.

        Where nothing is met there counts a point at the end of the range.
        """
        points, _ = self.sensor.points(np.asarray(laser, np.float32), self.navigation)
        _, _, way = self.ways.distances2(points.reshape(-1, points.shape[-1]))
        nearest = way.reshape(*points.shape[:-1], self.ways.gaits).min(-2)
        return np.sqrt(np.maximum(nearest, 0)) - self.radius
