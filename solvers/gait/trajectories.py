"""Eq. 1 over the states and target shapes of trajectories, at fixed w: values, derivatives, Newton.

Residuals are the paper's x_{i+1} - f(x_i, u_i), rotations in the tangent space, with the kernel's exact
Jacobians; the unknowns of a step touch those of the next only, and E_obj ties the ends of a cycle.
"""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as sla

from defplan_mj.dynamics.symbolic import (
    difference_function,
    retract,
    retract_function,
    tangent_function,
)
from defplan_mj.gait.problem import GaitProblem

_TRIALS = 8  # of the damping, before Newton gives up
_TURN, _SHAPE = 0.3, 0.1  # metres that one radian, and one unit of q, count in a residual


class Compiled:
    """A CasADi function on arrays without conversion: inputs and outputs as (columns, rows)."""

    def __init__(self, function: ca.Function):
        self.buffer, self.evaluate = function.buffer()
        self.arguments = [np.zeros(function.size_in(i)[::-1]) for i in range(function.n_in())]
        outputs = [function.sparsity_out(i) for i in range(function.n_out())]
        self.results = [np.zeros(p.size()[::-1] if p.is_dense() else p.nnz()) for p in outputs]
        for i, array in enumerate(self.arguments):
            self.buffer.set_arg(i, array.data)
        for i, array in enumerate(self.results):
            self.buffer.set_res(i, array.data)

    def __call__(self, *arguments: np.ndarray) -> list[np.ndarray]:
        """Return the outputs; the next call overwrites them."""
        for array, value in zip(self.arguments, arguments, strict=True):
            array[...] = value
        self.evaluate()
        if self.buffer.ret():
            raise RuntimeError("a reduced step did not converge")
        return self.results


