"""From a mesh to a run by a task file: what is written, judged, dropped, made anew, and not shared."""

from __future__ import annotations

import dataclasses
import json
from typing import Any

import numpy as np
import pytest

from defplan_mj import cli, registry
from defplan_mj.base import files
from defplan_mj.base.progress import no_progress
from defplan_mj.base.space import PLANE
from defplan_mj.body.build import build_body
from defplan_mj.body.options import BodyOptions
from defplan_mj.gait.gait import Gait
from defplan_mj.gait.switching import Switching
from defplan_mj.planning.planner import TrainResult
from defplan_mj.report.material import gather
from defplan_mj.task import Navigation
from defplan_mj.taskfile.guess import guess_task
from defplan_mj.taskfile.kinds import KINDS
from defplan_mj.taskfile.read import read_task
from defplan_mj.taskfile.write import write_task
from tests.samples.meshes import finned

SMALL = BodyOptions(vertices=150, modes=3, basis=10, samples=8, drag_points=24, drag_error=0.5)
NAVIGATION = Navigation(
    distance=4.0, max_cycles=3, k2=2, k2_obstacles=1, novel_obstacles=2, beams=8
)
FEW = ["--pairs", "6", "--episodes", "2", "--moving", "0", "--quiet"]


class Wave:
    """A gait solver that optimises nothing."""

    kind, name, summary, calls = "gait", "wave", "a wave", 0

    def solve(self, problem, seed=0, progress=no_progress):
        self.calls += 1
        body, tasks = problem.dynamics.body, problem.tasks
        alpha = np.zeros((len(tasks), problem.elements, body.n_modes))
        alpha[:, 0, 0] = 0.1 * body.amplitude[0] * np.arange(1, len(tasks) + 1)
        return Gait(
            body_hash=body.hash,
            task_names=tuple(task.name for task in tasks),
            timestep=problem.dynamics.timestep,
            steps_per_cycle=problem.steps_per_cycle,
            alpha=alpha,
            beta=np.zeros_like(alpha),
            mu=np.zeros(alpha.shape[1:]),
            amplitude=body.amplitude,
        )


class First:
    """A planner that takes the first gait, and its plugin."""

    kind, name, summary, needs_training, calls = "planner", "first", "the first gait", False, 0

    def reset(self):
        pass

    def values(self, observation):
        return -np.arange(float(self.count))

    def train(self, surrogate, navigation, seed, seconds=None, progress=no_progress):
        self.calls += 1
        return TrainResult(self.load(None, surrogate, navigation), {"x": np.zeros(1)}, 0.0)

    def save(self, planner, path):
        files.save_archive(path, "first", 1, {}, {})

    def load(self, path, surrogate, navigation):
        self.count = len(surrogate.task_names)
        return self


@pytest.fixture
def plugins(monkeypatch):
    """Put a wave and a planner in the place of the installed solvers; keep bodies small, reports short."""
    found: dict[str, Any] = {"wave": Wave(), "first": First()}
    found["none"] = registry.get_solver("none", "feedback")
    found["shooting-quick"], found["astar"] = found["wave"], found["first"]  # of guessed tasks
    real = registry.get_solver
    monkeypatch.setattr(registry, "get_solver", lambda n, k: found.get(n) or real(n, k))
    kinds = {"gait": "wave", "planner": "first", "feedback": "none"}
    monkeypatch.setattr(registry, "default_solver", lambda kind: kinds[kind])
    for kind in ("planar", "ground"):
        usual = KINDS[kind]
        small = dataclasses.replace(SMALL, medium=usual.body.medium)
        bends = dataclasses.replace(usual, body=small, bends=True)
        monkeypatch.setitem(KINDS, kind, bends)

    def report(folder, progress=no_progress):
        files.write_text(folder / "report.html", "report")
        return folder / "report.html"

    monkeypatch.setattr("defplan_mj.report.report.write_report", report)
    return found


@pytest.fixture
def verdicts(monkeypatch):
    """Return a function that says what each gait is found to do: (advance m, turn rad) by name."""
    told: dict = {}

    def evaluate(problem, gait, cycles=40, seed=0):
        assert tuple(task.name for task in problem.tasks) == gait.task_names
        task = np.arange(40) % len(gait.task_names)
        move, turn = np.zeros((40, 3)), np.zeros((40, 3))
        for j, one in enumerate(problem.tasks):
            advance, angle = told.get(one.name, (one.advance, one.turn[2]))
            move[task == j] = np.multiply(advance, one.direction)
            turn[task == j, 2] = angle
        return Switching(
            problem.tasks, PLANE, 1.0, task, move, turn, np.zeros(40), np.zeros(40, bool)
        )

    monkeypatch.setattr("defplan_mj.gait.switching.evaluate_switching", evaluate)
    return told


