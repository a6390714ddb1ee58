"""CasADi functions that hold the reduced dynamics as files, with the bodies they are of."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import casadi
import numpy as np

from defplan_mj.base import files
from defplan_mj.base.errors import DefplanError
from defplan_mj.dynamics import casadi_slots
from defplan_mj.kernel import library

_KIND, _PROBLEM, _VERSION = "CasADi function", "CasADi problem", 1


@dataclass(frozen=True)
class Instance:
    """A problem min f(x) with lbx <= x <= ubx, lbg <= g(x) <= ubg, from a file.

    Attributes:
        function: x (n,) -> f, g (m,).
        x0: (n,) where to start.
        lbx, ubx: (n,) bounds of x.
        lbg, ubg: (m,) bounds of g.
        meta: what it is, JSON-able.
        body: file of the body (npz), as bytes; see `save_body`.
    """

    function: casadi.Function
    x0: np.ndarray
    lbx: np.ndarray
    ubx: np.ndarray
    lbg: np.ndarray
    ubg: np.ndarray
    meta: dict = field(default_factory=dict)
    body: bytes = b""

    def save_body(self, path: str | Path) -> None:
        """Write the body that the problem is about, as `Body.load` reads it."""
        files.write_bytes(path, self.body)


_VALUES = ("x0", "lbx", "ubx", "lbg", "ubg")


def save_function(path: str | Path, function: casadi.Function) -> None:
    """Write a CasADi function with the models (bodies, options, terrains, feet) of the steps in it.

    CasADi's own `save` and pickle write the function without its body: CasADi refuses to load that
    where the slot does not hold the body.
    """
    _save(path, _KIND, function, {}, {})


def load_function(path: str | Path) -> casadi.Function:
    """Read a function of `save_function`, in any process; its bodies come with it.

    Load only files that you trust: a CasADi function may name libraries that run.

    Raises:
        DefplanError: the file is missing, damaged, of another version, or there is no slot left.
    """
    return _load(path, _KIND)[0]


def save_instance(path: str | Path, instance: Instance) -> None:
    """Write a whole problem, its body and the models of the steps in it."""
    arrays = {name: np.asarray(getattr(instance, name), float) for name in _VALUES}
    arrays["body_file"] = np.frombuffer(instance.body, np.uint8)
    _save(path, _PROBLEM, instance.function, arrays, instance.meta)


def load_instance(path: str | Path) -> Instance:
    """Read a problem of `save_instance` or `GaitProblem.export`; as `load_function`."""
    function, arrays, meta = _load(path, _PROBLEM)
    x0, lbx, ubx, lbg, ubg = (arrays[name] for name in _VALUES)
    return Instance(function, x0, lbx, ubx, lbg, ubg, meta, arrays["body_file"].tobytes())


def _save(
    path: str | Path,
    kind: str,
    function: casadi.Function,
    values: Mapping[str, np.ndarray],
    about: dict,
) -> None:
    text = function.serialize()
    arrays = {"function": np.frombuffer(text.encode(), np.uint8), **values}
    slots = []
    for slot in casadi_slots.slots_in(text):
        held = casadi_slots.opened(slot)
        for name, array in zip(casadi_slots.ARRAYS, held.arrays, strict=True):
            if array is not None:
                arrays[f"{name}_{held.key}"] = array
        slots.append({"slot": slot, "steps": held.steps, "key": held.key})
    meta = {"slots": slots, "library": str(library.PATH), "casadi": casadi.__version__}
    files.save_archive(path, kind, _VERSION, arrays, {**meta, "about": about})


def _load(path: str | Path, kind: str) -> tuple[casadi.Function, dict[str, np.ndarray], dict]:
    arrays, meta, _ = files.load_archive(path, kind, _VERSION)
    text, taken = arrays["function"].tobytes().decode(), []
    try:
        slots = {}
        for entry in meta["slots"]:
            model = tuple(arrays.get(f"{name}_{entry['key']}") for name in casadi_slots.ARRAYS)
            taken.append(casadi_slots.open_slot(model, entry["steps"], entry["steps"] == 1))
            slots[entry["slot"]] = taken[-1]
        text = _moved(_renamed(text, slots), meta["library"], str(library.PATH))
        try:
            return casadi.Function.deserialize(text), arrays, meta["about"]
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
