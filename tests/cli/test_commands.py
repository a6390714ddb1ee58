"""The command line: one JSON object, one sentence for an error, the right exit code."""

from __future__ import annotations

import errno
import io
import json
import os
import signal
import subprocess
import sys

import pytest

from defplan_mj import cli
from defplan_mj.base.errors import DefplanError
from defplan_mj.cli import commands
from defplan_mj.cli.console import Console, table

COMMANDS = "list run study body gait surrogate planner evaluate bench compare replay view".split()


@pytest.fixture
def failing(monkeypatch):
    """Return a function that lets `defplan list` raise the given error."""

    def put(error: BaseException) -> None:
        def command(arguments, console):
            raise error

        monkeypatch.setattr(commands, "list_installed", command)

    return put


def test_help_names_every_command(capfd):
    assert cli.main(["--help"]) == 0
    text = capfd.readouterr().out
    for name in COMMANDS:
        assert f"    {name}" in text


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_has_the_common_options(name, capfd):
    assert cli.main([name, "--help"]) == 0
    text = capfd.readouterr().out
    for option in ("--json", "--quiet", "--debug"):
        assert option in text


def test_help_and_list_import_nothing_heavy():
    code = (
        "import sys; from defplan_mj import cli; cli.main(['--help']);"
        "heavy = {'numpy', 'torch', 'mujoco', 'rich', 'casadi'} & set(sys.modules);"
        "sys.exit(f'imported {heavy}' if heavy else 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_list_does_not_load_torch():
    code = (
        "import sys; from defplan_mj import cli; cli.main(['list', '--quiet']);"
        "sys.exit('imported torch' if 'torch' in sys.modules else 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_list_prints_one_json_object_that_names_all_groups(capfd):
    assert cli.main(["list", "--json"]) == 0
    data = json.loads(capfd.readouterr().out)
    assert {"fish-swim", "quadruped-swim"} <= {task["name"] for task in data["tasks"]}
    assert {"dql", "shooting"} <= {solver["name"] for solver in data["solvers"]}
    assert [domain["name"] for domain in data["domains"]] == ["fish", "quadruped", "tee"]
    assert {"planar-laser", "spherical-laser"} <= {sensor["name"] for sensor in data["sensors"]}
    swim = {"domain": "fish", "task": "swim", "gymnasium": "defplan/FishSwim-v0"}
    assert swim in data["suite"]


@pytest.mark.parametrize(
    ("argv", "sentence"),
    [
        (["rnu"], "there is no rnu, did you mean run?"),
        ([], "required: COMMAND"),
        (["run"], "required: TASK"),
        (["run", "fish-swim", "--seed", "x"], "x is not a whole number, 0 or more"),
        (
            ["run", "fish-swim", "--sed", "1"],
            "defplan run: there is no option --sed, did you mean --seed?",
        ),
        (
            ["run", "fish-swim", "--episode=1"],
            "there is no option --episode, did you mean --episodes?",
        ),
        (
            ["run", "fish-swim", "--zzz"],
            "defplan run: there is no option --zzz; see defplan run --help",
        ),
        (["run", "fish-swim", "--rival", "cio"], "the option --rival is called --compare-with"),
        (["gait", "--solver", "cio", "fish-swim"], "the option --solver is called --gait-solver"),
        (["gait", "fish-swim", "cio"], "defplan gait: there is nothing to be done with cio"),
        (["body", "a.stl", "--poissons-ratio", "0.5"], "0.5 is not a number from 0 to below 0.5"),
        (["body", "a.stl", "--density", "nan"], "nan is not a positive number"),
        (["evaluate", "fish-swim", "--scenes", "k3"], "there is no k3; choose from k2, novel"),
        (["evaluate", "fish-swim", "--episodes", "0"], "0 is not a whole number, 1 or more"),
        (["view", "fish-swim", "--live", "--port", "65536"], "65536 is not a port, 1 to 65535"),
    ],
)
def test_wrong_usage_is_one_sentence_and_exit_code_2(argv, sentence, capfd):
    assert cli.main(argv) == 2
    captured = capfd.readouterr()
    assert sentence in captured.err
    assert captured.err.count("\n") == 1
    assert captured.out == ""


@pytest.mark.parametrize(
    ("error", "code", "sentence"),
    [
        (DefplanError("the mesh a.stl is empty"), 1, "the mesh a.stl is empty"),
        (OSError(errno.ENOSPC, "No space left on device", "body.npz"), 1, "the disk is full"),
        (PermissionError(errno.EACCES, "Permission denied", "/x"), 1, "no permission (/x)"),
        (FileNotFoundError(errno.ENOENT, "No such file or directory", "y"), 1, "(y)"),
        (MemoryError(), 1, "the memory is used up"),
        (ValueError("odd"), 1, "this is a mistake in defplan: ValueError: odd"),
        (KeyboardInterrupt(), 130, "stopped; run it again to go on"),
    ],
)
def test_an_error_is_one_sentence_on_stderr_and_a_traceback_only_with_debug(
    failing, capfd, error, code, sentence
):
    failing(error)
    assert cli.main(["list", "--json"]) == code
    captured = capfd.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("defplan list: ") and captured.err.count("\n") == 1
    assert sentence in captured.err
    assert cli.main(["list", "--debug"]) == code
    assert "Traceback" in capfd.readouterr().err


def test_an_error_leaves_the_caller_his_own_ctrl_c(failing):
    failing(KeyboardInterrupt())
    before = signal.getsignal(signal.SIGINT)
    assert cli.main(["list"]) == 130
    assert signal.getsignal(signal.SIGINT) is before


def test_with_json_whatever_else_is_printed_goes_to_stderr(capfd):
    with Console(json=True) as console:
        print("from Python")
        os.write(1, b"from C\n")
        console.result({"answer": 42}, "the answer is 42")
    captured = capfd.readouterr()
    assert json.loads(captured.out) == {"answer": 42}
    assert "from Python" in captured.err and "from C" in captured.err


def test_without_json_the_result_is_text(capfd):
    with Console() as console:
        console.result({"answer": 42}, "the answer is 42")
    assert capfd.readouterr().out == "the answer is 42\n"


def test_a_full_disk_under_stdout_is_an_error():
    for options in ([], ["--json"]):
        with open("/dev/full", "w") as full:
            done = subprocess.run(
                [sys.executable, "-m", "defplan_mj", "list", "--quiet", *options],
                stdout=full,
                stderr=subprocess.PIPE,
                text=True,
            )
        assert done.returncode == 1
        assert (
            done.stderr.startswith("defplan list: the disk is full")
            and done.stderr.count("\n") == 1
        )


def test_a_reader_that_has_seen_enough_is_no_error_message():
    read, write = os.pipe()
    os.close(read)
    done = subprocess.run(
        [sys.executable, "-m", "defplan_mj", "list", "--quiet"],
        stdout=write,
        stderr=subprocess.PIPE,
    )
    os.close(write)
    assert done.stderr == b""


def test_progress_is_plain_lines_where_there_is_no_terminal(capfd):
    with Console().progress() as progress:
        progress("meshing", 0.0)
        progress("meshing", 0.1)
        progress("modes", 0.5)
    assert capfd.readouterr().err == "meshing   0%\nmodes  50%\n"
    with Console(quiet=True).progress() as progress:
        progress("meshing", 0.0)
    assert capfd.readouterr().err == ""


class Terminal(io.StringIO):
    """A terminal with something typed."""

    def isatty(self):
        return True


@pytest.mark.parametrize(
    ("typed", "agreed"),
    [("y\n", True), ("yes\n", True), ("\n", False), ("n\n", False), ("", False)],
)
def test_a_question_is_agreed_to_by_yes_alone(monkeypatch, typed, agreed):
    monkeypatch.setattr("sys.stdin", Terminal(typed))
    monkeypatch.setattr("sys.stderr", screen := Terminal())
    ask = Console().asker()
    assert ask is not None and ask("Go on?") is agreed
    assert screen.getvalue() == "Go on? [y/N] "
    assert Console(json=True).asker() is None and Console(quiet=True).asker() is None


def test_nobody_is_asked_where_there_is_no_terminal(monkeypatch):
    monkeypatch.setattr("sys.stdin", io.StringIO("y\n"))
    assert Console().asker() is None


def test_a_progress_bar_does_not_show_before_there_is_progress(monkeypatch):
    monkeypatch.setattr("sys.stderr", screen := Terminal())
    with Console().progress() as progress:
        assert screen.getvalue() == ""
        progress("meshing", 0.5)
    assert "meshing" in screen.getvalue()


def test_a_table_lines_up_its_columns():
    text = table(["name", "µs"], [["step", 61.5], ["laser", 9]])
    assert text == "name     µs\n-----  ----\nstep   61.5\nlaser     9"


@pytest.mark.parametrize(
    ("argv", "sentence"),
    [
        (["body", "DIR"], "defplan body: mesh file DIR is a folder: name a file in it"),
        (["new", "DIR", "--medium", "water"], "defplan new: DIR is a folder: name a mesh"),
        (["run", "DIR", "--medium", "water"], "defplan run: DIR is a folder: name a task"),
        (["gait", "DIR"], "defplan gait: DIR is a folder, no task: name a mesh or a task file"),
        (["gait", "fish-swm"], "defplan gait: there is no task fish-swm, did you mean fish-swim?"),
    ],
)
def test_a_folder_is_no_mesh_and_no_task(tmp_path, argv, sentence, capfd, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "DIR").mkdir()
    assert cli.main([*argv, "--quiet"]) == 1
    captured = capfd.readouterr()
    assert captured.err.startswith(sentence) and captured.err.count("\n") == 1


def test_a_plugin_that_returns_none_is_named():
    from defplan_mj.gait.gait import Gait
    from defplan_mj.pipeline.making import expect

    with pytest.raises(DefplanError, match="the gait solver mine returns None from solve: .* Gait"):
        expect(None, Gait, "the gait solver mine", "solve")
    with pytest.raises(DefplanError, match="returns a list from solve"):
        expect([], Gait, "the gait solver mine", "solve")


def test_plain_progress_tells_the_time_that_is_left(capfd, monkeypatch):
    now = [0.0]
    monkeypatch.setattr("time.monotonic", lambda: now[0])
    with Console().progress() as progress:
        progress("gait (stage 2 of 7): forward", 0.0)
        now[0] = 60.0
        progress("gait (stage 2 of 7): forward", 0.25)
    assert "gait (stage 2 of 7): forward  25%, about 3 min left" in capfd.readouterr().err


def test_where_the_episodes_go_is_refused_before_any_work(tmp_path, capsys):
    logs = tmp_path / "logs"
    command = ["evaluate", "fish-swim", "--logs", str(logs)]
    assert cli.main([*command, "--jobs", "2", "--scheduler", "tcp://nowhere:1"]) == 1
    assert "--jobs is for this machine" in capsys.readouterr().err
    assert cli.main([*command, "--scheduler-file", str(tmp_path / "none.json")]) == 1
    assert "none.json does not exist" in capsys.readouterr().err
    assert not logs.exists()
