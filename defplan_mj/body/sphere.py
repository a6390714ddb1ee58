"""Directions evenly spread over the sphere."""

from __future__ import annotations

import numpy as np


def sphere_directions(count: int) -> np.ndarray:
    """Return unit vectors (count, 3), evenly spread (a Fibonacci spiral)."""
    z = 1.0 - (2.0 * np.arange(count) + 1.0) / count
    angle = np.pi * (3.0 - np.sqrt(5.0)) * np.arange(count)
    rho = np.sqrt(1.0 - z * z)
    return np.stack([rho * np.cos(angle), rho * np.sin(angle), z], axis=1)
