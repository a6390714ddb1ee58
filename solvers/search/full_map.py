"""What a planner knows that is told all obstacles: clearance of its cycles, points of their surfaces."""

from __future__ import annotations

import numpy as np

from defplan_mj.base.errors import DefplanError
from defplan_mj.planning.planner import Observation
from defplan_mj.planning.surrogate import Motions

_GOLDEN = np.pi * (3 - np.sqrt(5))


def told_obstacles(observation: Observation, name: str) -> np.ndarray:
    """Return the obstacles (n, 2 d + 1) of an observation: centres in the robot's frame, radii, and how far
    they move in a cycle, m.

    Raises:
        DefplanError: it has none: it is not of a scene that tells them.
    """
    if "obstacles" not in observation:
        raise DefplanError(
            f"the planner {name} has to be told where all obstacles are, and this environment does not:"
            " let it steer by `defplan evaluate`"
        )
    return observation["obstacles"]


def clearances(
    obstacles: np.ndarray, position: np.ndarray, frame: np.ndarray, motions: Motions
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return how far the centre of mass stays from all obstacles in a cycle of each gait, m.

    Args:
        obstacles: (n, d + 1) centres and radii.
        position, frame: (d,), (d, d) of the robot.
        motions: of the K gaits.

    Returns:
        (K,) at the start, at the end and along the straight way; infinite if there are no obstacles.
    """
    count = len(motions.translations)
    if not len(obstacles):
        return (np.full(count, np.inf),) * 3
    d = len(position)
    local = (obstacles[:, :d] - position) @ frame
    edge = motions.translations
    share = np.clip(local @ edge.T / np.maximum((edge * edge).sum(1), 1e-12), 0, 1)
    radii = obstacles[:, d, None]

    def least(shares: np.ndarray) -> np.ndarray:
        offset = local[:, None] - shares[:, :, None] * edge
        return (np.sqrt(np.einsum("nkd,nkd->nk", offset, offset)) - radii).min(0)

    return least(np.zeros_like(share)), least(np.ones_like(share)), least(share)


def surface_points(obstacles: np.ndarray, spacing: float, reach: float) -> np.ndarray:
    """Return points (p, d) of the obstacles' surfaces, about `spacing` apart, at most `reach` away, m."""
    d = obstacles.shape[1] - 1
    told = [np.zeros((0, d))]
    for *centre, radius in obstacles:
        if np.linalg.norm(centre) - radius <= reach:
            told.append(np.array(centre) + radius * _directions(radius / spacing, d))
    points = np.concatenate(told)
    return points[np.einsum("pd,pd->p", points, points) <= reach**2]


def _directions(radius: float, d: int) -> np.ndarray:
    """Return unit vectors (n, d), even over the circle or sphere, a distance of 1 apart at a radius."""
    if d == 2:
        angle = np.linspace(0, 2 * np.pi, max(8, round(2 * np.pi * radius)), endpoint=False)
        return np.column_stack([np.cos(angle), np.sin(angle)])
    n = max(12, round(4 * np.pi * radius**2))  # a spiral at the golden angle
    z = 1 - (2 * np.arange(n) + 1) / n
    angle, ring = _GOLDEN * np.arange(n), np.sqrt(1 - z * z)
    return np.column_stack([ring * np.cos(angle), ring * np.sin(angle), z])