class Trajectories:
    """Eq. 1 over the states and target shapes of some trajectories at fixed w.

    Arrays: states (M, nx) after each step, shapes (M, r), with M = steps over all trajectories.
    """

    def __init__(
        self, problem: GaitProblem, sequences: Sequence[Sequence[int]], settle: int, threads: int
    ):
        self.problem, self.sequences, self.settle = problem, sequences, settle
        dynamics = problem.dynamics
        self.nx, self.nt, self.r = dynamics.nx, dynamics.nx - 1, dynamics.nu
        self.n = problem.steps_per_cycle
        self.steps = self.n * len(sequences[0])
        self.total = self.steps * len(sequences)
        self.rest = dynamics.rest_state()
        h, r = dynamics.timestep, self.r
        scale = np.concatenate([np.ones(3), _TURN * np.ones(3), _SHAPE * np.ones(r)])
        self.scale = np.concatenate([scale, h * scale, _SHAPE * np.ones(r)])
        mode = ("thread", threads) if threads > 1 else ()
        self._stage = Compiled(self._stage_function(False).map(self.total, *mode))
        self._stage_jacobian = Compiled(self._stage_function(True).map(self.total, *mode))
        self._retract = Compiled(retract_function(self.nx).map(self.total))
        judged = len(sequences) * (len(sequences[0]) - settle)
        value, derivatives, pattern = self._cycle_functions(judged)
        self._cycle, self._cycle_derivatives = (
            Compiled(f.map(judged)) for f in (value, derivatives)
        )
        self._index(pattern)

    def _stage_function(self, jacobian: bool) -> ca.Function:
        """(x, u, x_next) -> scaled residual x_next - f(x, u) [and its Jacobians, in the tangent]."""
        nx, r = self.nx, self.r
        step = self.problem.casadi_dynamics.step
        compare, tangent = difference_function(nx, self.scale), tangent_function(nx)
        x, u, x_next = ca.MX.sym("x", nx), ca.MX.sym("u", r), ca.MX.sym("x_next", nx)
        y = step(x, u)
        value, by_next, by_y = compare(x_next, y)
        outputs = [value]
        if jacobian:
            by_x, by_u = step.jacobian()(x, u, y)
            outputs += [ca.densify(ca.horzcat(by_y @ (by_x @ tangent(x)), by_y @ by_u, by_next))]
        return ca.Function("stage", [x, u, x_next], outputs)

    def _cycle_functions(self, judged: int) -> tuple[ca.Function, ca.Function, ca.Sparsity]:
        """E_obj of one cycle by its states (nx, n + 1), start first: value; gradient and Hessian."""
        n, nt = self.n, self.nt
        x, step = ca.SX.sym("x", self.nx, n + 1), ca.SX.sym("step", nt, n + 1)
        goal = ca.SX.sym("goal", 7)
        moved = ca.horzcat(*(retract(x[:, i], step[:, i]) for i in range(n + 1)))
        cost = self.problem.cycle_cost(moved[:, 0], moved[:, 1:], goal) / judged
        hessian, gradient = ca.hessian(cost, ca.vec(step))
        zero = ca.DM.zeros(nt, n + 1)
        at = [ca.substitute(value, step, zero) for value in (cost, gradient, hessian)]
        value = ca.Function("cycle", [x, goal], at[:1])
        return (
            value,
            ca.Function("cycle", [x, goal], [ca.densify(at[1]), at[2]]),
            at[2].sparsity(),
        )

    def _index(self, cycle_pattern: ca.Sparsity) -> None:
        """Find where the entries of all terms go in the sparse Hessian, once."""
        nt, r, n, steps, total = self.nt, self.r, self.n, self.steps, self.total
        width = nt + r
        self.size = width * total
        # unknowns of step i: the state after it, then its target shape; -1: the fixed start
        state = width * np.arange(total)[:, None] + np.arange(nt)
        before = np.vstack([np.full(nt, -1), state[:-1]])
        before[::steps] = -1
        self._shape_index = (width * np.arange(total)[:, None] + nt + np.arange(r)).ravel()
        self._stage_index = np.hstack([before, self._shape_index.reshape(-1, r), state])
        starts, tasks = [], []
        for t, sequence in enumerate(self.sequences):
            for c in range(self.settle, len(sequence)):
                starts.append(t * steps + c * n)
                tasks.append(sequence[c])
        self._cycle_states = np.array(starts)[:, None] + np.arange(-1, n)  # -1: the state before
        self._first = np.array(starts) % steps == 0
        self._goals = self.problem.goals.T[tasks]
        self._cycle_index = np.where(
            self._first[:, None, None] & (np.arange(n + 1) == 0)[None, :, None],
            -1,
            state[self._cycle_states],
        ).reshape(len(starts), -1)
        row, column = (np.array(k) for k in cycle_pattern.get_triplet())
        stage = self._stage_index
        m = stage.shape[1]
        rows = [
            np.repeat(stage, m, 1).ravel(),
            self._cycle_index[:, row].ravel(),
            np.arange(self.size),
        ]
        columns = [
            np.tile(stage, (1, m)).ravel(),
            self._cycle_index[:, column].ravel(),
            np.arange(self.size),
        ]
        row, column = np.concatenate(rows), np.concatenate(columns)
        self._kept = np.flatnonzero((row >= 0) & (column >= 0))
        keys, self._place = np.unique(
            column[self._kept] * self.size + row[self._kept], return_inverse=True
        )
        self._indices = (keys % self.size).astype(np.int32)
        self._indptr = np.searchsorted(keys // self.size, np.arange(self.size + 1)).astype(np.int32)

    def simulate(self, shapes: np.ndarray) -> np.ndarray:
        """Return the states (M, nx) that target shapes (M, r) really lead to."""
        blocks = np.split(shapes, len(self.sequences))
        return np.vstack([self.problem.dynamics.rollout(self.rest, u)[1:] for u in blocks])

    def dmp(self, w: np.ndarray) -> np.ndarray:
        """Return the target shapes (M, r) of the gait w."""
        cycles = np.array(self.problem.dmp(w)).T.reshape(self.problem.n_tasks, self.n, self.r)
        return cycles[np.array(self.sequences)].reshape(self.total, self.r)

    def _before(self, states: np.ndarray) -> np.ndarray:
        before = np.vstack([self.rest, states[:-1]])
        before[:: self.steps] = self.rest
        return before

    def _cycles(self, states: np.ndarray) -> np.ndarray:
        """States of the judged cycles, (cycles (n + 1), nx)."""
        blocks = states[self._cycle_states]
        blocks[self._first, 0] = self.rest
        return blocks.reshape(-1, self.nx)

    def parts(self, states: np.ndarray, shapes: np.ndarray, targets: np.ndarray) -> np.ndarray:
        """Return E_phys, E_obj and E_dmp (means over steps, without weights)."""
        (residual,) = self._stage(self._before(states), shapes, states)
        (costs,) = self._cycle(self._cycles(states), self._goals)
        dmp = ((shapes - targets) ** 2).sum()
        return np.array([(residual**2).sum() / self.total, costs.sum(), dmp / self.total])

    def system(
        self,
        states: np.ndarray,
        shapes: np.ndarray,
        targets: np.ndarray,
        physics: float,
        dmp: float,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return gradient (size,) and Hessian entries (see `matrix`) of physics E_phys + E_obj + dmp E_dmp."""
        residual, jacobian = self._stage_jacobian(self._before(states), shapes, states)
        jacobian = jacobian.reshape(self.total, -1, self.nt)  # transposed
        gradient_cycle, hessian_cycle = self._cycle_derivatives(self._cycles(states), self._goals)
        factor = 2 * physics / self.total
        gradient = np.zeros(self.size + 1)  # the last entry takes what belongs to fixed starts
        np.add.at(gradient, self._stage_index, factor * np.einsum("mai,mi->ma", jacobian, residual))
        np.add.at(gradient, self._cycle_index.ravel(), gradient_cycle.ravel())
        gradient[self._shape_index] += 2 * dmp / self.total * (shapes - targets).ravel()
        diagonal = np.zeros(self.size)
        diagonal[self._shape_index] = 2 * dmp / self.total
        blocks = factor * jacobian @ jacobian.transpose(0, 2, 1)
        return gradient[:-1], np.concatenate([blocks.ravel(), hessian_cycle, diagonal])

    def matrix(self, entries: np.ndarray, damping: np.ndarray) -> sp.csc_matrix:
        """Return Hessian + diag(damping), (size, size), of the entries of `system`."""
        entries = entries.copy()
        entries[-self.size :] += damping
        data = np.bincount(self._place, entries[self._kept], minlength=len(self._indices))
        return sp.csc_matrix((data, self._indices, self._indptr), (self.size, self.size))

    def solve(self, entries: np.ndarray, damping: np.ndarray, rhs: np.ndarray) -> np.ndarray:
        """Return the step (size,) that solves (Hessian + diag(damping)) step = rhs."""
        symmetric = {"permc_spec": "MMD_AT_PLUS_A", "options": {"SymmetricMode": True}}
        factor = sla.splu(self.matrix(entries, damping), diag_pivot_thresh=0.0, **symmetric)
        return factor.solve(rhs)

    def move(self, states: np.ndarray, shapes: np.ndarray, step: np.ndarray):
        """Return states and shapes after a step (size,)."""
        step = step.reshape(self.total, -1)
        (moved,) = self._retract(states, step[:, : self.nt])
        return moved.copy(), shapes + step[:, self.nt :]

    def newton(
        self,
        states: np.ndarray,
        shapes: np.ndarray,
        targets: np.ndarray,
        physics: float,
        dmp: float,
        iterations: int,
        damping: float,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
        """Minimise physics E_phys + E_obj + dmp E_dmp over states and shapes; w is in `targets`.

        Gauss-Newton for E_phys, Newton for the rest, with Levenberg-Marquardt's damping.

        Returns:
            states, shapes, the three parts without weights, and the damping to go on with.
        """
        weights = np.array([physics, 1.0, dmp])
        parts = self.parts(states, shapes, targets)
        metric = np.concatenate([self.scale, np.full(self.r, _SHAPE)]) ** 2 / self.total
        metric = np.tile(metric, self.total)
        for _ in range(iterations):
            gradient, entries = self.system(states, shapes, targets, physics, dmp)
            before = weights @ parts
            for _ in range(_TRIALS):
                step = self.solve(entries, damping * metric, -gradient)
                new = self.move(states, shapes, step)
                try:
                    new_parts = self.parts(new[0], new[1], targets)
                except RuntimeError:  # a step from there does not converge: too far
                    new_parts = np.full(3, np.inf)
                if weights @ new_parts < before:
                    break
                damping *= 8
            else:
                return states, shapes, parts, damping
            (states, shapes), parts, damping = new, new_parts, max(damping / 4, 1e-6)
            if weights @ parts > (1 - 1e-3) * before:
                break
        return states, shapes, parts, damping
