"""Names the suite's tasks for Gymnasium, on `import defplan_mj`: nothing of a task is imported here."""

from __future__ import annotations

import importlib.util
import sys
import warnings
from collections.abc import Sequence
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec
from importlib.metadata import entry_points
from types import ModuleType

NAMESPACE = "defplan"
ENTRY_POINT = "defplan_mj.rl.single:SuiteEnv"
GROUP = "defplan_mj.gymnasium"
"""Entry points: functions without arguments that register what a package brings."""


class _OnImport(MetaPathFinder):
    """Registers the tasks as soon as Gymnasium has been imported, whoever imports it."""

    def find_spec(
        self, name: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        if name != "gymnasium":
            return None
        sys.meta_path.remove(self)
        spec = importlib.util.find_spec(name)
        if spec is not None and spec.loader is not None:
            load = spec.loader.exec_module

            def load_and_register(module: ModuleType) -> None:
                load(module)
                register_all()

            spec.loader.exec_module = load_and_register  # type: ignore[method-assign]
        return spec


def register_with_gymnasium() -> None:
    """Register all tasks now if Gymnasium is there already, else when it is imported (it takes NumPy along)."""
    if "gymnasium" in sys.modules:
        register_all()
    else:
        sys.meta_path.insert(0, _OnImport())


def register_all() -> None:
    """Register the tasks of all installed packages; one that cannot be loaded is warned about."""
    for point in entry_points(group=GROUP):
        try:
            point.load()()
        except Exception as error:
            warnings.warn(f"{GROUP}, {point.name}: {error}", stacklevel=2)


def registered() -> dict[tuple[str, str], str]:
    """Return the ids that Gymnasium knows the suite's tasks by, by domain and task."""
    from gymnasium.envs.registration import registry

    ours = [spec for spec in registry.values() if spec.entry_point == ENTRY_POINT]
    return {(spec.kwargs["domain"], spec.kwargs["task"]): spec.id for spec in ours}


def register_task(domain: str, task: str, many: bool, version: int = 0) -> str:
    """Make a task of the suite known to Gymnasium; returns its id, `defplan/FishSwim-v0`.

    Args:
        domain, task: as `suite.load` takes them.
        many: whether `gymnasium.make_vec` steps all robots in the kernel: tasks whose actions are target
            shapes; other tasks get Gymnasium's own vector environments.
    """
    from gymnasium.envs.registration import register, registry

    words = [word.capitalize() for word in f"{domain}_{task}".split("_")]
    name = f"{NAMESPACE}/{''.join(words)}-v{version}"
    if name not in registry:
        register(
            name,
            entry_point=ENTRY_POINT,
            vector_entry_point="defplan_mj.rl.many:KernelVectorEnv" if many else None,
            kwargs={"domain": domain, "task": task},
        )
    return name
