"""What `import defplan_mj` sees to, so that no process crashes: MuJoCo gets our plugin, triton is kept out.

A model of ours without the engine plugin crashes the process, so it is loaded as soon as MuJoCo is imported.
MuJoCo does not notice that the plugin of a saved or pickled model is missing. After `import defplan_mj`,
whoever imports MuJoCo, before or after, has the plugin; until then this module costs nothing.
"""

from __future__ import annotations

import importlib.abc
import importlib.machinery
import importlib.util
import sys
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType

_GPUS = "/dev/nvidiactl", "/dev/kfd"


def load_plugin_with_mujoco() -> None:
    """Load the plugin now if MuJoCo is there, else right after it is imported."""
    if "mujoco" in sys.modules:
        _load()
    elif not any(isinstance(finder, _Watch) for finder in sys.meta_path):
        sys.meta_path.insert(0, _Watch())


def keep_triton_out() -> None:
    """Let torch do without triton where no GPU is, as its builds for the CPU do.

    torch's usual build brings it and loads it with the first optimiser. Its LLVM and that of the software renderer
    that dm_control opens crash each other (seen with torch 2.13 and Mesa's EGL). Without a GPU it has no use.
    """
    if not any(Path(gpu).exists() for gpu in _GPUS):
        sys.modules.setdefault("triton", None)  # type: ignore[arg-type]


def _load() -> None:
    from defplan_mj.base.errors import DefplanError

    try:
        from defplan_mj.host.plugin import load_plugin

        load_plugin()
    except DefplanError:  # told where it is needed; logs and reports can be read without
        return


class _Watch(importlib.abc.MetaPathFinder):
    """Finds MuJoCo as it would be found, and loads the plugin after it."""

    def find_spec(
        self,
        fullname: str,
        path: Sequence[str] | None,
        target: ModuleType | None = None,
    ) -> importlib.machinery.ModuleSpec | None:
        if fullname != "mujoco":
            return None
        sys.meta_path.remove(self)
        spec = importlib.util.find_spec(fullname)
        if spec is not None and spec.loader is not None:
            spec.loader = _Then(spec.loader)
        return spec


class _Then(importlib.abc.Loader):
    """Loads a module by its own loader, and the plugin after that."""

    def __init__(self, loader: importlib.abc.Loader) -> None:
        self._loader = loader

    def create_module(self, spec: importlib.machinery.ModuleSpec) -> ModuleType | None:
        return self._loader.create_module(spec)

    def exec_module(self, module: ModuleType) -> None:
        self._loader.exec_module(module)
        _load()
