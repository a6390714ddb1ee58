"""`defplan --version`: what is installed, and what its kernel was built for."""

from __future__ import annotations

import platform
from importlib.metadata import PackageNotFoundError, version

from defplan_mj import __version__
from defplan_mj.base.errors import DefplanError

_TOLD = ("mujoco", "dm_control", "casadi", "torch", "numpy")


def version_text() -> str:
    """Return a line each for defplan, its kernel, and what the results depend on."""
    from defplan_mj.kernel import library

    try:
        built = library.build()
    except DefplanError:
        built = "not built"
    machine = f"Python {platform.python_version()}, {platform.system()} {platform.machine()}"
    with_what = ", ".join(f"{name} {_version(name)}" for name in _TOLD)
    return f"defplan {__version__}\nkernel {built}\n{machine}\n{with_what}"


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "is not installed"
