"""A run of a study is an ordinary run: its row, what it copies from others, what it fails with."""

from __future__ import annotations

import dataclasses
import json
from contextlib import nullcontext

import numpy as np
import pytest

from defplan_mj import cli, registry
from defplan_mj.base.progress import no_progress
from defplan_mj.body.surface import Surface
from defplan_mj.study import engines
from defplan_mj.study.conduct import conduct, write_tables
from defplan_mj.study.engines import Here
from defplan_mj.study.matrix import cells
from defplan_mj.study.outlook import prospects
from defplan_mj.study.page import write_page
from defplan_mj.study.spec import read_study
from defplan_mj.study.table import csv_text, read_parquet
from defplan_mj.task import Navigation
from defplan_mj.taskfile.guess import Guess
from tests.samples.solvers import Lame, Stubborn, Wave
from tests.samples.study import Straight

STUDY = """
tasks = ["fish-swim"]
gait_solvers = ["wave", "lame"]
planners = ["stubborn", "other"]
seeds = 1

[options]
pairs = 12
episodes = 1
logged = 0
moving = 0
"""


class Other(Stubborn):
    """Another planner that never turns."""

    name = "other"


@pytest.fixture
def plugins(monkeypatch, small_fish):
    """Put plugins that take no time in the place of the installed ones; return them."""
    navigation = Navigation(
        distance=2.0, max_cycles=2, k2=1, k2_obstacles=1, novel_obstacles=1, beams=16
    )
    spec = dataclasses.replace(
        registry.get_task("fish-swim"),
        navigation=navigation,
        planner="stubborn",
        rivals=(),
    )
    own = {"wave": Wave(), "lame": Lame("lame"), "stubborn": Stubborn(), "other": Other()}
    found = {**own, "none": registry.get_solver("none", "feedback")}
    monkeypatch.setattr(registry, "get_solver", lambda name, kind: found[name])
    monkeypatch.setattr(registry, "get_task", lambda name: spec)
    monkeypatch.setattr("defplan_mj.body.build.build_body", lambda *_: small_fish)
    monkeypatch.setattr("defplan_mj.report.report.write_report", _short_report)
    return own


def _short_report(folder, progress=None):
    path = folder / "report.html"
    path.write_text("report")
    return path


@pytest.fixture
def study(tmp_path, plugins):
    """Return a small study."""
    path = tmp_path / "small.toml"
    path.write_text(STUDY)
    return read_study(path)


def carried_out(study, root):
    """Carry a study out in this process; return its rows."""
    return conduct(cells(study), root, Here(lambda message, fraction: None))


def test_rows_have_what_the_runs_say_and_a_failed_run_its_sentence(study, plugins, tmp_path):
    rows = carried_out(study, tmp_path / "small")
    good, other, *failed = rows
    assert plugins["wave"].calls == 1  # the second planner's run copied the gaits
    assert (good["planner"], other["planner"]) == ("stubborn", "other")
    document = json.loads((tmp_path / "small" / good["folder"] / "evaluation.json").read_text())
    assert good["novel_success"] == document["novel"]["with_shield"]["success"]
    assert good["novel_episodes"] == 1 and good["k2_episodes"] == 1 and good["pairs"] == 12
    assert good["resimulated"] > 0 and good["gait_cycles"] == 200
    for name in ("resimulated", "rotation_sd", "novel_success", "body_seconds", "gait_seconds"):
        assert good[name] == other[name]
    for row in failed:
        assert row["failed"] and row["error"] == "it cannot walk" and row["failed_in"] == "gait"
        assert row["vertices"] == good["vertices"]  # what was made before is told

    paths = write_tables(tmp_path / "small", cells(study), rows)
    episodes = read_parquet(paths["episodes"])
    assert len(episodes) == 2 * 2 * 2  # runs, with and without the check, kinds of scenes
    text = write_page(study, rows, tmp_path / "small").read_text()
    for word in (
        "Does it arrive?",
        "Which is better?",
        "Gait solvers",
        "it cannot walk",
        "The robots",
    ):
        assert word in text
    assert "http://" not in text.replace("http://www.w3.org", "")  # one file, nothing is loaded


def test_a_study_that_is_done_again_makes_nothing_and_gives_the_same_table(
    study, plugins, tmp_path
):
    first = carried_out(study, tmp_path / "small")
    calls = plugins["wave"].calls, plugins["stubborn"].calls, plugins["other"].calls
    second = carried_out(study, tmp_path / "small")
    assert (plugins["wave"].calls, plugins["stubborn"].calls, plugins["other"].calls) == calls
    assert csv_text(second[:2]) == csv_text(first[:2])  # wall times, too


@pytest.mark.slow
def test_the_same_study_elsewhere_gives_the_same_table_to_the_bit(study, tmp_path):
    one, other = (carried_out(study, tmp_path / name) for name in ("here", "elsewhere"))
    assert csv_text(one, timed=False) == csv_text(other, timed=False)


