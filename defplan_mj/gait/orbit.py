"""The orbit of a gait: the motion that repeats when one task's cycle is played for ever.

A cycle moves the body, so it repeats up to a rigid motion: each cycle's states are told from the frame at its
start (`dynamics.tangent.Frame`). The orbit is found by Newton's method on the cycle's return map with exact
derivatives, so that it is found even if it is not stable, where simulation alone would never show it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from defplan_mj.dynamics import tangent
from defplan_mj.dynamics.reduced import ReducedDynamics
from defplan_mj.dynamics.tangent import Frame

ROUNDS = 30
TOLERANCE = 1e-9
_HALVINGS = 6


@dataclass(frozen=True)
class Orbit:
    """One cycle that repeats.

    Attributes:
        states: (n + 1, nx) told from the frame at its start.
        shapes: (n, r) target shapes, state i to i + 1.
        a, b: (n, n_z, n_z), (n, n_z, r) Jacobians of its steps in tangent coordinates.
        motion: of the frame over the cycle.
        residual: norm of what is not repeated, in tangent coordinates.
        multiplier: largest growth of a small disturbance over a cycle; stable below 1.
        level, depth: how frames are taken, see `Frame.of`.
    """

    states: np.ndarray
    shapes: np.ndarray
    a: np.ndarray
    b: np.ndarray
    motion: Frame
    residual: float
    multiplier: float
    level: bool
    depth: bool

    def unrolled(self, steps: int) -> np.ndarray:
        """Return the states (steps + 1, nx) of the orbit repeated, all told from the first frame."""
        n, frame, states = len(self.shapes), None, [self.states[0]]
        for i in range(1, steps + 1):
            state = self.states[(i - 1) % n + 1]
            states.append(state if frame is None else frame.outside(state))
            if i % n == 0:
                frame = self.motion if frame is None else frame.then(self.motion)
        return np.array(states)


def find_orbit(
    dynamics: ReducedDynamics,
    shapes: np.ndarray,
    *,
    level: bool = True,
    depth: bool = True,
    warm: int = 8,
    rounds: int = ROUNDS,
) -> Orbit:
    """Return the orbit of a cycle of target shapes.

    Args:
        shapes: (n, r) of one cycle.
        level, depth: what the dynamics does not notice: headings only or all attitudes; heights.
        warm: cycles from rest that are played before the search.
        rounds: of Newton's method; it ends sooner at a residual of 1e-9.

    Returns:
        The best cycle found; its `residual` says how well it repeats.
    """
    x = dynamics.rest_state()
    x = Frame.of(x, level, depth).inside(x)
    seen = []
    for _ in range(warm):
        cycle = _Cycle(dynamics, shapes, x, level, depth)
        seen.append(cycle)
        x = cycle.end
    best = min(seen, key=lambda cycle: cycle.residual)
    for _ in range(rounds):
        if best.residual < TOLERANCE:
            break
        change, better = best.newton(), best
        for halving in range(_HALVINGS):
            start = tangent.retract(best.states[0], _limited(change) * 0.5**halving)
            start = Frame.of(start, level, depth).inside(start)
            tried = _Cycle(dynamics, shapes, start, level, depth)
            if tried.residual < best.residual:
                better = tried
                break
        if better is best:
            break
        best = better
    return best.orbit()


def _limited(change: np.ndarray) -> np.ndarray:
    """Return the change, shortened to a turn of at most half a radian."""
    return change * min(1.0, 0.5 / max(float(np.linalg.norm(change[3:6])), 1e-12))


class _Cycle:
    """One cycle played from `start`, a state told from its own frame."""

    def __init__(self, dynamics: ReducedDynamics, shapes: np.ndarray, start: np.ndarray,
                 level: bool, depth: bool) -> None:  # fmt: skip
        self.dynamics, self.shapes, self.level, self.depth = dynamics, shapes, level, depth
        self.states, failed = dynamics.rollout_count(start, shapes)
        self.frame = Frame.of(self.states[-1], level, depth)
        self.end = self.frame.inside(self.states[-1])
        self.gap = tangent.difference(self.end, start)
        self.residual = np.inf if failed else float(np.linalg.norm(self.gap))

    def jacobians(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the steps' Jacobians in tangent coordinates."""
        pairs = []
        for x, u, y in zip(self.states, self.shapes, self.states[1:], strict=False):
            pairs.append(tangent.step_jacobian(x, y, *self.dynamics.step_jacobian(x, u, y)))
        return np.array([a for a, _ in pairs]), np.array([b for _, b in pairs])

    def map(self, a: np.ndarray) -> np.ndarray:
        """Return the return map's Jacobian (n_z, n_z): of `end` by `start`, frames taken out."""
        total = np.eye(a.shape[1])
        for one in a:
            total = one @ total
        turned = turn_tangent(self.frame.matrix.T, a.shape[1])
        return _frame_removed(self.end, self.level, self.depth) @ turned @ total

    def newton(self) -> np.ndarray:
        """Return the change (n_z,) of the start that Newton's method asks for.

        The least one: what only moves the frame changes nothing, and is left alone.
        """
        return_map = self.map(self.jacobians()[0])
        matrix = return_map - np.eye(len(return_map))
        keep = _frame_removed(self.states[0], self.level, self.depth)
        change = np.linalg.lstsq(matrix @ keep, -self.gap, rcond=1e-10)[0]
        return keep @ change

    def orbit(self) -> Orbit:
        a, b = self.jacobians()
        growth = np.abs(np.linalg.eigvals(self.map(a))).max()
        return Orbit(self.states, self.shapes, a, b, self.frame, self.residual, float(growth),
                     self.level, self.depth)  # fmt: skip


def turn_tangent(matrix: np.ndarray, n: int) -> np.ndarray:
    """Return (n, n): what turning the frame of reference does to changes of centre and velocity."""
    out, r = np.eye(n), (n - 12) // 2
    out[:3, :3] = matrix
    out[6 + r : 9 + r, 6 + r : 9 + r] = matrix
    return out


def _frame_removed(x: np.ndarray, level: bool, depth: bool) -> np.ndarray:
    """Return (n_z, n_z): changes of x as changes of x told from its own frame; x is told from it."""
    n = tangent.size(len(x))
    velocity = slice(6 + (n - 12) // 2, 9 + (n - 12) // 2)
    moved, turned = np.zeros((3, n)), np.zeros((3, n))  # how the frame moves and turns with x
    moved[:3, :3] = np.diag([1.0, 1.0, float(depth)])
    attitude = Frame(np.zeros(3), x[3:7]).matrix
    if level:
        ahead = attitude[:, 0]
        # the first column of R changes by R (0, theta_z, -theta_y)
        by = np.outer(attitude[:, 2], [0, -1, 0]) + np.outer(attitude[:, 1], [0, 0, 1])
        turned[2, 3:6] = (ahead[0] * by[1] - ahead[1] * by[0]) / (ahead[:2] @ ahead[:2])
    else:
        turned[:, 3:6] = attitude
    out = np.eye(n)
    out[:3] -= moved
    out[3:6] -= attitude.T @ turned
    v = x[(len(x) - 13) // 2 + 7 :][:3]
    out[velocity] += np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]]) @ turned
    # in the frame the centre stays at (0, 0, height), which turning about the vertical leaves there
    return out
