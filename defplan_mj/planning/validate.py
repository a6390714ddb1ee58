"""What a surrogate's content has to be: a proper rotation and a finite way for each gait."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import numpy as np

from defplan_mj.base.errors import DefplanError
from defplan_mj.base.printable import MOST_LETTERS, is_name

if TYPE_CHECKING:
    from defplan_mj.planning.surrogate import Surrogate

_HASH = re.compile("[0-9a-f]{64}")
_ORTHONORMAL = 1e-6
_MOST_GAITS = 10_000


def validate_surrogate(surrogate: Surrogate, where: str) -> None:
    """Raise a DefplanError that names the field if something of the surrogate cannot be.

    Args:
        where: what is wrong, for the error: a file.
    """

    def refuse(name: str, why: str) -> None:
        raise DefplanError(
            f"{where} is no surrogate that can be used: its {name} {why}; make it anew"
        )

    names = surrogate.task_names
    if not names or not all(isinstance(name, str) and is_name(name) for name in names):
        refuse("task_names", f"must be names of at most {MOST_LETTERS} letters, one or more")
    if len(set(names)) < len(names) or len(names) > _MOST_GAITS:
        refuse("task_names", f"must be different and at most {_MOST_GAITS}")
    for name in ("body_hash", "gait_hash"):
        value = getattr(surrogate, name)
        if not isinstance(value, str) or not _HASH.fullmatch(value):
            refuse(name, "must be 64 hexadecimal digits")
    pairs = surrogate.pairs
    if not isinstance(pairs, int) or isinstance(pairs, bool) or not 1 <= pairs < 2**31:
        refuse("pairs", f"is {pairs!r:.40}, a whole number of at least 1 is wanted")
    decisions = surrogate.decisions_per_cycle
    if not isinstance(decisions, int) or isinstance(decisions, bool) or not 1 <= decisions < 1000:
        refuse(
            "decisions_per_cycle", f"is {decisions!r:.40}, a whole number of at least 1 is wanted"
        )
    if decisions > 1 and surrogate.switching is None:
        refuse(
            "decisions_per_cycle", f"is {decisions}, and motions of parts of a cycle are missing"
        )
    for name in ("cycle_seconds", "radius"):
        value = getattr(surrogate, name)
        if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 < value < 1e9:
            refuse(name, f"is {value!r:.40}, a positive number is wanted")
    k = len(names)
    shapes = {"rotations": (k, 3, 3), "translations": (k, 3)}
    shapes |= dict.fromkeys(("rotation_mean", "rotation_sd"), (k,))
    shapes |= dict.fromkeys(("translation_mean", "translation_sd"), (k,))
    for name, shape in shapes.items():
        array = getattr(surrogate, name)
        if not isinstance(array, np.ndarray) or array.dtype.kind != "f":
            refuse(name, "must be floating numbers")
        if array.shape != shape:
            refuse(name, f"has shape {array.shape}, wanted {shape}")
        # the spread of a single pair is not a number
        bad = np.isinf(array) if name.endswith("_sd") else ~np.isfinite(array)
        if bad.any():
            refuse(name, "has numbers that are not finite")
    if not _are_rotations(surrogate.rotations):
        refuse("rotations", "are no rotations")
    if (switching := surrogate.switching) is None:
        return
    pasts = surrogate.rest + 1
    shapes = {"rotations": (pasts, k, 3, 3), "translations": (pasts, k, 3)}
    shapes |= dict.fromkeys(("rotation_sd", "translation_sd"), (pasts, k))
    for name, shape in shapes.items():
        array = getattr(switching, name)
        if array.dtype.kind != "f" or array.shape != shape or not np.isfinite(array).all():
            refuse(f"switched {name}", f"must be finite numbers of shape {shape}")
    if not _are_rotations(switching.rotations):
        refuse("switched rotations", "are no rotations")


def _are_rotations(turns: np.ndarray) -> bool:
    off = np.abs(turns @ np.swapaxes(turns, -1, -2) - np.eye(3)).max()
    return bool(off <= _ORTHONORMAL and (np.linalg.det(turns) >= 0.0).all())