@pytest.fixture(scope="module")
def mesh(tmp_path_factory):
    """Return the file of an ellipsoid with a fin."""
    path = tmp_path_factory.mktemp("mesh") / "shark.stl"
    finned().export(path)
    return path


@pytest.fixture(scope="module")
def guessed(mesh):
    """Return a small task of the mesh, guessed once, and its body, built once."""
    spec = guess_task(mesh, "water").spec
    size: dict[str, Any] = {
        "length": spec.body.length,
        "up": spec.body.up,
        "forward": spec.body.forward,
    }
    spec = dataclasses.replace(
        spec,
        name="shark",
        body=dataclasses.replace(SMALL, **size),
        navigation=NAVIGATION,
        steps_per_cycle=8,
    )
    return spec, build_body(mesh, spec.body)


@pytest.fixture
def task(guessed, tmp_path, plugins, monkeypatch):
    """Return the file of a small task in a folder of its own."""
    spec, body = guessed
    build = lambda mesh, options, *rest: (  # noqa: E731
        body if options == spec.body else build_body(mesh, options, *rest)
    )
    monkeypatch.setattr("defplan_mj.body.build.build_body", build)
    monkeypatch.chdir(tmp_path)
    return write_task(spec, tmp_path / "shark.toml")


def run(*argv, capfd):
    """Run a command; return its exit code, its JSON and what it said."""
    capfd.readouterr()
    code = cli.main([str(word) for word in argv])
    out, said = capfd.readouterr()
    return code, json.loads(out) if out.strip().startswith("{") else out, said


def test_a_run_of_a_file_says_what_its_gaits_can_do(task, verdicts, plugins, capfd, tmp_path):
    code, data, _ = run("run", task, "--json", *FEW, capfd=capfd)
    assert code == 0 and data["task"] == "shark"
    assert [skill["name"] for skill in data["skills"]] == ["forward", "left", "right"]
    assert all(set(skill) >= {"name", "wanted", "got", "kept"} for skill in data["skills"])
    folder = tmp_path / "logs" / "shark-seed0"
    kept = read_task(folder / "task.toml")
    assert dataclasses.replace(kept, file=None) == dataclasses.replace(read_task(task), file=None)
    task.rename(tmp_path / "gone.toml")
    assert gather(folder).spec == kept  # the report does not need the user's file


def test_a_gait_that_fails_is_dropped_with_a_sentence(task, verdicts, plugins, capfd, tmp_path):
    verdicts["right"] = (0.3, 0.2)
    code, data, said = run("run", task, "--json", *FEW[:-1], capfd=capfd)
    assert code == 0
    assert [skill["kept"] for skill in data["skills"]] == [True, True, False]
    assert "right turns the wrong way: +0.20 rad a cycle, wanted -0.60" in said
    assert "it goes on with forward, left" in said
    assert [row["name"] for row in data["surrogate"]["tasks"]] == ["forward", "left"]
    folder = tmp_path / "logs" / "shark-seed0"
    assert Gait.load(folder / "gait.npz").task_names == ("forward", "left")
    assert Gait.load(folder / "gait-tried.npz").task_names == ("forward", "left", "right")
    code, text, _ = run("run", task, *FEW, capfd=capfd)  # used again
    assert code == 0 and "right turns the wrong way" in text and plugins["wave"].calls == 3


@pytest.mark.parametrize(("good", "steps"), [(2, 8), (3, 10)])
def test_gaits_that_fail_are_tried_again(good, steps, task, verdicts, plugins, capfd, tmp_path):
    wave, seeds = plugins["wave"], []
    solve = wave.solve

    def later(problem, seed=0, progress=no_progress):
        gait = solve(problem, seed, progress)
        seeds.append(seed)
        verdicts["right"] = (0.3, -0.6 if wave.calls == good else 0.2)
        return gait

    wave.solve = later
    code, data, said = run("run", task, "--json", *FEW[:-1], capfd=capfd)
    assert code == 0 and all(skill["kept"] for skill in data["skills"])
    assert wave.calls == good and len(set(seeds)) == good and "dropped" not in said
    assert said.count("right turns the wrong way") == good - 1
    folder = tmp_path / "logs" / "shark-seed0"
    assert Gait.load(folder / "gait.npz").steps_per_cycle == steps
    tries = json.loads((folder / "skills.json").read_text())["tries"]
    assert [bool(one["faults"]) for one in tries] == [True] * (good - 1) + [False]


