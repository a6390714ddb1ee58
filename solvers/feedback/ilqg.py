"""Feedback `ilqg`: iterative LQG around the DMP's output, over a short horizon (paper, section IV-A).

Every step minimises E_obj + E_dmp over the next steps. E_dmp is what the target shapes are off from the DMP.
E_obj is what the body is off from the gait's mean cycle while tasks are switched (`gait.mean_cycle`), as
told from a frame that goes where the gait would go: the wanted motion, upright, in the wanted direction.
The mean cycle is what the gait does when nothing but switching disturbs it, so that both terms are small then
and the body nearly plays the DMP as it is.

Five steps see less than a quarter of a cycle: too little to know that a lean ends in a fall. So the last
step is weighed with the cost of going on along the cycle for ever, from the periodic Riccati equation.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from defplan_mj.base.errors import DefplanError
from defplan_mj.base.space import PLANE, SPACES
from defplan_mj.dynamics import tangent
from defplan_mj.dynamics.reduced import ReducedDynamics
from defplan_mj.dynamics.tangent import Frame
from defplan_mj.gait.gait import Gait
from defplan_mj.gait.mean_cycle import MeanCycle, mean_cycles, turn_tangent
from defplan_solvers.feedback.ilqg_step import Cost, Guide, cost_to_go, optimise


@dataclass(frozen=True)
class Options:
    """What is weighed, how far ahead, and how hard.

    Attributes:
        height: of the squared error of the height above the ground, 1/m^2.
        velocity: s^2/m^2.
        tilt, heading: 1/rad^2; in space, where no direction is up, heading is of every rotation.
        spin: of the angular velocity, s^2/rad^2.
        shape, rate: of the modal coordinates and their velocities, in units of the amplitude (and s).
        effort: E_dmp, of the target shape less the DMP's, in units of the amplitude.
        horizon: steps.
        iterations: of a decision.
        terminal: weigh the last step with the cost of going on for ever.
        leash: largest error of heading that is carried into the next cycle, rad.
    """

    height: float = 10.0
    velocity: float = 1.0
    tilt: float = 10.0
    heading: float = 2.0
    spin: float = 0.1
    shape: float = 0.1
    rate: float = 0.0
    effort: float = 1.0
    horizon: int = 5
    iterations: int = 1
    terminal: bool = True
    leash: float = 0.3


class BodyModel:
    """The reduced dynamics for `optimise`: changes of state are tangent coordinates."""

    def __init__(self, dynamics: ReducedDynamics) -> None:
        self.dynamics = dynamics

    def step(
        self, x: np.ndarray, u: np.ndarray, near: np.ndarray | None = None
    ) -> np.ndarray | None:
        """Return the next state (nx,), which may be guessed to be `near`; None if the solve failed."""
        after, info = self.dynamics.step_info(x, u, near)
        return None if info.failed else after

    def jacobian(
        self, x: np.ndarray, u: np.ndarray, x_next: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the step's exact derivatives in tangent coordinates."""
        return tangent.step_jacobian(x, x_next, *self.dynamics.step_jacobian(x, u, x_next))

    def difference(self, x: np.ndarray, origin: np.ndarray) -> np.ndarray:
        """Return the changes (..., n_z) from `origin` to `x`."""
        return tangent.difference(x, origin)

    def difference_jacobian(self, x: np.ndarray, origin: np.ndarray) -> np.ndarray:
        """Return (..., n_z, n_z), 1 but for the rotation."""
        block = tangent.difference_jacobian(x, origin)
        out = np.broadcast_to(np.eye(x.shape[-1] - 1), (*block.shape[:-2], *[x.shape[-1] - 1] * 2))
        out = out.copy()
        out[..., 3:6, 3:6] = block
        return out

    def changed(self, x: np.ndarray, z: np.ndarray) -> np.ndarray:
        """Return the state (nx,) after the change `z` (n_z,)."""
        return tangent.retract(x, z)


@dataclass(frozen=True)
class Track:
    """What is followed in a cycle of one gait, and beyond its end by the horizon, told from its start.

    Attributes:
        states: (n + H + 1, nx).
        controls: (n + H, r) the DMP's output.
        weights: (n + H + 1, n_z, n_z) of E_obj.
        onward: (n + H + 1, n_z, n_z) cost of going on for ever.
        motion: of the frame over the cycle.
    """

    states: np.ndarray
    controls: np.ndarray
    weights: np.ndarray
    onward: np.ndarray
    motion: Frame


