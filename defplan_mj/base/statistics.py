"""Statistics of episodes: rates with their uncertainty."""

from __future__ import annotations

import numpy as np


def wilson_interval(count: int, n: int) -> tuple[float, float]:
    """Return the 95% interval of a rate by Wilson's score, of `count` successes in `n` trials."""
    z = 1.959963984540054
    rate, weight = count / n, z * z / n
    centre = (rate + weight / 2) / (1 + weight)
    half = z / (1 + weight) * np.sqrt(rate * (1 - rate) / n + weight / (4 * n))
    # at the ends exactly, whatever is rounded
    low = 0.0 if count == 0 else float(centre - half)
    high = 1.0 if count == n else float(centre + half)
    return low, high
