"""Load the engine plugin `defplan.reduced_fem` into MuJoCo, once a process."""

from __future__ import annotations

import functools
from pathlib import Path

from defplan_mj.base.errors import DefplanError
from defplan_mj.kernel.library import kernel, library_path

NAME = "defplan.reduced_fem"
LIBRARY = library_path("host", "libdefplan_plugin.so")


def load_plugin(library: Path = LIBRARY) -> None:
    """Register the plugin with MuJoCo; later calls do nothing.

    Raises:
        DefplanError: the library is not built, or was built for another MuJoCo.
    """
    # here, and not above: importing MuJoCo loads the plugin (`on_import`), by this module
    import mujoco  # noqa: F401

    _register(library)


@functools.cache
def _register(library: Path) -> None:
    import mujoco

    if not library.is_file():
        raise DefplanError(
            f"the MuJoCo plugin {library} is not built: install defplan from source"
            " (pip install .), which needs gcc or clang"
        )
    kernel()  # says so if this machine cannot run it
    try:
        mujoco.mj_loadPluginLibrary(str(library))
    except (mujoco.FatalError, RuntimeError, OSError) as error:
        raise DefplanError(
            f"MuJoCo {mujoco.__version__} cannot load {library} ({error}):"
            " install defplan from source again, beside this MuJoCo"
        ) from error
