"""What a result was made from: a plugin's source with all it imports, its options, files without wall times."""

from __future__ import annotations

import dataclasses
import importlib
import subprocess
import sys

import numpy as np
import pytest

from defplan_mj import registry
from defplan_mj.base import files
from defplan_mj.pipeline.provenance import (
    content_of,
    plain_data,
    plugin_data,
    source_files,
    source_hash,
)


@pytest.fixture
def package(tmp_path, monkeypatch):
    """Return the folder of a package with a plugin that imports one module at once, one when it works."""
    folder = tmp_path / "swimmers"
    folder.mkdir()
    (folder / "__init__.py").write_text("")
    (folder / "common.py").write_text("HALF = 0.5\n")
    (folder / "recipe.py").write_text("STEPS = 100\n")
    (folder / "other.py").write_text("UNUSED = 1\n")
    (folder / "plugin.py").write_text(
        "from swimmers import common\n"
        "class Plugin:\n"
        "    kind, name = 'gait', 'swimmer'\n"
        "    def solve(self, problem, seed, progress):\n"
        "        from .recipe import STEPS\n"
        "        return STEPS * common.HALF\n"
        "SOLVER = Plugin()\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    yield folder
    for name in [name for name in sys.modules if name.partition(".")[0] == "swimmers"]:
        del sys.modules[name]


@pytest.mark.parametrize("edited", ["plugin.py", "common.py", "recipe.py", "__init__.py"])
def test_an_edit_of_a_plugins_source_changes_what_it_is(package, edited):
    solver = importlib.import_module("swimmers.plugin").SOLVER
    before = plugin_data(solver)
    (package / edited).write_text((package / edited).read_text() + "# another\n")
    assert plugin_data(solver) != before


def test_what_a_plugin_does_not_import_is_no_part_of_it(package):
    solver = importlib.import_module("swimmers.plugin").SOLVER
    before = plugin_data(solver)
    (package / "other.py").write_text("UNUSED = 2\n")
    assert plugin_data(solver) == before


@pytest.mark.parametrize(
    ("kind", "name", "line"),
    [
        ("planner", "dql", "class Recipe"),
        ("gait", "shooting", "IPOPT = {"),
        ("gait", "cio-shooting", "IPOPT = {"),
        ("planner", "astar", "SOLVER = UntrainedSolver("),
    ],
)
def test_our_solvers_are_told_by_the_files_that_hold_their_recipes(kind, name, line):
    solver = registry.get_solver(name, kind)
    paths = source_files([type(solver).__module__, *registry.modules_of(solver)])
    assert any(line in path.read_text() for path in paths.values())
    assert all(module.partition(".")[0] == "defplan_solvers" for module in paths)


def test_what_is_slow_to_import_is_read_and_not_imported():
    code = (
        "import sys; from defplan_mj import registry\n"
        "from defplan_mj.pipeline.provenance import plugin_data\n"
        "plugin_data(registry.get_solver('dql', 'planner'))\n"
        "sys.exit('imported torch' if 'torch' in sys.modules else 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_options_are_part_of_a_plugin_and_the_same_in_every_process():
    solver = registry.get_solver("shooting", "gait")
    assert plugin_data(solver) == plugin_data(dataclasses.replace(solver))
    assert plugin_data(solver) != plugin_data(dataclasses.replace(solver, starts=6))
    untrained = registry.get_solver("astar", "planner")
    assert "0x" not in str(plugin_data(untrained))


def test_a_module_without_a_file_has_no_source():
    assert source_files(["sys", "no_such_module"]) == {}
    assert source_hash([]) == source_hash(["sys"])


def test_plain_data_tells_equal_options_alike():
    assert plain_data({"a": (1, 2), "b": np.array([1.0])}) == {"a": [1, 2], "b": [1.0]}
    assert plain_data(len) == "builtins.len"
    assert plain_data(object()) == "builtins.object"


def test_an_archive_is_what_it_says_apart_from_wall_times(tmp_path):
    one, two, other = (tmp_path / f"{name}.npz" for name in ("one", "two", "other"))
    files.save_archive(one, "gait", 1, {"a": np.ones(2)}, {"seconds": 1.0})
    files.save_archive(two, "gait", 1, {"a": np.ones(2)}, {"seconds": 2.0})
    files.save_archive(other, "gait", 1, {"a": np.zeros(2)}, {"seconds": 1.0})
    assert content_of(one) == content_of(two) != content_of(other)
    one.write_bytes(b"something else")
    two.write_bytes(b"something else")
    assert content_of(one) == content_of(two)
