"""How much each mode of a body is of a style: motions that gaits start in, and use freely."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from defplan_mj.body.model import Body

_X = np.array([1.0, 0.0, 0.0])


def lateral_share(
    vertices: np.ndarray,
    modes: np.ndarray,
    mass: np.ndarray,
    axis: np.ndarray = _X,
    sections: int = 24,
) -> np.ndarray:
    """Return (r,) how much of each mode bends a body sideways as a whole, 0 to 1.

    The share of the mode's kinetic energy in the lateral motion of the means of its cross-sections
    along the own axis (a horizontal one).

    Args:
        vertices: (n, 3).
        modes: (n, 3, r) of any scale.
        mass: (n,) of the vertices.
    """
    x, side = vertices @ axis, np.cross([0.0, 0.0, 1.0], axis)
    edges = np.linspace(x.min(), x.max(), sections + 1)[1:-1]
    motion = (modes.transpose(0, 2, 1) @ side)[None]
    return _share_of_means(modes, mass, np.digitize(x, edges), motion)


def sideways_share(body: Body, axis: np.ndarray) -> np.ndarray:
    """Return `lateral_share` of a body's modes."""
    return lateral_share(body.vertices, body.modes, body.vertex_mass, axis)


def pulse_share(body: Body, axis: np.ndarray, sections: int = 8, rings: int = 4) -> np.ndarray:
    """Return (r,) how much of each mode is the same all around the own axis, 0 to 1.

    The share of its kinetic energy in the mean radial and axial motion of rings about the axis.
    """
    along = body.vertices @ axis
    radial = body.vertices - np.outer(along, axis)
    radius = np.linalg.norm(radial, axis=1)
    outward = radial / np.maximum(radius, 1e-9)[:, None]
    section = np.digitize(along, np.linspace(along.min(), along.max(), sections + 1)[1:-1])
    ring = np.digitize(radius, np.linspace(0.0, radius.max(), rings + 1)[1:-1])
    motion = [
        np.einsum("nir,ni->nr", body.modes, outward),
        np.einsum("nir,i->nr", body.modes, axis),
    ]
    group = section * rings + ring
    return _share_of_means(body.modes, body.vertex_mass, group, np.array(motion))


def _share_of_means(
    modes: np.ndarray, mass: np.ndarray, group: np.ndarray, motion: np.ndarray
) -> np.ndarray:
    """Return (r,) the share of the modes' energy in the group means of motions (c, n, r)."""
    groups = group.max() + 1
    weight = np.bincount(group, mass, groups)
    shares = []
    for r, mode in enumerate(modes.transpose(2, 0, 1)):
        moments = [np.bincount(group, mass * part[:, r], groups) for part in motion]
        means = np.array(moments) / np.maximum(weight, 1e-300)
        shares.append((weight * means**2).sum() / (mass[:, None] * mode**2).sum())
    return np.array(shares)


STYLES: dict[str, Callable[[Body, np.ndarray], np.ndarray]] = {
    "sideways": sideways_share,
    "pulse": pulse_share,
}
