"""Gauss-Newton for contact-invariant optimisation: several walks side by side, with damping.

Unknowns of a step: the state after it, the forces on the feet, and the target shape, or w through the
DMP. Forces (and target shapes) touch one step and are eliminated there; the states make a block
tridiagonal matrix; w and E_obj's ties between the ends of a cycle are its border.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from defplan_mj.dynamics.symbolic import retract_function
from defplan_mj.gait.problem import GaitProblem
from defplan_solvers.cio.model import Walker
from defplan_solvers.cio.terms import Weights, cycle_function, stage_function, state_scale
from defplan_solvers.gait.trajectories import Compiled

_FORCE, _SHAPE, W_METRIC, _STATE = 0.3, 0.3, 0.3, 30.0  # of the damping: forces, shapes, w, states
_LONGEST = 0.5  # of a step of the states, in rad and units of q
_LEAST_DAMPING = 1e-7
_GOOD, _FAIR = 0.7, 0.2  # part of the promised decrease from which damping is lowered, and kept


@dataclass(frozen=True)
class Iterate:
    """B walks of N steps each, all from rest.

    Attributes:
        states: (B, N + 1, nx), the start first.
        forces: (B, N, 3F) on the feet, foot after foot, in units of the weight.
        shapes: (B, N, r) target shapes, if they are unknowns; else those of w.
        w: (B, n_w) DMP of each walk's one task: mu, alpha, beta.
    """

    states: np.ndarray
    forces: np.ndarray
    shapes: np.ndarray
    w: np.ndarray

    def where(self, chosen: np.ndarray, other: Iterate) -> Iterate:
        """Return these walks where `chosen` (B,), and the other ones elsewhere."""
        return Iterate(
            *(
                np.where(chosen.reshape((-1,) + (1,) * (a.ndim - 1)), a, b)
                for a, b in zip(self.arrays(), other.arrays(), strict=True)
            )
        )

    def arrays(self) -> tuple[np.ndarray, ...]:
        """Return the four arrays: states, forces, shapes, w."""
        return self.states, self.forces, self.shapes, self.w


class ContactInvariant:
    """Eq. 1 for B walks of one task each.

    With `joint` the target shapes are the DMP's, w is unknown but for its phases mu; without, they
    are unknowns and w is fixed.
    """

    def __init__(
        self,
        walker: Walker,
        problem: GaitProblem,
        tasks: list[int],
        cycles: int,
        *,
        joint: bool,
        settle: int = 1,
        bound: float = 4.0,
        threads: int = 1,
    ):
        self.walker, self.problem, self.tasks, self.joint = walker, problem, tasks, joint
        self.bound, self.cycles, self.settle = bound, cycles, settle
        self.n = problem.steps_per_cycle
        self.count, self.steps, self.nt = len(tasks), cycles * self.n, walker.nx - 1
        self.alone = [problem.alone(j) for j in tasks]
        judged = cycles - settle
        self.starts = self.n * np.arange(settle, cycles)  # states at which judged cycles start
        self.goals = problem.goals.T[np.repeat(tasks, judged)]
        total, mode = self.count * self.steps, ("thread", threads) if threads > 1 else ()
        self._stage, self._stage_jacobian = (
            Compiled(stage_function(walker, problem, judged, jacobian).map(total, *mode))
            for jacobian in (False, True)
        )
        self._cycle, self._cycle_jacobian = (
            Compiled(cycle_function(problem, walker.nx, judged, jacobian).map(self.count * judged))
            for jacobian in (False, True)
        )
        self._retract = Compiled(retract_function(walker.nx).map(total))
        self._dmp, self._dmp_jacobian, self._of_w, self._of_w_derivatives = self._w_functions()
        metric = np.full(self.nt, _STATE) * (state_scale(walker)) ** 2
        self.metric = metric

    def _w_functions(self) -> tuple[ca.Function, ca.Function, ca.Function, ca.Function]:
        alone = self.alone[0]  # the DMP and its regularisation are the same for every task
        w = ca.MX.sym("w", alone.n_w)
        shapes, free = ca.vec(alone.dmp(w)), slice(alone.n_phases, alone.n_w)
        regular = alone.regularisation(w)
        hessian, gradient = ca.hessian(regular, w)
        jacobian = ca.densify(ca.jacobian(shapes, w)[:, free])
        derivatives = [ca.densify(gradient[free]), ca.densify(hessian[free, free])]
        return (
            ca.Function("dmp", [w], [shapes]),
            ca.Function("dmp_jacobian", [w], [jacobian]),
            ca.Function("regular", [w], [regular]),
            ca.Function("regular_derivatives", [w], derivatives),
        )

    def dmp(self, w: np.ndarray) -> np.ndarray:
        """Return the target shapes (B, N, r) of DMPs w (B, n_w)."""
        cycle = np.array([np.array(self._dmp(v)).reshape(self.n, -1) for v in w])
        return np.tile(cycle, (1, self.cycles, 1))

    def regular(self, w: np.ndarray) -> float:
        """Return what E_obj has of w (n_w,) of a task alone."""
        return float(self._of_w(w))

    def of_w(self, w: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return gradient and Hessian of `regular` at w (n_w,), over alpha and beta."""
        gradient, hessian = self._of_w_derivatives(w)
        return np.array(gradient).ravel(), np.array(hessian)

    # --- values

    def _inputs(self, walk: Iterate, weights: Weights) -> list[np.ndarray]:
        shapes_of_w = self.dmp(walk.w)
        shapes = shapes_of_w if self.joint else walk.shapes
        x = walk.states
        arrays = (x[:, :-1], x[:, 1:], walk.forces, shapes, shapes_of_w)
        flat = [a.reshape(self.count * self.steps, -1) for a in arrays]
        return [*flat, np.tile(weights.array(), (len(flat[0]), 1))]

    def _ends(self, walk: Iterate, weights: Weights) -> list[np.ndarray]:
        x = walk.states
        pair = (x[:, self.starts], x[:, self.starts + self.n])
        flat = [a.reshape(-1, x.shape[2]) for a in pair]
        return [*flat, self.goals, np.full((len(flat[0]), 1), weights.objective)]

    def residuals(self, walk: Iterate, weights: Weights) -> tuple[np.ndarray, np.ndarray]:
        """Return the residuals of the steps (B, N, m) and of the cycles' motions (B, judged m)."""
        (stage,) = self._stage(*self._inputs(walk, weights))
        (cycle,) = self._cycle(*self._ends(walk, weights))
        return stage.reshape(self.count, self.steps, -1).copy(), cycle.reshape(
            self.count, -1
        ).copy()

    def cost(self, walk: Iterate, weights: Weights) -> np.ndarray:
        """Return the sum of all terms (B,)."""
        stage, cycle = self.residuals(walk, weights)
        regular = np.array([self.regular(w) for w in walk.w])
        return (stage**2).sum((1, 2)) + (cycle**2).sum(1) + weights.objective**2 * regular

    def parts(self, walk: Iterate, weights: Weights) -> dict[str, np.ndarray]:
        """Return mean squares (B,) without weights: of 'physics' a step (g), of 'contact' a step.

        'contact' is the squared gap and slip of feet that carry, in units of 5 cm, summed over feet.
        """
        unit = replace(weights, physics=1.0, contact=1.0)
        stage, _ = self.residuals(walk, unit)
        feet = stage[:, :, self.nt : self.nt + 9 * self.walker.n_feet]
        feet = feet.reshape(self.count, self.steps, self.walker.n_feet, 9)
        return {
            "physics": (stage[:, :, : self.nt] ** 2).sum(2).mean(1),
            "contact": (feet[..., :3] ** 2).sum((2, 3)).mean(1),
        }

    # --- a step

    def system(self, walk: Iterate, weights: Weights) -> System:
        """Linearise: the normal equations with forces, shapes and states apart, w and E_obj as border."""
        count, steps, nt, r = self.count, self.steps, self.nt, self.walker.nu
        value, jacobian = self._stage_jacobian(*self._inputs(walk, weights))
        jacobian = jacobian.reshape(count, steps, -1, value.shape[1])  # transposed
        value = value.reshape(count, steps, -1, 1)
        normal = jacobian @ jacobian.transpose(0, 1, 3, 2)
        gradient = (jacobian @ value)[..., 0]
        n_free = self.alone[0].n_w - self.alone[0].n_phases if self.joint else 0
        x, local = slice(0, 2 * nt), slice(2 * nt, normal.shape[2] - (r if self.joint else 0))
        border = np.zeros((count, steps, normal.shape[2], n_free))
        w_w, w_gradient = np.zeros((count, n_free, n_free)), np.zeros((count, n_free))
        if self.joint:
            by_w = np.array([self._dmp_jacobian(w) for w in walk.w])
            by_w = np.tile(by_w.reshape(count, self.n, r, n_free), (1, self.cycles, 1, 1))
            border = normal[..., -r:] @ by_w
            w_w = np.einsum("bnrv,bnrw->bvw", by_w, border[:, :, -r:], optimize=True)
            w_gradient = np.einsum("bnrw,bnr->bw", by_w, gradient[..., -r:])
            for b, w in enumerate(walk.w):
                g, h = self.of_w(w)
                w_gradient[b] += 0.5 * weights.objective**2 * g
                w_w[b] += 0.5 * weights.objective**2 * h
        cycle, by_ends = self._cycle_jacobian(*self._ends(walk, weights))
        judged = len(self.starts)
        by_ends = by_ends.reshape(count, judged, 2, nt, -1)
        ties = np.zeros((count, steps, nt, judged, by_ends.shape[-1]))
        for c, start in enumerate(self.starts):
            if start:
                ties[:, start - 1, :, c] += by_ends[:, c, 0]
            ties[:, start + self.n - 1, :, c] += by_ends[:, c, 1]
        return System(
            x_x=normal[:, :, x, x],
            x_local=normal[:, :, x, local],
            local_local=normal[:, :, local, local],
            x_w=border[:, :, x],
            local_w=border[:, :, local],
            w_w=w_w,
            x_gradient=gradient[:, :, x],
            local_gradient=gradient[:, :, local],
            w_gradient=w_gradient,
            ties=ties.reshape(count, steps, nt, -1),
            tie_values=cycle.reshape(count, -1).copy(),
        )

    @property
    def local_metric(self) -> np.ndarray:
        """Metric of the damping for forces, and target shapes if they are unknowns."""
        shapes = 0 if self.joint else self.walker.nu
        return np.concatenate([np.full(3 * self.walker.n_feet, _FORCE), np.full(shapes, _SHAPE)])

    def moved(self, walk: Iterate, step: tuple[np.ndarray, ...]) -> Iterate:
        """Return the walks after a step of states (B, N, nt), local unknowns (B, N, .) and w (B, .)."""
        dx, dlocal, dw = step
        largest = np.abs(dx[..., 3 : 6 + self.walker.nu]).max((1, 2))
        share = np.minimum(1.0, _LONGEST / np.maximum(largest, 1e-9))[:, None, None]
        dx, dlocal, dw = share * dx, share * dlocal, share[:, :, 0] * dw
        states = walk.states.copy()
        (after,) = self._retract(
            walk.states[:, 1:].reshape(-1, self.walker.nx), dx.reshape(-1, self.nt)
        )
        states[:, 1:] = after.reshape(states[:, 1:].shape)
        feet, w = 3 * self.walker.n_feet, walk.w.copy()
        shapes = walk.shapes if self.joint else walk.shapes + dlocal[..., feet:]
        if self.joint:
            free = w[:, self.alone[0].n_phases :]
            np.clip(free + dw, -self.bound, self.bound, out=free)
        return Iterate(states, walk.forces + dlocal[..., :feet], shapes, w)

    def minimise(
        self, walk: Iterate, weights: Weights, iterations: int, damping: np.ndarray
    ) -> tuple[Iterate, np.ndarray]:
        """Take `iterations` steps; each walk keeps those that lower its cost, damped as they do.

        Args:
            damping: (B,) at the start.

        Returns:
            the walks, and the damping to go on with.
        """
        cost, system = self.cost(walk, weights), self.system(walk, weights)
        for done in range(1, iterations + 1):
            step = system.solve(damping, self.metric, self.local_metric)
            new = self.moved(walk, step)
            try:
                new_cost = self.cost(new, weights)
            except RuntimeError:  # a step from there does not converge: too far, for one of them
                new_cost = np.full(self.count, np.inf)
            better = np.isfinite(new_cost) & (new_cost < cost)
            promised = system.promised(step, damping, self.metric, self.local_metric)
            gain = np.where(better, cost - new_cost, -np.inf) / np.maximum(promised, 1e-300)
            walk, cost = new.where(better, walk), np.where(better, new_cost, cost)
            damping = damping * np.select([gain > _GOOD, gain > _FAIR, gain > 0], [1 / 3, 1, 3], 6)
            damping = np.maximum(damping, _LEAST_DAMPING)
            if better.any() and done < iterations:
                system = self.system(walk, weights)
        return walk, damping


