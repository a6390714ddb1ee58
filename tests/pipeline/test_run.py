"""The pipeline: what it returns, what it uses again, what it makes anew, what an interruption leaves."""

from __future__ import annotations

import dataclasses
import json
import os
import resource
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from defplan_mj import cli, registry
from defplan_mj.base import files
from defplan_mj.base.errors import DefplanError
from defplan_mj.base.progress import no_progress
from defplan_mj.body.build import build_body
from defplan_mj.cli.text import STAGE_TEXTS, run_text
from defplan_mj.log.reader import read_log
from defplan_mj.log.replay import replay_log
from defplan_mj.pipeline.evaluation import SPEEDS
from defplan_mj.pipeline.outlook import Consent
from defplan_mj.pipeline.provenance import plugin_data
from defplan_mj.pipeline.results import run_results
from defplan_mj.pipeline.robustness import robustness
from defplan_mj.pipeline.run import open_run
from defplan_mj.pipeline.stages import STAGES
from defplan_mj.pipeline.store import read_config
from defplan_mj.planning.outcome import ENDINGS
from defplan_mj.planning.planner import TrainResult
from defplan_mj.report.material import gather
from defplan_mj.report.report import SECTIONS
from defplan_mj.task import TaskSpec
from tests.samples.processes import heed_ctrl_c
from tests.samples.solvers import Lame, Straight, Stubborn, Wave
from tests.samples.tiny_run import NAVIGATION, SMALL


@dataclasses.dataclass
class Setting:
    """A small task with its plugins, and the folder of its runs."""

    spec: TaskSpec
    wave: Wave
    stubborn: Stubborn
    logs: Path

    def run(self, **options):
        """Do everything in the folder; return the results and how often each plugin worked."""
        before = self.wave.calls, self.stubborn.calls
        whole = options.pop("whole", True)
        fresh = options.pop("fresh", False)
        seed = options.pop("seed", 0)
        consent = options.pop("consent", Consent(options.pop("remake", False)))
        chosen = {"rivals": ["none"], "pairs": 12, "episodes": 3, "logged": 1, "moving": 0}
        chosen |= options
        with open_run(
            self.spec, self.logs, seed, chosen, whole=whole, fresh=fresh, consent=consent
        ) as run:
            results = run_results(run)
        return results, (self.wave.calls - before[0], self.stubborn.calls - before[1])


@pytest.fixture(scope="module")
def body():
    """Return the small body, built once."""
    return build_body(registry.get_task("fish-swim").mesh, SMALL)


@pytest.fixture
def setting(tmp_path, monkeypatch, body):
    """Return a small setting whose plugins stand in for the installed ones."""
    fish = registry.get_task("fish-swim")
    spec = dataclasses.replace(
        fish,
        body=SMALL,
        navigation=NAVIGATION,
        gait_solver="wave",
        planner="stubborn",
        rivals=("wave", "rival"),
    )
    wave, stubborn = Wave(), Stubborn()
    plugins: dict[str, Any] = {"wave": wave, "rival": Wave("rival"), "lame": Lame("lame")}
    plugins |= {"stubborn": stubborn, "other": stubborn}
    plugins |= {name: registry.get_solver(name, "feedback") for name in ("none", "ilqg", "lqr")}
    monkeypatch.setattr(registry, "get_solver", lambda name, kind: plugins[name])
    monkeypatch.setattr(registry, "get_task", lambda name: spec)
    monkeypatch.setattr("defplan_mj.body.build.build_body", lambda *_: body)
    return Setting(spec, wave, stubborn, tmp_path / "logs")


@pytest.fixture
def short_report(monkeypatch):
    """Put a line in the place of the report: its pictures take seconds."""

    def write(folder, progress=no_progress):
        files.write_text(folder / "report.html", "report")
        return folder / "report.html"

    monkeypatch.setattr("defplan_mj.report.report.write_report", write)


