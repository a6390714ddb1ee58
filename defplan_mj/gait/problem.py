"""The paper's gait optimisation (Eq. 1) as CasADi expressions that any gait solver can take.

A gait is judged while its tasks are switched, as it will be used: a trajectory is a sequence of
cycles, each of one task, and E_obj adds up over its cycles.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path

import casadi as ca
import numpy as np

from defplan_mj.base.errors import DefplanError
from defplan_mj.base.space import PLANE, SPACES, Space
from defplan_mj.dynamics.external import CasadiDynamics
from defplan_mj.dynamics.reduced import ReducedDynamics
from defplan_mj.gait import costs, export
from defplan_mj.gait.friction import Sliding
from defplan_mj.gait.gait import Gait
from defplan_mj.gait.style import STYLES
from defplan_mj.task import GaitTask, TaskSpec, Weights

DEFAULT_WEIGHTS = Weights()


class GaitProblem:
    """Eq. 1 for one body: the dynamics, the tasks and the objective, in CasADi.

    The unknown w holds mu (D, r), then alpha and beta (K, D, r), row-major; tau is fixed by the
    number of steps in a cycle.

    Attributes:
        dynamics: the reduced dynamics f.
        tasks: the K gait tasks.
        steps_per_cycle: steps in a cycle.
        elements: D.
        cycles: cycles in a trajectory (N_1 over the steps of a cycle).
        space: by name, see `base.space`. In the plane cycles are judged in the yaw frame at their start, and
            the body is to stay upright; in space in the body frame at their start.
        weights: of E_obj.
        axis: (3,) the body's own axis, which turns in space are to tilt.
    """

    def __init__(
        self,
        dynamics: ReducedDynamics,
        tasks: Sequence[GaitTask],
        steps_per_cycle: int,
        gait_steps: int = 200,
        elements: int = 5,
        *,
        space: str = PLANE.name,
        weights: Weights = DEFAULT_WEIGHTS,
        axis: Sequence[float] | np.ndarray = (1.0, 0.0, 0.0),
    ):
        self.dynamics = dynamics
        self.tasks = tuple(tasks)
        self.steps_per_cycle = steps_per_cycle
        self.elements = elements
        self.cycles = max(1, gait_steps // steps_per_cycle)
        self.space = space
        self.weights = weights
        self.axis = np.array(axis, float)

    @classmethod
    def of(cls, spec: TaskSpec, dynamics: ReducedDynamics) -> GaitProblem:
        """Return the gait problem of a task."""
        return cls(
            dynamics,
            spec.gait_tasks,
            spec.steps_per_cycle,
            spec.gait_steps,
            space=spec.navigation.space,
            weights=spec.weights,
            axis=spec.axis,
        )

    @property
    def place(self) -> Space:
        """The space itself."""
        return SPACES[self.space]

    @property
    def n_tasks(self) -> int:
        """K, the number of tasks."""
        return len(self.tasks)

    @property
    def n_phases(self) -> int:
        """Number of entries of mu in w."""
        return self.elements * self.dynamics.nu

    @property
    def n_w(self) -> int:
        """Number of unknowns."""
        return self.n_phases * (1 + 2 * self.n_tasks)

    @cached_property
    def casadi_dynamics(self) -> CasadiDynamics:
        """The reduced dynamics as CasADi functions."""
        return CasadiDynamics(self.dynamics)

    def alone(self, task: int) -> GaitProblem:
        """Return the problem of one task only."""
        return self.of_tasks([self.tasks[task]])

    def at_most(self, advance: float) -> GaitProblem:
        """Return the problem whose tasks want no longer displacement of a cycle than `advance`, m."""
        if all(task.advance <= advance for task in self.tasks):
            return self
        shares = [min(1.0, advance / (task.advance or 1.0)) for task in self.tasks]
        moves = [np.multiply(s, t.move) for s, t in zip(shares, self.tasks, strict=True)]
        return self.of_tasks(
            [replace(t, move=tuple(m.tolist())) for t, m in zip(self.tasks, moves, strict=True)]
        )

    def of_tasks(self, tasks: Sequence[GaitTask]) -> GaitProblem:
        """Return the problem with other tasks."""
        steps = self.cycles * self.steps_per_cycle
        return GaitProblem(
            self.dynamics,
            tasks,
            self.steps_per_cycle,
            steps,
            self.elements,
            space=self.space,
            weights=self.weights,
            axis=self.axis,
        )

    @cached_property
    def style(self) -> np.ndarray:
        """(r,) how much each mode is of the style that the weights name, 0 to 1 (0: no style)."""
        body, style = self.dynamics.body, self.weights.style
        if style == "any":
            return np.zeros(body.n_modes)
        if style not in STYLES:
            raise DefplanError(f"there is no gait style {style!r}: take any, {', '.join(STYLES)}")
        return STYLES[style](body, self.axis)

    def random_gait(self, rng: np.random.Generator) -> np.ndarray:
        """Return w (n_w,) of any phases and a little motion, mostly of the style.

        A walker's is smaller, so that it stays on its feet, and its elements follow each other evenly.
        """
        d, r, k = self.elements, self.dynamics.nu, self.n_tasks
        if self.dynamics.world.walks:
            mu = np.repeat(2 * np.pi * np.arange(d)[:, None] / d, r, 1)
            return self.join(mu, 0.05 * rng.normal(size=(k, d, r)), np.ones((k, d, r)))
        share = np.ones(r) if self.weights.style == "any" else 0.05 + 0.95 * self.style
        mu = rng.uniform(0, 2 * np.pi, (d, r))
        alpha = 0.3 * share * rng.normal(size=(k, d, r))
        return self.join(mu, alpha, 1 + 0.3 * rng.normal(size=(k, d, r)))

    # --- the DMP

    def split(self, w: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return mu (D, r), alpha and beta (K, D, r) of w."""
        d, r, k = self.elements, self.dynamics.nu, self.n_tasks
        mu, alpha, beta = np.split(np.asarray(w, float), [d * r, d * r * (1 + k)])
        return mu.reshape(d, r), alpha.reshape(k, d, r), beta.reshape(k, d, r)

    def join(self, mu: np.ndarray, alpha: np.ndarray, beta: np.ndarray) -> np.ndarray:
        """Return w of mu (D, r), alpha and beta (K, D, r)."""
        return np.concatenate([mu.ravel(), alpha.ravel(), beta.ravel()])

    def together(self, alone: Sequence[np.ndarray], phases: int = 0) -> np.ndarray:
        """Return w of gaits that were found for each task alone (`alone`), with the phases of one of them."""
        parts = [self.alone(j).split(w) for j, w in enumerate(alone)]
        alpha, beta = (np.concatenate([part[i] for part in parts]) for i in (1, 2))
        return self.join(parts[phases][0], alpha, beta)

    @cached_property
    def dmp(self) -> ca.Function:
        """w -> target shapes (r, K n): the DMP of each task over one cycle, task after task."""
        d, r, k, n = self.elements, self.dynamics.nu, self.n_tasks, self.steps_per_cycle
        mu, alpha, beta = (ca.SX.sym(s, r, d) for s in ("mu", "alpha", "beta"))
        phase = 2 * np.pi * np.arange(1, n + 1) / n
        columns = [ca.sum2(alpha * ca.exp(beta * ca.cos(p - mu))) for p in phase]
        one = ca.Function("dmp", [mu, alpha, beta], [ca.horzcat(*columns)])
        w = ca.MX.sym("w", self.n_w)
        blocks = [ca.reshape(b, r, d) for b in ca.vertsplit(w, d * r)]
        shapes = [one(blocks[0], blocks[1 + j], blocks[1 + k + j]) for j in range(k)]
        return ca.Function("dmp", [w], [ca.horzcat(*shapes)], ["w"], ["shapes"])

    @cached_property
    def excess(self) -> ca.Function:
        """w -> mean squared excess of the target shapes over the body's amplitude, in units of it.

        For what takes no constraints: the shapes are meant to stay within the amplitude.
        """
        w, amplitude = ca.MX.sym("w", self.n_w), self.dynamics.body.amplitude
        bound = np.tile(amplitude, self.n_tasks * self.steps_per_cycle)
        over = ca.fmax(ca.fabs(ca.vec(self.dmp(w))) / bound - 1, 0)
        return ca.Function("excess", [w], [ca.sumsqr(over) / len(bound)])

    # --- E_obj

    @cached_property
    def goals(self) -> np.ndarray:
        """(7, K): what each task wants of a cycle: rotation vector, direction, advance."""
        columns = [(*task.turn, *task.direction, task.advance) for task in self.tasks]
        return np.array(columns).T

    @cached_property
    def cycle_cost(self) -> ca.Function:
        """(x_start: nx, x: nx x n, goal: 7) -> cost of one cycle, a term of E_obj."""
        n, nx = self.steps_per_cycle, self.dynamics.nx
        start, x, goal = ca.SX.sym("x_start", nx), ca.SX.sym("x", nx, n), ca.SX.sym("goal", 7)
        asked = goal[:3], goal[3:6], goal[6]
        if self.place.level:
            cost = costs.planar(self.weights, start, x, *asked)
        else:
            cost = costs.spatial(self.weights, self.axis, start, x, *asked)
        return ca.Function("cycle_cost", [start, x, goal], [cost])

    def trajectory_cost(self, sequence: Sequence[int], settle: int = 1) -> ca.Function:
        """Return (x0: nx, x: nx x (n cycles)) -> mean cost of the cycles after the first `settle`.

        Args:
            sequence: the task of each cycle.
            settle: cycles that are not judged: the body starts from rest.
        """
        n, nx, cycles = self.steps_per_cycle, self.dynamics.nx, len(sequence)
        x0, x = ca.MX.sym("x0", nx), ca.MX.sym("x", nx, n * cycles)
        starts = ca.horzcat(x0, x[:, n - 1 : -1 : n])
        costs = self.cycle_cost.map(cycles)(starts, x, self.goals[:, list(sequence)])
        cost = ca.sum2(costs[settle:]) / (cycles - settle)
        if self.weights.slip and self.dynamics.world.walks:
            cost += self.weights.slip * self._sliding.path(ca.horzcat(x0, x)) / cycles
        return ca.Function("trajectory_cost", [x0, x], [cost])

    @cached_property
    def _sliding(self) -> Sliding:
        return Sliding(self.dynamics)

    def objective(
        self, sequences: Sequence[Sequence[int]], settle: int = 1, threads: int = 1
    ) -> ca.Function:
        """Return w -> E_obj + regularisation, by rollouts from rest.

        With the rollout in it, E_phys and E_dmp of Eq. 1 are zero by construction (single
        shooting); its derivatives are the kernel's exact adjoint.

        Args:
            sequences: the task of each cycle, one list a trajectory; all of one length.
            settle: see `trajectory_cost`.
            threads: rollouts in parallel.
        """
        n = self.steps_per_cycle
        w = ca.MX.sym("w", self.n_w)
        shapes = self.dmp(w)
        cycles = ca.horzsplit(shapes, n)
        u = ca.horzcat(*(cycles[j] for sequence in sequences for j in sequence))
        steps, count = n * len(sequences[0]), len(sequences)
        x0 = ca.repmat(ca.DM(self.dynamics.rest_state()), 1, count)
        x = self.casadi_dynamics.rollouts(steps, count, threads)(x0, u)
        cost = 0
        for i, sequence in enumerate(sequences):
            cost += self.trajectory_cost(sequence, settle)(
                x0[:, i], x[:, i * steps : (i + 1) * steps]
            )
        return ca.Function(
            "objective", [w], [cost / count + self.regularisation(w)], ["w"], ["cost"]
        )

    def regularisation(self, w: ca.MX) -> ca.MX:
        """Return the part of the objective that is of w alone: effort and sharpness."""
        body, n = self.dynamics.body, self.n_tasks * self.steps_per_cycle
        counted = (1 - self.style) / body.amplitude**2
        effort = ca.sum2(self.dmp(w) ** 2) / n
        beta = w[self.n_phases * (1 + self.n_tasks) :]
        return (
            self.weights.effort * ca.dot(counted, effort)
            + self.weights.sharpness * ca.sumsqr(beta) / beta.numel()
        )

    def switching_sequences(self, rng: np.random.Generator, count: int = 2) -> list[list[int]]:
        """Return `count` task sequences of K N_1 steps in all, every transition about as often.

        The paper has a trajectory a task; an even number of longer ones keeps two threads busy.
        """
        length = max(2, self.n_tasks * self.cycles // count)
        return [balanced_sequence(self.n_tasks, length, rng) for _ in range(count)]

    # --- results

    def export(
        self,
        path: str | Path,
        seed: int = 0,
        start: np.ndarray | None = None,
        bound: float = 4.0,
        sequences: list[list[int]] | None = None,
    ) -> None:
        """Write the whole problem to a file that `external.load_instance` reads, without this class.

        It holds w -> (E_obj, target shapes), bounds of w (of alpha and beta) and of the shapes (the
        body's amplitude), a start, the body and the kernel's arrays.

        Args:
            seed: of the sequences and of the start.
            start: (n_w,) where to start; None: a random gait.
            bound: of alpha and beta.
            sequences: of tasks, as `objective` takes them; None: `switching_sequences`.
        """
        export.export(self, path, seed, start, bound, sequences)

    def gait(self, w: np.ndarray, meta: dict) -> Gait:
        """Return the Gait of w (n_w,), with `meta` for its file."""
        mu, alpha, beta = self.split(w)
        return Gait(
            body_hash=self.dynamics.body.hash,
            task_names=tuple(task.name for task in self.tasks),
            timestep=self.dynamics.timestep,
            steps_per_cycle=self.steps_per_cycle,
            alpha=alpha,
            beta=beta,
            mu=mu,
            amplitude=self.dynamics.body.amplitude,
            **self.dynamics.stepping,
            meta=meta,
        )

    def w_of(self, gait: Gait) -> np.ndarray:
        """Return the unknowns w (n_w,) of a Gait of this problem."""
        return self.join(gait.mu, gait.alpha, gait.beta)


def balanced_sequence(n_tasks: int, length: int, rng: np.random.Generator) -> list[int]:
    """Return a random walk over the tasks that uses every transition about equally often."""
    used = np.zeros((n_tasks, n_tasks))
    sequence = [int(rng.integers(n_tasks))]
    while len(sequence) < length:
        here = sequence[-1]
        rare = np.flatnonzero(used[here] == used[here].min())
        sequence.append(int(rng.choice(rare)))
        used[here, sequence[-1]] += 1
    return sequence