@dataclass(frozen=True)
class System:
    """Normal equations of B walks; the sums over residuals r of products of their derivatives.

    x: the states before and after a step (2 nt), local: forces and target shapes, w: the DMP.
    ties: derivatives of E_obj's residuals by the state after each step (B, N, nt, ties).
    """

    x_x: np.ndarray
    x_local: np.ndarray
    local_local: np.ndarray
    x_w: np.ndarray
    local_w: np.ndarray
    w_w: np.ndarray
    x_gradient: np.ndarray
    local_gradient: np.ndarray
    w_gradient: np.ndarray
    ties: np.ndarray
    tie_values: np.ndarray

    def solve(
        self, damping: np.ndarray, metric: np.ndarray, local_metric: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the steps of states (B, N, nt), local unknowns (B, N, .) and w (B, .)."""
        count, steps, nt, n_ties = self.ties.shape
        n_w, each = self.w_w.shape[1], damping[:, None, None]
        local = self.local_local + each[..., None] * np.diag(local_metric)
        local = local + 1e-8 * np.eye(len(local_metric))
        right = [self.x_local.transpose(0, 1, 3, 2), self.local_w, self.local_gradient[..., None]]
        eliminated = np.linalg.solve(local, np.concatenate(right, 3))
        reduced = np.concatenate([self.x_x, self.x_w, self.x_gradient[..., None]], 3)
        reduced = reduced - self.x_local @ eliminated
        w_right = np.swapaxes(self.local_w, 2, 3) @ eliminated[..., 2 * nt :]
        w_right = w_right.sum(1)
        w_w, w_gradient = self.w_w - w_right[:, :, :-1], self.w_gradient - w_right[:, :, -1]
        # states: diagonal and lower blocks, and the border (w, ties) with the gradient as last column
        diagonal = reduced[:, :, nt:, nt : 2 * nt].copy()
        diagonal[:, :-1] += reduced[:, 1:, :nt, :nt]
        diagonal += each[..., None] * np.diag(metric) + 1e-9 * np.eye(nt)
        lower = reduced[:, 1:, nt:, :nt]
        columns = reduced[:, :, nt:, 2 * nt :].copy()
        columns[:, :-1] += reduced[:, 1:, :nt, 2 * nt :]
        columns = np.concatenate([columns[..., :-1], self.ties, columns[..., -1:]], 3)
        factor = _BlockCholesky(diagonal, lower)
        half = factor.forward(columns)
        border, last = half[..., :-1], half[..., -1]
        schur = -np.einsum("bniv,bniw->bvw", border, border, optimize=True)
        schur[:, :n_w, :n_w] += w_w + each * W_METRIC * np.eye(n_w) + 1e-9 * np.eye(n_w)
        schur[:, n_w:, n_w:] -= np.eye(n_ties)
        value = -np.concatenate([w_gradient, self.tie_values], 1)
        value += np.einsum("bniv,bni->bv", border, last)
        ends = np.linalg.solve(schur, value[..., None])[..., 0]
        dx = -factor.backward(last + np.einsum("bniv,bv->bni", border, ends))
        dw = ends[:, :n_w]
        both = np.concatenate([np.zeros_like(dx), dx], 2)
        both[:, 1:, :nt] = dx[:, :-1]
        dlocal = eliminated[..., -1] + np.einsum("bnlx,bnx->bnl", eliminated[..., : 2 * nt], both)
        dlocal += np.einsum("bnlw,bw->bnl", eliminated[..., 2 * nt : -1], dw)
        return dx, -dlocal, dw

    def slope(self, step: tuple[np.ndarray, ...]) -> np.ndarray:
        """Return half the derivative (B,) of the cost along a step."""
        dx, dlocal, dw = step
        nt = dx.shape[2]
        slope = (self.x_gradient[..., nt:] * dx).sum((1, 2))
        slope += (self.x_gradient[:, 1:, :nt] * dx[:, :-1]).sum((1, 2))
        slope += (self.local_gradient * dlocal).sum((1, 2)) + (self.w_gradient * dw).sum(1)
        return slope + np.einsum("bnit,bni,bt->b", self.ties, dx, self.tie_values)

    def promised(
        self,
        step: tuple[np.ndarray, ...],
        damping: np.ndarray,
        metric: np.ndarray,
        local_metric: np.ndarray,
    ) -> np.ndarray:
        """Return by how much the cost (B,) falls along a whole step of `solve`, if it is quadratic."""
        dx, dlocal, dw = step
        size = (metric * dx**2).sum((1, 2)) + (local_metric * dlocal**2).sum((1, 2))
        return damping * (size + W_METRIC * (dw**2).sum(1)) - self.slope(step)


class _BlockCholesky:
    """L L^T of B block tridiagonal matrices: diagonal (B, N, n, n) and lower blocks (B, N - 1, n, n)."""

    def __init__(self, diagonal: np.ndarray, lower: np.ndarray):
        self.inverse = np.empty_like(diagonal)  # of the diagonal blocks of L
        self.below = np.empty_like(lower)  # the other blocks of L
        for i in range(diagonal.shape[1]):
            block = diagonal[:, i]
            if i:
                self.below[:, i - 1] = lower[:, i - 1] @ self.inverse[:, i - 1].swapaxes(1, 2)
                block = block - self.below[:, i - 1] @ self.below[:, i - 1].swapaxes(1, 2)
            self.inverse[:, i] = np.linalg.inv(np.linalg.cholesky(block))

    def forward(self, right: np.ndarray) -> np.ndarray:
        """Return L^-1 right (B, N, n, columns)."""
        out = np.empty_like(right)
        out[:, 0] = self.inverse[:, 0] @ right[:, 0]
        for i in range(1, right.shape[1]):
            out[:, i] = self.inverse[:, i] @ (right[:, i] - self.below[:, i - 1] @ out[:, i - 1])
        return out

    def backward(self, right: np.ndarray) -> np.ndarray:
        """Return L^-T right (B, N, n)."""
        out = np.empty_like(right)
        for i in reversed(range(right.shape[1])):
            row = right[:, i]
            if i + 1 < right.shape[1]:
                row = row - np.einsum("bji,bj->bi", self.below[:, i], out[:, i + 1])
            out[:, i] = np.einsum("bji,bj->bi", self.inverse[:, i], row)
        return out
