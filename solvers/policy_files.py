"""Policy files (npz) of the planners: what all of them hold and how they are told apart."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from defplan_mj.base import files
from defplan_mj.base.errors import DefplanError

FORMAT_VERSION = 1


def save_policy(
    path: Path,
    planner: str,
    arrays: Mapping[str, np.ndarray] | None = None,
    meta: dict | None = None,
) -> None:
    """Write `arrays` and `meta` of a planner's policy to `path`, atomically.

    Args:
        planner: name of the plugin.
        meta: names of the gaits as 'task_names' (if the policy depends on them) and what else there
            is to tell.
    """
    said = {"planner": planner, **(meta or {})}
    files.save_archive(path, "policy", FORMAT_VERSION, dict(arrays or {}), said)


def load_policy(
    path: Path, planner: str, task_names: tuple[str, ...]
) -> tuple[dict[str, np.ndarray], dict]:
    """Return arrays (by name) and meta of a file of `save_policy`.

    Args:
        planner: name of the plugin that should have written it.
        task_names: the robot's gaits.

    Raises:
        DefplanError: the file is missing, damaged, of another version or planner or for other gaits.
    """
    arrays, meta, _ = files.load_archive(path, "policy", FORMAT_VERSION)
    if meta.get("planner") != planner:
        raise DefplanError(
            f"{path} holds a policy of {meta.get('planner')}, not of {planner}: train it anew"
        )
    for name, array in arrays.items():
        if array.dtype.kind not in "fiu" or not np.isfinite(array).all():
            raise DefplanError(
                f"{path} is no policy that can be used: its {name} has what is no finite number;"
                " train it anew"
            )
    names = meta.get("task_names", task_names)
    if not isinstance(names, list | tuple) or not all(isinstance(name, str) for name in names):
        raise DefplanError(
            f"{path} is no policy that can be used: its task_names are no names; train it anew"
        )
    gaits = tuple(names)
    if gaits != task_names:
        raise DefplanError(
            f"{path} was trained for the gaits {', '.join(gaits)}, not for"
            f" {', '.join(task_names)}: train the planner anew"
        )
    return arrays, meta