def test_a_run_returns_what_the_command_line_promises_and_is_used_again(setting):
    results, made = setting.run()
    assert made == (1, 1)
    assert set(results["seconds"]) == {
        "body", "gait", "surrogate", "planner", "evaluation", "total",
    }  # fmt: skip
    assert results["seconds"]["total"] >= sum(
        v for k, v in results["seconds"].items() if k != "total"
    )
    assert [task["name"] for task in results["gait"]["tasks"]] == ["forward", "left", "right"]
    assert {"advance_m", "advance_sd", "turn_rad", "turn_sd"} <= set(results["gait"]["tasks"][0])
    assert set(results["gait"]["switching"]) >= {"cycles", "falls"}
    assert results["surrogate"]["pairs"] == 12
    assert set(results["surrogate"]["tasks"][0]) == {
        "name", "rotation_mean", "rotation_sd", "translation_mean", "translation_sd",
    }  # fmt: skip
    for scenes, episodes in (("k2", 2), ("novel", 3)):
        for found in (
            results["evaluation"][scenes],
            results["evaluation"][scenes]["without_shield"],
        ):
            assert found["episodes"] == episodes
            total = found["success"] + found["collision"] + found["timeout"]
            assert total == pytest.approx(1.0)
    for path in results["files"]["logs"]:
        assert read_log(path).whole
    names = [os.path.basename(path) for path in results["files"]["logs"]]
    assert names == ["k2-00.mcap", "k2-01.mcap", "novel-00.mcap"]
    assert set(results["files"]) >= {"log", "report", "body", "gait", "policy"}
    assert all(os.path.isfile(results["files"][n]) for n in ("log", "report", "body", "policy"))
    json.dumps(results, allow_nan=False)

    again, made = setting.run()
    assert made == (0, 0)
    assert again == results

    # a stage command takes the run's own options from the folder
    with open_run(setting.spec, setting.logs) as run:
        run.do("surrogate")
        assert run.result("surrogate").pairs == 12
        assert run.plan.options.episodes == 3


def test_what_is_damaged_or_changed_is_made_anew_and_nothing_before_it(setting, short_report):
    first, _ = setting.run()
    folder = setting.logs / "fish-swim-seed0"
    body = (folder / "body.npz").stat().st_mtime_ns
    gait = folder / "gait.npz"
    gait.write_bytes(gait.read_bytes()[:-50])
    second, made = setting.run()
    assert made == (1, 0)  # the same gait again: what follows from it stands
    assert second["evaluation"] == first["evaluation"]

    (folder / "policy.npz").unlink()
    assert setting.run()[1] == (0, 1)
    third, made = setting.run(pairs=14, remake=True)
    assert made == (0, 1) and third["surrogate"]["pairs"] == 14
    assert (folder / "body.npz").stat().st_mtime_ns == body
    (folder / "k2-01.mcap").unlink()
    fourth, made = setting.run(pairs=14)
    assert made == (0, 0) and os.path.isfile(fourth["files"]["logs"][1])


def test_a_second_planner_keeps_the_gaits_and_lies_beside_the_first(setting, short_report):
    setting.run()
    results, made = setting.run(planner="other", remake=True)
    assert made == (0, 1)
    assert os.path.basename(results["files"]["policy"]) == "policy-other.npz"
    assert (setting.logs / "fish-swim-seed0" / "policy.npz").is_file()


def test_what_is_tried_beside_a_whole_run_does_not_take_its_place(setting, short_report, capfd):
    setting.run()
    argv = ["evaluate", "fish-swim", "--episodes", "1", "--logs", str(setting.logs), "--json"]
    assert cli.main([*argv, "--planner", "other", "--feedback", "lqr"]) == 0
    tried = json.loads(capfd.readouterr().out)
    assert (tried["planner"], tried["feedback"]) == ("stubborn", "lqr")  # the other's own name
    config = read_config(setting.logs / "fish-swim-seed0")
    assert config["planner"] is config["feedback"] is None and config["whole"] is True
    assert cli.main(argv) == 0
    assert json.loads(capfd.readouterr().out)["feedback"] == "none"


def compared(setting):
    """Return the rows of the comparison of gait solvers."""
    path = setting.logs / "fish-swim-seed0" / "gait_solvers.json"
    return json.loads(path.read_text())["solvers"]


def test_rival_gait_solvers_are_measured_like_the_chosen_one(setting, short_report):
    _, made = setting.run(rivals=["rival", "lame"], solver_seeds=2)
    rows = compared(setting)
    assert [(row["name"], row["seed"]) for row in rows] == [
        ("wave", 0), ("wave", 1), ("rival", 0), ("rival", 1), ("lame", 0), ("lame", 1),
    ]  # fmt: skip
    assert made[0] == 2  # its gait of the run's own seed is the run's
    for row in rows[1:4]:  # the same gait: the same figures
        for name in ("resimulated", "advance_m", "turn_rad", "slip_share", "cycles", "falls"):
            assert row[name] == rows[0][name]
    assert np.isfinite(rows[0]["resimulated"]) and rows[0]["cycles"] == 200
    assert rows[0]["turn_rad"] > 0
    assert rows[4] == {"name": "lame", "seed": 0, "error": "it cannot walk"}
    # one more seed costs no more than that
    assert setting.run(rivals=["rival", "lame"], solver_seeds=3)[1][0] == 1
    assert len(compared(setting)) == 9


