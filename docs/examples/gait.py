"""A gait is a rhythmic DMP, u(t) = sum_k alpha_k exp(beta_k cos(tau t - mu_k)): play one, and see how far it goes.

python docs/examples/gait.py
"""

from __future__ import annotations

import numpy as np

from defplan_mj.body.model import Body
from defplan_mj.dynamics.reduced import ReducedDynamics
from defplan_mj.gait.gait import Gait
from defplan_mj.registry import get_task


def shapes(gait: Gait, task: int) -> np.ndarray:
    """Return the target shapes u (n, r) at the ends of the n steps of a cycle."""
    t = gait.timestep * np.arange(1, gait.steps_per_cycle + 1)
    alpha, beta, mu = gait.alpha[task], gait.beta[task], gait.mu  # (D, r)
    bumps = [
        a * np.exp(b * np.cos(gait.tau * t[:, None] - m))
        for a, b, m in zip(alpha, beta, mu, strict=True)
    ]
    return np.clip(np.sum(bumps, axis=0), -gait.amplitude, gait.amplitude)


def main(cycles: int = 6) -> float:
    """Return the advance in the last of some cycles of the fish's gait 'forward', m."""
    shipped = get_task("fish-swim").shipped
    assert shipped is not None
    gait = Gait.load(shipped[1])
    f = ReducedDynamics(Body.load(shipped[0]), gait.timestep, **gait.stepping)
    u = shapes(gait, gait.task_names.index("forward"))
    x = f.rollout(f.rest_state(), np.tile(u, (cycles, 1)))
    c = x[:: gait.steps_per_cycle, :3]  # centre of mass between cycles
    advance = float(np.linalg.norm(c[-1] - c[-2]))
    print(f"{advance:.2f} m in a cycle of {gait.cycle_seconds:.2f} s")
    return advance


if __name__ == "__main__":
    main()
