"""Places in which a command may find itself: folders that cannot be written, no TMPDIR, no screen."""

from __future__ import annotations

import ctypes
import os
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

from tests.samples.paths import ROOT

_DROP, _OVERRIDES = 24, (1, 2)  # PR_CAPBSET_DROP; CAP_DAC_OVERRIDE, CAP_DAC_READ_SEARCH
DEAD_SCREEN = ":4711"


def heed_permissions() -> None:
    """Let root find read-only what is so; to be called in the child (`preexec_fn`)."""
    for capability in _OVERRIDES:
        ctypes.CDLL(None).prctl(_DROP, capability, 0, 0, 0)  # for other users it does nothing


def defplan(
    *arguments: str,
    module: str = "defplan_mj",
    environment: Mapping[str, str | None] | None = None,
) -> subprocess.CompletedProcess[str]:
    """Run a command with these variables; those that are None are not set."""
    return subprocess.run(
        command(arguments, module),
        cwd=ROOT,
        env=variables(environment or {}),
        preexec_fn=heed_permissions,
        capture_output=True,
        text=True,
    )


def command(arguments: Sequence[str], module: str = "defplan_mj") -> list[str]:
    """Return a command line."""
    return [sys.executable, "-m", module, *arguments]


def variables(changed: Mapping[str, str | None]) -> dict[str, str]:
    """Return the environment with some variables set, or not set (None)."""
    return {name: value for name, value in {**os.environ, **changed}.items() if value is not None}


def read_only(folder: Path) -> Path:
    """Return a new folder that cannot be written."""
    folder.mkdir(parents=True)
    folder.chmod(0o555)
    return folder


def strange(folder: Path) -> dict[str, str | None]:
    """Return the variables of a place with a HOME that cannot be written, no TMPDIR and a dead screen."""
    return {
        "HOME": str(read_only(folder / "home")),
        "XDG_CACHE_HOME": None,
        "XDG_CONFIG_HOME": None,
        "MPLCONFIGDIR": None,
        "TMPDIR": str(folder / "nowhere"),
        "DISPLAY": DEAD_SCREEN,
        "WAYLAND_DISPLAY": None,
        "MUJOCO_GL": None,
        "PYOPENGL_PLATFORM": None,
    }


CLUSTER = {
    "SLURM_JOB_ID": "4711",
    "SLURM_NTASKS": "4",
    "SLURM_PROCID": "0",
    "SLURM_LOCALID": "0",
    "SLURM_NODELIST": "node[01-02]",
    "SLURM_CPUS_PER_TASK": "1",
    "SLURM_CPUS_ON_NODE": "64",
    "SLURM_MEM_PER_NODE": "512",
}
"""What SLURM sets for a job of four tasks of one core each."""
