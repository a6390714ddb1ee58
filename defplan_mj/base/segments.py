"""Distances of points from straight segments."""

from __future__ import annotations

import numpy as np


def segment_distance(point: np.ndarray, start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Return the distance of points to segments; all arguments (..., d), broadcast together."""
    edge = end - start
    offset = point - start
    length = np.einsum("...d,...d->...", edge, edge)
    length = np.maximum(length, np.finfo(length.dtype).tiny)  # of a point: its distance
    share = np.clip(np.einsum("...d,...d->...", offset, edge) / length, 0, 1)
    gap = offset - share[..., None] * edge
    return np.sqrt(np.einsum("...d,...d->...", gap, gap))
