"""The residuals of a cycle in E_obj, in CasADi: shooting sums their squares, Gauss-Newton takes each."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from defplan_mj.dynamics.symbolic import forward_axis

UPRIGHT = np.radians(15)
"""The tilt from which leaning over costs extra, rad."""


@dataclass(frozen=True)
class PlanarResiduals:
    """How a cycle in the plane misses its task, in the yaw frame at its start.

    Attributes:
        turn: (1,) change of heading beyond that of the task, rad.
        shortfall: (1,) what the displacement along the task's direction lacks, m; 0 if it is longer.
        drift: (2,) displacement across it, m.
        rise: (1,) of the centre of mass, m.
    """

    turn: ca.SX
    shortfall: ca.SX
    drift: ca.SX
    rise: ca.SX


def planar(
    start: ca.SX, end: ca.SX, turn: ca.SX, direction: ca.SX, advance: ca.SX
) -> PlanarResiduals:
    """Return the residuals of a cycle between states (nx,); the task's as in `GaitProblem.goals`."""
    forward, forward_end = forward_axis(start), forward_axis(end)
    yaw = ca.atan2(
        forward[0] * forward_end[1] - forward[1] * forward_end[0],
        forward[0] * forward_end[0] + forward[1] * forward_end[1],
    )
    move = end[:3] - start[:3]
    ahead = forward[:2] / ca.sqrt(ca.sumsqr(forward[:2]) + 1e-12)
    left = ca.vertcat(-ahead[1], ahead[0])
    moved = ca.vertcat(ca.dot(ahead, move[:2]), ca.dot(left, move[:2]))
    shortfall, drift = displacement(moved, direction[:2], advance)
    return PlanarResiduals(yaw - turn[2], shortfall, drift, move[2])


def displacement(moved: ca.SX, direction: ca.SX, advance: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Return what a displacement (d,) lacks along a unit vector (d,), at least 0, and what is across it."""
    along = ca.dot(direction, moved)
    return ca.fmax(0, advance - along), moved - along * direction


def tilt(x: ca.SX) -> ca.SX:
    """Return the residuals (2,) of a state's tilt; their squares are 2 (1 - R_zz), to second order."""
    return 2 * x[4:6]


def lean(x: ca.SX) -> ca.SX:
    """Return by how much a state's squared tilt is above that of `UPRIGHT`, rad^2."""
    return ca.fmax(0, 4 * ca.sumsqr(x[4:6]) - UPRIGHT**2)