def test_the_tasks_own_rivals_are_compared_unless_others_are_asked_for(setting, short_report):
    setting.run(rivals=None)
    assert [row["name"] for row in compared(setting)] == ["wave", "rival"]


def test_episodes_among_moving_obstacles_are_counted_at_every_speed(setting, short_report):
    results, _ = setting.run(moving=2)
    assert [row["speed"] for row in results["moving"]] == list(SPEEDS)
    for row in results["moving"]:
        assert row["episodes"] == 2 and "rows" not in row
        assert sum(row[name] for name in ENDINGS) == pytest.approx(1.0)
        assert set(row["interval"]) >= {"success"}
    json.dumps(results, allow_nan=False)
    assert setting.run(moving=2)[0]["moving"] == results["moving"]
    assert setting.run()[0]["moving"] == []


def test_a_feedback_changes_the_episodes_and_nothing_before_them(setting, short_report):
    before, _ = setting.run()
    opened = read_log(before["files"]["log"])
    results, made = setting.run(feedback="ilqg", remake=True)
    assert made == (0, 0)
    shapes = [log.target_shapes for log in (opened, read_log(results["files"]["log"]))]
    n = min(map(len, shapes))
    assert np.abs(shapes[0][:n] - shapes[1][:n]).max() > 1e-3
    assert results["gait"] == before["gait"] and results["surrogate"] == before["surrogate"]
    assert replay_log(results["files"]["log"]).identical


def test_fresh_makes_everything_anew_with_the_same_result(setting, short_report):
    first, _ = setting.run()
    second, made = setting.run(fresh=True)
    assert made == (1, 1)
    for name in ("gait", "surrogate"):
        assert first[name] == second[name]
    for scenes in ("k2", "novel"):
        one, two = first["evaluation"][scenes], second["evaluation"][scenes]
        for key in ("success", "collision", "timeout"):
            assert one[key] == two[key]


def test_an_interruption_loses_nothing_made_before(setting, monkeypatch):
    def stop(*_args, **_kwargs):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(setting.stubborn, "train", stop)
        setting.run()
    folder = setting.logs / "fish-swim-seed0"
    kept = {name: (folder / name).stat().st_mtime_ns for name in ("body.npz", "gait.npz")}
    assert not (folder / "policy.npz").exists()
    setting.run()
    assert setting.wave.calls == 1
    for name, time in kept.items():
        assert (folder / name).stat().st_mtime_ns == time


def contents(folder):
    """Return every file of a folder with its bytes."""
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"pairs": 14}, r"surrogate \(pairs is 14, was 12\); what follows from it: planner, eval"),
        ({"planner": "other"}, r"evaluation \(planner is other, was stubborn\)"),
        ({"feedback": "ilqg"}, r"evaluation \(feedback is ilqg, was none\)"),
        ({"gait_solver": "rival"}, r"gait \(gait_solver is rival, was wave\); what follows"),
    ],
)
def test_a_finished_run_is_not_made_anew_for_an_option_unless_that_is_said(
    setting, short_report, monkeypatch, options, told
):
    setting.run()
    setting.stubborn.name = options.get("planner", "stubborn")
    folder = setting.logs / "fish-swim-seed0"
    before = contents(folder)
    with pytest.raises(DefplanError, match=told) as error:
        setting.run(**options)
    assert "add --remake" in str(error.value) and "\n" not in str(error.value)
    assert contents(folder) == before
    _, made = setting.run(**options, remake=True)
    assert contents(folder) != before


def test_a_stopped_run_of_other_options_is_asked_about_too(setting, monkeypatch, short_report):
    def stop(*_args, **_kwargs):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(setting.stubborn, "train", stop)
        setting.run()
    with pytest.raises(DefplanError, match="pairs is 14, was 12"):
        setting.run(pairs=14)


def test_a_terminal_is_asked_and_a_no_changes_nothing(setting, short_report):
    setting.run()
    folder = setting.logs / "fish-swim-seed0"
    said: list[str] = []
    before = contents(folder)
    with pytest.raises(DefplanError, match="was changed"):
        setting.run(pairs=14, consent=Consent(say=said.append, ask=lambda question: False))
    assert contents(folder) == before
    assert said == [
        "made anew: surrogate (pairs is 14, was 12); what follows from it: planner, evaluation"
    ]
    with pytest.raises(DefplanError, match="add --remake"):
        setting.run(pairs=14, consent=Consent(say=said.append))
    assert len(said) == 1  # a refusal is one sentence: nothing is said beside it
    results, _ = setting.run(pairs=14, consent=Consent(ask=lambda question: True))
    assert results["surrogate"]["pairs"] == 14


