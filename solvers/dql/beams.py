"""The paper's CNN over the beams of a laser: which beams a filter looks at, and how it acts, in plain NumPy."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from defplan_mj.base.space import SPACES
from defplan_mj.planning.sensors.laser import beam_directions
from defplan_mj.task import Navigation

WIDTHS = (8, 4, 4)  # of the CNN's filters
FILTERS = 16  # of each layer
FEATURES = 32  # of the CNN


def taps(beams: int, space: str, width: int) -> np.ndarray:
    """Return the (beams, width) beams that a filter of `width` weights looks at around each beam.

    On the circle these are the beam and those to its left. On the sphere they are its neighbours, all
    different, that fit best on a small sunflower around it, as dense as the beams and turned with the
    meridian, so that a weight means about the same direction everywhere but at the poles.
    """
    if SPACES[space].level:
        return (np.arange(beams)[:, None] + np.arange(width)) % beams
    directions = beam_directions(beams, space)
    east = np.column_stack([-directions[:, 1], directions[:, 0], np.zeros(beams)])
    east /= np.linalg.norm(east, axis=1, keepdims=True)
    north = np.cross(directions, east)
    j = np.arange(width)
    # A disc of j beams' solid angle, j 4 pi / beams, has this radius (rad).
    away, angle = 2 * np.sqrt(j / beams), np.pi * (3 - np.sqrt(5)) * j
    places = directions[:, None] * np.cos(away)[:, None]
    places = places + east[:, None] * (np.sin(away) * np.cos(angle))[:, None]
    places = places + north[:, None] * (np.sin(away) * np.sin(angle))[:, None]
    return np.array([linear_sum_assignment(fit, maximize=True)[1] for fit in places @ directions.T])


@dataclass(frozen=True)
class BeamFilters:
    """The trained CNN: proximities of beams to `FEATURES` features.

    Attributes:
        filters: weights of each layer, (16, width x channels).
        biases: of each layer, (16,).
        dense, dense_bias: of the last layer, (FEATURES, beams x 16) and (FEATURES,).
        looks: the taps of each layer, (beams, width).
    """

    filters: tuple[np.ndarray, ...]
    biases: tuple[np.ndarray, ...]
    dense: np.ndarray
    dense_bias: np.ndarray
    looks: tuple[np.ndarray, ...]

    @property
    def count(self) -> int:
        """The number of beams."""
        return len(self.looks[0])

    def arrays(self) -> dict[str, np.ndarray]:
        """Return what a file keeps of it, by name."""
        named = {"dense": self.dense, "dense_bias": self.dense_bias}
        for i, (weight, bias) in enumerate(zip(self.filters, self.biases, strict=True)):
            named[f"filter{i}"], named[f"filter_bias{i}"] = weight, bias
        return named

    @classmethod
    def take(cls, arrays: dict[str, np.ndarray], navigation: Navigation) -> BeamFilters:
        """Take its arrays out of those of a file. Raises ValueError or KeyError: they do not fit."""
        beams, space = navigation.beams, navigation.space
        sizes = {"dense": (FEATURES, FILTERS * beams), "dense_bias": (FEATURES,)}
        for i, width in enumerate(WIDTHS):
            sizes[f"filter{i}"] = (FILTERS, width * (FILTERS if i else 1))
            sizes[f"filter_bias{i}"] = (FILTERS,)
        for name, size in sizes.items():
            if arrays[name].shape != size:
                raise ValueError(f"{name} is {arrays[name].shape}, not {size}")
        taken = {name: arrays.pop(name) for name in sizes}
        layers = range(len(WIDTHS))
        return cls(
            tuple(taken[f"filter{i}"] for i in layers),
            tuple(taken[f"filter_bias{i}"] for i in layers),
            taken["dense"],
            taken["dense_bias"],
            tuple(taps(beams, space, width) for width in WIDTHS),
        )

    def __call__(self, proximities: np.ndarray) -> np.ndarray:
        """Return the (n, FEATURES) features of (n, beams) proximities."""
        x = proximities[..., None]  # n, beams, channels
        for weight, bias, look in zip(self.filters, self.biases, self.looks, strict=True):
            seen = x[:, look].reshape(*x.shape[:2], -1)
            x = softplus(seen @ weight.T + bias)
        return softplus(x.reshape(len(x), -1) @ self.dense.T + self.dense_bias)


def softplus(x: np.ndarray) -> np.ndarray:
    """Return log(1 + exp(x)), the paper's BNLL, float32 as x is."""
    return np.logaddexp(x, np.float32(0))
