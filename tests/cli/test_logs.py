"""`defplan compare` and `defplan replay` on whole, cut, foreign and missing logs."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest

from defplan_mj import cli
from defplan_mj.log.replay import replay_log
from tests.samples.logs import record_episode


@pytest.fixture
def log(tmp_path):
    """Return the path of a whole log."""
    path = tmp_path / "episode.mcap"
    record_episode(path, error=(0.05, 0.02))
    return path


def run(argv, capfd):
    """Run the command line; return exit code, stdout, stderr."""
    code = cli.main([*map(str, argv)])
    captured = capfd.readouterr()
    return code, captured.out, captured.err


def test_compare_prints_tables_json_and_a_plot(log, tmp_path, capfd):
    code, out, _ = run(["compare", log, log, "-o", tmp_path / "plot.png"], capfd)
    assert code == 0
    assert "Surrogate against reduced dynamics" in out and out.count("episode.mcap") == 2
    assert (tmp_path / "plot.png").read_bytes().startswith(b"\x89PNG")
    code, out, _ = run(["compare", log, "--json"], capfd)
    data = json.loads(out)
    assert code == 0 and data["logs"][0]["whole"]
    assert data["gaits"][-1]["position"]["mean"] == pytest.approx(0.05, abs=1e-6)


def test_a_log_cut_at_any_byte_is_used_up_to_there_or_refused_in_one_sentence(log, capfd):
    data = log.read_bytes()
    used = refused = 0
    for size in [0, 5, *np.linspace(9, len(data) - 1, 40).astype(int)]:
        log.write_bytes(data[:size])
        code, out, err = run(["compare", log, "--quiet", "--json"], capfd)
        if code == 0:
            used += 1
            assert not json.loads(out)["logs"][0]["whole"]
        else:
            refused += 1
            assert code == 1 and out == "" and err.count("\n") == 1
            assert "episode.mcap" in err and "mistake in defplan" not in err
    assert used and refused


@pytest.mark.parametrize("command", ["compare", "replay"])
def test_a_missing_or_foreign_log_is_one_sentence(command, tmp_path, capfd):
    code, out, err = run([command, tmp_path / "none.mcap"], capfd)
    assert code == 1 and out == "" and err.count("\n") == 1 and "does not exist" in err
    other = tmp_path / "other.mcap"
    other.write_text("not a log at all")
    code, out, err = run([command, other], capfd)
    assert code == 1 and out == "" and err.count("\n") == 1 and "is not an MCAP log" in err


def test_replay_exits_with_0_only_if_every_bit_is_the_same(swim_log, capfd, monkeypatch):
    code, out, _ = run(["replay", swim_log, "--quiet", "--json"], capfd)
    assert code == 0 and json.loads(out)["identical"] is True

    def bent(log, progress):
        shapes = log.target_shapes.copy()
        shapes[7, 0] += 1e-12
        return replay_log(dataclasses.replace(log, target_shapes=shapes), progress)

    monkeypatch.setattr("defplan_mj.log.replay.replay_log", bent)
    code, out, _ = run(["replay", swim_log, "--quiet", "--json"], capfd)
    data = json.loads(out)
    assert code == 1
    assert data["identical"] is False and data["difference"]["step"] == 8