def test_stages_made_one_by_one_are_made_anew_without_a_question(setting):
    for pairs in (12, 14):
        with open_run(setting.spec, setting.logs, chosen={"pairs": pairs}) as run:
            run.do("surrogate")
            assert run.result("surrogate").pairs == pairs


def test_a_run_of_an_earlier_version_is_not_made_anew_unasked(setting, short_report):
    setting.run()
    path = setting.logs / "fish-swim-seed0" / "run.json"
    data = json.loads(path.read_text())
    for record in data["stages"].values():
        record["inputs"] = "0" * 64
        del record["made_from"], record["contents"]
    path.write_text(json.dumps(data))
    with pytest.raises(DefplanError, match="made by another version of defplan"):
        setting.run()
    assert setting.run(remake=True)[1] == (1, 1)


def test_an_edited_plugin_makes_anew_what_depends_on_it_and_says_so(
    setting, short_report, monkeypatch
):
    setting.run()
    said: list[str] = []
    consent = Consent(say=said.append)
    source = {"planner": "edited"}

    def edited(solver):
        data = plugin_data(solver)
        return {**data, "source": source.get(solver.kind, data["source"])}

    for module in ("making", "evaluation"):
        monkeypatch.setattr(f"defplan_mj.pipeline.{module}.plugin_data", edited)
    assert setting.run(consent=consent)[1] == (0, 1)
    assert said == ["made anew: planner, evaluation (the planner stubborn has changed)"]
    source["gait"] = "edited"
    assert setting.run(consent=consent)[1] == (1, 0)  # the same gait again
    assert "gait (the gait solver wave has changed)" in said[-1]


def test_a_gait_that_took_another_time_is_the_same_gait(setting, short_report, monkeypatch):
    solve, times = setting.wave.solve, iter((1.0, 2.0))

    def timed(problem, seed, progress=no_progress):
        gait = solve(problem, seed, progress)
        return dataclasses.replace(gait, meta={**gait.meta, "seconds": next(times)})

    monkeypatch.setattr(setting.wave, "solve", timed)
    setting.run()
    (setting.logs / "fish-swim-seed0" / "gait.npz").unlink()
    assert setting.run()[1] == (1, 0)


def test_a_training_that_is_cut_short_says_so_everywhere(setting, monkeypatch, capfd):
    limits = []

    def train(surrogate, navigation, seed, seconds=None, progress=no_progress):
        limits.append(seconds)
        return TrainResult(Straight(), {"iterations": np.arange(3.0)}, 0.0, seconds is not None)

    monkeypatch.setattr(setting.stubborn, "train", train)
    folder = setting.logs / "fish-swim-seed0"
    results, _ = setting.run()
    assert results["planner"] == {"planner": "stubborn", "cut_short": False}
    assert "cut short" not in (folder / "report.html").read_text()
    results, _ = setting.run(training_seconds=2.0, remake=True)
    assert limits == [None, 2.0] and results["planner"]["cut_short"]
    assert "cut short" in run_text(results)
    assert "cut short" in (folder / "report.html").read_text()
    argv = ["planner", "fish-swim", "--logs", str(setting.logs), "--quiet"]
    assert cli.main(argv) == 0 and "cut short" in capfd.readouterr().out


def test_nothing_is_made_by_looking(setting):
    with (
        open_run(setting.spec, setting.logs) as run,
        pytest.raises(KeyError, match="gait is not done"),
    ):
        run.result("gait")
    assert setting.wave.calls == 0


def test_robustness_reaches_the_report_of_a_run(setting, capfd):
    setting.run()
    report = setting.logs / "fish-swim-seed0" / "report.html"
    assert "Not measured yet" in report.read_text()
    argv = "robustness fish-swim --feedback none --cycles 3 --quiet --json".split()
    assert cli.main([*argv, "--logs", str(setting.logs)]) == 0
    assert json.loads(capfd.readouterr().out)["cycles"] == 3
    page = report.read_text()
    assert "Not measured yet" not in page and "pushes, 0.3 m/s" in page
    assert setting.run()[1] == (0, 0) and report.read_text() == page


