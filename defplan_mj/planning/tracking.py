"""How fast what a sensor sees moves: obstacles are followed from scan to scan in the robot's own odometry."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.sparse.csgraph import connected_components

from defplan_mj.planning.odometry import Odometry
from defplan_mj.planning.sensors.sensor import sensor_of
from defplan_mj.planning.surrogate import Surrogate
from defplan_mj.task import Navigation

NOISE = 0.03  # of a point's distance from a ball's surface, m
ODOMETRY = 0.01  # what a cycle's motion is off beside the surrogate's scatter, m
RADIUS, RADIUS_SD = 1.1, 0.7  # of an obstacle before it is measured, m
CENTRE_SD = 0.8  # of its centre, then, m
SPEED_SD = 1.0  # of its velocity along an axis before it is measured, m/s
KNOWN = (
    0.2  # a velocity that is known better than this lets a ball take points for its own, m a cycle
)
STEADY = 0.01  # change of an obstacle's velocity between scans, m a cycle
GATE = 0.05  # a point belongs to a ball whose surface is this near, beside what is uncertain, m
SEED = 4  # points next to each other that a new ball is begun with
LINK = 2.5  # beams: points closer together than these belong together
ROUNDS = 4  # of looking for balls among the points that belong to none
FIT = 25.0  # largest squared distance of a new ball from one that was seen, in deviations
FORGET = 8  # cycles after which an obstacle that is out of sight is forgotten
SURE = 3.0  # standard deviations: a velocity smaller than these is none
LOOKS = {2: 1, 3: 2}  # at as many points as dimensions, or more, before a ball's velocity counts
STANDS, SHARE = 0.12, 0.7
"""A ball stands if this share of its points are this near to what the scan a cycle before saw, m: a wall does."""
ITERATIONS = 3


class Seen(NamedTuple):
    """What is around the robot, in its present frame.

    Attributes:
        points: (p, d) that the sensor sees, m.
        drift: (p, d) how far each moves until the next decision, m.
        drift_of_all: (q, d) the same for all points of the reading, 0 where nothing is.
    """

    points: np.ndarray
    drift: np.ndarray
    drift_of_all: np.ndarray


class Balls(NamedTuple):
    """Obstacles as balls, in a robot's frame.

    Attributes:
        centres: (m, d) m.
        radii: (m,) m.
        drift: (m, d) how far each moves until the next decision, m.
    """

    centres: np.ndarray
    radii: np.ndarray
    drift: np.ndarray


class Tracker:
    """Obstacles of a scan, each as a ball with a centre c, a radius r and a velocity v.

    An extended Kalman filter (c, r, v) for each ball: a scan's point p says |p - c| = r. The prediction
    takes the robot's motion from its `Odometry` and the obstacle's from v. Of the points that belong to
    no ball whose velocity is known, new balls are fitted, and told to be one that was seen before if
    there is one where it can have got to. One look gives no velocity; what fits no ball stands still.
    There is a scan a decision; what is told above in cycles is scaled to the time between them.

    Args:
        surrogate: f_fit.
        navigation: for the sensor and the space.

    Attributes:
        odometry: of the robot.
    """

    def __init__(self, surrogate: Surrogate, navigation: Navigation) -> None:
        self.navigation, self.d = navigation, navigation.dimension
        self.odometry = Odometry(surrogate, navigation)
        self.decisions = m = surrogate.decisions_per_cycle
        self.speed_sd, self.known = SPEED_SD * surrogate.decision_seconds, KNOWN / m
        self.steady = STEADY / m**1.5  # a walk at random, of a velocity that is told in less time
        turn, way = surrogate.scatter()
        self.way_sd, self.turn_sd = ODOMETRY / m**0.5 + float(way.mean()), float(turn.mean())
        apart = 2 * np.pi if self.d == 2 else np.sqrt(4 * np.pi * navigation.beams)
        self.link = LINK * apart / navigation.beams  # rad
        self.reset()

    def reset(self) -> None:
        """Forget all."""
        size = 2 * self.d + 1
        self.mean, self.covariance = np.zeros((0, size)), np.zeros((0, size, size))
        self.unseen, self.looks = np.zeros(0, int), np.zeros(0, int)
        self.still = np.zeros(0, bool)
        self._loose = np.zeros((0, self.d))  # points of no ball
        self._scans: list[
            np.ndarray
        ] = []  # points of the scans of the last cycle, the oldest first
        self.odometry.reset()

    def chose(self, gait: int) -> None:
        """Take note of the gait of the coming cycle."""
        self.odometry.chose(gait)

    def update(self, readings: np.ndarray, target: np.ndarray) -> Seen:
        """Take a sensor's reading (size,) and the target (d,), m; return what is seen, and how it moves."""
        if (motion := self.odometry.moved(target)) is not None:
            self._predict(*motion)
            self._scans = [(scan - motion[0]) @ motion[1] for scan in self._scans]
        ends, there = sensor_of(self.navigation).points(
            np.asarray(readings, float), self.navigation
        )
        points, every = ends[there], np.zeros_like(ends)
        owner = self._follow(points)
        owner = self._find(points, owner)
        count = np.bincount(owner[owner >= 0], minlength=len(self.mean))
        self.looks += count >= self.d
        stay = self._stay(points)[owner >= 0]
        here = np.bincount(owner[owner >= 0], stay, len(self.mean))
        self.still = np.where(count > 0, here >= SHARE * count, self.still)
        self._scans = [*self._scans, points][-self.decisions :]
        velocities = np.concatenate([self._velocities(), np.zeros((1, self.d))])
        every[there] = drift = velocities[owner]  # the last one is that of no ball
        self._loose = points[owner < 0]
        kept = self.unseen <= FORGET * self.decisions
        self.mean, self.covariance = self.mean[kept], self.covariance[kept]
        self.unseen, self.looks, self.still = (
            part[kept] for part in (self.unseen, self.looks, self.still)
        )
        return Seen(points, drift, every)

    def balls(self) -> Balls:
        """Return the obstacles that are followed, of which some may be out of sight, and what fits no ball."""
        d, loose = self.d, self._loose
        centres = np.concatenate([self.mean[:, :d], loose])
        radii = np.concatenate([self.mean[:, d], np.zeros(len(loose))])
        return Balls(centres, radii, np.concatenate([self._velocities(), np.zeros_like(loose)]))

    def _stay(self, points: np.ndarray) -> np.ndarray:
        """Return which points (p, d) are where the scan of a cycle ago, or the first since, saw something."""
        if not self._scans:
            return np.zeros(len(points), bool)
        near = STANDS * len(self._scans) / self.decisions
        return _stay(points, self._scans[0], near)

    def _velocities(self) -> np.ndarray:
        """Return the (t, d) velocities that are certain, others as 0, m until the next decision."""
        d = self.d
        velocity, spread = self.mean[:, d + 1 :], self.covariance[:, d + 1 :, d + 1 :]
        share = np.einsum(
            "ti,ti->t", velocity, np.linalg.solve(spread, velocity[..., None])[..., 0]
        )
        certain = (share > SURE**2) & (self.looks >= LOOKS[self.d]) & ~self.still
        return np.where(certain[:, None], velocity, 0.0)

    def _predict(self, shift: np.ndarray, turn: np.ndarray) -> None:
        d = self.d
        size = 2 * d + 1
        step = np.eye(size)
        step[:d, :d] = step[d + 1 :, d + 1 :] = turn.T
        step[:d, d + 1 :] = turn.T
        self.mean[:, :d] -= shift
        self.mean = self.mean @ step.T
        self.covariance = step @ self.covariance @ step.T
        away2 = np.einsum("ti,ti->t", self.mean[:, :d], self.mean[:, :d])
        own = np.arange(d)
        self.covariance[:, own, own] += (self.way_sd**2 + self.turn_sd**2 * away2)[:, None]
        self.covariance[:, d + 1 + own, d + 1 + own] += self.steady**2
        self.unseen += 1

    def _follow(self, points: np.ndarray) -> np.ndarray:
        """Correct balls of known velocity by their points; return to which each belongs (p,), -1: to none."""
        d, part = self.d, self.d + 1
        spread = np.trace(self.covariance[:, part:, part:], axis1=1, axis2=2)
        balls = np.flatnonzero(spread < d * self.known**2)
        if not len(balls) or not len(points):
            return np.full(len(points), -1)
        mean, covariance = self.mean[balls], self.covariance[balls]
        gap, gradient = _rows(mean, points)
        own = covariance[:, :part, :part]
        variance = np.einsum("tpi,tij,tpj->tp", gradient, own, gradient) + NOISE**2
        near = np.abs(gap) < GATE + 2 * np.sqrt(variance)
        owner = np.where(near.any(0), np.where(near, gap**2 / variance, np.inf).argmin(0), -1)
        mean, covariance, owner = _fitted(mean, covariance, points, owner)
        self.mean[balls], self.covariance[balls] = mean, covariance
        owner = np.where(owner >= 0, balls[owner], -1)
        self.unseen[owner[owner >= 0]] = 0
        return owner

    def _find(self, points: np.ndarray, owner: np.ndarray) -> np.ndarray:
        """Fit new balls to points that belong to none, and tell which were seen before; return the owners."""
        for attempt in range(ROUNDS):
            free = np.flatnonzero(owner < 0)
            if not len(free):
                break
            mean, covariance, label = self._new(points[free], attempt / ROUNDS)
            labels = np.unique(label[label >= 0])
            mean, covariance = mean[labels], covariance[labels]
            number = self._known_as(mean, covariance)
            owner = owner.copy()
            for ball, index in enumerate(labels):
                owner[free[label == index]] = number[ball]
        return owner

    def _new(self, points: np.ndarray, rank: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return a ball in each cluster of points: means, covariances and the points' owners, -1: none.

        A cluster can be of several balls that touch. So one is fitted to a point and those next to it,
        and then to all of the cluster that are on it.

        Args:
            rank: of that point in the order of distances, as a share.
        """
        d = self.d
        distance = np.linalg.norm(points, axis=1)
        near = self.link * np.minimum(distance[:, None], distance) + 0.1
        apart = np.linalg.norm(points[:, None] - points, axis=2)
        count, label = connected_components(apart < near, directed=False)
        mean, seed = np.zeros((count, 2 * d + 1)), np.full(len(points), -1)
        mean[:, d] = RADIUS
        for cluster in range(count):
            mine = np.flatnonzero(label == cluster)
            first = mine[np.argsort(distance[mine])[int(rank * len(mine))]]
            seed[mine[np.argsort(apart[first, mine])[:SEED]]] = cluster
            mean[cluster, :d] = points[first] * (1 + RADIUS / max(float(distance[first]), 1e-9))
        deviations = [CENTRE_SD] * d + [RADIUS_SD] + [self.speed_sd] * d
        covariance = np.repeat(np.diag(np.square(deviations))[None], count, 0)
        begun, _, seed = _fitted(mean, covariance, points, seed)
        gap, _ = _rows(begun, points)
        on_it = np.abs(gap[label, np.arange(len(points))]) < GATE
        sound = np.isin(label, np.unique(seed[seed >= 0]))
        return _fitted(mean, covariance, points, np.where(on_it & sound, label, -1), begun)

    def _known_as(self, mean: np.ndarray, covariance: np.ndarray) -> np.ndarray:
        """Take new balls for ones that were seen before, or else begin them; return their numbers."""
        part = self.d + 1
        number = np.full(len(mean), -1)
        lost = np.flatnonzero(self.unseen > 0)
        if len(lost) and len(mean):
            offset = mean[None, :, :part] - self.mean[lost, None, :part]
            spread = self.covariance[lost, None, :part, :part] + covariance[None, :, :part, :part]
            solved = np.linalg.solve(spread, offset[..., None])[..., 0]
            far = np.einsum("tni,tni->tn", offset, solved)
            cost = np.where(far < FIT, far + np.log(np.linalg.det(spread)), 1e6)
            for old, new in zip(*linear_sum_assignment(cost), strict=True):
                if cost[old, new] < 1e6:
                    number[new] = lost[old]
                    self._take(lost[old], mean[new, :part], covariance[new, :part, :part])
        new = np.flatnonzero(number < 0)
        number[new] = len(self.mean) + np.arange(len(new))
        self.mean = np.concatenate([self.mean, mean[new]])
        self.covariance = np.concatenate([self.covariance, covariance[new]])
        self.unseen = np.concatenate([self.unseen, np.zeros(len(new), int)])
        self.looks = np.concatenate([self.looks, np.zeros(len(new), int)])
        self.still = np.concatenate([self.still, np.zeros(len(new), bool)])
        return number

    def _take(self, ball: int, seen: np.ndarray, spread: np.ndarray) -> None:
        """Correct a ball by a centre and radius (d + 1,) that were fitted to its points."""
        part = self.d + 1
        before = self.covariance[ball]
        gain = before[:, :part] @ np.linalg.inv(before[:part, :part] + spread)
        self.mean[ball] += gain @ (seen - self.mean[ball, :part])
        self.covariance[ball] = before - gain @ before[:part]
        self.unseen[ball] = 0


def _stay(points: np.ndarray, before: np.ndarray, near: float) -> np.ndarray:
    """Return which points (p, d) are where a scan before (q, d) saw something: between its two nearest points.

    Args:
        near: how far from there at most, m.
    """
    if len(before) < 2:
        return np.zeros(len(points), bool)
    offset = before - points[:, None]
    nearest = np.argsort(np.einsum("pqd,pqd->pq", offset, offset), axis=1)[:, :2]
    one, two = (offset[np.arange(len(points)), nearest[:, i]] for i in range(2))
    edge = two - one
    share = -np.einsum("pd,pd->p", one, edge) / np.maximum(np.einsum("pd,pd->p", edge, edge), 1e-12)
    gap = one + np.clip(share, 0, 1)[:, None] * edge
    return np.einsum("pd,pd->p", gap, gap) < near**2


def _rows(mean: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return distances (t, p) of points from the balls' surfaces, and their gradient (t, p, d + 1)."""
    d = points.shape[1]
    offset = points - mean[:, None, :d]
    length = np.sqrt(np.einsum("tpi,tpi->tp", offset, offset))
    gradient = -np.ones((*offset.shape[:2], d + 1))
    gradient[..., :d] = -offset / np.maximum(length, 1e-9)[..., None]
    return length - mean[:, None, d], gradient


def _fitted(
    mean: np.ndarray,
    covariance: np.ndarray,
    points: np.ndarray,
    owner: np.ndarray,
    start: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return balls corrected by the points they own, and the owners again, -1 for points that do not fit.

    Gauss-Newton from `start` on the points' distances and the prior, with Cauchy's weights: few outliers do
    not count.
    """
    d = points.shape[1]
    part = d + 1  # a point says nothing of a velocity
    own = owner == np.arange(len(mean))[:, None]
    prior, information = mean, np.linalg.inv(covariance)
    mean = mean if start is None else start
    precision = information
    for _ in range(ITERATIONS):
        gap, gradient = _rows(mean, points)
        weight = own / (NOISE**2 * (1 + (gap / (3 * NOISE)) ** 2))
        precision = information.copy()
        precision[:, :part, :part] += np.einsum("tp,tpi,tpj->tij", weight, gradient, gradient)
        pull = np.einsum("tij,tj->ti", information, prior - mean)
        pull[:, :part] -= np.einsum("tp,tp,tpi->ti", weight, gap, gradient)
        mean = mean + np.linalg.solve(precision, pull[..., None])[..., 0]
        mean[:, d] = np.maximum(mean[:, d], 0.05)
    gap, _ = _rows(mean, points)
    fits = (own & (np.abs(gap) < GATE)).any(0)
    return mean, np.linalg.inv(precision), np.where(fits, owner, -1)
