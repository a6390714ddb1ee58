"""Wall times of calls."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Timing:
    """Wall times of one call, seconds."""

    samples: np.ndarray

    @property
    def median(self) -> float:
        """Half of the calls are faster."""
        return float(np.median(self.samples))

    @property
    def p99(self) -> float:
        """One call of a hundred is slower."""
        return float(np.quantile(self.samples, 0.99))

    def scaled(self, unit: float, digits: int = 2) -> dict[str, float]:
        """Return median and p99 in units of `unit` seconds."""
        return {
            "median": round(self.median / unit, digits),
            "p99": round(self.p99 / unit, digits),
        }


def measure(call: Callable[[], Any], repeats: int, warm: int = 3) -> Timing:
    """Time `repeats` calls, after `warm` untimed ones."""
    for _ in range(warm):
        call()
    samples = np.empty(repeats)
    clock = time.perf_counter_ns
    for i in range(repeats):
        start = clock()
        call()
        samples[i] = clock() - start
    return Timing(1e-9 * samples)