def test_a_check_reaches_the_report_of_a_run(setting, capfd):
    setting.run()
    folder = setting.logs / "fish-swim-seed0"
    assert "Not checked yet" in (folder / "report.html").read_text()
    assert cli.main(["check", "fish-swim", "--run", str(folder), "--no-full", "--quiet"]) == 0
    page = (folder / "report.html").read_text()
    assert "Not checked yet" not in page and "substeps x 4" in page
    document = json.loads((folder / "check.json").read_text())
    (folder / "check.json").write_text(json.dumps({**document, "gait": "0" * 64}))
    setting.run()
    assert "Checked with other gaits" in (folder / "report.html").read_text()


def test_a_stage_that_has_figures_is_told_and_shown(setting, tmp_path):
    shown = {make(gather(tmp_path)).name for make in SECTIONS}
    stages = [*STAGES, robustness(setting.spec)]
    for stage in stages:
        assert set(stage.sections) <= shown, stage.name
    results, _ = setting.run(moving=1)
    told = [stage.name for stage in stages if stage.name in results]
    assert told == [name for name in STAGE_TEXTS if name != "robustness"]


def test_a_single_stage_of_a_whole_run_is_guarded_too(setting, short_report, capfd):
    setting.run()
    folder = setting.logs / "fish-swim-seed0"
    before = contents(folder)
    argv = ["surrogate", "fish-swim", "--pairs", "14", "--logs", str(setting.logs)]
    assert cli.main(argv) == 1
    refusal = capfd.readouterr().err
    assert "pairs is 14, was 12" in refusal and refusal.count("\n") == 1
    assert contents(folder) == before
    assert cli.main([*argv, "--remake", "--json"]) == 0
    captured = capfd.readouterr()
    assert json.loads(captured.out)["pairs"] == 14
    assert captured.err.startswith("made anew: surrogate (pairs is 14, was 12); what follows")


@pytest.mark.parametrize(
    "planted", [{"made_from": {"options": 5, "before": 7}}, {"files": {"../x": "0"}}]
)
def test_whatever_a_foreign_run_file_says_the_run_goes_on(setting, short_report, planted):
    setting.run()
    path = setting.logs / "fish-swim-seed0" / "run.json"
    data = json.loads(path.read_text())
    data["stages"]["surrogate"] |= {"inputs": "0" * 64, **planted}
    data["config"] |= {"pairs": "many", "planner": 7, "rivals": "x", "whole": "yes"}
    path.write_text(json.dumps(data))
    assert setting.run(remake=True)[0]["surrogate"]["pairs"] == 12


def test_logs_of_the_user_in_a_runs_folder_stay(setting, short_report):
    folder = setting.logs / "fish-swim-seed0"
    folder.mkdir(parents=True)
    for name in ("mine.mcap", "k2-mine.mcap"):
        (folder / name).write_bytes(b"mine")
    (folder / "novel-77.mcap").write_bytes(b"of an evaluation before")
    setting.run()
    assert (folder / "mine.mcap").exists() and (folder / "k2-mine.mcap").exists()
    assert not (folder / "novel-77.mcap").exists()


def test_view_lets_the_planner_steer_the_runs_environment(setting, monkeypatch, capfd):
    def one_cycle(environment, policy):
        step = environment.step(policy(environment.reset()))
        assert step.observation["laser"].shape == (NAVIGATION.beams,)
        assert environment.task.cycles == 1
        return ["success"]

    monkeypatch.setattr("defplan_mj.host.viewer.require_display", lambda: None)
    monkeypatch.setattr("defplan_mj.host.viewer.view", one_cycle)
    argv = ["view", "fish-swim", "--logs", str(setting.logs), "--obstacles", "1", "--quiet"]
    assert cli.main(argv) == 0
    assert capfd.readouterr().out == "success\n"


def test_evaluate_prints_one_evaluation_and_logs_every_episode(setting, tmp_path, capfd):
    argv = ["evaluate", "fish-swim", "--logs", str(setting.logs), "--quiet", "--json"]
    options = "--planner stubborn --no-shield --scenes novel --episodes 2 --obstacles 1".split()
    logs = tmp_path / "episodes"
    assert cli.main([*argv, *options, "--obstacle-speed", "0.3", "--log", str(logs)]) == 0
    data = json.loads(capfd.readouterr().out)
    assert data["episodes"] == 2 and data["shield"] is False and data["planner"] == "stubborn"
    assert data["success"] + data["collision"] + data["timeout"] == pytest.approx(1.0)
    found = [read_log(path) for path in sorted(logs.iterdir())]
    assert len(found) == 2
    speeds = np.linalg.norm(found[0].scene.velocities, axis=1)
    np.testing.assert_allclose(speeds, 0.3)
    assert len(found[0].scene.radii) == 1


