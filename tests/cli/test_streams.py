"""Closed, full and ASCII streams, and what files bring along: a sentence or nothing, the right exit code."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time

import pytest
from hypothesis import given
from hypothesis import strategies as st

from defplan_mj import cli
from defplan_mj.base.errors import DefplanError
from defplan_mj.base.printable import is_name, printable
from defplan_mj.cli import commands
from defplan_mj.cli.console import Console, table
from defplan_mj.cli.stops import Stops, Terminated
from tests.samples.processes import heed_ctrl_c

COMMAND = f"{sys.executable} -m defplan_mj"


def shell(line: str, **environment: str) -> subprocess.CompletedProcess[bytes]:
    """Run a line of a shell, DEFPLAN in it being the command."""
    return subprocess.run(
        ["bash", "-c", line.replace("DEFPLAN", COMMAND)],
        capture_output=True,
        env={**os.environ, **environment},
    )


@pytest.mark.parametrize(
    ("line", "code", "told"),
    [
        ("DEFPLAN list >&-", 1, "stdout is closed: the work is done"),
        ("DEFPLAN list --json >&-", 1, "stdout is closed: the work is done"),
        ("DEFPLAN list <&- >&- 2>&-", 1, ""),
        ("DEFPLAN list 2>&- >/dev/null", 0, ""),
        ("DEFPLAN list 2>/dev/full >/dev/null", 0, ""),
        ("DEFPLAN list >/dev/full", 1, "the disk is full"),
        ("DEFPLAN list --json >/dev/full", 1, "the disk is full"),
        ("DEFPLAN --help >/dev/full", 1, "the disk is full"),
        ("DEFPLAN run --help | true; exit ${PIPESTATUS[0]}", None, ""),
    ],
)
def test_streams_that_take_nothing(line, code, told):
    done = shell(line)
    if code is not None:
        assert done.returncode == code
    error = done.stderr.decode()
    assert error.count("\n") == (1 if told else 0), error
    assert told in error and "mistake" not in error and "Traceback" not in error


def test_a_name_that_the_terminal_cannot_write_is_written_out(tmp_path):
    missing = tmp_path / "größe.mcap"
    for environment in (
        {"PYTHONIOENCODING": "ascii"},
        {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"},
    ):
        done = shell(f"DEFPLAN replay '{missing}'", **environment)
        assert done.returncode == 1
        assert done.stderr.isascii() and done.stderr.count(b"\n") == 1
        assert b"does not exist" in done.stderr and b"gr\\" in done.stderr


HOSTILE = "a\x1b[2J\x07\r\n\x9b31m‮\ud800\x7fb"


def test_what_steers_a_terminal_never_reaches_it(capsys, monkeypatch):
    def fail(arguments, console):
        console.say(f"said {HOSTILE}")
        with console.progress() as progress:
            progress(f"doing {HOSTILE}", 0.5)
        console.result({}, table(["x"], [[HOSTILE]]))
        raise DefplanError(f"failed {HOSTILE}")

    monkeypatch.setattr(commands, "list_installed", fail)
    assert cli.main(["list"]) == 1
    captured = capsys.readouterr()
    for text in (captured.out, captured.err):
        assert not set(text) & {"\x1b", "\x07", "\r", "\x9b", "‮", "\ud800", "\x7f"}
        assert "a\\x1b[2J\\x07\\r" in text
    assert captured.err.splitlines()[-1].startswith(
        "defplan list: failed a\\x1b[2J\\x07\\r\\n\\x9b31m"
    )


def test_a_json_result_is_ascii(capfd):
    with Console(json=True) as console:
        console.result({"name": HOSTILE}, "")
    assert capfd.readouterr().out.isascii()


@given(st.text())
def test_printable_text_has_one_line_and_no_control_character(text):
    safe = printable(text)
    assert not any(ord(c) < 32 and c != "\t" or 127 <= ord(c) < 160 for c in safe)
    assert len(safe.splitlines()) <= 1
    safe.encode()  # no half of a character
    assert printable(safe) == safe
    assert not is_name(text) or printable(text) == text


# ---- stops


@pytest.fixture
def listening():
    """Return stops that are listened for, looked after every 50 ms."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored in the background
    stops = Stops()
    stops.listen()
    yield stops
    stops.leave()
    signal.signal(signal.SIGINT, before)


