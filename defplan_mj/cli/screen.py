"""How MuJoCo draws in this process: decided before it is imported, since it looks only then."""

from __future__ import annotations

import ctypes
import os
import sys


def choose_renderer(draws: bool) -> None:
    """Set MUJOCO_GL for a machine without a screen, unless the user has set it.

    Args:
        draws: whether the command makes pictures; if not, nothing is loaded for it.
    """
    if "MUJOCO_GL" in os.environ:
        return
    if not draws:
        os.environ["MUJOCO_GL"] = "disable"
    elif sys.platform == "linux" and not has_screen():
        os.environ["MUJOCO_GL"] = "egl" if _loads("libEGL.so.1") else "osmesa"
        if os.environ["MUJOCO_GL"] == "osmesa" and not _loads("libOSMesa.so.8"):
            os.environ["MUJOCO_GL"] = "disable"


def has_screen() -> bool:
    """Return whether there is a display to open a window on."""
    return sys.platform != "linux" or any(
        os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY")
    )


def _loads(library: str) -> bool:
    try:
        ctypes.CDLL(library)
    except OSError:
        return False
    return True
