"""The paper's gait optimisation (Eq. 1) as CasADi expressions that any gait solver can take.

A gait is judged while its tasks are switched, as it will be used: a trajectory is a sequence of
cycles, each of one task, and E_obj adds up over its cycles.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property

import casadi as ca
import numpy as np

from defplan_mj.body.model import Body
from defplan_mj.dynamics.external import CasadiDynamics
from defplan_mj.dynamics.feet import lowest_feet
from defplan_mj.dynamics.reduced import ReducedDynamics
from defplan_mj.errors import DefplanError
from defplan_mj.gait.gait import Gait
from defplan_mj.task import GaitTask, TaskSpec, Weights

_X = np.array([1.0, 0.0, 0.0])
DEFAULT_WEIGHTS = Weights()
LIFT = 0.02  # m; a foot that is lifted by more is free to move


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
        space: 'planar' (cycles are judged in the yaw frame at their start, the body is to stay
            upright) or 'spatial' (in the body frame at their start).
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
        space: str = "planar",
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
            *(dynamics, spec.gait_tasks, spec.steps_per_cycle, spec.gait_steps),
            space=spec.navigation.space,
            weights=spec.weights,
            axis=spec.axis,
        )

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
        steps = self.cycles * self.steps_per_cycle
        return GaitProblem(
            *(self.dynamics, [self.tasks[task]], self.steps_per_cycle, steps, self.elements),
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
        """Return w of any phases and a little motion, mostly of the style.

        A walker's is smaller, so that it stays on its feet, and its elements follow each other evenly.
        """
        d, r, k = self.elements, self.dynamics.nu, self.n_tasks
        if self.dynamics.terrain is not None:
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

    # --- E_obj

    @cached_property
    def wanted(self) -> np.ndarray:
        """(7, K): what each task wants of a cycle: rotation vector, direction, advance."""
        columns = [(*task.turn, *task.direction, task.advance) for task in self.tasks]
        return np.array(columns).T

    @cached_property
    def cycle_cost(self) -> ca.Function:
        """(x_start: nx, x: nx x n, wanted: 7) -> cost of one cycle, a term of E_obj."""
        n, nx = self.steps_per_cycle, self.dynamics.nx
        start, x, wanted = ca.SX.sym("x_start", nx), ca.SX.sym("x", nx, n), ca.SX.sym("wanted", 7)
        cost = (self._planar_cost if self.space == "planar" else self._spatial_cost)(
            start, x, wanted[:3], wanted[3:6], wanted[6]
        )
        return ca.Function("cycle_cost", [start, x, wanted], [cost])

    def _planar_cost(
        self, start: ca.SX, x: ca.SX, turn: ca.SX, direction: ca.SX, advance: ca.SX
    ) -> ca.SX:
        """Yaw and displacement in the yaw frame at the start, tilt and depth in the world."""
        n, weights = self.steps_per_cycle, self.weights
        forward, end = _forward(start), _forward(x[:, -1])
        yaw = ca.atan2(
            forward[0] * end[1] - forward[1] * end[0], forward[0] * end[0] + forward[1] * end[1]
        )
        move = x[:3, -1] - start[:3]
        ahead = forward[:2] / ca.sqrt(ca.sumsqr(forward[:2]) + 1e-12)
        left = ca.vertcat(-ahead[1], ahead[0])
        moved = ca.vertcat(ca.dot(ahead, move[:2]), ca.dot(left, move[:2]))
        # squared tilt 2 (1 - R_zz), to second order
        tilts = [4 * ca.sumsqr(x[4:6, i]) for i in range(n)]
        tilt = sum(tilts) / n
        lean = sum(ca.fmax(0, t - np.radians(15) ** 2) ** 2 for t in tilts) / n
        return (
            weights.turn * (yaw - turn[2]) ** 2
            + self._move_cost(moved, direction[:2], advance)
            + weights.tilt * tilt
            + weights.upright * lean
            + weights.sink * move[2] ** 2
        )

    def _spatial_cost(
        self, start: ca.SX, x: ca.SX, turn: ca.SX, direction: ca.SX, advance: ca.SX
    ) -> ca.SX:
        """Rotation and displacement in the body frame at the start; no attitude is preferred.

        With p the vector part of the rotation's error as a quaternion, 4 |p across y|^2 is the
        paper's |R(x_start)^T R(x_end) y - y_j|^2 for the own axis y, and 4 (p . y)^2 is the squared
        roll about it, both to second order.
        """
        angle = ca.sqrt(ca.sumsqr(turn) + 1e-30)
        target = ca.vertcat(ca.cos(angle / 2), ca.sin(angle / 2) / angle * turn)
        made = quaternion_product(_conjugate(start[3:7]), x[3:7, -1])
        error = quaternion_product(_conjugate(target), made)[1:4]
        roll = ca.dot(error, self.axis)
        moved = _rotation(start[3:7]).T @ (x[:3, -1] - start[:3])
        return (
            self.weights.turn * 4 * (ca.sumsqr(error) - roll**2)
            + self.weights.roll * 4 * roll**2
            + self._move_cost(moved, direction, advance)
        )

    def _move_cost(self, moved: ca.SX, direction: ca.SX, advance: ca.SX) -> ca.SX:
        along = ca.dot(direction, moved)
        drift = ca.sumsqr(moved - along * direction)
        shortfall = ca.fmax(0, advance - along)
        return self.weights.move * shortfall**2 + self.weights.drift * drift

    def trajectory_cost(self, sequence: Sequence[int], settle: int = 1) -> ca.Function:
        """Return (x0: nx, x: nx x (n cycles)) -> mean cost of the cycles after the first `settle`.

        Args:
            sequence: the task of each cycle.
            settle: cycles that are not judged: the body starts from rest.
        """
        n, nx, cycles = self.steps_per_cycle, self.dynamics.nx, len(sequence)
        x0, x = ca.MX.sym("x0", nx), ca.MX.sym("x", nx, n * cycles)
        starts = ca.horzcat(x0, x[:, n - 1 : -1 : n])
        costs = self.cycle_cost.map(cycles)(starts, x, self.wanted[:, list(sequence)])
        cost = ca.sum2(costs[settle:]) / (cycles - settle)
        if self.weights.slip and self.dynamics.terrain is not None:
            cost += self.weights.slip * self._slip(ca.horzcat(x0, x))
        return ca.Function("trajectory_cost", [x0, x], [cost])

    def _slip(self, x: ca.MX) -> ca.MX:
        """Mean over steps of the squared horizontal speeds of the feet, of each as far as it is down."""
        count, places = x.shape[1], self._feet.map(x.shape[1])(x)
        rest = np.array(self._feet(self.dynamics.rest_state()))
        n_feet = rest.shape[1]
        apart = ca.horzsplit(places, n_feet)
        before, after = ca.vertcat(*map(ca.vec, apart[:-1])), ca.vertcat(*map(ca.vec, apart[1:]))
        speed = ca.reshape(after - before, 3, -1)[:2, :] / self.dynamics.timestep
        lifted = ca.reshape(after, 3, -1)[2, :] - np.tile(rest[2], count - 1)[None]
        down = ca.exp(-((ca.fmax(0, lifted) / LIFT) ** 2))
        return ca.dot(ca.sum1(speed**2), down) / (count - 1)

    @cached_property
    def _feet(self) -> ca.Function:
        """x -> (3, n_feet): where the feet are, the parts of the body that it stands on."""
        feet = lowest_feet(self.dynamics.body)
        return CasadiDynamics(self.dynamics.with_feet(feet)).feet

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

    def gait(self, w: np.ndarray, meta: dict) -> Gait:
        """Return the Gait of w."""
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
            meta=meta,
        )

    def w_of(self, gait: Gait) -> np.ndarray:
        """Return the unknowns of a Gait of this problem."""
        return self.join(gait.mu, gait.alpha, gait.beta)


def _forward(x: ca.SX) -> ca.SX:
    """The body's x axis in the world, from the state's quaternion."""
    w, a, b, c = (x[3 + i] for i in range(4))
    return ca.vertcat(1 - 2 * (b * b + c * c), 2 * (a * b + w * c), 2 * (a * c - w * b))


def quaternion_product(a: ca.SX, b: ca.SX) -> ca.SX:
    """Return the product of quaternions (w x y z), symbolic."""
    return ca.vertcat(
        a[0] * b[0] - ca.dot(a[1:4], b[1:4]),
        a[0] * b[1:4] + b[0] * a[1:4] + ca.cross(a[1:4], b[1:4]),
    )


def _conjugate(q: ca.SX) -> ca.SX:
    return ca.vertcat(q[0], -q[1:4])


def _rotation(q: ca.SX) -> ca.SX:
    """The rotation matrix of a unit quaternion."""
    w, a, b, c = (q[i] for i in range(4))
    return ca.vertcat(
        ca.horzcat(1 - 2 * (b * b + c * c), 2 * (a * b - w * c), 2 * (a * c + w * b)),
        ca.horzcat(2 * (a * b + w * c), 1 - 2 * (a * a + c * c), 2 * (b * c - w * a)),
        ca.horzcat(2 * (a * c - w * b), 2 * (b * c + w * a), 1 - 2 * (a * a + b * b)),
    )


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


def lateral_share(body: Body, axis: np.ndarray = _X, sections: int = 24) -> np.ndarray:
    """Return (r,) how much of each mode bends the body sideways as a whole, 0 to 1.

    The share of the mode's kinetic energy in the lateral motion of the means of its cross-sections
    along the own axis (a horizontal one).
    """
    x, side = body.vertices @ axis, np.cross([0.0, 0.0, 1.0], axis)
    edges = np.linspace(x.min(), x.max(), sections + 1)[1:-1]
    return _share_of_means(
        body, np.digitize(x, edges), (body.modes.transpose(0, 2, 1) @ side)[None]
    )


def pulse_share(body: Body, axis: np.ndarray, sections: int = 8, rings: int = 4) -> np.ndarray:
    """Return (r,) how much of each mode is the same all around the own axis, 0 to 1.

    The share of its kinetic energy in the mean radial and axial motion of rings about the axis.
    """
    along = body.vertices @ axis
    radial = body.vertices - np.outer(along, axis)
    radius = np.linalg.norm(radial, axis=1)
    outward = radial / np.maximum(radius, 1e-9)[:, None]
    section = np.digitize(along, np.linspace(along.min(), along.max(), sections + 1)[1:-1])
    ring = np.digitize(radius, np.linspace(0.0, radius.max(), rings + 1)[1:-1])
    motion = [
        np.einsum("nir,ni->nr", body.modes, outward),
        np.einsum("nir,i->nr", body.modes, axis),
    ]
    return _share_of_means(body, section * rings + ring, np.array(motion))


def _share_of_means(body: Body, group: np.ndarray, motion: np.ndarray) -> np.ndarray:
    """Return (r,) the share of the modes' energy in the group means of motions (c, n, r)."""
    mass, groups = body.vertex_mass, group.max() + 1
    weight = np.bincount(group, mass, groups)
    shares = []
    for r, mode in enumerate(body.modes.transpose(2, 0, 1)):
        moments = [np.bincount(group, mass * part[:, r], groups) for part in motion]
        means = np.array(moments) / np.maximum(weight, 1e-300)
        shares.append((weight * means**2).sum() / (mass[:, None] * mode**2).sum())
    return np.array(shares)


STYLES: dict[str, Callable[[Body, np.ndarray], np.ndarray]] = {
    "sideways": lateral_share,
    "pulse": pulse_share,
}
