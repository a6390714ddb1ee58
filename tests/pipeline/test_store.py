"""A run's folder: what is whole and of the same inputs is used again, anything else is made anew."""

from __future__ import annotations

import errno
import json
import os
import subprocess
import sys

import pytest

from defplan_mj.base import files
from defplan_mj.base.errors import DefplanError
from defplan_mj.pipeline.store import RUN_FILE, RunFolder, input_hash


class Stage:
    """A stage that writes one file and counts how often."""

    def __init__(self, folder: RunFolder, name: str = "body", text: str = "made") -> None:
        self.folder, self.name, self.text, self.made = folder, name, text, 0

    def make(self):
        self.made += 1
        path = self.folder.file(f"{self.name}.txt")
        files.write_text(path, self.text)
        return [path]


def run(path, inputs, fresh=False, text="made"):
    """Open the folder, ask for one stage; return whether it was made and its file hashes."""
    with RunFolder(path, {"seed": 0}, fresh) as folder:
        stage = Stage(folder, text=text)
        hashes = folder.stage("body", inputs, stage.make).files
    return stage.made == 1, hashes


def test_a_stage_is_made_once_and_then_used_again(tmp_path):
    made, first = run(tmp_path, {"mesh": "a"})
    again, second = run(tmp_path, {"mesh": "a"})
    assert (made, again) == (True, False)
    assert first == second


def test_other_inputs_make_it_anew(tmp_path):
    run(tmp_path, {"mesh": "a"})
    assert run(tmp_path, {"mesh": "b"})[0]


def test_fresh_makes_it_anew(tmp_path):
    run(tmp_path, {"mesh": "a"})
    assert run(tmp_path, {"mesh": "a"}, fresh=True)[0]


@pytest.mark.parametrize("damage", ["cut", "changed", "removed"])
def test_a_file_that_is_not_as_it_was_written_is_made_anew(tmp_path, damage):
    run(tmp_path, {"mesh": "a"})
    path = tmp_path / "body.txt"
    if damage == "cut":
        path.write_text("ma")
    elif damage == "changed":
        path.write_text("mode")
    else:
        path.unlink()
    assert run(tmp_path, {"mesh": "a"})[0]
    assert path.read_text() == "made"


@pytest.mark.parametrize("text", ["", "{", "[]", '{"format": 99}', '{"format": 1, "stages": [1]}'])
def test_a_damaged_run_file_counts_as_not_there(tmp_path, text):
    run(tmp_path, {"mesh": "a"})
    (tmp_path / RUN_FILE).write_text(text)
    assert run(tmp_path, {"mesh": "a"})[0]
    assert not run(tmp_path, {"mesh": "a"})[0]


def test_seconds_and_configuration_are_kept_over_a_second_run(tmp_path):
    run(tmp_path, {"mesh": "a"})
    first = json.loads((tmp_path / RUN_FILE).read_text())
    run(tmp_path, {"mesh": "a"})
    second = json.loads((tmp_path / RUN_FILE).read_text())
    assert first["seconds"] == second["seconds"] and first["seconds"]["body"] > 0
    assert first["config"] == {"seed": 0}
    assert first["versions"]["defplan"]


@pytest.mark.parametrize("error", [DefplanError("no"), KeyboardInterrupt()])
def test_a_stage_that_fails_loses_nothing_made_before(tmp_path, error):
    run(tmp_path, {"mesh": "a"})

    def fail():
        raise error

    with pytest.raises(type(error)), RunFolder(tmp_path, {}) as folder:
        folder.stage("gait", {}, fail)
    assert not run(tmp_path, {"mesh": "a"})[0]


def test_files_that_a_stage_no_longer_makes_are_removed(tmp_path):
    def make(folder, names):
        for name in names:
            files.write_text(folder.file(name), name)
        return [folder.file(name) for name in names]

    with RunFolder(tmp_path, {}) as folder:
        folder.stage("evaluation", {"n": 2}, lambda: make(folder, ["0.txt", "1.txt"]))
        folder.stage("evaluation", {"n": 1}, lambda: make(folder, ["0.txt"]))
    assert not (tmp_path / "1.txt").exists()


def test_what_a_killed_writer_left_is_removed(tmp_path):
    left = tmp_path / ".body.npz.abcd.npz"
    left.write_bytes(b"half")
    with RunFolder(tmp_path, {}):
        assert not left.exists()


