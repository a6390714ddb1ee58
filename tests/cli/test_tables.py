"""`defplan logs` and `defplan export`: many logs at a glance, and as files."""

from __future__ import annotations

import csv
import json

import pytest

from defplan_mj import cli
from tests.samples.logs import record_episode


@pytest.fixture
def folder(tmp_path):
    """Two whole logs, one cut short and one that is none."""
    record_episode(tmp_path / "a.mcap", cycles=2)
    record_episode(tmp_path / "b.mcap", cycles=3, outcome="collision")
    record_episode(tmp_path / "c.mcap", cycles=3)
    whole = (tmp_path / "c.mcap").read_bytes()
    (tmp_path / "c.mcap").write_bytes(whole[: len(whole) * 2 // 3])
    (tmp_path / "d.mcap").write_text("not a log")
    return tmp_path


def run(argv, capfd):
    """Run the command line; return exit code, stdout, stderr."""
    code = cli.main([*map(str, argv)])
    captured = capfd.readouterr()
    return code, captured.out, captured.err


def test_logs_has_a_row_for_each_log_even_a_broken_one(folder, capfd):
    code, out, _ = run(["logs", folder, "--quiet", "--json"], capfd)
    data = json.loads(out)
    assert code == 0 and data["outcomes"] == {"collision": 1, "success": 1, "unknown": 2}
    assert [row["outcome"] for row in data["logs"]] == ["success", "collision", "", ""]
    assert data["logs"][1]["cycles"] == 3 and data["logs"][1]["task"] == "bar-swim"
    assert "cut at byte" in data["logs"][2]["fault"]
    assert "is not an MCAP log" in data["logs"][3]["fault"]
    code, out, _ = run(["logs", folder, "--quiet"], capfd)
    assert code == 0 and "4 logs: 1 collision, 1 success, 2 unknown" in out


def test_export_writes_the_table_that_is_asked_for(folder, capfd):
    target = folder / "cycles.csv"
    argv = ["export", folder / "a.mcap", folder / "b.mcap", "-o", target, "--table", "cycles"]
    code, out, _ = run([*argv, "--quiet", "--json"], capfd)
    data = json.loads(out)
    with open(target, newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert code == 0 and len(rows) == data["rows"] == 5
    assert data["columns"] == list(rows[0])
    assert [row["cycle"] for row in rows] == ["0", "1", "0", "1", "2"]


def test_export_writes_a_layout(folder, capfd):
    code, _, _ = run(["export", folder / "a.mcap", "--layout", folder / "x.json"], capfd)
    assert code == 0 and "Plot!shape" in json.loads((folder / "x.json").read_text())["configById"]


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ([], "say where to, once"),
        (["-o", "x.csv", "--layout", "x.json"], "say where to, once"),
        (["-o", "x.xlsx"], "end its name in .parquet or .csv"),
        (["--rerun", "x.rec"], "end its name in .rrd"),
        (["--layout", "x.json"], "these are 4: name one"),
    ],
)
def test_what_export_cannot_do_is_one_sentence(folder, options, sentence, capfd, monkeypatch):
    monkeypatch.chdir(folder)
    code, out, err = run(["export", ".", *options], capfd)
    assert code == 1 and out == "" and err.count("\n") == 1 and sentence in err


def test_a_log_that_is_not_there_is_no_row(folder, capfd):
    code, out, err = run(["logs", folder, folder / "nothere", "--quiet"], capfd)
    assert code == 1 and not out and err.endswith("nothere does not exist\n")
