"""The house has one direction: docs, contract and code say the same, and the harness knows no solver."""

from __future__ import annotations

import ast
import functools
import re
import subprocess
import sys
import tomllib

import pytest

from defplan_mj import registry
from tests.samples.paths import ROOT

CONTRACTS = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"][
    "contracts"
]
BY_METHOD = {"shooting", "none"}  # words of the field, too: 'single shooting', 'none'


def layers() -> list[list[str]]:
    """Return the layers of the harness from the bottom up."""
    lines = CONTRACTS[0]["layers"]
    return [re.findall(r"\w+", line) for line in reversed(lines)]


def test_the_list_in_the_docs_is_the_contract_from_the_bottom_up():
    text = (ROOT / "docs/architecture.md").read_text()
    table = text[text.index("## Inside `defplan_mj`") : text.index("What the dynamics are made of")]
    rows = [line.split("|")[1] for line in table.splitlines() if line.startswith("| `")]
    told = [re.findall(r"`(\w+)(?:\.py)?/?`", row) for row in rows]
    order = {name: level for level, names in enumerate(layers()) for name in names}
    levels = [[order[name] for name in names] for names in told]
    assert levels == sorted(levels)
    assert {n for names in told for n in names} >= {n for names in layers()[:-3] for n in names}


def test_no_solver_is_named_in_the_harness():
    names = set(registry.names(registry.SOLVERS)) - BY_METHOD
    word = re.compile(rf"\b({'|'.join(map(re.escape, sorted(names)))})\b")
    named = [
        f"{path.relative_to(ROOT)}: {found[0]}"
        for path in sorted((ROOT / "defplan_mj").rglob("*.py"))
        if (found := word.findall(path.read_text()))
    ]
    assert named == []


@functools.cache
def nodes() -> list[tuple[str, ast.AST]]:
    """Return all of the harness's code: a file's name and line, and what stands there."""
    return [
        (f"{path.relative_to(ROOT)}:{getattr(node, 'lineno', 0)}", node)
        for path in sorted((ROOT / "defplan_mj").rglob("*.py"))
        for node in ast.walk(ast.parse(path.read_text()))
    ]


def test_no_call_spreads_a_tuple_that_is_written_in_it():
    """Nor a list: `f(*(a, b), c=d)` only keeps the formatter from a line for each."""
    calls = [(place, node) for place, node in nodes() if isinstance(node, ast.Call)]
    spread = [
        place
        for place, node in calls
        for argument in node.args
        if isinstance(argument, ast.Starred) and isinstance(argument.value, ast.Tuple | ast.List)
    ]
    assert len(calls) > 1000 and spread == []


def test_names_are_nouns():
    """What was found, told or wanted is called by what it is."""
    named = [
        (place, node.arg if isinstance(node, ast.arg) else node.id)
        for place, node in nodes()
        if isinstance(node, ast.arg)
        or (isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store))
    ]
    assert len(named) > 1000
    participles = [place for place, name in named if name in ("found", "told", "wanted")]
    # the attribute `Skill.wanted` is a key of the JSON
    assert [place.partition(":")[0] for place in participles] == ["defplan_mj/gait/skills.py"]


@pytest.mark.slow
def test_an_import_that_goes_up_breaks_the_contract(tmp_path):
    import shutil

    for part in ("defplan_mj", "tasks", "solvers", "pyproject.toml"):
        source = ROOT / part
        copy = tmp_path / {"tasks": "defplan_tasks", "solvers": "defplan_solvers"}.get(part, part)
        shutil.copytree(source, copy) if source.is_dir() else shutil.copy(source, copy)
    (tmp_path / "defplan_mj/body/up.py").write_text("from defplan_mj.host import scene\n")
    command = [sys.executable, "-c", "from importlinter.cli import lint_imports_command as c; c()"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 1
    assert "defplan_mj.body.up -> defplan_mj.host.scene" in done.stdout
