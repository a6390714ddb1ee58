"""What a robot remembers of its laser scans: points in its present frame, carried along by odometry."""

from __future__ import annotations

import numpy as np

from defplan_mj.planning.beams import beam_directions
from defplan_mj.planning.frames import turn_between
from defplan_mj.planning.observation import laser_points
from defplan_mj.planning.surrogate import Surrogate
from defplan_mj.task import Navigation

CELL = 0.25  # a remembered point stands for its neighbours this close, m
REACH = 15.0  # points farther away are forgotten, m
MATCH = 0.4  # a point is gone if the beams next to it go on this much farther, m
PASS = 0.3  # and one of them comes this close to it, m
AROUND = 3  # beams next to a point


class LaserMap:
    """Points that the laser saw, in the robot's present frame.

    The robot does not know how it moved. It knows the gait it chose, which says the motion up to the
    surrogate's scatter, and it sees the target from before and after. Where the target is seen
    beside its expected place, the turn is corrected, and the displacement by what is left: the more
    to the turn, the farther away the target is (the most likely motion, if both errors are normal
    with the surrogate's deviations). Only a turn about the line to the target goes unnoticed, and
    that leaves what is on the way where it is.

    Args:
        surrogate: f_fit.
        navigation: for the laser.
    """

    def __init__(self, surrogate: Surrogate, navigation: Navigation) -> None:
        self.motions = surrogate.motions(navigation.space)
        self.turn_variance = surrogate.rotation_sd**2
        self.way_variance = surrogate.translation_sd**2
        self.navigation, self.d = navigation, navigation.dimension
        self.directions = beam_directions(navigation.beams, navigation.space)
        self.reset()

    def reset(self) -> None:
        """Forget all."""
        self.points = np.zeros((0, self.d))
        self._target: np.ndarray | None = None
        self._gait: int | None = None

    def chose(self, gait: int) -> None:
        """Take note of the gait of the coming cycle."""
        self._gait = gait

    def update(self, laser: np.ndarray, target: np.ndarray) -> np.ndarray:
        """Take a scan (beams,) and the target (d,); return all points known now (p, d), m."""
        scan = laser_points(laser, self.navigation)
        if self._target is not None and self._gait is not None:
            shift, turn = self._moved(target)
            self.points = (self.points - shift) @ turn  # x_old = shift + R x_new
            self._carve(laser)
        near = np.linalg.norm(self.points, axis=1) < REACH
        everything = np.concatenate([scan, self.points[near]])
        _, first = np.unique(np.round(everything / CELL).astype(int), axis=0, return_index=True)
        self.points = everything[np.sort(first)]
        self._target = target
        return self.points

    def _moved(self, target: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the displacement (d,) and turn (d, d) since the last target, in the frame then."""
        assert self._target is not None and self._gait is not None
        turn = self.motions.rotations[self._gait]
        expected = turn @ target  # from the robot's new place, as seen in its old frame
        seen = self._target - self.motions.translations[self._gait]
        distance2 = float(expected @ expected)
        leeway = self.turn_variance[self._gait] * distance2
        share = leeway / max(leeway + self.way_variance[self._gait], 1e-12)
        turn = turn_between(expected, expected + share * (seen - expected)) @ turn
        return self._target - turn @ target, turn

    def _carve(self, laser: np.ndarray) -> None:
        """Forget points that a beam passes: what stood there has moved, or was misplaced."""
        if not len(self.points):
            return
        along = self.points @ self.directions.T
        beams = np.argpartition(-along, AROUND, axis=1)[:, :AROUND]
        distance2 = (self.points * self.points).sum(1)
        passed = distance2 - along.max(1) ** 2 < PASS**2
        gone = passed & (np.sqrt(distance2) <= laser[beams].min(1) - MATCH)
        self.points = self.points[~gone]
