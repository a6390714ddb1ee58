"""Turns a mesh so that it looks along x with z up: which of its file's axes these are is an option."""

from __future__ import annotations

from dataclasses import replace
from typing import TypeVar

import numpy as np

from defplan_mj.base.errors import DefplanError
from defplan_mj.body.options import AXES
from defplan_mj.body.surface import Surface
from defplan_mj.body.tetmesh import TetMesh

_Mesh = TypeVar("_Mesh", bound=Surface | TetMesh)


def direction(name: str) -> np.ndarray:
    """Return the unit vector (3,) of 'x', '-x', 'y' and so on.

    Raises:
        DefplanError: there is no such axis.
    """
    if name not in AXES:
        raise DefplanError(f"there is no axis {name}: it is one of {', '.join(AXES)}")
    return (-1.0 if name.startswith("-") else 1.0) * np.eye(3)["xyz".index(name[-1])]


def frame_of(up: str, forward: str) -> np.ndarray:
    """Return the rotation (3, 3) that takes the file's coordinates to the body's.

    Raises:
        DefplanError: both are along one axis.
    """
    z, x = direction(up), direction(forward)
    if up[-1] == forward[-1]:
        raise DefplanError(f"up is {up} and forward is {forward}: they must be two different axes")
    return np.array([x, np.cross(z, x), z])


def turned(mesh: _Mesh, up: str = "z", forward: str = "x") -> _Mesh:
    """Return a mesh whose axes `up` and `forward` are z and x; the same object if they already are."""
    frame = frame_of(up, forward)
    if np.array_equal(frame, np.eye(3)):
        return mesh
    return replace(mesh, vertices=mesh.vertices @ frame.T)
