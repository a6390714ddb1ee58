"""What the arrays of a body have to be: shapes that belong together, indices, numbers, an orthonormal basis."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING

import numpy as np

from defplan_mj.base.errors import DefplanError

if TYPE_CHECKING:
    from defplan_mj.body.model import Body

MOST_VERTICES = 1_000_000
_ORTHONORMAL, _CONSISTENT = 1e-8, 1e-8
_LARGEST = 1e30  # of any number: its square is one, too

_SHAPES = {
    "vertices": ("n", 3),
    "tetrahedra": ("t", 4),
    "faces": ("f", 3),
    "vertex_mass": ("n",),
    "modes": ("n", 3, "r"),
    "frequencies": ("r",),
    "stiffness": ("r",),
    "amplitude": ("r",),
    "basis": ("n", 3, "k"),
    "sampled": ("s",),
    "feature_map": ("s", 9, "r"),
    "feature_weights": ("k", "9s"),
    "moments": ("k+1", "k+1", 3, 3),
    "drag_points": ("p", 3, "k+1"),
    "drag_tangents": (2, "p", 3, "k+1"),
    "drag_areas": ("p",),
    "surface": ("m",),
}
_INDICES = {"tetrahedra": "n", "faces": "n", "surface": "n", "sampled": "t"}
_POSITIVE = ("vertex_mass", "frequencies", "stiffness", "amplitude", "drag_areas")
_SIGNED = {"medium": ("gravity", "righting_height"), "material": ("poissons_ratio",)}
_MAY_BE_ZERO = ("damping", "control_stiffness", "drag_normal", "drag_tangential")


def validate_body(body: Body, where: str, whole: bool = True) -> None:
    """Raise a DefplanError that names the field if something of the body cannot be.

    Args:
        where: what is wrong, for the error: a file, or 'the body NAME'.
        whole: also mesh and basis, which the reduced step does not read.
    """
    sizes = _check_shapes(body, where)
    for name, of in _INDICES.items() if whole else (("surface", "n"),):
        index = getattr(body, name)
        if index.size and not (index.min() >= 0 and index.max() < sizes[of]):
            what = "vertices" if of == "n" else "tetrahedra"
            _refuse(where, name, f"names {what} that are not among the {sizes[of]}")
    for name in _POSITIVE:
        if not (getattr(body, name) > 0.0).all():
            _refuse(where, name, "must be positive")
    for name, least in (("n", 4), ("t", 1), ("f", 4), ("r", 1)) if whole else (("r", 1),):
        if sizes[name] < least:
            _refuse(where, {"n": "vertices", "t": "tetrahedra", "f": "faces", "r": "modes"}[name],
                    f"has {sizes[name]} entries, at least {least} are wanted")  # fmt: skip
    if (np.diff(body.surface) <= 0).any():
        _refuse(where, "surface", "must be sorted, each vertex once")
    if whole and not np.array_equal(body.surface, np.unique(body.faces)):
        _refuse(where, "surface", "is not the vertices of its faces")
    _check_constants(body, where)
    if not body.length > 0.0:
        _refuse(where, "vertices", "are all in one place")
    if whole:
        _check_basis(body, where)


def _refuse(where: str, name: str, why: str) -> None:
    raise DefplanError(f"{where} is no body that can be used: its {name} {why}; make it anew")


def _check_shapes(body: Body, where: str) -> dict[str, int]:
    """Return the sizes that the letters of `_SHAPES` stand for."""
    sizes: dict[str, int] = {}
    for name, shape in _SHAPES.items():
        array = getattr(body, name)
        kind = "iu" if name in _INDICES else "f"
        if not isinstance(array, np.ndarray) or array.dtype.kind not in kind:
            _refuse(where, name, f"must be {'integers' if kind == 'iu' else 'floating numbers'}")
        if array.ndim != len(shape):
            _refuse(where, name, f"has {array.ndim} dimensions, wanted {len(shape)}")
        for size, letter in zip(array.shape, shape, strict=True):
            known = dict(sizes)
            if "k" in sizes:
                known["k+1"] = sizes["k"] + 1
            if "s" in sizes:
                known["9s"] = 9 * sizes["s"]
            expected = letter if isinstance(letter, int) else known.get(letter)
            if expected is None:
                sizes[str(letter)] = size
            elif size != expected:
                _refuse(where, name, f"has shape {array.shape}, which does not fit the others"
                        f" ({expected} wanted where it has {size})")  # fmt: skip
        if kind == "f" and not (np.abs(array) < _LARGEST).all():
            _refuse(where, name, "has numbers that are not finite or too large")
    if sizes["n"] > MOST_VERTICES:
        _refuse(where, "vertices", f"are {sizes['n']}, at most {MOST_VERTICES} can be")
    return sizes


def _check_constants(body: Body, where: str) -> None:
    """Check material and medium."""
    for group in ("material", "medium"):
        for name, value in asdict(getattr(body, group)).items():
            if name == "name":
                continue
            label = f"{group}'s {name}"
            if not isinstance(value, (int, float)) or not abs(value) < _LARGEST:
                _refuse(where, label, f"is {value!r:.40}, a finite number is wanted")
            if name in _SIGNED[group]:
                continue
            zero = name in _MAY_BE_ZERO or (group, name) == ("medium", "density")
            if value < 0.0 or (value == 0.0 and not zero):
                _refuse(
                    where,
                    label,
                    f"is {value}, it must {'not be negative' if zero else 'be positive'}",
                )
    softening = body.mesh_softening
    if not isinstance(softening, (int, float)) or not 0.0 < softening < np.inf:
        _refuse(where, "mesh_softening", f"is {softening!r:.40}, it must be positive")
    if not -1.0 < body.material.poissons_ratio < 0.5:
        _refuse(where, "material's poissons_ratio", "must lie between -1 and 0.5")


def _check_basis(body: Body, where: str) -> None:
    """Check the basis and its moments against the mass they are of."""
    k = body.basis.shape[2]
    if not k:
        return
    mass = np.repeat(body.vertex_mass, 3)
    flat = np.concatenate([body.vertices[:, :, None], body.basis], axis=2).reshape(len(mass), -1)
    gram = flat.T @ (mass[:, None] * flat)
    off = np.abs(gram[1:, 1:] - np.eye(k)).max()
    if off > _ORTHONORMAL:
        _refuse(where, "basis", f"is not mass-orthonormal (by {off:.1e})")
    trace = np.einsum("abii->ab", body.moments)
    if np.abs(trace - gram).max() > _CONSISTENT * np.abs(gram).max():
        _refuse(where, "moments", "are not those of its vertices, mass and basis")
