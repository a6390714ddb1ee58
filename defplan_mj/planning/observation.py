"""What a planner's network sees: a laser scan, a target and each gait's room, as features of about unit size."""

from __future__ import annotations

import numpy as np

from defplan_mj.planning.beams import beam_directions
from defplan_mj.planning.motion_tree import MotionTree
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
        size: the number of features, beams + d + 3 + 2 K.
    """

    def __init__(self, surrogate: Surrogate, navigation: Navigation) -> None:
        self.laser_range, self.radius = navigation.laser_range, np.float32(surrogate.radius)
        self.directions = beam_directions(navigation.beams, navigation.space).astype(np.float32)
        self.ways = MotionTree(surrogate.motions(navigation.space), 1)
        self.size = navigation.beams + navigation.dimension + 3 + 2 * self.ways.gaits

    def __call__(self, laser: np.ndarray, target: np.ndarray) -> np.ndarray:
        """Return (..., size) float32 features of laser scans and targets.

        A beam becomes its proximity 1 - distance / range. The target, in the robot's frame, becomes
        its direction (a unit vector) and three views of its distance r (m): log(1 + r) / 3, r / 20
        and exp(-r / 2), so that near and far are both told apart. The room c of a gait becomes
        tanh(c / 0.2) and, from c = -0.5 on, exp(-c).

        Args:
            laser: (..., beams) m.
            target: (..., d) m; the first d components of an observation's.
        """
        beams, d, gaits = laser.shape[-1], target.shape[-1], self.ways.gaits
        distance = np.sqrt(np.einsum("...d,...d->...", target, target))
        inverse = 1.0 / np.maximum(distance, 1e-6)
        out = np.empty((*laser.shape[:-1], self.size), np.float32)
        out[..., :beams] = 1.0 - laser / self.laser_range
        out[..., beams : beams + d] = target * inverse[..., None]
        beams += d
        out[..., beams] = np.log1p(distance) / 3
        out[..., beams + 1] = distance / 20
        out[..., beams + 2] = np.exp(-0.5 * distance)
        room = self.room(laser)
        out[..., -2 * gaits : -gaits] = np.tanh(room / NARROW)
        out[..., -gaits:] = np.exp(-np.maximum(room, -0.5) / WIDE)
        return out

    def room(self, laser: np.ndarray) -> np.ndarray:
        """Return (..., K) how far scans (..., beams) stay clear of the robot in a cycle, m.

        A beam that meets nothing counts as a point at the end of its range.
        """
        points = np.asarray(laser, np.float32)[..., None] * self.directions
        _, _, way = self.ways.distances2(points.reshape(-1, points.shape[-1]))
        nearest = way.reshape(*laser.shape, self.ways.gaits).min(-2)
        return np.sqrt(np.maximum(nearest, 0)) - self.radius


def laser_points(laser: np.ndarray, navigation: Navigation) -> np.ndarray:
    """Return the (p, d) points that a scan of `beams` distances hit, in the robot's frame, m.

    A distance of the range is a miss.
    """
    hit = laser < navigation.laser_range * (1 - 1e-6)
    return laser[hit][:, None] * beam_directions(len(laser), navigation.space)[hit]
