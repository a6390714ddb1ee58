"""The blocks of Python in the documentation run: here, or where `ELSEWHERE` says."""

from __future__ import annotations

import re
import shutil
import sys
import types
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from defplan_mj.dynamics.external import CasadiDynamics
from defplan_mj.dynamics.feet import lowest_feet
from defplan_mj.dynamics.reduced import ReducedDynamics
from defplan_mj.planning.fit import fit_surrogate
from defplan_mj.planning.robot import Robot
from defplan_mj.planning.scene import Scene
from defplan_mj.registry import get_task
from defplan_mj.studies import check
from tests.samples.paths import ROOT

ELSEWHERE = {
    "tutorials.md": (5, "test_tutorials.py"),
    "plugins.md": (4, "test_docs.py, test_adding.py"),
    "studies.md": (
        1,
        "tests/study/test_conduct.py reads the same table its own way, not this block",
    ),
}
"""How many blocks of these pages are run, and by what."""


def blocks(page: str) -> list[str]:
    """Return the Python blocks of a page."""
    text = next(path for path in (ROOT / page, ROOT / "docs" / page) if path.exists()).read_text()
    return re.findall(r"```python\n(.*?)```", text, re.DOTALL)


def packaged(name: str = "fish-swim") -> Robot:
    return check.packaged_robot(get_task(name))


def still(observation: Any) -> np.ndarray:
    return np.zeros(5)


def readme(_: Callable) -> dict:
    return {"my_policy": still}


def body(path: Callable) -> dict:
    import trimesh

    ball = trimesh.creation.icosphere(subdivisions=3)
    ball.apply_scale((0.5, 0.12, 0.2)).export(path("eel.stl"))
    return {}


def kernel(path: Callable) -> dict:
    packaged().body.save(path("body.npz"))
    return {"shapes": np.zeros((4, 5)), "g_states": np.ones((5, 13 + 15))}


def casadi(_: Callable) -> dict:
    return {"dynamics": packaged().dynamics, "n": 3, "count": 2}


def recording(_: Callable) -> dict:
    robot = packaged()
    there = get_task("fish-swim").navigation
    gait = robot.gait
    return {
        "body": robot.body,
        "gait": gait,
        "dynamics": robot.dynamics,
        "surrogate": fit_surrogate(robot.dynamics, gait, pairs=2),
        "scene": Scene(np.array([9.0, 0, 0]), np.zeros((0, 3)), np.zeros(0), np.zeros((0, 3))),
        "time": 0.0,
        "x": robot.dynamics.rest_state(),
        "clearance": 1.0,
        "values": np.zeros(len(gait.task_names)),
        "reward": 0.0,
        "laser": np.full(there.beams, there.laser_range),
    }


GIVEN: dict[str, Callable[[Callable], dict]] = {
    "README.md": readme,
    "body.md": body,
    "kernel.md": kernel,
    "suite.md": lambda _: {"policy": still},
    "casadi.md": casadi,
    "gymnasium.md": lambda _: {},
    "logs.md": recording,
    "report.md": lambda _: {},
}
"""What a page's reader has before the first block, by page; `path` says where in the working folder."""

SMALLER = {"vertices=1500, modes=6": "vertices=200, modes=3, basis=10, samples=10, drag_points=24"}
"""What is put in the place of what would take minutes."""


def test_no_page_s_blocks_are_left_out():
    pages = [*ROOT.glob("*.md"), *(ROOT / "docs").glob("*.md")]
    found = {page.name: len(blocks(page.name)) for page in pages if blocks(page.name)}
    assert {page: count for page, (count, _) in ELSEWHERE.items()}.items() <= found.items()
    assert set(found) == {*GIVEN, *ELSEWHERE}


@pytest.mark.filterwarnings("ignore:.*infinity")
@pytest.mark.parametrize("page", GIVEN)
def test_the_blocks_of_a_page_run_one_after_the_other(page, tmp_path, monkeypatch, swim_log):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "logs/fish-swim-seed0").mkdir(parents=True)
    for name in ("logs/fish-swim-seed0/k2-00.mcap", "k2-00.mcap", "k2-01.mcap"):
        shutil.copy(swim_log, tmp_path / name)
    if page == "logs.md" and not _has("pandas"):  # only its DataFrame is used
        stand_in = types.ModuleType("pandas")
        stand_in.DataFrame = dict  # type: ignore[attr-defined]
        monkeypatch.setitem(sys.modules, "pandas", stand_in)
    names = GIVEN[page](tmp_path.joinpath)
    for block in blocks(page):
        if "symbolic.step_forced " in block:
            walker = packaged("quadruped-walk").body
            feet = ReducedDynamics(walker, 0.015, feet=lowest_feet(walker))
            names["symbolic"] = CasadiDynamics(feet)
        if "failure(solver)" in block:
            names["solver"] = names["symbolic"].step
        if "load_instance" in block:  # takes long: tests/gait/test_export.py solves one
            continue
        for long, short in SMALLER.items():
            block = block.replace(long, short)
        exec(block, names)


def _has(module: str) -> bool:
    from importlib.util import find_spec

    return find_spec(module) is not None