def test_gaits_that_cannot_steer_end_the_run_before_any_training(task, verdicts, plugins, capfd):
    verdicts["left"], verdicts["right"] = (0.3, -0.1), (0.3, 0.2)
    for _ in range(2):  # and again, of what is there
        code, out, said = run("run", task, "--json", *FEW, capfd=capfd)
        assert code == 1 and out == "" and said.count("\n") == 1
        assert "left turns the wrong way" in said and "right turns the wrong way" in said
        assert "what is left: forward" in said and "Change gait_tasks" in said
        assert "tried: as the task says, from another start, " in said
    assert plugins["first"].calls == 0 and plugins["wave"].calls == 3
    code, data, _ = run("gait", task, "--json", "--quiet", capfd=capfd)
    assert code == 0 and [s["kept"] for s in data["skills"]] == [True, False, False]


def test_an_edited_field_makes_anew_what_depends_on_it_and_asks(task, verdicts, plugins, capfd):
    assert run("run", task, *FEW, capfd=capfd)[0] == 0
    text = task.read_text()
    for old, new, told, made in (
        ("k2 = 2", "k2 = 3", "navigation.k2 is 3, was 2", (1, 2)),
        ("steps_per_cycle = 8", "steps_per_cycle = 9", "steps_per_cycle is 9, was 8", (2, 3)),
        ("density = 1000.0", "density = 1100.0", "body.material.density is 1100.0, was 1000.0", (3, 4)),
    ):  # fmt: skip
        text = text.replace(old, new, 1)
        task.write_text(text)
        code, _, said = run("run", task, *FEW, capfd=capfd)
        assert code == 1 and told in said and "--remake" in said
        assert run("run", task, "--remake", *FEW, capfd=capfd)[0] == 0
        assert (plugins["wave"].calls, plugins["first"].calls) == made
    task.write_text(text + "\n# a comment changes nothing\n")
    assert run("run", task, *FEW, capfd=capfd)[0] == 0
    assert (plugins["wave"].calls, plugins["first"].calls) == made


def test_two_files_of_one_name_do_not_share_a_run(task, verdicts, plugins, capfd, tmp_path):
    assert run("gait", task, "--quiet", capfd=capfd)[0] == 0
    other = write_task(read_task(task), tmp_path / "other" / "shark.toml")
    code, _, said = run("gait", other, "--quiet", capfd=capfd)
    assert code == 1 and said.count("\n") == 1
    assert f"holds a run of the task file {task}, not of {other}" in said and "--logs" in said
    assert run("gait", other, "--quiet", "--remake", capfd=capfd)[0] == 0
    code, _, said = run("gait", task, "--quiet", capfd=capfd)
    assert code == 1 and str(other) in said
    other.unlink()  # it was moved: its run is anybody's
    assert run("gait", task, "--quiet", capfd=capfd)[0] == 0


def test_every_command_that_takes_a_task_takes_its_file(task, verdicts, plugins, capfd):
    short = ("--json", "--quiet")
    assert run("body", task, "-o", "b.npz", *short, capfd=capfd)[1]["vertices"] == 150
    assert run("surrogate", task, "--pairs", "6", *short, capfd=capfd)[0] == 0
    assert run("planner", task, *short, capfd=capfd)[0] == 0
    code, data, _ = run("evaluate", task, "--episodes", "1", *short, capfd=capfd)
    assert code == 0 and data["task"] == "shark"
    code, data, _ = run("robustness", task, "--cycles", "2", *short, capfd=capfd)
    assert code == 0 and data["task"] == "shark"
    where = ("--run", "logs/shark-seed0", "--no-full", "--cycles", "2")
    assert run("check", task, *where, *short, capfd=capfd)[0] == 0


