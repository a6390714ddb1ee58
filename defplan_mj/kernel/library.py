"""Load the compiled kernel and declare its functions (kernel.h) to ctypes; ctypes releases the GIL."""

from __future__ import annotations

import ctypes
import os
import platform
from ctypes import c_char_p, c_double, c_int, c_long, c_size_t, c_void_p
from functools import cache
from pathlib import Path

import numpy as np

from defplan_mj.base.errors import DefplanError

# Where libraries lie that were built elsewhere: those of `make sanitize`.
FOLDER = os.environ.get("DEFPLAN_LIBRARIES", "")


def library_path(package: str, name: str) -> Path:
    """Return where the library `name` of defplan_mj/`package` is."""
    root = Path(FOLDER).resolve() / "defplan_mj" if FOLDER else Path(__file__).parents[1]
    return root / package / name


PATH = library_path("kernel", "libdefplan_kernel.so")


class Info(ctypes.Structure):
    """dp_info: Newton iterations, attempts, failure flag, parts of a substep, size of the last Newton step."""

    _fields_ = [
        ("iterations", c_int),
        ("attempts", c_int),
        ("failed", c_int),
        ("division", c_int),
        ("residual", c_double),
    ]


class Model(ctypes.Structure):
    """dp_model: addresses of body, options, terrain, feet (the last two may be None)."""

    _fields_ = [(name, c_void_p) for name in ("body", "par", "terrain", "feet")]

    def __init__(
        self,
        body: np.ndarray,
        par: np.ndarray | None = None,
        terrain: np.ndarray | None = None,
        feet: np.ndarray | None = None,
    ) -> None:
        self.arrays = (body, par, terrain, feet)  # kept alive
        super().__init__(*(None if a is None else a.ctypes.data for a in self.arrays))


class Geom(ctypes.Structure):
    """dp_geom: MuJoCo's geom type, size (3), position (3), orientation (9, row-major)."""

    _fields_ = [
        ("type", c_int),
        ("size", c_double * 3),
        ("pos", c_double * 3),
        ("mat", c_double * 9),
    ]


class SearchProblem(ctypes.Structure):
    """dp_search_problem."""

    _integers = "d n_gaits before n_balls n_axes nodes cycles enough decisions single".split()
    _numbers = ("goal_radius", "margin", "weight", "cell", "heading", "advance", "per_radian")
    _arrays = ("rotations", "translations", "target", "balls", "axes", "then", "phase")
    _fields_ = [
        *((name, c_int) for name in _integers),
        *((name, c_double) for name in (*_numbers, "horizon")),
        *((name, c_void_p) for name in _arrays),
    ]


class AstarProblem(ctypes.Structure):
    """dp_astar_problem."""

    _integers = ("d", "n_sets", "before", "n_points", "n_axes", "nodes")
    _numbers = ("goal_radius", "clearance", "least", "weight", "cell", "heading", "advance")
    _arrays = (
        "ways_at steps_at reach starts ends parents in_place rotations"
        " translations cycles ends_with firsts finals points target axes"
    ).split()
    _fields_ = [
        *((name, c_int) for name in _integers),
        *((name, c_double) for name in (*_numbers, "per_radian", "horizon")),
        *((name, c_void_p) for name in _arrays),
    ]


_array = np.ctypeslib.ndpointer(np.float64, flags="C_CONTIGUOUS")
_pointer = ctypes.POINTER


def check_machine(lib: ctypes.CDLL) -> None:
    """Raise DefplanError if this machine lacks instructions that the library was compiled to use.

    Only the function that is called here runs on any machine (kernel/machine.c).
    """
    lib.dp_missing_instructions.restype = c_char_p
    if missing := lib.dp_missing_instructions().decode():
        raise DefplanError(
            f"this machine ({platform.processor() or platform.machine()}) has no {missing.upper()}"
            " instructions, which defplan was compiled with: build it here with DEFPLAN_MARCH=native"
        )


def build() -> str:
    """Return what the kernel was built for and of: target, hash of sources and options, compiler.

    Raises:
        DefplanError: it was not built.
    """
    library = _open()
    library.dp_build.restype = c_char_p
    return library.dp_build().decode()


def _open() -> ctypes.CDLL:
    try:
        return ctypes.CDLL(str(PATH))
    except OSError as error:
        raise DefplanError(
            f"the compiled kernel {PATH} is missing: reinstall defplan with a C compiler"
        ) from error


@cache
def kernel() -> ctypes.CDLL:
    """Return the kernel's library.

    Raises:
        DefplanError: it was not built, or for another kind of machine.
    """
    lib = _open()
    check_machine(lib)
    a, p = _array, _pointer
    m = p(Model)
    f, i = (np.ctypeslib.ndpointer(kind, flags="C_CONTIGUOUS") for kind in (np.float32, np.int32))
    signatures = {
        "dp_check": (c_int, [a, c_size_t]),
        "dp_check_model": (c_int, [m]),
        "dp_sizes": (None, [a, p(c_int)]),
        "dp_check_terrain": (c_int, [a, c_size_t]),
        "dp_check_feet": (c_int, [a, a, c_size_t]),
        "dp_step": (c_int, [m, a, a, a, p(Info)]),
        "dp_step_near": (c_int, [m, a, a, a, a, p(Info)]),
        "dp_step_many": (c_int, [m, c_int, c_void_p, c_void_p, c_void_p, c_int, c_void_p]),
        "dp_rollout": (c_int, [m, c_int, a, a, p(c_long)]),
        "dp_step_jac": (c_int, [m, a, a, a, a, a]),
        "dp_step_adj": (c_int, [m, a, a, a, a, a, a]),
        "dp_rollout_adj": (c_int, [m, c_int, a, a, a, a]),
        "dp_energy": (None, [m, a, a]),
        "dp_contacts": (c_int, [m, a, a, a, a]),
        "dp_terrain_gap": (c_double, [a, a, a]),
        "dp_feet": (None, [m, a, a, c_void_p]),
        "dp_surface": (None, [a, a, a]),
        "dp_clearance": (c_double, [a, a, c_int, p(Geom), c_double, p(c_int), p(c_int)]),
        "dp_geom_distance": (c_double, [p(Geom), a, a]),
        "dp_ways": (None, [c_int, c_int, i, f, f, i, c_int, f, f, f, f]),
        "dp_search_size": (c_size_t, [c_int]),
        "dp_search": (c_int, [p(SearchProblem), c_void_p, i]),
        "dp_astar_size": (c_size_t, [p(AstarProblem)]),
        "dp_astar": (c_int, [p(AstarProblem), c_void_p]),
        "dp_slot_open": (c_int, [m, c_int, c_char_p, c_int]),
        "dp_slot_close": (None, [c_int]),
        "dp_slot_sizes": (None, [c_int, c_char_p]),
        "dp_slot_failure": (c_int, [c_int]),
    }
    for name, (result, arguments) in signatures.items():
        function = getattr(lib, name)
        function.restype, function.argtypes = result, arguments
    return lib
