"""Many robots of one body, each a control step further by one call: threads of the kernel, no Python between."""

from __future__ import annotations

import ctypes
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from defplan_mj.base import threads
from defplan_mj.base.errors import DefplanError
from defplan_mj.dynamics.reduced import ReducedDynamics
from defplan_mj.kernel.library import kernel

_SMALL = 8  # robots that a second thread is not worth


class Batch:
    """The states of n robots. Results do not depend on the number of threads.

    Attributes:
        states: (n, nx), kernel.h's layout.
        failed: (n,) whether the last step of a robot had no solution: its state is then
            the one before, with the new target.
    """

    def __init__(self, dynamics: ReducedDynamics, n: int, workers: int | None = None) -> None:
        """Start n robots at rest.

        Args:
            dynamics: of all of them.
            n: at least 1.
            workers: threads; by default one a core.
        """
        if n < 1:
            raise DefplanError(f"a batch of {n} robots: at least one is needed")
        self.dynamics = dynamics
        self.states = np.tile(dynamics.rest_state(), (n, 1))
        self.failed = np.zeros(n, np.int32)
        self._next = np.empty_like(self.states)
        count = min(threads.available_cores() if workers is None else workers, -(-n // _SMALL))
        self._parts = [part for part in np.array_split(np.arange(n), count) if len(part)]
        self._pool = ThreadPoolExecutor(count) if count > 1 else None

    def step(self, inputs: np.ndarray) -> np.ndarray:
        """Take a control step under the inputs (n, nu), in place; returns `failed`."""
        shape = (len(self.states), self.dynamics.nu)
        u = np.ascontiguousarray(inputs, np.float64)
        if u.shape != shape:
            raise DefplanError(f"the inputs have shape {u.shape}, they need {shape}")
        if self._pool is None:
            self._part(u, self._parts[0])
        else:
            list(self._pool.map(lambda part: self._part(u, part), self._parts))
        self.states, self._next = self._next, self.states
        return self.failed

    def close(self) -> None:
        """End the threads."""
        if self._pool is not None:
            self._pool.shutdown()

    def _part(self, u: np.ndarray, part: np.ndarray) -> None:
        """Step the robots `part`, which follow each other."""
        first, n = int(part[0]), len(part)
        x, inputs, out, failed = (
            a[first:].ctypes.data for a in (self.states, u, self._next, self.failed)
        )
        model = ctypes.byref(self.dynamics.model)
        kernel().dp_step_many(model, n, x, inputs, out, self.dynamics.nu, failed)
