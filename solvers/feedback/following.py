"""What feedbacks follow: a gait's mean cycle, told from a frame that goes where the gait would go.

What the body is off from the gait's mean cycle while tasks are switched (`gait.mean_cycle`) is weighed as E_obj:
the wanted motion, upright, in the wanted direction. The mean cycle is what the gait does when nothing but
switching disturbs it, so that the body nearly plays the DMP as it is.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from defplan_mj.base.errors import DefplanError
from defplan_mj.base.space import SPACES
from defplan_mj.dynamics import tangent
from defplan_mj.dynamics.reduced import ReducedDynamics
from defplan_mj.dynamics.tangent import Frame
from defplan_mj.gait.gait import Gait
from defplan_mj.gait.mean_cycle import MeanCycle, mean_cycles, turn_tangent
from defplan_solvers.feedback.ilqg_step import cost_to_go


@dataclass(frozen=True)
class Weights:
    """What is weighed of a state and a control.

    Attributes:
        height: of the squared error of the height above the ground, 1/m^2.
        velocity: s^2/m^2.
        tilt, heading: 1/rad^2; in space, where no direction is up, heading is of every rotation.
        spin: of the angular velocity, s^2/rad^2.
        shape, rate: of the modal coordinates and their velocities, in units of the amplitude (and s).
        effort: E_dmp, of the target shape less the DMP's, in units of the amplitude.
        terminal: weigh the last step of a horizon with the cost of going on for ever.
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
    terminal: bool = True
    leash: float = 0.3


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
    cycle: MeanCycle, effort: np.ndarray, amplitude: np.ndarray, weigh: Weights, ahead: int
) -> Track:
    """Return what to follow of a task's mean cycle.

    Args:
        effort: (r,) weights of the controls.
        amplitude: (r,) of the gait.
        weigh: what is weighed.
        ahead: steps beyond the cycle's end.
    """
    n = len(cycle.shapes)
    states = cycle.unrolled(n + ahead)
    weights = np.array([state_weights(x, amplitude, weigh) for x in states])
    onward = weights
    if weigh.terminal:
        turn = turn_tangent(cycle.motion.matrix.T, weights.shape[1])
        values = cost_to_go(cycle.a, cycle.b, weights[:n], effort, turn)
        turns = [np.linalg.matrix_power(turn, i // n) for i in range(len(states))]
        onward = np.array([t.T @ values[i % n] @ t for i, t in enumerate(turns)])
    controls = cycle.shapes[np.arange(n + ahead) % n]
    return Track(states, controls, weights, onward, cycle.motion)


def state_weights(x: np.ndarray, amplitude: np.ndarray, weigh: Weights) -> np.ndarray:
    """Return the (n_z, n_z) weights of E_obj at a wanted state."""
    r, nz = len(amplitude), len(x) - 1
    weights = np.zeros(nz)
    weights[2] = weigh.height
    weights[6 : 6 + r] = weigh.shape / amplitude**2
    weights[6 + r : 9 + r] = weigh.velocity
    weights[9 + r : 12 + r] = weigh.spin
    weights[12 + r : 12 + 2 * r] = weigh.rate / amplitude**2  # the last target is not judged
    out = np.diag(weights)
    attitude = Frame(x[:3], x[3:7]).matrix
    out[3:6, 3:6] = attitude.T @ np.diag([weigh.tilt, weigh.tilt, weigh.heading]) @ attitude
    return out


class Follower:
    """Keeps the frame that a gait's mean cycles are told from, from cycle to cycle.

    Attributes:
        cycles, tracks: (K) one a gait.
        effort: (r,) weights of the controls.
        bound: (r,) of the target shape.
        task: the gait that is played now.
        step: of the cycle, the next one.
    """

    def __init__(
        self, dynamics: ReducedDynamics, gait: Gait, space: str, weigh: Weights, ahead: int
    ) -> None:
        self.level, self.depth = SPACES[space].level, not dynamics.world.walks
        if self.depth:
            weigh = replace(weigh, height=0.0)
        if not self.level:
            weigh = replace(weigh, tilt=weigh.heading)
        self.leash, self.bound = weigh.leash, gait.amplitude
        self.effort = weigh.effort / gait.amplitude**2
        self.cycles = mean_cycles(dynamics, gait, level=self.level, depth=self.depth)
        self.tracks = [
            make_track(cycle, self.effort, gait.amplitude, weigh, ahead) for cycle in self.cycles
        ]
        self.reset()

    def reset(self) -> None:
        """Forget the frame."""
        self.step = self.task = 0
        self._frame: Frame | None = None

    def begin(self, task: int, x: np.ndarray, first: int = 0) -> None:
        """Begin a cycle: the frame to follow begins where the body is, on its old course if near.

        Raises:
            DefplanError: it is to be entered within, at the step `first`.
        """
        if first:
            raise DefplanError(
                "a feedback that follows mean cycles follows whole ones: take the feedback none, or set"
                " navigation.decisions_per_cycle to 1"
            )
        here = Frame.of(x, self.level, self.depth)
        if self._frame is not None:
            course = self._frame.then(self.track.motion).quaternion
            error = 2 * tangent.attitude_tangent(here.quaternion).T @ course
            error *= 1.0 if here.quaternion @ course >= 0 else -1.0
            error *= min(1.0, self.leash / max(float(np.linalg.norm(error)), 1e-12))
            turned = here.quaternion + tangent.attitude_tangent(here.quaternion) @ (0.5 * error)
            here = Frame(here.position, turned / np.linalg.norm(turned))
        self._frame, self.task, self.step = here, task, 0

    @property
    def track(self) -> Track:
        """What is followed now."""
        return self.tracks[self.task]

    def inside(self, x: np.ndarray) -> np.ndarray:
        """Return the state (nx,) as told from the frame."""
        if self._frame is None:
            raise RuntimeError("a cycle has to begin first")
        return self._frame.inside(x)
