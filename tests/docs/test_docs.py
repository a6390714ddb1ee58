"""The documentation: its links lead somewhere, its commands exist, its plugin example works."""

from __future__ import annotations

import re
import shlex
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from defplan_mj.cli.parser import build
from defplan_mj.dynamics.reduced import ReducedDynamics
from defplan_mj.gait.problem import GaitProblem
from defplan_mj.planning.surrogate import Surrogate
from defplan_mj.task import GaitTask, Navigation, TaskSpec
from tests.samples.paths import ROOT

PAGES = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/*.md")])
LINK = re.compile(r"\]\(([^)#\s]+)(?:#[^)]*)?\)")
COMMAND = re.compile(r"^\s*(?:\$ )?(defplan [a-z].*?)(?:\s+#.*)?$", re.MULTILINE)


def shell_lines(page: Path) -> list[str]:
    """Return the `defplan` commands in the page's shell blocks."""
    blocks = re.findall(r"```(?:sh|bash|console)\n(.*?)```", page.read_text(), re.DOTALL)
    return [command for block in blocks for command in COMMAND.findall(block)]


def python_blocks(page: Path) -> list[str]:
    """Return the page's Python blocks."""
    return re.findall(r"```python\n(.*?)```", page.read_text(), re.DOTALL)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_lead_to_files_that_exist(page):
    missing = [
        link
        for link in LINK.findall(page.read_text())
        if "://" not in link and not (page.parent / link).exists()
    ]
    assert not missing


def test_the_index_names_every_page():
    linked = set(LINK.findall((ROOT / "docs/index.md").read_text()))
    pages = {page.name for page in (ROOT / "docs").glob("*.md")} - {"index.md"}
    assert pages <= linked


def test_the_site_s_menu_has_every_page():
    menu = (ROOT / "mkdocs.yml").read_text().partition("\nnav:\n")[2]
    named = re.findall(r"(\S+\.md)$", menu, re.MULTILINE)
    assert sorted(named) == sorted(page.name for page in (ROOT / "docs").glob("*.md"))


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_commands_in_shell_blocks_are_understood(page):
    for command in shell_lines(page):
        build().parse_args(shlex.split(command)[1:])  # exits with 2 if it is wrong usage


def test_every_command_and_option_has_its_place_on_the_command_line_page():
    text = (ROOT / "docs/command-line.md").read_text()
    commands = next(a.choices for a in build()._actions if isinstance(a.choices, dict))
    for name, parser in commands.items():
        assert re.search(rf"^## .*\b{name}\b", text, re.MULTILINE), name
        for action in parser._actions:
            for option in action.option_strings:
                if option.startswith("--") and option != "--help":
                    assert option in text, f"{name} {option}"


def test_the_plugin_page_s_gait_solver_solves(small_fish):
    blocks = python_blocks(ROOT / "docs/plugins.md")
    page: dict = {}
    exec(next(b for b in blocks if "class HillClimber" in b), page)
    problem = GaitProblem(ReducedDynamics(small_fish), (GaitTask("forward"),), 11, gait_steps=22)
    told = []
    solver = page["HillClimber"](iterations=30)
    gait = solver.solve(problem, 1, lambda message, fraction: told.append(fraction))
    cost = problem.objective(problem.switching_sequences(np.random.default_rng(1)))
    assert float(cost(problem.w_of(gait))) == pytest.approx(gait.meta["objective"])
    assert gait.meta["objective"] < 0.9 * gait.meta["history"][0]
    assert told[-1] == 1.0
    assert np.array_equal(gait.alpha, solver.solve(problem, 1).alpha)


def test_the_plugin_page_s_planner_and_task_work(tmp_path):
    blocks = python_blocks(ROOT / "docs/plugins.md")
    task: dict[str, Any] = {"__file__": str(tmp_path / "eel.py")}
    planner = dict(task)
    exec(next(b for b in blocks if "TaskSpec(" in b), task)
    exec(next(b for b in blocks if "class StraightSolver" in b), planner)
    assert isinstance(task["SWIM"], TaskSpec)
    surrogate = Surrogate(
        body_hash="",
        gait_hash="",
        task_names=("forward", "left"),
        rotations=np.array([np.eye(3), [[0.8, -0.6, 0], [0.6, 0.8, 0], [0, 0, 1.0]]]),
        translations=np.array([[0.6, 0, 0], [0.5, 0, 0]]),
        cycle_seconds=0.44,
        pairs=1,
        rotation_mean=np.zeros(2),
        rotation_sd=np.zeros(2),
        translation_mean=np.zeros(2),
        translation_sd=np.zeros(2),
        radius=0.5,
    )
    solver = planner["SOLVER"]
    trained = solver.train(surrogate, Navigation(), seed=0).planner
    solver.save(trained, tmp_path / "policy.npz")
    loaded = solver.load(tmp_path / "policy.npz", surrogate, Navigation())
    ahead = {"target": np.array([5.0, 0.0, 0.0])}
    to_the_left = {"target": np.array([5.0, 4.0, 0.0])}
    assert loaded.values(ahead).argmax() == 0
    assert loaded.values(to_the_left).argmax() == 1
