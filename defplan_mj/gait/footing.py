"""How a walker puts its feet: slip, penetration, and what else of the body touches the ground."""

from __future__ import annotations

import numpy as np

from defplan_mj.dynamics.reduced import ReducedDynamics
from defplan_mj.kernel.contact_points import contact_points

# Shares of the undeformed height: below is a foot's (a T's bar is arched by 12%), above is no leg's.
SOLE, TORSO = 0.15, 0.30
_CYCLES = 40  # at most, that are looked at


def footing(dynamics: ReducedDynamics, states: np.ndarray) -> dict[str, float]:
    """Return measures of walking on level ground z = 0, over cycles of states (cycles, n + 1, nx).

    Returns:
        'slip_m': what the loaded contacts slide in a cycle, weighted with their share of the load;
        'slip_share': the same a metre that the body walks;
        'penetration_mm', 'penetration_share': deepest contact, and in units of the body's height;
        'torso_clearance_m': least height of a point above the lowest 30% of the undeformed body;
        'belly_load': share of the load that is not on the lowest 15% of it, the soles.
    """
    body = dynamics.body
    surface = body.vertices[body.surface]
    height = (surface[:, 2] - surface[:, 2].min()) / np.ptp(surface[:, 2])
    touching = contact_points(body)
    states = states[:_CYCLES]
    if not len(states):
        return {}
    slip, deepest, clearance, load, belly = 0.0, -np.inf, np.inf, 0.0, 0.0
    for cycle in states:
        before = dynamics.surface(cycle[0])
        for x in cycle[1:]:
            now, contacts = dynamics.surface(x), dynamics.contacts(x)
            clearance = min(clearance, float(now[height > TORSO, 2].min()))
            if len(contacts.which):
                points, weight = touching[contacts.which], contacts.forces[:, 2]
                moved = np.linalg.norm((now - before)[points, :2], axis=1)
                slip += float(weight @ moved) / weight.sum()
                deepest = max(deepest, float(contacts.depths.max()))
                load += weight.sum()
                belly += weight[height[points] > SOLE].sum()
            before = now
    walked = np.linalg.norm(states[:, -1, :2] - states[:, 0, :2], axis=1).sum()
    return {
        "slip_m": float(slip / len(states)),
        "slip_share": float(slip) / max(walked, 1e-9),
        "penetration_mm": 1e3 * max(deepest, 0.0),
        "penetration_share": max(deepest, 0.0) / float(np.ptp(surface[:, 2])),
        "torso_clearance_m": clearance,
        "belly_load": float(belly) / max(load, 1e-9),
    }
