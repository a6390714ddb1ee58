"""What a robot remembers of its laser scans: points in its present frame, carried along by odometry."""

from __future__ import annotations

import numpy as np

from defplan_mj.planning.observation import laser_points

CELL = 0.25  # a remembered point stands for its neighbours this close, m
TURN_WINDOW = 0.3  # how far the turn may differ from the surrogate's, rad
TURN_STEPS = 25
MATCH = 0.4  # points farther apart than this are not the same, m
PRIOR = 0.05  # weight of the surrogate's turn against the scans', m of mean mismatch / rad


class LaserMap:
    """Points that the laser saw, in the robot's present yaw frame.

    The robot does not know how it moved. It knows the gait it chose, which says the turn up to the
    surrogate's error, and it sees the target from before and after: given the turn, that fixes the
    displacement. Of the turns about the surrogate's, the one that lays the new scan best on the old
    one is taken.

    Args:
        motions: (K, 3) the surrogate's forward and left displacement (m) and yaw (rad).
        laser_range: m.
        reach: points farther away are forgotten, m.
    """

    def __init__(self, motions: np.ndarray, laser_range: float, reach: float = 15.0) -> None:
        self.motions, self.laser_range, self.reach = motions, laser_range, reach
        self.reset()

    def reset(self) -> None:
        """Forget all."""
        self.points = np.zeros((0, 2))
        self._scan = np.zeros((0, 2))
        self._target: np.ndarray | None = None
        self._gait: int | None = None

    def chose(self, gait: int) -> None:
        """Take note of the gait of the coming cycle."""
        self._gait = gait

    def update(self, laser: np.ndarray, target: np.ndarray) -> np.ndarray:
        """Take a scan (beams,) and the target (2 or 3,); return all points known now (p, 2), m."""
        scan, target = laser_points(laser, self.laser_range), np.asarray(target)[:2]
        if self._target is not None and self._gait is not None:
            shift, turn = self._moved(scan, target)
            # x_old = shift + R x_new
            self.points = (self.points - shift) @ _rotation(turn)
            self._carve(laser)
        near = np.linalg.norm(self.points, axis=1) < self.reach
        everything = np.concatenate([scan, self.points[near]])
        _, first = np.unique(np.round(everything / CELL).astype(int), axis=0, return_index=True)
        self.points = everything[np.sort(first)]
        self._scan, self._target = scan, target
        return self.points

    def _moved(self, scan: np.ndarray, target: np.ndarray) -> tuple[np.ndarray, float]:
        """Return the displacement (2,) and turn since the last scan."""
        assert self._target is not None and self._gait is not None
        expected = self.motions[self._gait, 2]
        best = expected
        if len(scan) >= 3 and len(self._scan) >= 3:
            turns = expected + np.linspace(-TURN_WINDOW, TURN_WINDOW, TURN_STEPS)
            rotations = np.array([_rotation(turn) for turn in turns])
            shifts = self._target - rotations @ target
            moved = scan @ rotations.transpose(0, 2, 1) + shifts[:, None]  # (turns, points, 2)
            offset = moved[:, :, None] - self._scan
            gap = np.sqrt(np.einsum("tpqd,tpqd->tpq", offset, offset).min(2))
            mismatch = np.minimum(gap, MATCH).mean(1) + PRIOR * np.abs(turns - expected)
            best = turns[mismatch.argmin()]
        return self._target - _rotation(best) @ target, float(best)

    def _carve(self, laser: np.ndarray) -> None:
        """Forget points that a beam passes: what stood there has moved, or was misplaced."""
        beams = len(laser)
        distance = np.linalg.norm(self.points, axis=1)
        bearing = np.arctan2(self.points[:, 1], self.points[:, 0])
        beam = np.round(bearing * beams / (2 * np.pi)).astype(int)
        seen = np.min([laser[(beam + k) % beams] for k in (-1, 0, 1)], axis=0)
        self.points = self.points[distance > seen - MATCH]


def _rotation(angle: float) -> np.ndarray:
    cosine, sine = np.cos(angle), np.sin(angle)
    return np.array([[cosine, -sine], [sine, cosine]])