def make_track(
    cycle: MeanCycle, effort: np.ndarray, amplitude: np.ndarray, options: Options
) -> Track:
    """Return what to follow of a task's mean cycle.

    Args:
        effort: (r,) weights of the controls.
        amplitude: (r,) of the gait.
    """
    n, ahead = len(cycle.shapes), options.horizon
    states = cycle.unrolled(n + ahead)
    weights = np.array([state_weights(x, amplitude, options) for x in states])
    onward = weights
    if options.terminal:
        turn = turn_tangent(cycle.motion.matrix.T, weights.shape[1])
        values = cost_to_go(cycle.a, cycle.b, weights[:n], effort, turn)
        turns = [np.linalg.matrix_power(turn, i // n) for i in range(len(states))]
        onward = np.array([t.T @ values[i % n] @ t for i, t in enumerate(turns)])
    controls = cycle.shapes[np.arange(n + ahead) % n]
    return Track(states, controls, weights, onward, cycle.motion)


def state_weights(x: np.ndarray, amplitude: np.ndarray, options: Options) -> np.ndarray:
    """Return the (n_z, n_z) weights of E_obj at a wanted state."""
    r, nz = len(amplitude), len(x) - 1
    weights = np.zeros(nz)
    weights[2] = options.height
    weights[6 : 6 + r] = options.shape / amplitude**2
    weights[6 + r : 9 + r] = options.velocity
    weights[9 + r : 12 + r] = options.spin
    weights[12 + r : 12 + 2 * r] = options.rate / amplitude**2  # the last target is not judged
    out = np.diag(weights)
    attitude = Frame(x[:3], x[3:7]).matrix
    out[3:6, 3:6] = attitude.T @ np.diag([options.tilt, options.tilt, options.heading]) @ attitude
    return out


class Ilqg:
    """Follows the gait's mean cycles by iterative LQG.

    Attributes:
        tracks: (K) one a gait.
        costs: of the last decision: before the first iteration and after each.
    """

    def __init__(
        self,
        dynamics: ReducedDynamics,
        gait: Gait,
        space: str = PLANE.name,
        options: Options = Options(),
    ) -> None:
        self._level, self._depth = SPACES[space].level, not dynamics.world.walks
        if self._depth:
            options = replace(options, height=0.0)
        if not self._level:
            options = replace(options, tilt=options.heading)
        self.model, self.options, self.bound = BodyModel(dynamics), options, gait.amplitude
        self.effort = options.effort / gait.amplitude**2
        self.cycles = mean_cycles(dynamics, gait, level=self._level, depth=self._depth)
        self.tracks = [
            make_track(cycle, self.effort, gait.amplitude, options) for cycle in self.cycles
        ]
        self.reset()

    def reset(self) -> None:
        """Forget the frame that is followed and the last plan."""
        self.costs: tuple[float, ...] = ()
        self._track: Track | None = None
        self._frame: Frame | None = None
        self._guide: Guide | None = None
        self._more = np.zeros((self.options.horizon, len(self.bound)))
        self._next = 0

    def begin(self, task: int, x: np.ndarray, first: int = 0) -> None:
        """Begin a cycle: the frame to follow begins where the body is, on its old course if near.

        Raises:
            DefplanError: it is to be entered within.
        """
        if first:
            raise DefplanError(
                "the feedback ilqg follows whole gait cycles: take another one, or set"
                " navigation.decisions_per_cycle to 1"
            )
        here = Frame.of(x, self._level, self._depth)
        if self._frame is not None and self._track is not None:
            course = self._frame.then(self._track.motion).quaternion
            error = 2 * tangent.attitude_tangent(here.quaternion).T @ course
            error *= 1.0 if here.quaternion @ course >= 0 else -1.0
            error *= min(1.0, self.options.leash / max(float(np.linalg.norm(error)), 1e-12))
            turned = here.quaternion + tangent.attitude_tangent(here.quaternion) @ (0.5 * error)
            here = Frame(here.position, turned / np.linalg.norm(turned))
        self._frame, self._track, self._next = here, self.tracks[task], 0
        self._guide = None  # it is told from the old frame

    def shape(self, x: np.ndarray) -> np.ndarray:
        """Return the first target shape (r,) of the best plan from `x` over the horizon."""
        track, i, ahead = self._track, self._next, self.options.horizon
        if track is None or self._frame is None:
            raise RuntimeError("a cycle has to begin first")
        self._next += 1
        weights = track.weights[i + 1 : i + 1 + ahead].copy()
        weights[-1] = track.onward[i + ahead]
        reference = track.controls[i : i + ahead]
        cost = Cost(track.states[i + 1 : i + 1 + ahead], weights, reference, self.effort)
        start = reference + self._more
        plan = optimise(
            self.model,
            cost,
            self._frame.inside(x),
            start,
            self.bound,
            self.options.iterations,
            self._guide,
        )
        self.costs = plan.costs
        self._more[:-1] = (plan.controls - reference)[1:]
        self._more[-1] = 0.0
        self._guide = plan.guide
        return plan.controls[0]


@dataclass(frozen=True)
class IlqgSolver:
    """The plugin."""

    options: Options = Options()
    kind: ClassVar = "feedback"
    name: ClassVar = "ilqg"
    summary: ClassVar = (
        "iterative LQG over 5 steps: follows the gait's mean cycle, near the DMP's output"
    )

    def prepare(self, dynamics: ReducedDynamics, gait: Gait, space: str = PLANE.name) -> Ilqg:
        """Return the feedback of a gait: finds its mean cycles and their costs of going on."""
        return Ilqg(dynamics, gait, space, self.options)


SOLVER = IlqgSolver()
