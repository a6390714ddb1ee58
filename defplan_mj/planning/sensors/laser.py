"""What lasers have in common: beams in fixed directions, of which each says how far it goes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from defplan_mj.base.errors import DefplanError
from defplan_mj.base.space import SPACES
from defplan_mj.planning.sensors.sensor import View, sensor_of
from defplan_mj.task import Navigation

_HIT = 1 - 1e-6  # of the range: a beam that goes as far has met nothing


@dataclass(frozen=True)
class Laser:
    """A laser scanner of `Navigation.beams` beams and `Navigation.laser_range`.

    Attributes:
        directions: of n beams, the unit vectors (n, d), read-only.
    """

    name: str
    summary: str
    spaces: tuple[str, ...]
    directions: Callable[[int], np.ndarray]

    def labels(self, navigation: Navigation) -> list[str]:
        """Return the names of the beams."""
        return [f"beam {i}" for i in range(navigation.beams)]

    def measure(self, view: View, navigation: Navigation) -> np.ndarray:
        """Return how far each beam goes (..., beams), at most the range, m."""
        return view.cast(self.directions(navigation.beams), navigation.laser_range)

    def points(self, readings: np.ndarray, navigation: Navigation) -> tuple[np.ndarray, np.ndarray]:
        """Return the beams' ends (..., beams, d), m, and whether they are hits."""
        directions = self.directions(readings.shape[-1]).astype(readings.dtype)
        return readings[..., None] * directions, readings < navigation.laser_range * _HIT

    def features(self, readings: np.ndarray, navigation: Navigation) -> np.ndarray:
        """Return the beams' proximities (..., beams), 1 - distance / range."""
        return 1.0 - readings / navigation.laser_range


def laser_of(navigation: Navigation) -> Laser:
    """Return the laser of a navigation problem, for planners that look at its beams.

    Raises:
        DefplanError: its sensor is no laser.
    """
    sensor = sensor_of(navigation)
    if not isinstance(sensor, Laser):
        raise DefplanError(
            f"this planner looks at a laser's beams, and the sensor {sensor.name} has none:"
            f" take another planner, or the sensor {navigation.place.sensor}"
        )
    return sensor


def beam_directions(beams: int, space: str) -> np.ndarray:
    """Return the unit vectors (beams, d) of the laser that robots have in a space."""
    return laser_of(Navigation(beams=beams, space=SPACES[space].name)).directions(beams)