def test_a_folder_belongs_to_one_process_at_a_time(tmp_path):
    code = (
        "import sys; from pathlib import Path; from defplan_mj.pipeline.store import RunFolder\n"
        "with RunFolder(Path(sys.argv[1]), {}): pass"
    )
    command = [sys.executable, "-c", code, str(tmp_path)]
    with RunFolder(tmp_path, {}):
        busy = subprocess.run(command, capture_output=True, text=True)
    free = subprocess.run(command, capture_output=True, text=True)
    assert "another defplan is at work in" in busy.stderr
    assert free.returncode == 0, free.stderr


def test_a_folder_that_cannot_be_made_is_one_sentence(tmp_path):
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(DefplanError, match="cannot write into"), RunFolder(tmp_path / "file/a", {}):
        pass


def test_the_input_hash_depends_on_every_input_but_not_on_their_order():
    assert input_hash({"a": 1, "b": 2}) == input_hash({"b": 2, "a": 1})
    assert input_hash({"a": 1, "b": 2}) != input_hash({"a": 1, "b": 3})


def test_a_lock_does_not_outlive_its_process(tmp_path):
    code = (
        "import os, sys; from pathlib import Path; from defplan_mj.pipeline.store import RunFolder\n"
        "RunFolder(Path(sys.argv[1]), {}).__enter__(); os._exit(1)"
    )
    subprocess.run([sys.executable, "-c", code, str(tmp_path)], check=False)
    with RunFolder(tmp_path, {}):
        assert os.path.exists(tmp_path)


def planted(path, names):
    """Write a run.json, as another program might, whose stage left files of these names."""
    record = {"inputs": "0" * 64, "files": dict.fromkeys(names, "0" * 64), "seconds": 1.0}
    text = json.dumps({"format": 1, "config": {}, "stages": {"body": record}})
    (path / RUN_FILE).write_text(text)


@pytest.mark.parametrize("name", ["../../x", "/tmp/x", "..", "a/x", ".lock", ".x", ""])
def test_a_foreign_run_file_cannot_name_what_lies_elsewhere(tmp_path, name):
    folder = tmp_path / "a" / "b"
    (folder / "a").mkdir(parents=True)
    outside = [tmp_path / "x", folder / "a" / "x", folder / ".x"]
    for path in outside:
        path.write_text("mine")
    absolute = str(tmp_path / "x") if name.startswith("/") else name
    planted(folder, [absolute, "old.txt"])
    (folder / "old.txt").write_text("mine")
    assert run(folder, {"mesh": "a"})[0]
    assert all(path.read_text() == "mine" for path in outside)
    assert (folder / "old.txt").exists()  # the whole record counts as not there


def test_a_plain_name_may_be_a_folder_and_stays(tmp_path):
    planted(tmp_path, ["mine"])
    (tmp_path / "mine").mkdir()
    assert run(tmp_path, {"mesh": "a"})[0]
    assert (tmp_path / "mine").is_dir()


@pytest.mark.parametrize("name", ["../x", "a/b", "", ".hidden"])
def test_a_file_of_a_run_has_a_plain_name(tmp_path, name):
    with pytest.raises(DefplanError, match="must be a plain one"):
        RunFolder(tmp_path, {}).file(name)


def test_hidden_files_of_the_user_stay(tmp_path):
    mine = [tmp_path / name for name in (".mine.npz", ".notes.json", ".body.txt")]
    for path in mine:
        path.write_text("mine")
    with RunFolder(tmp_path, {}):
        assert all(path.exists() for path in mine)


@pytest.mark.parametrize("code", [errno.ENOSYS, errno.EOPNOTSUPP, errno.ENOLCK])
def test_a_file_system_without_locks_is_called_that(tmp_path, monkeypatch, code):
    def flock(stream, operation):
        raise OSError(code, os.strerror(code))

    monkeypatch.setattr("fcntl.flock", flock)
    with pytest.raises(DefplanError, match="knows no locks") as error, RunFolder(tmp_path, {}):
        pass
    assert "another defplan" not in str(error.value) and "\n" not in str(error.value)


def test_what_a_stage_was_made_from_can_be_read_in_its_folder(tmp_path):
    run(tmp_path, {"options": {"pairs": 3}})
    stages = json.loads((tmp_path / RUN_FILE).read_text())["stages"]
    assert stages["body"]["made_from"] == {"options": {"pairs": 3}}
