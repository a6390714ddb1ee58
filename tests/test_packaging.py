"""The package: what is locked, what is built, and what a machine without a compiler is told."""

from __future__ import annotations

import os
import platform
import re
import shutil
import subprocess
import sys
import sysconfig
import tarfile
import tomllib
import venv
import zipfile
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from tests.samples.paths import ROOT

PARTS = ("defplan_mj", "tasks", "solvers", "setup.py", "pyproject.toml", "README.md", "LICENSE")

needs_source_tree = pytest.mark.skipif(
    not (ROOT / "setup.py").is_file(), reason="runs in the source tree only"
)
pytestmark = needs_source_tree


@pytest.fixture
def tree(tmp_path):
    """Return a copy of what the package is built from, without anything that was built."""
    for part in PARTS:
        source = ROOT / part
        if source.is_dir():
            ignored = shutil.ignore_patterns("*.so", "*.built", "__pycache__")
            shutil.copytree(source, tmp_path / part, ignore=ignored)
        else:
            shutil.copy(source, tmp_path / part)
    return tmp_path


def build(tree: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run `setup.py build_ext --inplace` in `tree`."""
    return subprocess.run(
        [sys.executable, "setup.py", "-q", "build_ext", "--inplace"],
        cwd=tree,
        env={**os.environ, "DEFPLAN_MARCH": "", **environment},
        capture_output=True,
        text=True,
    )


def locked() -> dict[str, str]:
    """Return the versions in the lock file by canonical name."""
    lines = (ROOT / "requirements.lock").read_text().splitlines()
    pairs = [line.split("==") for line in lines if line and not line.startswith("#")]
    return {canonicalize_name(name): version for name, version in pairs}


def test_the_lock_holds_every_dependency_in_a_version_that_fits():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    versions = locked()
    for text in [*project["dependencies"], *project["optional-dependencies"]["dev"]]:
        requirement = Requirement(text)
        version = versions[canonicalize_name(requirement.name)]
        assert requirement.specifier.contains(version), f"{text} is locked to {version}"


def test_the_lock_names_versions_only():
    for line in (ROOT / "requirements.lock").read_text().splitlines():
        assert line.startswith("#") or re.fullmatch(r"[A-Za-z0-9._-]+==[0-9][0-9a-z.]*", line), line


def test_the_hashed_lock_is_the_lock_without_torch():
    text = (ROOT / "requirements.hashes").read_text().replace("\\\n", " ")
    hashed = [line.split() for line in text.splitlines() if not line.startswith("#")]
    lines = (ROOT / "requirements.lock").read_text().splitlines()
    wanted = [n for n in lines if not n.startswith(("#", "torch=="))]
    assert [line[0] for line in hashed] == wanted, "run `make hashes`"
    for name, *hashes in hashed:
        assert hashes, name
        for one in hashes:
            assert re.fullmatch("--hash=sha256:[0-9a-f]{64}", one), name


def test_the_python_versions_are_the_same_everywhere():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert project["requires-python"] == ">=3.11,<3.13"
    made = (ROOT / "Makefile").read_text()
    assert "(3, 11) <= sys.version_info < (3, 13)" in made and "python3.13" not in made
    assert "Python 3.11 or 3.12" in (ROOT / "README.md").read_text()


def test_without_a_compiler_there_is_one_sentence(tree):
    done = build(tree, CC="no-such-compiler")
    assert done.returncode != 0
    assert done.stderr.startswith("defplan needs a C compiler to build its kernel")
    assert "no-such-compiler" in done.stderr and done.stderr.count("\n") == 1
    assert not list(tree.rglob("*.so"))


def test_libraries_are_built_again_only_if_what_they_are_made_of_changes(tree):
    first = build(tree)
    assert first.returncode == 0, first.stderr
    kernel = tree / "defplan_mj/kernel/libdefplan_kernel.so"
    plugin = tree / "defplan_mj/host/libdefplan_plugin.so"
    assert kernel.is_file() and plugin.is_file()

    def times() -> tuple[int, int]:
        return kernel.stat().st_mtime_ns, plugin.stat().st_mtime_ns

    made = times()
    assert build(tree).returncode == 0
    assert times() == made
    with open(tree / "defplan_mj/host/plugin.c", "a") as source:
        source.write("/* changed */\n")
    assert build(tree).returncode == 0
    assert times()[0] == made[0] and times()[1] != made[1]
    with open(tree / "defplan_mj/kernel/kernel.h", "a") as header:
        header.write("/* changed */\n")
    assert build(tree).returncode == 0
    assert times()[0] != made[0]


def test_a_source_that_does_not_compile_leaves_the_old_library(tree):
    assert build(tree).returncode == 0
    kernel = tree / "defplan_mj/kernel/libdefplan_kernel.so"
    before = kernel.read_bytes()
    with open(next((tree / "defplan_mj/kernel").glob("*.c")), "a") as source:
        source.write("this is not C\n")
    done = build(tree)
    assert done.returncode != 0
    assert "could not build defplan_mj/kernel/libdefplan_kernel.so" in done.stderr
    assert kernel.read_bytes() == before


@pytest.fixture(scope="module")
def archives(tmp_path_factory):
    """Return the wheel and the source archive, and the files that they are built from."""
    tree, made = tmp_path_factory.mktemp("tracked"), tmp_path_factory.mktemp("dist")
    names = tracked()
    for name in names:
        (tree / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / name, tree / name)
    subprocess.run(
        [sys.executable, "setup.py", "-q", "sdist", "-d", made, "bdist_wheel", "-d", made],
        cwd=tree,
        check=True,
        capture_output=True,
    )
    (wheel,), (source,) = made.glob("defplan-*.whl"), made.glob("defplan-*.tar.gz")
    return wheel, source, set(names)


def tracked() -> list[str]:
    """Return the files that the repository tracks; skip the test where that cannot be asked."""
    done = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True)
    if done.returncode:
        pytest.skip("this is no repository")
    return [name for name in done.stdout.split("\0") if name and (ROOT / name).is_file()]


@pytest.mark.slow
def test_a_source_archive_holds_all_that_the_repository_does_and_its_tests_run(archives, tmp_path):
    _, source, names = archives
    with tarfile.open(source) as archive:
        archive.extractall(tmp_path, filter="data")
    (tree,) = tmp_path.iterdir()
    there = {path.relative_to(tree).as_posix() for path in tree.rglob("*") if path.is_file()}
    assert names <= there
    tests = ("tests/kernel/test_step.py", "tests/base/test_files.py")
    build(tree, DEFPLAN_MARCH="x86-64-v3" if "x86" in platform.machine() else "")
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", f"--basetemp={tmp_path / 'inner'}", *tests],
        cwd=tree,
        env={**os.environ, "PYTHONPATH": str(tree)},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0 and " passed" in done.stdout, done.stdout


@pytest.mark.slow
def test_a_wheel_runs_where_there_is_no_compiler_nor_anything_else(archives, swim_log, tmp_path):
    wheel, *_ = archives
    assert re.fullmatch(r"defplan-.*-py3-none-manylinux_2_\d+_[a-z0-9_]+\.whl", wheel.name)
    venv.create(tmp_path / "env", with_pip=False)
    (site,) = tmp_path.glob("env/lib/python*/site-packages")
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(site)
    # what it depends on is installed here; this tree itself, editable, is not reached by that
    (site / "dependencies.pth").write_text(sysconfig.get_path("purelib") + "\n")

    def defplan(*arguments: str) -> str:
        done = subprocess.run(
            [tmp_path / "env/bin/python", "-m", "defplan_mj", *arguments],
            cwd=tmp_path,
            env={"PATH": "", "HOME": str(tmp_path)},
            capture_output=True,
            text=True,
        )
        assert done.returncode == 0, done.stderr
        return done.stdout

    assert "kernel " in defplan("--version")
    assert "fish-swim" in defplan("list")
    assert "kernel and mujoco, identical to the bit" in defplan("replay", str(swim_log), "--quiet")


@pytest.mark.slow
def test_a_wheel_holds_libraries_plugins_and_data(archives):
    wheel, *_ = archives
    names = set(zipfile.ZipFile(wheel).namelist())
    wanted = {
        "defplan_mj/kernel/libdefplan_kernel.so",
        "defplan_mj/host/libdefplan_plugin.so",
        "defplan_mj/kernel/kernel.h",
        "defplan_tasks/assets/fish.obj",
    }
    assert wanted <= names
    for folder, package in (
        ("defplan_mj", "defplan_mj"),
        ("tasks", "defplan_tasks"),
        ("solvers", "defplan_solvers"),
    ):
        for path in (ROOT / folder).rglob("*"):
            inside = path.relative_to(ROOT / folder).as_posix()
            if path.suffix in (".py", ".html", ".obj"):
                assert f"{package}/{inside}" in names
