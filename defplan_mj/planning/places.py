"""Named scenes that are harder than a few obstacles on the way: dense fields, pockets, gates, mazes, tunnels."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from defplan_mj.base.errors import DefplanError
from defplan_mj.base.places import PLACES, check_place
from defplan_mj.base.rotations import level_attitude
from defplan_mj.planning.scene import FAR, Scene, SceneBatch
from defplan_mj.task import Navigation

_STREAM = 120  # first word of the seeds; a place's number is the second
POST, STEP = 0.4, 0.75
"""Walls are rows of cylinders of this radius, this far apart: nothing passes between them, m."""

Layout = Callable[[np.random.Generator, float, float], tuple[np.ndarray, np.ndarray]]
"""layout(generator, distance, width) returns centres (m, 2) and radii (m,), m; the target lies at (distance, 0),
`width` is that of the disc that holds the robot, and there is a way for that from the start."""


def _clear(centres: np.ndarray, radii: np.ndarray, distance: float) -> np.ndarray:
    """Return which obstacles leave 2 m around the start and the target clear."""
    start = np.linalg.norm(centres, axis=1)
    end = np.linalg.norm(centres - [distance, 0], axis=1)
    return np.minimum(start, end) > radii + 2.0


def _field(count: int, half_width: float) -> Layout:
    def layout(
        generator: np.random.Generator, distance: float, width: float
    ) -> tuple[np.ndarray, np.ndarray]:
        gap = 1.25 * width  # between any two
        centres, radii = np.zeros((0, 2)), np.zeros(0)
        for _ in range(4000):
            centre = generator.uniform([1.0, -half_width], [distance - 1.0, half_width])
            radius = generator.uniform(0.3, 0.8)
            apart = np.linalg.norm(centres - centre, axis=1)
            free = np.all(apart > radii + radius + gap)
            if free and _clear(centre[None], np.array([radius]), distance)[0]:
                centres, radii = np.vstack([centres, centre]), np.append(radii, radius)
                if len(radii) == count:
                    break
        return centres, radii

    return layout


def _wall(points: np.ndarray) -> np.ndarray:
    """Return posts (m, 2) along a polygon (n, 2)."""
    lengths = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    along = np.linspace(0, lengths[-1], int(np.ceil(lengths[-1] / STEP)) + 1)
    return np.column_stack([np.interp(along, lengths, column) for column in points.T])


def _posts(walls: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    centres = np.concatenate([_wall(wall) for wall in walls])
    return centres, np.full(len(centres), POST)


def _pockets(
    generator: np.random.Generator, distance: float, width: float
) -> tuple[np.ndarray, np.ndarray]:
    walls = []
    for middle in (0.35 * distance, 0.7 * distance):
        radius = generator.uniform(1.5, 2.0) * width
        angle = generator.uniform(-0.3, 0.3) + np.linspace(-1.7, 1.7, 40)
        centre = np.array([middle - 0.3 * radius, generator.uniform(-1.0, 1.0)])
        walls.append(centre + radius * np.column_stack([np.cos(angle), np.sin(angle)]))
    return _posts(walls)


def _gates(
    generator: np.random.Generator, distance: float, width: float
) -> tuple[np.ndarray, np.ndarray]:
    walls = []
    half = 0.75 * width + POST  # the gate is as wide as the robot and a half
    for x in (0.35 * distance, 0.7 * distance):
        gate = generator.uniform(-4.0, 4.0)
        walls.append(np.array([[x, -10.0], [x, gate - half]]))
        walls.append(np.array([[x, gate + half], [x, 10.0]]))
    return _posts(walls)


def _maze(
    generator: np.random.Generator, distance: float, width: float
) -> tuple[np.ndarray, np.ndarray]:
    side, lane = 1.5, 1.75 * width + 2 * POST
    square = side / 2 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1], [-1, -1]])
    boxes = []
    for row, x in enumerate(np.arange(4.0, distance - 3.0, side + lane)):
        offset = generator.uniform(-1, 1) + (row % 2) * (side + lane) / 2
        boxes += [square + [x, offset + k * (side + lane)] for k in range(-2, 3)]
    centres, radii = _posts(boxes)
    keep = _clear(centres, radii, distance)
    return centres[keep], radii[keep]


def _tunnel(
    generator: np.random.Generator, distance: float, width: float
) -> tuple[np.ndarray, np.ndarray]:
    x = np.linspace(-2.0, distance + 2.0, 200)
    share = np.clip(x / distance, 0, 1)
    bend = np.sin(2 * np.pi * generator.uniform(0.8, 1.5) * share + generator.uniform(0, np.pi))
    bend = generator.uniform(1.0, 2.5) * (bend - bend[0]) * np.sin(np.pi * share) ** 0.5
    slope = np.gradient(bend, x)
    across = np.column_stack([-slope, np.ones_like(x)]) / np.hypot(1, slope)[:, None]
    way, half = np.column_stack([x, bend]), 1.1 * width + POST
    left, right = way + half * across, way - half * across
    return _posts([left, np.array([left[0], right[0]]), right])


_LAYOUTS: dict[str, Layout] = {
    "field-20": _field(20, 7.0),
    "field-40": _field(40, 14.0),
    "pockets": _pockets,
    "gates": _gates,
    "maze": _maze,
    "tunnel": _tunnel,
}


def place_batch(
    name: str,
    navigation: Navigation,
    generator: np.random.Generator,
    radius: float,
    bearings: np.ndarray,
    headings: np.ndarray,
    distances: np.ndarray,
) -> SceneBatch:
    """Return scenes of a named place, the robot heading along the tunnel, if it is one.

    Args:
        radius: of the disc that holds the robot, m: gates, lanes and tunnels are as wide as it asks for.
        bearings, headings: (n,) direction of the target and of the robot at the start, rad.
        distances: (n,) of the targets, m.
    """
    along = np.column_stack([np.cos(bearings), np.sin(bearings)])
    parts = [_LAYOUTS[name](generator, distance, 2 * radius) for distance in distances]
    n, most = len(parts), max(len(radii) for _, radii in parts)
    centres, radii = np.full((n, most, 2), FAR), np.zeros((n, most))
    for i, ((x, y), (places, sizes)) in enumerate(zip(along, parts, strict=True)):
        centres[i, : len(sizes)] = places @ np.array([[x, y], [-y, x]])
        radii[i, : len(sizes)] = sizes
    return SceneBatch(
        targets=distances[:, None] * along,
        orientations=level_attitude(bearings if name == "tunnel" else headings),
        centres=centres,
        radii=radii,
        velocities=np.zeros_like(centres),
        goal_radius=navigation.goal_radius,
        max_cycles=navigation.max_cycles,
    )


def place_scenes(
    name: str, navigation: Navigation, n: int, seed: int, radius: float
) -> list[Scene]:
    """Return n scenes of a named place; targets lie in any direction, the start heads anywhere.

    Args:
        radius: see `place_batch`.

    Raises:
        DefplanError: there is no such place, or the task is not of the plane.
    """
    check_place(name, navigation.dimension)
    if n < 1:
        raise DefplanError(f"an evaluation needs at least 1 episode, not {n}")
    generator = np.random.default_rng([_STREAM, list(PLACES).index(name), seed])
    bearings, headings = generator.uniform(-np.pi, np.pi, (2, n))
    distances = np.full(n, navigation.distance)
    batch = place_batch(name, navigation, generator, radius, bearings, headings, distances)
    return batch.scenes([{"kind": name, "seed": seed, "index": i} for i in range(n)])
