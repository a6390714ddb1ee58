"""What a robot remembers of its laser scans: points in its present frame, carried along by odometry."""

from __future__ import annotations

import numpy as np

from defplan_mj.planning.odometry import Odometry
from defplan_mj.planning.sensors.laser import laser_of
from defplan_mj.planning.sensors.sensor import seen_points
from defplan_mj.planning.surrogate import Surrogate
from defplan_mj.task import Navigation

CELL = 0.25  # a remembered point stands for its neighbours this close, m
REACH = 15.0  # points farther away are forgotten, m
MATCH = 0.4  # a point is gone if the beams next to it go on this much farther, m
PASS = 0.3  # and one of them comes this close to it, m
AROUND = 3  # beams next to a point


class LaserMap:
    """Points that the laser saw, in the robot's present frame, carried along by its `Odometry`.

    Args:
        surrogate: f_fit.
        navigation: for the laser.
    """

    def __init__(self, surrogate: Surrogate, navigation: Navigation) -> None:
        self.odometry = Odometry(surrogate, navigation)
        self.navigation, self.d = navigation, navigation.dimension
        self.directions = laser_of(navigation).directions(navigation.beams)
        self.reset()

    def reset(self) -> None:
        """Forget all."""
        self.points = np.zeros((0, self.d))
        self.odometry.reset()

    def chose(self, gait: int) -> None:
        """Take note of the gait of the coming cycle."""
        self.odometry.chose(gait)

    def update(self, laser: np.ndarray, target: np.ndarray) -> np.ndarray:
        """Take a scan (beams,) and the target (d,); return all points known now (p, d), m."""
        scan = seen_points(laser, self.navigation)
        motion = self.odometry.moved(target)
        if motion is not None:
            shift, turn = motion
            self.points = (self.points - shift) @ turn  # x_old = shift + R x_new
            self._carve(laser)
        near = np.linalg.norm(self.points, axis=1) < REACH
        everything = np.concatenate([scan, self.points[near]])
        _, first = np.unique(np.round(everything / CELL).astype(int), axis=0, return_index=True)
        self.points = everything[np.sort(first)]
        return self.points

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