@pytest.mark.parametrize(
    "command",
    ["run", "body", "gait", "surrogate", "planner", "evaluate", "robustness", "check", "bench"],
)
def test_every_command_tells_what_is_wrong_before_any_work(command, task, capfd, tmp_path):
    task.write_text(task.read_text().replace("vertices =", "vertexes ="))
    code, out, said = run(command, task, capfd=capfd)
    assert code == 1 and out == "" and said.count("\n") == 1
    assert f"{task}, line " in said and "did you mean vertices?" in said
    assert not (tmp_path / "logs").exists()


def test_new_writes_what_run_takes(mesh, plugins, tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    code, data, said = run("new", mesh, "--medium", "water", "-o", "my.toml", "--json", capfd=capfd)
    assert code == 0 and data["task"] == "my"
    assert "ahead is x" in said and "natural frequencies" in said
    spec = read_task("my.toml")
    assert spec.mesh == mesh and [t.name for t in spec.gait_tasks] == ["forward", "left", "right"]
    assert "# of a control step, s" in (tmp_path / "my.toml").read_text()
    again = run("new", mesh, "--medium", "water", "-o", "my.toml", capfd=capfd)
    assert again[0] == 1 and "--overwrite" in again[2]
    monkeypatch.setattr("defplan_mj.taskfile.guess._as_tried", lambda spec, *_: spec)
    turned = ("--up", "y", "--forward", "-x", "--length", "0.5", "--overwrite", "--quiet")
    assert run("new", mesh, "--medium", "ground", "-o", "my.toml", *turned, capfd=capfd)[0] == 0
    spec = read_task("my.toml")
    assert (spec.body.up, spec.body.forward, spec.body.length) == ("y", "-x", 0.5)
    assert spec.world.walks and spec.gait_tasks[0].advance == pytest.approx(0.1)


@pytest.mark.parametrize(
    ("argv", "told"),
    [
        (("new",), "name a mesh"),
        (("new", "{mesh}"), "--medium water, or --medium ground"),
        (("new", "{mesh}", "--from", "fish-swim"), "one of them"),
        (("new", "fish-swim", "--medium", "water"), "`defplan new --from fish-swim`"),
        (("new", "--from", "fish-swim", "--medium", "water"), "--medium is for a mesh"),
        (("new", "--from", "fish-swam"), "did you mean fish-swim?"),
        (("new", "{mesh}", "--medium", "water", "-o", "x.yaml"), "ends in .toml, not .yaml"),
        (("new", "no.stl", "--medium", "water"), "no.stl does not exist"),
        (("new", "{mesh}", "--medium", "water", "--up", "x", "--forward", "-x"), "two different axes"),
        (("run", "{mesh}"), "--medium water, or --medium ground"),
        (("run", "fish-swim", "--length", "2"), "--length is for a mesh"),
        (("gait", "{mesh}"), "is a mesh and no task"),
    ],
)  # fmt: skip
def test_wrong_use_is_one_sentence(argv, told, mesh, tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    words = [str(mesh) if word == "{mesh}" else word for word in argv]
    code, out, said = run(*words, "--quiet", capfd=capfd)
    assert code == 1 and out == "" and told in said and said.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_a_shipped_task_is_a_start_for_one_s_own(tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    assert run("new", "--from", "fish-swim", "-o", "my.toml", "--quiet", capfd=capfd)[0] == 0
    fish = dataclasses.replace(registry.get_task("fish-swim"), name="my")
    assert read_task("my.toml") == fish


def test_a_mesh_runs_by_one_command(mesh, plugins, verdicts, tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("defplan_mj.taskfile.kinds.Kind.navigation_of", lambda *_: NAVIGATION)
    code, data, said = run("run", mesh, "--medium", "water", "--json", *FEW[:-1], capfd=capfd)
    assert code == 0 and data["task"] == "shark-swim" and len(data["skills"]) == 3
    assert "ahead is x" in said and "logs/shark-swim.toml" in said
    assert (tmp_path / "logs" / "shark-swim-seed0" / "report.html").is_file()
    again = run("run", mesh, "--medium", "water", *FEW, capfd=capfd)
    assert again[0] == 0 and plugins["wave"].calls == 1
    told = run("run", mesh, "--medium", "water", "--length", "2", *FEW, capfd=capfd)
    assert told[0] == 1 and "says something else than what is guessed" in told[2]
    path = tmp_path / "logs" / "shark-swim.toml"
    assert run("run", path, *FEW, capfd=capfd)[0] == 0 and plugins["wave"].calls == 1