def test_what_is_to_be_made_is_told_before_and_takes_what_it_took(study, plugins, tmp_path):
    root = tmp_path / "small"
    runs = cells(study)
    before = prospects(runs, root, tmp_path)
    assert [p.state for p in before] == ["to be made"] * 4
    assert before[0].missing[:3] == ("body", "gait", "surrogate") and before[0].seconds is None
    assert before[1].missing == ("planner", "evaluation", "report")  # the rest it copies
    assert not root.exists()
    carried_out(study, root)
    after = prospects(runs, root, tmp_path)
    assert [p.state for p in after] == ["there", "there", "begun", "begun"]
    assert after[0].seconds == 0.0
    grown = dataclasses.replace(study, seeds=(0, 1))
    one = next(p for p in prospects(cells(grown), root, tmp_path) if p.cell.seed == 1)
    assert one.missing == ("gait", "surrogate", "planner", "evaluation", "report")
    assert one.seconds is not None and one.seconds > 0


def test_the_command_prints_one_object_and_a_dry_run_makes_nothing(
    study, tmp_path, capfd, monkeypatch
):
    monkeypatch.setattr(engines, "local_engine", lambda jobs, progress: nullcontext(Straight()))
    command = ["study", str(study.file), "--logs", str(tmp_path / "logs"), "--json", "--quiet"]
    assert cli.main([*command, "--dry-run"]) == 0
    told = json.loads(capfd.readouterr().out)
    assert told["counts"] == {"there": 0, "begun": 0, "to be made": 4} and told["unknown"] == 4
    assert not (tmp_path / "logs").exists()
    assert cli.main(command) == 0
    told = json.loads(capfd.readouterr().out)
    assert (told["rows"], told["failed"]) == (4, 0) and told["seconds"] > 0
    assert set(told["files"]) >= {"table", "page"}
    assert len(read_parquet(told["files"]["table"])) == 4
    assert (tmp_path / "logs/small/study.toml").read_text() == STUDY
    assert cli.main([*command, "--jobs", "2", "--scheduler", "tcp://nowhere:1"]) == 1
    assert "--jobs is for this machine" in capfd.readouterr().err


def test_what_is_to_be_made_of_meshes_and_tunnels_has_no_moving_obstacles(tmp_path):
    (tmp_path / "shark.stl").write_text("")
    path = tmp_path / "mixed.toml"
    path.write_text(
        'meshes = ["shark.stl"]\nmedium = "water"\ntasks = ["fish-swim", "fish-tunnel"]\n'
    )
    runs = cells(read_study(path))
    told = {p.cell.task: p.missing for p in prospects(runs, tmp_path / "out", tmp_path)}
    moving = {task: "moving" in missing for task, missing in told.items()}
    assert moving == {"fish-swim": True, "fish-tunnel": False, "shark-swim": False}
    path.write_text(path.read_text() + "[options]\nmoving = 3\n")
    asked = prospects(cells(read_study(path)), tmp_path / "out", tmp_path)
    assert [p.cell.task for p in asked if "moving" in p.missing] == ["fish-swim", "shark-swim"]


def test_a_mesh_that_cannot_be_used_is_a_row_with_its_sentence(plugins, tmp_path):
    (tmp_path / "nothing.stl").write_text("")
    path = tmp_path / "meshes.toml"
    path.write_text('meshes = ["nothing.stl"]\nmedium = "water"\nuntil = "gait"\n')
    [row] = conduct(cells(read_study(path)), tmp_path / "out", Here(no_progress))
    assert row["failed"] and row["failed_in"] == "task" and row["task"] == "nothing-swim"
    assert "nothing.stl" in row["error"] and "\n" not in row["error"]


def test_a_mesh_s_task_is_guessed_once_and_gaits_that_cannot_steer_are_told(
    plugins, tmp_path, monkeypatch
):
    mesh = tmp_path / "cow.stl"
    mesh.write_text("a mesh")
    calls = []

    def guess(path, medium, progress):
        calls.append((path, medium))
        own = registry.get_task("fish-swim")
        spec = dataclasses.replace(own, name="cow-swim", skin=None, gait_solver="wave")
        return Guess(spec, "a guess", Surface(np.zeros((0, 3)), np.zeros((0, 3), int)))

    monkeypatch.setattr("defplan_mj.taskfile.guess.guess_task", guess)
    path = tmp_path / "meshes.toml"
    text = 'meshes = ["cow.stl"]\nmedium = "water"\nuntil = "gait"\ngait_solvers = ["wave"]\n'
    text += 'planners = ["stubborn"]\n'
    path.write_text(text)
    for times in range(2):
        [row] = conduct(cells(read_study(path)), tmp_path / "out", Here(no_progress))
        assert "cannot steer" in row["error"] and "from another start" in row["error"]
        assert (row["guess_seconds"] is None) is (times == 1)
    assert calls == [(str(mesh), "water")]
    assert plugins["wave"].calls == 3
    assert "Guessed: a guess" in (tmp_path / "out" / "cow-swim.toml").read_text()
