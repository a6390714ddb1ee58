"""How fast a guessed body moves: its time step, its cycle, and a stiffness that goes with them."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from defplan_mj.body.options import BodyOptions
from defplan_mj.dynamics.terrain import STANDARD_GRAVITY


@dataclass(frozen=True)
class Rhythm:
    """How long a gait cycle is, in units of the slowest natural period; see `rhythm`.

    Attributes:
        fastest: of the first mode with the control stiffness in a body of 1 m, Hz; stiffer bodies
            are softened (on the ground none is).
        periods: a cycle, in periods of the first mode with the control stiffness.
        steps: control steps in a cycle, at least.
        finest: longest time step, in periods of the last mode with the control stiffness.
        falling: a cycle lasts this many sqrt(height / g) at least, on the ground.
    """

    fastest: float
    periods: float
    steps: int
    finest: float
    falling: float = 0.0


_MOST_STEPS = 200


def rhythm(rule: Rhythm, hertz: Sequence[float] | np.ndarray, height: float) -> tuple[float, int]:
    """Return the time step, s, and the steps of a cycle.

    With f the natural frequencies with the control stiffness, which is what the target shape pulls with:
    a cycle is 2.5 / f_1 (a swimmer in the plane), 1.4 / f_1 (in space) or 2.1 / f_1 on the ground, there
    at least 2.6 sqrt(height / g), the time of falling over; 32, 18 and 46 steps a cycle, and more if
    the last mode would have fewer than 1.7 of them in a period. So have it the shipped tasks: the fish
    2.50, the swimmer 1.38, the walkers 2.11 and 2.6. The time step has three digits.

    Args:
        rule: of its kind (`taskfile.kinds`).
        hertz: of the modes that are used, with the control stiffness.
        height: of the body, m.
    """
    period = max(rule.periods / min(hertz), rule.falling * np.sqrt(height / STANDARD_GRAVITY))
    steps = max(rule.steps, int(np.ceil(period * max(hertz) / rule.finest)))
    steps = min(steps, _MOST_STEPS)
    return float(f"{period / steps:.3g}"), steps


def stiffened(
    rule: Rhythm, options: BodyOptions, hertz: np.ndarray, length: float, height: float
) -> tuple[BodyOptions, np.ndarray]:
    """Return options whose Young's modulus suits the body, and its modes, Hz.

    A swimmer is softened if its modes are faster than the shipped swimmer's: what rights it, and its
    material's damping, go with time and not with its modes; a stiffer body is tilted before it is righted, and
    overdamped. Sizes are compared at the same Froude number, that is at frequencies that go with the
    inverse root of the length. A walker is stiffened if a cycle of its modes lasts longer than it takes to
    fall over (`rhythm`): its legs do not carry it. The righting height goes with the length.

    Args:
        rule: of its kind (`taskfile.kinds`).
        hertz: of the modes that are used, with the control stiffness.
        length, height: of the body, m.
    """
    medium = options.medium
    medium = dataclasses.replace(medium, righting_height=medium.righting_height * length)
    slowest = min(hertz)
    if rule.falling:
        aim = max(slowest, rule.periods / (rule.falling * np.sqrt(height / STANDARD_GRAVITY)))
    else:
        aim = min(slowest, rule.fastest / np.sqrt(length))
    if aim == slowest:
        return dataclasses.replace(options, medium=medium), hertz
    material = options.material
    young = float(f"{material.youngs_modulus * (aim / slowest) ** 2:.2g}")
    faster = np.sqrt(young / material.youngs_modulus)
    material = dataclasses.replace(material, youngs_modulus=young)
    return dataclasses.replace(options, medium=medium, material=material), hertz * faster
