"""The kernel's slots for CasADi (kernel/casadi.c): functions that name their model, and why they fail."""

from __future__ import annotations

import ctypes
import hashlib
import re
from dataclasses import dataclass

import casadi
import numpy as np

from defplan_mj.base.errors import DefplanError
from defplan_mj.kernel import library

N_SLOTS = 64
ARRAYS = ("body", "par", "terrain", "feet")
Arrays = tuple[np.ndarray | None, ...]  # of a Model, in the order of ARRAYS

_DERIVATIVES = {
    "defplan_step": ("jac_", "adj1_"),
    "defplan_rollout": ("adj1_",),
    "defplan_feet": ("jac_",),
}
_SIZES = 64  # kernel.h: DP_SLOT_SIZES
_FAILURES = {
    1: "a state or an input is not finite",
    2: "a quaternion has no direction: its length is 0 or huge",
    3: "a step was not solved",
    4: "there is no derivative: a step's matrix is singular",
}
_ERRORS = {
    -1: f"all {N_SLOTS} slots are in use: delete functions that are not needed any more"
    " (del, then gc.collect()), or make one function and map it",
    -2: "steps must be positive",
    -3: "there is no memory",
}


@dataclass(frozen=True)
class Slot:
    """What a slot holds.

    Attributes:
        key: hash of the model (64 hex digits).
        steps: N of its rollout.
        arrays: the model.
    """

    key: str
    steps: int
    arrays: Arrays


# What was opened last in each slot; right for every slot that a living function is on.
_opened: dict[int, Slot] = {}


def model_key(arrays: Arrays) -> str:
    """Return the hash (64 hex digits) of a model: body, options, terrain and feet."""
    digest = hashlib.sha256()
    for name, array in zip(ARRAYS, arrays, strict=True):
        values = np.empty(0) if array is None else np.ascontiguousarray(array, np.float64)
        digest.update(f"{name} {values.size} ".encode() + values.tobytes())
    return digest.hexdigest()


def open_slot(arrays: Arrays, steps: int, share: bool) -> int:
    """Open a slot with a copy of a model, or with `share` one that holds it already; close it again.

    Raises:
        DefplanError: there is none, or `steps` is not positive.
    """
    key = model_key(arrays)
    known = (held.arrays for held in _opened.values() if held.key == key)
    copied = next(known, None) or tuple(None if a is None else np.array(a, float) for a in arrays)
    body, par, terrain, feet = copied
    assert body is not None
    model = library.Model(body, par, terrain, feet)
    slot = library.kernel().dp_slot_open(model, steps, key.encode(), share)
    if slot < 0:
        raise DefplanError(
            f"no CasADi function of the reduced dynamics can be made: {_ERRORS[slot]}"
        )
    _opened[slot] = Slot(key, steps, copied)
    return slot


def close_slot(slot: int) -> None:
    """Give up what `open_slot` returned: the slot is free when no function is on it any more."""
    library.kernel().dp_slot_close(slot)


def opened(slot: int) -> Slot:
    """Return what a slot holds that a living function is on."""
    return _opened[slot]


def make_function(arrays: Arrays, name: str, steps: int) -> casadi.Function:
    """Return a function of a model: 'defplan_step' or 'defplan_feet' (one step), 'defplan_rollout'.

    It and its derivatives name their model in their config_args, which stay with them when they are
    saved. Functions of one step share a slot; a rollout has a slot, and a memory, of its own.
    """
    slot = open_slot(arrays, steps, share=steps == 1)
    try:
        sizes = ctypes.create_string_buffer(_SIZES)
        library.kernel().dp_slot_sizes(slot, sizes)
        options = {"config_args": [_opened[slot].key, sizes.value.decode()]}
        whole, path = f"{name}_{slot:02d}", str(library.PATH)
        # Made by CasADi itself, derivatives would not name their model.
        derivatives = {
            prefix + whole: casadi.external(prefix + whole, path, options)
            for prefix in _DERIVATIVES[name]
        }
        return casadi.external(whole, path, {**options, "cache": derivatives})
    finally:
        close_slot(slot)


def slots_in(serialised: str) -> list[int]:
    """Return the slots that a serialised function is on."""
    names = "|".join(map(encode, _DERIVATIVES))
    matches = set(re.findall(f"(?:{names}){encode('_')}([a-p]{{4}})", serialised))
    return sorted(int(decode(digits)) for digits in matches)


def encode(text: str) -> str:
    """Return `text` as CasADi's serialisation writes its characters: two letters each."""
    return "".join(chr(97 + (c & 15)) + chr(97 + (c >> 4)) for c in text.encode())


def decode(letters: str) -> str:
    """Return what `encode` was given."""
    pairs = zip(letters[::2], letters[1::2], strict=True)
    return bytes((ord(a) - 97) + 16 * (ord(b) - 97) for a, b in pairs).decode()


def failure(function: casadi.Function) -> str | None:
    """Return why the last evaluation of the dynamics in `function` that failed did, or None.

    CasADi says 'Evaluation failed' only. The reason is forgotten when it has been asked for.
    """
    codes = [library.kernel().dp_slot_failure(slot) for slot in slots_in(function.serialize())]
    reasons = [_FAILURES[code] for code in codes if code]
    return reasons[0] if reasons else None
