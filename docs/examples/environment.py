"""The suite like dm_control's: o, r = env.step(a), with the actions a = u / amplitude of a gait as the policy.

python docs/examples/environment.py
"""

from __future__ import annotations

import numpy as np

from defplan_mj import suite
from defplan_mj.gait.gait import Gait
from defplan_mj.registry import get_task


def main(seconds: float = 2.0) -> float:
    """Return how far the fish gets in some seconds, m."""
    shipped = get_task("fish-swim").shipped
    assert shipped is not None
    gait = Gait.load(shipped[1])
    actions = gait.table()[gait.task_names.index("forward")] / gait.amplitude  # (n, r) in [-1, 1]
    env = suite.load("fish", "swim", task_kwargs={"random": 0})
    env.reset()
    start, total = env.physics.com(), 0.0
    for k in range(round(seconds / env.control_timestep())):
        total += env.step(actions[k % len(actions)]).reward
    way = float(np.linalg.norm(env.physics.com() - start))
    print(f"{way:.2f} m, return {total:.1f}")
    return way


if __name__ == "__main__":
    main()
