"""The rigid surrogate f_fit: a cycle of gait j takes the body frame (c, R) to (c + R t_j, R R_j).

python docs/examples/surrogate.py
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from defplan_mj.body.model import Body
from defplan_mj.dynamics.reduced import ReducedDynamics
from defplan_mj.gait.gait import Gait
from defplan_mj.planning.fit import fit_surrogate
from defplan_mj.registry import get_task


def main(pairs: int = 60, cycles: int = 5) -> float:
    """Fit the fish's gaits, and return how far f_fit is off after one steady cycle of 'forward', m."""
    shipped = get_task("fish-swim").shipped
    assert shipped is not None
    gait = Gait.load(shipped[1])
    f = ReducedDynamics(Body.load(shipped[0]), gait.timestep, **gait.stepping)
    fit = fit_surrogate(f, gait, pairs)
    j = gait.task_names.index("forward")
    x = f.rollout(f.rest_state(), np.tile(gait.table()[j], (cycles, 1)))
    before, after = x[-1 - gait.steps_per_cycle], x[-1]
    R = Rotation.from_quat(before[3:7], scalar_first=True).as_matrix()
    error = float(np.linalg.norm(before[:3] + R @ fit.translations[j] - after[:3]))
    print(
        f"a cycle goes {np.linalg.norm(fit.translations[j]):.2f} m; this one is {error:.3f} m off"
    )
    return error


if __name__ == "__main__":
    main()
