"""Iterative LQG over a short horizon with bounded controls: the paper's [15], in tangent coordinates.

Each iteration linearises the dynamics and expands the cost about the present trajectory, solves the resulting
linear-quadratic problem backwards with the controls kept in their box, and searches along the result
until the cost falls. The number of iterations is fixed, so that a decision takes the same work every time
and is the same to the bit.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

STEPS = tuple(0.5**i for i in range(6))  # of the line search
_DAMPING = (1e-9, 1e6)  # least and most; below the least it is none
_QP_ROUNDS = 30


class Model(Protocol):
    """What is controlled. States may be of any kind; changes of them are vectors (n_z,)."""

    def step(
        self, x: np.ndarray, u: np.ndarray, near: np.ndarray | None = None
    ) -> np.ndarray | None:
        """Return the state after one step; None if it cannot be computed. `near` is a guess of it."""

    def jacobian(
        self, x: np.ndarray, u: np.ndarray, x_next: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the step's derivatives (n_z, n_z), (n_z, r)."""

    def difference(self, x: np.ndarray, origin: np.ndarray) -> np.ndarray:
        """Return the changes (..., n_z) from `origin` to `x`."""

    def difference_jacobian(self, x: np.ndarray, origin: np.ndarray) -> np.ndarray:
        """Return (..., n_z, n_z): the derivative of `difference` by a change of x."""

    def changed(self, x: np.ndarray, z: np.ndarray) -> np.ndarray:
        """Return the state after the change `z`; the inverse of `difference`."""


