"""CasADi functions that hold the reduced dynamics as files, with the bodies they are of."""

from __future__ import annotations

from pathlib import Path

import casadi
import numpy as np

from defplan_mj import files
from defplan_mj.dynamics import casadi_slots
from defplan_mj.errors import DefplanError
from defplan_mj.kernel import library

_KIND, _VERSION = "CasADi function", 1


def save_function(path: str | Path, function: casadi.Function) -> None:
    """Write a CasADi function with the models (bodies, options, terrains, feet) of the steps in it.

    CasADi's own `save` and pickle write the function without its body: `load_function` cannot open
    that, and CasADi refuses to where the slot does not hold the body.
    """
    text = function.serialize()
    arrays = {"function": np.frombuffer(text.encode(), np.uint8)}
    slots = []
    for slot in casadi_slots.slots_in(text, encoded=True):
        held = casadi_slots.opened(slot)
        for name, array in zip(casadi_slots.ARRAYS, held.arrays, strict=True):
            if array is not None:
                arrays[f"{name}_{held.key}"] = array
        slots.append({"slot": slot, "steps": held.steps, "key": held.key})
    meta = {"slots": slots, "library": str(library.PATH), "casadi": casadi.__version__}
    files.save_archive(path, _KIND, _VERSION, arrays, meta)


def load_function(path: str | Path) -> casadi.Function:
    """Read a function of `save_function`, in any process; its bodies come with it.

    Load only files that you trust: a CasADi function may name libraries that run.

    Raises:
        DefplanError: the file is missing, damaged, of another kernel, or there is no slot left.
    """
    arrays, meta, _ = files.load_archive(path, _KIND, _VERSION)
    text, taken = arrays["function"].tobytes().decode(), []
    try:
        slots = {}
        for entry in meta["slots"]:
            model = tuple(arrays.get(f"{name}_{entry['key']}") for name in casadi_slots.ARRAYS)
            taken.append(casadi_slots.open_slot(model, entry["steps"], entry["steps"] == 1))
            slots[entry["slot"]] = taken[-1]
        text = _moved(_renamed(text, slots), meta["library"], str(library.PATH))
        try:
            return casadi.Function.deserialize(text)
        except RuntimeError as error:
            raise DefplanError(
                f"{path} was made by another version of defplan or of CasADi ({meta['casadi']}):"
                " make it anew"
            ) from error
    finally:
        for slot in taken:
            casadi_slots.close_slot(slot)


def _renamed(text: str, slots: dict[int, int]) -> str:
    """Return a serialised function on other slots; names have one length, so nothing else changes."""
    for prefix in ("defplan_step_", "defplan_rollout_", "defplan_feet_"):
        start = casadi_slots.encode(prefix)
        parts = text.split(start)
        for i, part in enumerate(parts[1:], 1):
            digits = casadi_slots.decode(part[:4])
            parts[i] = casadi_slots.encode(f"{slots[int(digits)]:02d}") + part[4:]
        text = start.join(parts)
    return text


def _moved(text: str, old: str, new: str) -> str:
    """Return a serialised function with the kernel at another path."""
    return text.replace(_sized(old), _sized(new))


def _sized(text: str) -> str:
    """Return a string as CasADi's serialisation writes it: its size (8 bytes), its characters."""
    size = len(text.encode()).to_bytes(8, "little")
    letters = "".join(chr(97 + (b & 15)) + chr(97 + (b >> 4)) for b in size)
    return letters + casadi_slots.encode(text)
