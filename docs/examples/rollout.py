"""A rollout x_{k+1} = f(x_k, u_k): a bent fish is let go, straightens, and the water takes the energy.

python docs/examples/rollout.py
"""

from __future__ import annotations

import numpy as np

from defplan_mj.body.model import Body
from defplan_mj.dynamics.reduced import ReducedDynamics
from defplan_mj.registry import get_task


def energies(dynamics: ReducedDynamics, states: np.ndarray) -> np.ndarray:
    """Return kinetic plus elastic energy of each state (N + 1,), J."""
    energy = [dynamics.energy(x) for x in states]
    return np.array([e["kinetic"] + e["elastic"] for e in energy], float)


def main(seconds: float = 1.0) -> np.ndarray:
    """Return the energies after letting go of a shape q_0, J."""
    spec = get_task("fish-swim")
    assert spec.shipped is not None
    f = ReducedDynamics(Body.load(spec.shipped[0]), spec.timestep)
    x = f.rest_state()
    x[7] = 0.5 * f.body.amplitude[0]  # q_0: bent sideways
    u = np.zeros((round(seconds / f.timestep), f.nu))  # the muscles pull to the straight shape
    energy = energies(f, f.rollout(x, u))
    print(f"{energy[0]:.2f} J, after {seconds:g} s {energy[-1]:.4f} J")
    return energy


if __name__ == "__main__":
    main()
