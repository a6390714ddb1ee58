"""What of a robot's past tells how its next decision moves it: a small automaton of the gaits just played."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np

MOST_PASTS = 400
"""More of them than this are not told apart: each has its motions, and planners a tree of what may follow."""


@dataclass(frozen=True)
class Past:
    """The pasts of a robot that chooses among K gaits, m times in a cycle, numbered from 0 to `rest`.

    A decision plays one segment, 1 / m of a cycle, of the gait that it chooses, at the phase that the last
    one ended at. What the segment does depends on the gaits of the segments before it. A past is the phase,
    and the gaits of the last segments, as many as make a cycle (fewer if those would be too many pasts), or
    of all segments if the robot has started from rest just now. With m = 1 past i is 'after gait i', and
    past K is rest.

    Attributes:
        gaits: K.
        decisions: m, in a cycle.
    """

    gaits: int
    decisions: int = 1

    @cached_property
    def memory(self) -> int:
        """Segments whose gaits are told apart."""
        fit = (h for h in range(self.decisions, 1, -1) if self._count(h) <= MOST_PASTS)
        return next(fit, 1)

    def _count(self, memory: int) -> int:
        return self.decisions * self.gaits**memory + sum(self.gaits**i for i in range(memory))

    @property
    def rest(self) -> int:
        """The past of a robot that was put down at rest: the last one."""
        return self._count(self.memory) - 1

    @cached_property
    def then(self) -> np.ndarray:
        """(rest + 1, K) the past once a gait was played after a past."""
        return self._tables[0]

    @cached_property
    def phase(self) -> np.ndarray:
        """(rest + 1,) the segment of the cycle that comes next, 0 to m - 1."""
        return self._tables[1]

    @cached_property
    def segment(self) -> np.ndarray:
        """(rest + 1,) what was just played: gait + K times its segment; K m at rest."""
        return self._tables[2]

    @cached_property
    def _tables(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        k, m, h = self.gaits, self.decisions, self.memory
        # the last h gaits are the digits of a number, the latest is its last one
        whole, gait = k**h, np.arange(k)
        code = np.arange(whole)
        then, phase, segment = [], [], []
        for last in range(m):
            after = (last + 1) % m
            then.append(after * whole + (code[:, None] * k + gait) % whole)
            phase.append(np.full(whole, after))
            segment.append(last * k + code % k)
        # from rest: one block for each number of segments that were played, then rest itself
        blocks = {0: self.rest}
        for played in range(1, h):
            blocks[played] = m * whole + sum(k**i for i in range(1, played))
        for played in [*range(1, h), 0]:
            code = np.arange(k**played)
            onward = blocks[played + 1] if played + 1 < h else played * whole
            then.append(onward + code[:, None] * k + gait)
            phase.append(np.full(len(code), played))
            segment.append((played - 1) * k + code % k if played else np.array([k * m]))
        return np.concatenate(then), np.concatenate(phase), np.concatenate(segment)

    def kept(self, phase: int) -> np.ndarray:
        """Return (K,) the past of a robot that has played one gait alone, and is at a phase of its cycle."""
        k, h = self.gaits, self.memory
        alike = sum(k**i for i in range(h))
        return (phase - 1) % self.decisions * k**h + np.arange(k) * alike

    def row(self, phase: np.ndarray, gaits: np.ndarray, played: np.ndarray) -> np.ndarray:
        """Return the pasts (n,) of n segments to come.

        Args:
            phase: (n,) of the segments to come.
            gaits: (n, memory) of the segments before, the latest one last.
            played: (n,) how many there were since the robot was at rest; only so many of `gaits` count.
        """
        past = np.full(len(phase), self.rest)
        full = played >= self.memory
        digits = self.gaits ** np.arange(self.memory)[::-1]
        past[full] = (phase[full] - 1) % self.decisions * self.gaits**self.memory
        past[full] += gaits[full] @ digits
        for i in np.flatnonzero(~full):
            for gait in gaits[i, self.memory - played[i] :]:
                past[i] = self.then[past[i], gait]
        return past


@cache
def past_of(gaits: int, decisions: int = 1) -> Past:
    """Return the pasts of a robot, whose tables are made once."""
    return Past(gaits, decisions)
