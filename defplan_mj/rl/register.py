"""Names the suite's tasks for Gymnasium, on `import defplan_mj`: nothing of a task is imported here."""

from __future__ import annotations

import warnings
from importlib.metadata import entry_points

NAMESPACE = "defplan"
ENTRY_POINT = "defplan_mj.rl.single:SuiteEnv"
GROUP = "defplan_mj.gymnasium"
"""Entry points: functions without arguments that register what a package brings."""


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