def test_a_stop_that_is_swallowed_comes_again(listening, monkeypatch):
    monkeypatch.setattr("defplan_mj.cli.stops.AGAIN_SECONDS", 0.05)
    swallowed = 0
    with pytest.raises(Terminated):
        try:
            os.kill(os.getpid(), signal.SIGTERM)
            time.sleep(5)
        except KeyboardInterrupt:
            swallowed += 1
        time.sleep(5)
    assert swallowed == 1 and listening.code == 143


class _Dropping:
    """Something whose destructor takes its time, and fails or is stopped."""

    def __init__(self, error: Exception | None = None) -> None:
        self.error = error

    def __del__(self) -> None:
        if self.error is not None:
            raise self.error
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(5)


def test_a_stop_that_a_destructor_drops_comes_again_and_is_no_error(monkeypatch):
    monkeypatch.setattr("defplan_mj.cli.stops.AGAIN_SECONDS", 0.05)
    told = list[str]()
    hook = lambda lost: told.append(str(lost.exc_value))  # noqa: E731
    monkeypatch.setattr(sys, "unraisablehook", hook)
    stops = Stops()
    stops.listen()
    try:
        one = _Dropping(ValueError("of its own"))
        del one
        with pytest.raises(Terminated):
            other = _Dropping()
            del other
            time.sleep(5)
    finally:
        stops.leave()
    assert told == ["of its own"] and sys.unraisablehook is hook


def test_a_stop_does_not_come_again_while_somebody_cleans_up(listening, monkeypatch):
    monkeypatch.setattr("defplan_mj.cli.stops.AGAIN_SECONDS", 0.05)
    cleaned = False
    with pytest.raises(KeyboardInterrupt):
        try:
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(5)
        finally:
            os.kill(os.getpid(), signal.SIGINT)  # impatience
            for _ in range(4):
                time.sleep(0.05)
            cleaned = True
    assert cleaned and listening.code == 130


def test_whatever_a_stop_looks_like_it_is_told_as_one(capsys, monkeypatch):
    def import_error(arguments, console):
        try:
            os.kill(os.getpid(), signal.SIGTERM)
            time.sleep(5)
        except KeyboardInterrupt as error:
            raise ImportError("initialization failed") from error

    monkeypatch.setattr(commands, "list_installed", import_error)
    before = signal.getsignal(signal.SIGTERM), signal.getsignal(signal.SIGALRM)
    assert cli.main(["list"]) == 143
    assert capsys.readouterr().err == "defplan list: stopped; run it again to go on\n"
    assert (signal.getsignal(signal.SIGTERM), signal.getsignal(signal.SIGALRM)) == before


def test_in_a_thread_of_a_program_that_calls_us_signals_stay_its_own(monkeypatch):
    before, codes = signal.getsignal(signal.SIGTERM), []
    monkeypatch.setattr(commands, "list_installed", lambda arguments, console: 0)
    thread = threading.Thread(target=lambda: codes.append(cli.main(["list"])))
    thread.start()
    thread.join()
    assert codes == [0] and signal.getsignal(signal.SIGTERM) is before


def test_a_stop_within_an_exec_ends_with_its_code(tmp_path):
    (tmp_path / "stopped.py").write_text(
        "import sys\n"
        "from defplan_mj import cli\n"
        "from defplan_mj.cli import commands\n"
        "def stop(arguments, console):\n"
        "    exec('import os, signal, time; os.kill(os.getpid(), signal.SIGINT); time.sleep(5)')\n"
        "commands.list_installed = stop\n"
        "sys.argv[1:] = ['list']\n"
        "sys.exit(cli.main())\n"
    )
    done = subprocess.run(
        [sys.executable, "-m", "stopped"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        preexec_fn=heed_ctrl_c,
    )
    assert done.returncode == 130
    assert done.stderr == "defplan list: stopped; run it again to go on\n"