def test_an_unknown_planner_is_told_before_any_work(tmp_path, capfd):
    argv = ["run", "fish-swim", "--planner", "dqll", "--logs", str(tmp_path), "--quiet"]
    assert cli.main(argv) == 1
    assert "there is no planner dqll, did you mean dql?" in capfd.readouterr().err
    assert not (tmp_path / "fish-swim-seed0" / "body.npz").exists()


def test_an_unknown_task_is_told_with_what_there_is(tmp_path, capfd):
    for command in ("run", "gait", "surrogate", "planner", "evaluate", "bench", "view"):
        assert cli.main([command, "fsh-swim", "--logs", str(tmp_path)]) == 1
        captured = capfd.readouterr()
        assert "there is no task fsh-swim, did you mean fish-swim?" in captured.err or (
            command == "view" and "no screen" in captured.err
        )
        assert captured.out == "" and captured.err.count("\n") == 1


def start(argv, **options):
    """Start `defplan` in a process of its own."""
    command = [sys.executable, "-m", "defplan_mj", *argv]
    options = {"preexec_fn": heed_ctrl_c, **options}
    return subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, **options
    )


def test_ctrl_c_in_the_middle_of_a_stage_is_one_sentence_and_exit_code_130(tmp_path):
    process = start(["gait", "fish-swim", "--logs", str(tmp_path)])
    assert process.stderr is not None
    for line in process.stderr:
        if line.startswith("body (stage 1 of 2): finding"):
            break
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=60)
    assert process.returncode == 130
    assert out == "" and err.splitlines()[-1] == "defplan gait: stopped; run it again to go on"
    assert "Traceback" not in err
    left = sorted(path.name for path in (tmp_path / "fish-swim-seed0").iterdir())
    assert left == [".lock"]


@pytest.mark.slow
def test_ctrl_c_while_casadi_solves_keeps_the_body(tmp_path):
    process = start(["gait", "fish-swim", "--logs", str(tmp_path)])
    assert process.stderr is not None
    for line in process.stderr:
        if line.startswith("gait (stage 2 of 2):"):
            break
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 130
    assert err.splitlines()[-1] == "defplan gait: stopped; run it again to go on"
    left = sorted(path.name for path in (tmp_path / "fish-swim-seed0").iterdir())
    assert left == [".lock", "body.npz", "run.json"]


@pytest.mark.parametrize("mesh", ["fish-swim", str(registry.get_task("fish-swim").mesh)])
def test_no_room_for_a_file_is_one_sentence_and_leaves_none(tmp_path, mesh):
    """A mesh file that is held to its surface is written for fTetWild before the body is."""

    def small_files_only():
        resource.setrlimit(resource.RLIMIT_FSIZE, (10_000, 10_000))

    output = tmp_path / "small.npz"
    argv = ["body", mesh, "-o", str(output), "--vertices", "300", "--quiet"]
    process = start(argv, preexec_fn=small_files_only)
    out, err = process.communicate(timeout=120)
    assert process.returncode == 1
    assert out == "" and err.count("\n") == 1 and "cannot write " in err
    assert (str(output) in err) == (mesh == "fish-swim")
    assert os.listdir(tmp_path) == []


@pytest.mark.slow
def test_the_fish_goes_the_whole_way_from_its_mesh_to_its_targets(tmp_path):
    argv = ["run", "fish-swim", "--logs", str(tmp_path), "--episodes", "20", "--json", "--quiet"]
    out, err = start(argv).communicate(timeout=1800)
    results = json.loads(out)
    assert err == ""
    tasks = {task["name"]: task for task in results["gait"]["tasks"]}
    assert tasks["forward"]["advance_m"] >= 0.5
    assert tasks["left"]["turn_rad"] >= 0.5 and tasks["right"]["turn_rad"] <= -0.5
    assert results["gait"]["switching"] == {
        **results["gait"]["switching"],
        "cycles": 200,
        "falls": 0,
    }
    assert results["evaluation"]["k2"]["success"] >= 0.9
    assert results["evaluation"]["novel"]["success"] >= 0.8
    replay = start(["replay", results["files"]["log"], "--quiet"])
    assert "identical to the bit" in replay.communicate(timeout=300)[0]
    assert replay.returncode == 0
