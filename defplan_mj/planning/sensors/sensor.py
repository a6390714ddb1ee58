"""What a sensor is, what it can ask of its surroundings, and which one a task has."""

from __future__ import annotations

from functools import lru_cache
from typing import Protocol

import numpy as np

from defplan_mj import registry
from defplan_mj.base.errors import DefplanError
from defplan_mj.task import Navigation


class View(Protocol):
    """The surroundings of a robot, or of n robots at once (then everything has n rows more).

    MuJoCo's scene and the surrogate's both are such a view, so that a sensor is written once. All is
    in the robot's frame, of d dimensions: its yaw frame in the plane, its body frame in space.
    """

    def cast(self, directions: np.ndarray, farthest: float) -> np.ndarray:
        """Return the distances (..., b) to what rays in `directions` (b, d) meet, m; `farthest` if nothing."""

    def obstacles(self) -> tuple[np.ndarray, np.ndarray]:
        """Return centres (..., m, d) and radii (..., m) of the obstacles, m; those of radius 0 are not there."""


class Sensor(Protocol):
    """A sensor plugin (entry point group `defplan_mj.sensors`).

    What it measures is a planner's observation['laser'], whatever the sensor, and the log's ranges.
    """

    @property
    def name(self) -> str:
        """What a task's `Navigation.sensor` says."""

    @property
    def summary(self) -> str:
        """One line."""

    @property
    def spaces(self) -> tuple[str, ...]:
        """Names of the spaces it works in."""

    def labels(self, navigation: Navigation) -> list[str]:
        """Return what each of the numbers of a reading is."""

    def measure(self, view: View, navigation: Navigation) -> np.ndarray:
        """Return the readings (..., size) in a view."""

    def points(self, readings: np.ndarray, navigation: Navigation) -> tuple[np.ndarray, np.ndarray]:
        """Return the points (..., p, d) that readings tell of, m, and whether something is there (..., p).

        The shield and the maps keep clear of these. A point where nothing is lies at the end of the
        range. Points are of the type of the readings.
        """

    def features(self, readings: np.ndarray, navigation: Navigation) -> np.ndarray:
        """Return readings (..., size) as a network takes them, of about unit size."""


@lru_cache
def sensor_of(navigation: Navigation) -> Sensor:
    """Return the sensor of a navigation problem.

    Raises:
        DefplanError: there is none of that name, or it is not for that space.
    """
    sensor = registry.get_sensor(navigation.sensor or navigation.place.sensor)
    if navigation.space not in sensor.spaces:
        raise DefplanError(
            f"the sensor {sensor.name} is for {' and '.join(sensor.spaces)} navigation,"
            f" not for {navigation.space}: take {navigation.place.sensor}"
        )
    return sensor


def reading_size(navigation: Navigation) -> int:
    """Return how many numbers a reading has."""
    return len(sensor_of(navigation).labels(navigation))


def seen_points(readings: np.ndarray, navigation: Navigation) -> np.ndarray:
    """Return the (p, d) points at which one reading (size,) says something is, in the robot's frame, m."""
    points, there = sensor_of(navigation).points(np.asarray(readings, float), navigation)
    return points[there]
