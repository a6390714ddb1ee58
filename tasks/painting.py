"""Colours as formulas: what the skins of the suite's bodies are painted with."""

from __future__ import annotations

import numpy as np


def rise(value: np.ndarray, low: float, high: float) -> np.ndarray:
    """Return (..., 1): 0 below `low`, 1 above `high`, smooth between."""
    share = np.clip((value - low) / (high - low), 0, 1)
    return (share * share * (3 - 2 * share))[..., None]


def blend(colour: np.ndarray, other: np.ndarray, share: np.ndarray) -> np.ndarray:
    """Return `colour` where `share` (..., 1) is 0, `other` where it is 1; colours (..., 3)."""
    return colour + share * (other - colour)


def to_picture(colour: np.ndarray) -> np.ndarray:
    """Return colours (h, w, 3) of 0 to 1 as a uint8 picture."""
    return np.round(255 * np.clip(colour, 0, 1)).astype(np.uint8)
