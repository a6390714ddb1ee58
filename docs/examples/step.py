"""One step x' = f(x, u) and its derivatives A = df/dx, B = df/du, against central differences.

python docs/examples/step.py
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from defplan_mj.body.model import Body
from defplan_mj.dynamics.reduced import ReducedDynamics
from defplan_mj.registry import get_task

Function = Callable[[np.ndarray], np.ndarray]


def differences(f: Function, u: np.ndarray, h: float = 1e-5) -> np.ndarray:
    """Return (f(u + h e_j) - f(u - h e_j)) / 2h, column by column."""
    return np.stack([(f(u + h * e) - f(u - h * e)) / (2 * h) for e in np.eye(len(u))], axis=1)


def fish() -> ReducedDynamics:
    """Return the dynamics of the packaged fish."""
    spec = get_task("fish-swim")
    assert spec.shipped is not None
    return ReducedDynamics(Body.load(spec.shipped[0]), spec.timestep, tolerance=1e-12)


def main() -> float:
    """Return the largest difference between B and its differences, over B's largest entry."""
    f = fish()
    x = f.rest_state()
    u = 0.3 * f.body.amplitude * np.sin(np.arange(f.nu))
    _, B = f.step_jacobian(x, u, f.step(x, u))
    error = np.abs(B - differences(lambda u: f.step(x, u), u)).max() / np.abs(B).max()
    print(f"B is {B.shape}, off by {error:.1e}")
    return float(error)


if __name__ == "__main__":
    main()
