"""Which way up a mesh is and where its head points: as told, as the format lays down, or a guess."""

from __future__ import annotations

import numpy as np

from defplan_mj.base.errors import DefplanError
from defplan_mj.body.fidelity import asked_points, distances_of
from defplan_mj.body.orientation import direction
from defplan_mj.body.surface import Surface

_POINTS = 2000  # compared with their mirror images
_MIRROR = 0.02  # of the length: mean distance up to which a shape is its own image
_ALIKE = 2e-3  # the same, up to which y is a mirror whatever the others are
_CLEARLY = 2.0  # a better mirror than y has to be so many times better


def turn(
    surface: Surface,
    up: str | None,
    forward: str | None,
    said_up: str | None = None,
    said_forward: str | None = None,
) -> tuple[np.ndarray, str]:
    """Return the rotation (3, 3) that takes the file's axes to x forward, z up, and a sentence.

    Args:
        surface: in the file's axes.
        up, forward: what the user says, or None.
        said_up, said_forward: what the format says, or None.
    """
    if up and forward and direction(up) @ direction(forward) != 0.0:
        raise DefplanError(f"up is {up} and forward {forward}: they must be different axes")
    if up is None and forward is None and said_up is None:
        return _guess(surface)
    why = "as told" if up or forward else "by the format"
    if up is None:
        up = said_up if said_up and _crosses(said_up, forward) else _other(surface, forward)
        why = "up as the format has it" if up == said_up and forward else why
    if forward is None:
        fits = said_forward and _crosses(said_forward, up)
        forward = said_forward if fits else _other(surface, up)
        why += "" if fits else ", forward a guess"
    assert up is not None and forward is not None
    x, z = direction(forward), direction(up)
    matrix = np.stack([x, np.cross(z, x), z])
    if np.allclose(matrix, np.eye(3)):
        return matrix, ""
    return (
        matrix,
        f"turned: {up} of the file is up, {forward} is forward ({why}); --up and --forward overrule",
    )


def _extent(surface: Surface) -> np.ndarray:
    return np.ptp(surface.vertices[np.unique(surface.faces)], axis=0)


def _crosses(first: str, second: str | None) -> bool:
    return second is None or direction(first) @ direction(second) == 0.0


def _error(surface: Surface, axis: int) -> float:
    """Return how far the surface is from its mirror image along an axis, share of the length."""
    points = asked_points(surface, _POINTS)
    low, high = points.min(0), points.max(0)
    points[:, axis] = low[axis] + high[axis] - points[:, axis]
    return float(distances_of(points, surface)[0].mean() / (high - low).max())


def _other(surface: Surface, fixed: str | None) -> str:
    """Return the axis across `fixed` that is most likely the other one of up and forward."""
    free = [k for k in range(3) if fixed is None or "xyz"[k] != fixed[-1]]
    first, second = free
    errors, extent = [_error(surface, k) for k in range(3)], _extent(surface)
    if max(errors[first], errors[second]) > _CLEARLY * min(errors[first], errors[second]):
        side = first if errors[first] < errors[second] else second
        return "xyz"[second if side == first else first]
    return "xyz"[first if extent[first] >= extent[second] else second]


def _guess(surface: Surface) -> tuple[np.ndarray, str]:
    """Guess by the mirror: left and right are alike. Without a clear one nothing is turned."""
    left = _error(surface, 1)
    if left < _ALIKE:
        return np.eye(3), ""
    errors, extent = [_error(surface, 0), left, _error(surface, 2)], _extent(surface)
    side = int(np.argmin(errors))
    if side == 1 or errors[side] > _MIRROR or left < _CLEARLY * errors[side]:
        return np.eye(3), ""
    # left and right are along x or z: then y is up, as modelling programs have it, or forward
    other = 2 if side == 0 else 0
    up, forward = ("y", "xyz"[other])
    if side == 0 and extent[1] > 1.2 * extent[2]:
        up, forward = "z", "y"
    x, z = direction(forward), direction(up)
    return np.stack([x, np.cross(z, x), z]), (
        f"turned by a guess: the mesh is its own mirror image along {'xyz'[side]}, so {up} of the"
        f" file is taken as up and {forward} as forward; --up and --forward overrule"
    )
