"""Where the laser's beams point: evenly around a circle, or evenly over a sphere."""

from __future__ import annotations

import functools

import numpy as np


@functools.lru_cache
def beam_directions(beams: int, space: str) -> np.ndarray:
    """Return the unit vectors (beams, d) of the beams in the frame that the laser turns with.

    In the plane (d = 2) beam k points 2 pi k / beams to the left of ahead. In space (d = 3) the beams
    lie on a Fibonacci spiral: from pole (+z) to pole, each a golden angle further round, so that each
    has about the same solid angle. The array is read-only.
    """
    k = np.arange(beams)
    if space == "planar":
        angle = 2 * np.pi * k / beams
        directions = np.column_stack([np.cos(angle), np.sin(angle)])
    else:
        angle = np.pi * (3 - np.sqrt(5)) * k
        height = 1 - (2 * k + 1) / beams
        across = np.sqrt(1 - height * height)
        directions = np.column_stack([across * np.cos(angle), across * np.sin(angle), height])
    directions.flags.writeable = False
    return directions
