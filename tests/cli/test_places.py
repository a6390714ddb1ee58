"""Places that are not as one would wish: success or one sentence, and the same bits."""

from __future__ import annotations

import shutil
import subprocess

import pytest

from tests.samples import places
from tests.samples.stopping import undisturbed
from tests.samples.tiny_run import said_by


def told(done: subprocess.CompletedProcess[str]) -> str:
    """Return the one sentence of a command that could not do what it was asked."""
    assert done.returncode == 1 and done.stderr.count("\n") == 1, done.stderr
    assert "mistake" not in done.stderr
    return done.stderr


def test_a_folder_that_cannot_be_written_is_told_before_any_work(tmp_path):
    logs = places.read_only(tmp_path / "logs")
    done = places.defplan("run", "fish-swim", "--logs", str(logs), "--quiet")
    assert "cannot write into" in told(done) and "Permission denied" in done.stderr


def test_a_log_of_a_read_only_folder_replays_where_nothing_else_can_be_written(swim_log, tmp_path):
    logs = tmp_path / "logs"
    logs.mkdir()
    shutil.copy(swim_log, logs / "swim.mcap")
    logs.chmod(0o555)
    done = places.defplan(
        "replay", str(logs / "swim.mcap"), "--quiet", environment=places.strange(tmp_path)
    )
    assert done.returncode == 0 and "identical to the bit" in done.stdout
    assert done.stderr == ""


def test_a_video_is_drawn_though_a_screen_is_named_that_is_not_there(swim_log, tmp_path, rendering):
    video = tmp_path / "swim.webp"
    done = places.defplan(
        "replay",
        str(swim_log),
        "--video",
        str(video),
        "--quiet",
        environment=places.strange(tmp_path),
    )
    assert done.returncode == 0 and done.stderr == "" and video.stat().st_size > 1000


def test_a_viewer_without_a_screen_is_one_sentence(tmp_path):
    done = places.defplan("view", "fish-swim", environment=places.strange(tmp_path))
    assert f"DISPLAY is {places.DEAD_SCREEN}, which does not answer" in told(done)


@pytest.mark.slow
@pytest.mark.parametrize("threads", ["1", "8"])
def test_a_run_has_the_same_bits_in_a_strange_place_on_one_core(tmp_path, threads):
    wanted, _ = undisturbed(tmp_path / "undisturbed")
    names = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
    done = places.defplan(
        str(tmp_path / "logs"),
        "--quiet",
        module="tests.samples.tiny_run",
        environment={
            **places.strange(tmp_path),
            **places.CLUSTER,
            **dict.fromkeys(names, threads),
        },
    )
    assert done.returncode == 0 and done.stderr == ""
    assert said_by(tmp_path / "logs" / "fish-swim-seed0") == wanted


@pytest.mark.slow
def test_four_videos_at_once_are_four_whole_videos(swim_log, tmp_path, rendering):
    videos = [tmp_path / f"{number}.mp4" for number in range(4)]
    drawing = [
        subprocess.Popen(
            places.command(["replay", str(swim_log), "--video", str(video), "--quiet"]),
            stderr=subprocess.PIPE,
            text=True,
        )
        for video in videos
    ]
    for process in drawing:
        _, error = process.communicate()
        assert process.returncode == 0 and error == ""
    assert len({video.read_bytes() for video in videos}) == 1
