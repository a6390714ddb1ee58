"""What has to be the same on all machines of a study for them to give the same bits, and whether it is."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

from defplan_mj import registry
from defplan_mj.base.errors import DefplanError


@cache
def build_of() -> Mapping[str, str]:
    """Return what results depend on here: versions, compiled libraries, sources, plugins."""
    import platform

    from defplan_mj.host.plugin import LIBRARY as host
    from defplan_mj.kernel.library import PATH as kernel
    from defplan_mj.log.recorder import versions

    root = Path(__file__).parents[1]
    return {
        **versions(),
        "C library": " ".join(platform.libc_ver()),
        "processor's arithmetic": _arithmetic(),
        "compiled kernel": _hash([kernel]),
        "compiled MuJoCo plugin": _hash([host]),
        "source of defplan": _hash(sorted(root.rglob("*.py"))),
        "plugins": ", ".join(_plugins()),
    }


def _arithmetic() -> str:
    """Return which loops NumPy and its BLAS choose for this processor: their sums differ in the last digits."""
    import numpy as np

    # SciPy's BLAS counts too, so it has to be loaded
    import scipy.linalg  # noqa: F401
    from threadpoolctl import threadpool_info

    config: Any = np.show_config(mode="dicts")
    blas = {
        pool.get("architecture", "unknown")
        for pool in threadpool_info()
        if pool["user_api"] == "blas"
    }
    return " ".join([*config["SIMD Extensions"]["found"], "BLAS", *sorted(blas)])


def _plugins() -> list[str]:
    """Return the plugins with the source they come from."""
    from defplan_mj.pipeline.provenance import source_hash

    entries = []
    for group in (registry.TASKS, registry.SOLVERS, registry.SENSORS):
        for name, module in sorted(registry.modules(group).items()):
            entries.append(f"{name} {source_hash([module])[:12]}")
    return entries


def _hash(paths: list[Path]) -> str:
    digest = hashlib.sha256()
    for path in paths:
        digest.update(path.name.encode())
        digest.update(path.read_bytes() if path.is_file() else b"missing")
    return digest.hexdigest()[:16]


def differences(here: Mapping[str, str], there: Mapping[str, str]) -> list[str]:
    """Return what is not the same, each as a clause."""
    clauses = []
    for name in [*here, *(name for name in there if name not in here)]:
        one, other = here.get(name, "not there"), there.get(name, "not there")
        if one != other:
            clauses.append(_clause(name, one, other))
    return clauses


def _clause(name: str, one: str, other: str) -> str:
    if name != "plugins":
        return f"{name} is {other} there, {one} here"
    mine, theirs = set(one.split(", ")), set(other.split(", "))
    names = sorted({entry.split(" ")[0] for entry in mine ^ theirs})
    return f"plugins differ: {', '.join(names)}"


def require_same(build: Mapping[str, str]) -> None:
    """Raise DefplanError unless this machine has what the study's own has; none: it is not asked."""
    clauses = differences(build, build_of()) if build else []
    if clauses:
        import socket

        raise DefplanError(
            f"the machine {socket.gethostname()} would not give the same results: {'; '.join(clauses)}"
        )