@dataclass(frozen=True)
class Guide:
    """Steps that are known, with their derivatives: what steps nearby lead to is guessed from them.

    Attributes:
        before, after: (n, nx) the states of each step.
        controls: (n, r).
        a, b: (n, n_z, n_z), (n, n_z, r).
    """

    before: np.ndarray
    after: np.ndarray
    controls: np.ndarray
    a: np.ndarray
    b: np.ndarray

    def guess(self, model: Model, i: int, off: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Return about where step i leads from the change `off` (n_z,) of its state, under `u`."""
        change = self.a[i] @ off + self.b[i] @ (u - self.controls[i])
        return model.changed(self.after[i], change)


@dataclass(frozen=True)
class Cost:
    """Half the weighted squares of what the states and the controls are off from what is wanted.

    Attributes:
        states: (N, nx) wanted states 1 to N.
        weights: (N, n_z, n_z), symmetric, positive semidefinite; the last is the terminal one.
        controls: (N, r) wanted controls 0 to N - 1.
        effort: (r,) weights of the controls, positive.
    """

    states: np.ndarray
    weights: np.ndarray
    controls: np.ndarray
    effort: np.ndarray

    def value(self, model: Model, x: np.ndarray, u: np.ndarray) -> float:
        """Return the cost of states 1 to N, x (N, nx), and controls u (N, r)."""
        off, more = model.difference(x, self.states), u - self.controls
        weighted = (self.weights @ off[..., None])[..., 0]
        return 0.5 * float((off * weighted).sum() + (self.effort * more * more).sum())

    def expanded(self, model: Model, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return gradients (N, n_z) and Gauss-Newton Hessians (N, n_z, n_z) by changes of x."""
        off, by = model.difference(x, self.states), model.difference_jacobian(x, self.states)
        transposed = np.swapaxes(by, -1, -2) @ self.weights
        return (transposed @ off[..., None])[..., 0], transposed @ by


@dataclass(frozen=True)
class Plan:
    """A trajectory over the horizon.

    Attributes:
        states: (N + 1, nx), the first as it was given.
        controls: (N, r).
        gains: (N, r, n_z) of the last backward pass.
        costs: before the first iteration and after each.
        guide: for the plan from the next step on.
    """

    states: np.ndarray
    controls: np.ndarray
    gains: np.ndarray
    costs: tuple[float, ...]
    guide: Guide | None = None


def optimise(
    model: Model,
    cost: Cost,
    x0: np.ndarray,
    start: np.ndarray,
    bound: np.ndarray,
    iterations: int,
    guide: Guide | None = None,
) -> Plan:
    """Return the controls in [-bound, bound] that keep the cost low from `x0` on.

    Args:
        start: (N, r) controls to begin with; clipped to the bound.
        bound: (r,).
        iterations: how many, at least one; none of them raises the cost.
        guide: for the first steps of the first rollout; it saves time and changes nothing.
    """
    u = np.clip(start, -bound, bound)
    x = _rolled(model, x0, u, bound, guide)
    if x is None:  # not even the first controls can be followed: there is nothing to improve
        none = np.zeros((len(u), u.shape[1], cost.weights.shape[1]))
        return Plan(x0[None].repeat(len(u) + 1, 0), u, none, (np.inf,))
    states, u = x
    costs, damping, moved = [cost.value(model, states[1:], u)], 0.0, True
    for _ in range(iterations):
        if moved:
            a, b = _linearised(model, states, u)
            gradients, hessians = cost.expanded(model, states[1:])
        change, gains = backward(
            (a, b), (gradients, hessians), u - cost.controls, cost.effort, (-bound - u, bound - u), damping
        )  # fmt: skip
        moved, about = False, Guide(states[:-1], states[1:], u, a, b)
        for share in STEPS:
            tried = _rolled(model, x0, u + share * change, bound, about, gains)
            if tried is None:
                continue
            value = cost.value(model, tried[0][1:], tried[1])
            if value < costs[-1]:
                moved, (states, u) = True, tried
                break
        costs.append(value if moved else costs[-1])
        damping = _next_damping(damping, moved)
    guide = Guide(states[1:-1], states[2:], u[1:], a[1:], b[1:])
    return Plan(states, u, gains, tuple(costs), guide)


def _next_damping(damping: float, moved: bool) -> float:
    low, high = _DAMPING
    if moved:
        return damping / 10 if damping / 10 > low else 0.0
    return min(max(10 * damping, 1e-3), high)


def _linearised(model: Model, x: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    pairs = [model.jacobian(x[i], u[i], x[i + 1]) for i in range(len(u))]
    return np.array([a for a, _ in pairs]), np.array([b for _, b in pairs])


def _rolled(
    model: Model,
    x0: np.ndarray,
    controls_ahead: np.ndarray,
    bound: np.ndarray,
    guide: Guide | None,
    gains: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray] | None:
    """Return states and controls of a rollout of `controls_ahead`; None: it failed.

    Args:
        guide: what the first steps' results are guessed from.
        gains: (N, r, n_z) feedback to the guide's states before the steps.
    """
    states, controls = np.empty((len(controls_ahead) + 1, len(x0))), np.empty_like(controls_ahead)
    states[0] = x0
    for i, control in enumerate(controls_ahead):
        known = guide if guide is not None and i < len(guide.before) else None
        if known:
            off = model.difference(states[i], known.before[i])
            control = control if gains is None else control + gains[i] @ off
        controls[i] = np.minimum(np.maximum(control, -bound), bound)
        near = known.guess(model, i, off, controls[i]) if known else None
        after = model.step(states[i], controls[i], near)
        if after is None:
            return None
        states[i + 1] = after
    return states, controls


def backward(
    linear: tuple[np.ndarray, np.ndarray],
    quadratic: tuple[np.ndarray, np.ndarray],
    off: np.ndarray,
    effort: np.ndarray,
    box: tuple[np.ndarray, np.ndarray],
    damping: float = 0.0,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the changes of the controls (N, r) and the gains (N, r, n_z) of the linear-quadratic problem.

    Args:
        linear: A (N, n_z, n_z), B (N, n_z, r).
        quadratic: gradients (N, n_z) and Hessians (N, n_z, n_z) of the cost by states 1 to N.
        off: (N, r) controls less the wanted ones.
        effort: (r,).
        box: lower and upper bounds (N, r) of the changes; 0 lies between.
        damping: of the change, in units of the effort.
    """
    (a, b), (gradients, hessians), (low, high) = linear, quadratic, box
    n, r = off.shape
    change, gains = np.empty((n, r)), np.zeros((n, r, a.shape[1]))
    slope, curve = np.zeros(a.shape[1]), np.zeros(a.shape[1:])
    weight = np.diag(effort)
    for i in range(n - 1, -1, -1):
        slope, curve = slope + gradients[i], curve + hessians[i]
        through = curve @ b[i]
        qu, quu = effort * off[i] + b[i].T @ slope, weight + b[i].T @ through
        qux = through.T @ a[i]
        damped = quu + damping * weight
        change[i], free = box_minimum(damped, qu, low[i], high[i])
        gain = gains[i]
        if free.all():
            gain[:] = -np.linalg.solve(damped, qux)
        elif free.any():
            gain[free] = -np.linalg.solve(damped[np.ix_(free, free)], qux[free])
        slope = a[i].T @ slope + gain.T @ (quu @ change[i] + qu) + qux.T @ change[i]
        curve = a[i].T @ curve @ a[i] + gain.T @ quu @ gain + gain.T @ qux + qux.T @ gain
        curve = 0.5 * (curve + curve.T)
    return change, gains


def box_minimum(
    hessian: np.ndarray, gradient: np.ndarray, low: np.ndarray, high: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return argmin of x H x / 2 + g x over low <= x <= high, and which entries are free (r,).

    Projected Newton (Bertsekas): what lies at a bound and would go on beyond it is held there.

    Args:
        hessian: (r, r), positive definite.
        gradient: (r,).
        low, high: (r,); 0 lies between.
    """
    x = -np.linalg.solve(hessian, gradient)
    if (x >= low).all() and (x <= high).all():
        return x, np.ones(len(x), bool)
    x = np.minimum(np.maximum(x, low), high)
    free = np.ones(len(x), bool)
    for _ in range(_QP_ROUNDS):
        slope = gradient + hessian @ x
        free = ~(((x <= low) & (slope > 0)) | ((x >= high) & (slope < 0)))
        size = np.abs(slope[free]).max(initial=0.0)
        if size <= 1e-12 * (1 + np.abs(gradient).max()):
            break
        direction = np.zeros_like(x)
        direction[free] = -np.linalg.solve(hessian[np.ix_(free, free)], slope[free])
        value, share = x @ (0.5 * hessian @ x + gradient), 1.0
        while True:
            tried = np.minimum(np.maximum(x + share * direction, low), high)
            fall = slope @ (tried - x)
            if tried @ (0.5 * hessian @ tried + gradient) <= value + 0.1 * fall or share < 1e-8:
                break
            share *= 0.5
        if (tried == x).all():
            break
        x = tried
    return x, free


def cost_to_go(
    a: np.ndarray,
    b: np.ndarray,
    weights: np.ndarray,
    effort: np.ndarray,
    turn: np.ndarray,
    cycles: int = 50,
    tolerance: float = 1e-6,
) -> np.ndarray:
    """Return (n, n_z, n_z): the quadratic cost of going on for ever along a cycle, from each step.

    The periodic Riccati equation, by value iteration from 0: cycles are added in front until that changes
    nothing, or `cycles` of them.

    Args:
        a, b: Jacobians (n, n_z, n_z), (n, n_z, r) of the steps.
        weights: (n, n_z, n_z) of the state before each step.
        effort: (r,).
        turn: (n_z, n_z) what the change of frame at the cycle's end does to a change of state.
    """
    n, size = len(a), a.shape[1]
    matrices, value = np.zeros((n, size, size)), np.zeros((size, size))
    for _ in range(cycles):
        before, value = value, turn.T @ value @ turn
        for i in range(n - 1, -1, -1):
            through = value @ b[i]
            quu, qux = np.diag(effort) + b[i].T @ through, through.T @ a[i]
            value = weights[i] + a[i].T @ value @ a[i] - qux.T @ np.linalg.solve(quu, qux)
            value = 0.5 * (value + value.T)
            matrices[i] = value
        if np.abs(value - before).max() <= tolerance * np.abs(value).max():
            break
    return matrices
