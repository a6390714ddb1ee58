"""Files that mean harm: bounded memory and time, one sentence with file and field, never a success."""

from __future__ import annotations

import json
import os
import subprocess
import sys

import pytest

from defplan_mj.base.errors import DefplanError
from defplan_mj.log.compare import compare_logs
from defplan_mj.log.reader import read_log
from defplan_mj.log.replay import replay_log
from tests.samples import hostile
from tests.samples.bodies import pebble
from tests.samples.logs import record_episode, record_swim, swimming_files
from tests.samples.paths import ROOT

MOST_MEMORY, MOST_SECONDS = 1 << 30, 10.0
QUICK = (
    "zstd frame of 5 GB, chunk of 1 MB.mcap",
    "zstd frame without a size.mcap",
    "chunk that says 1 GiB.mcap",
    "lz4 of 2 GB.mcap",
    "800 MB of numbers.mcap",
    "JSON nested 100,000 deep.mcap",
    "gait.npz: 10^9 steps a cycle.mcap",
    "claims a shape.npz",
    "unpacks to 1 GB.npz",
    "lzma.npz",
    "JSON nested 900 deep.npz",
)


@pytest.fixture(scope="module")
def swim(tmp_path_factory):
    path = tmp_path_factory.mktemp("swim") / "swim.mcap"
    record_swim(path, swimming_files(pebble()), cycles=2)
    assert replay_log(path).identical
    return path.read_bytes()


def bombs(tmp_path, *names: str) -> list[dict]:
    """Return what reading each of the bombs took, all in one process of their own."""
    log = tmp_path / "whole.mcap"
    record_episode(log, cycles=2)
    done = subprocess.run(
        [sys.executable, "-m", "tests.samples.peak", str(log), *names],
        cwd=ROOT,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    return [json.loads(line) for line in done.stdout.splitlines()]


def check(found: list[dict]) -> None:
    for bomb in found:
        assert bomb["size"] < 50e6, bomb
        assert bomb["peak"] < MOST_MEMORY, bomb
        assert bomb["seconds"] < MOST_SECONDS, bomb  # a bound of the work, not a speed
        assert "\n" not in bomb["said"]


def test_bombs_are_read_within_memory_and_time(tmp_path):
    found = bombs(tmp_path, *QUICK)
    assert [bomb["name"] for bomb in found] == list(QUICK)
    check(found)


@pytest.mark.slow
def test_all_bombs_are_read_within_memory_and_time(tmp_path):
    found = bombs(tmp_path)
    assert len(found) > 40
    check(found)


def test_a_whole_log_of_senseless_content_is_one_sentence_and_no_success(swim, tmp_path):
    path = tmp_path / "x.mcap"
    made = hostile.senseless_logs(swim)
    assert len(made) > 120
    unread = {
        replay_log: ("surrogate.npz",),
        compare: (
            *("body.npz", "no body.npz", "terrain.json", "navigation {'sensor': '\\x1b"),
            "/control/target_shape missing",
        ),
    }
    for name, data in made.items():
        path.write_bytes(data)
        for use, not_its in unread.items():
            if name.startswith(not_its):
                continue
            with pytest.raises(DefplanError) as told:
                use(path)
            assert "\n" not in str(told.value) and len(str(told.value)) < 600, name
            assert str(path) in str(told.value), name


def compare(path):
    """Compare one log."""
    return compare_logs([path])


def test_a_log_of_no_step_is_no_success(swim, tmp_path):
    path = tmp_path / "x.mcap"

    def start(topic, sequence, numbers):
        return None if sequence > 0 else numbers

    path.write_bytes(hostile.edited(swim, {"end": hostile.setting("steps", "0")}, messages=start))
    with pytest.raises(DefplanError, match="holds no step to replay"):
        replay_log(path)


def test_a_log_with_another_body_is_no_success(swim, tmp_path):
    path, other = tmp_path / "x.mcap", tmp_path / "body.npz"
    pebble(None, (0.5, 0.13, 0.2)).save(other)
    path.write_bytes(hostile.edited(swim, attachments={"body.npz": other.read_bytes()}))
    with pytest.raises(DefplanError, match="parts of another body than the one that moved"):
        replay_log(path)


def test_what_is_no_file_with_an_end_is_not_read(tmp_path):
    os.mkfifo(tmp_path / "pipe.mcap")
    for path in (tmp_path / "pipe.mcap", "/dev/zero"):
        with pytest.raises(DefplanError, match="is no regular file"):
            read_log(path)
