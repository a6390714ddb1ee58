"""Logs as tables: what the columns say is what was logged, and files hold the same bits."""

from __future__ import annotations

import csv
import json
import re
import subprocess
import sys

import numpy as np
import pytest

from defplan_mj.base.errors import DefplanError
from defplan_mj.log import foxglove_layout, tables
from defplan_mj.log.columns import TABLES
from defplan_mj.log.reader import read_log
from defplan_mj.log.schemas import state_labels
from tests.samples.logs import (
    MODES,
    STEPS_PER_CYCLE,
    record_episode,
    sample_body,
    sample_scene,
    spatial_parts,
    spatial_scene,
)
from tests.samples.paths import ROOT
from tests.samples.rewriting import rewrite


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Two planar logs, the second with a known error; return the folder and what was recorded."""
    place = tmp_path_factory.mktemp("logs")
    kept = record_episode(place / "a.mcap", cycles=4)
    record_episode(place / "inner" / "b.mcap", cycles=2, error=(0.05, 0.02), outcome="timeout")
    return place, kept


def test_steps_are_the_states_under_their_names(folder):
    place, kept = folder
    table = tables.steps(place / "a.mcap")
    columns = {
        **{f"{n}_m": n for n in "xyz"},
        **{n: n for n in ("qw", "qx", "qy", "qz")},
        **{f"v{n}_m_per_s": f"v{n}" for n in "xyz"},
        **{f"w{n}_rad_per_s": f"w{n}" for n in "xyz"},
        **{f"{k}{i}{unit}": f"{k}{i}" for i in (1, 2) for k, unit in (("q", ""), ("u", ""))},
        **{f"dq{i}_per_s": f"dq{i}" for i in (1, 2)},
    }
    assert sorted(columns.values()) == sorted(state_labels(MODES))
    for column, label in columns.items():
        expected = kept["states"][:, state_labels(MODES).index(label)]
        np.testing.assert_array_equal(table[column], expected, err_msg=column)
    np.testing.assert_array_equal(table["clearance_m"][1:], kept["clearance"])
    assert np.isnan(table["clearance_m"][0]) and not table["collision"].any()
    np.testing.assert_array_equal(table["step"], np.arange(4 * STEPS_PER_CYCLE + 1))
    np.testing.assert_array_equal(table["cycle"], [*np.repeat(np.arange(4), STEPS_PER_CYCLE), 3])
    names = np.array(["forward", "left", "right"])[kept["gait_index"]]
    assert [*table["gait"]] == [*np.repeat(names, STEPS_PER_CYCLE), names[-1]]
    np.testing.assert_allclose(table["phase"][:3], [0, 1 / 11, 2 / 11])
    distance = np.linalg.norm(kept["states"][:, :2] - sample_scene().target[:2], axis=1)
    np.testing.assert_allclose(table["target_distance_m"], distance)


def test_cycles_have_the_motions_and_the_error_that_was_put_in(folder):
    place, _ = folder
    table = tables.cycles(place / "inner" / "b.mcap")
    forward = table["gait"] == "forward"
    np.testing.assert_allclose(table["position_error_m"], 0.05, atol=1e-9)
    np.testing.assert_allclose(table["turn_error_rad"], 0.02, atol=1e-9)
    np.testing.assert_allclose(table["predicted_ahead_m"], np.where(forward, 0.7, 0.4), atol=1e-9)
    wanted = np.select([forward, table["gait"] == "left"], [0.0, 0.6], -0.6)
    np.testing.assert_allclose(table["turn_rad"], wanted + 0.02, atol=1e-9)
    log = read_log(place / "inner" / "b.mcap")
    np.testing.assert_array_equal(table["value_left"], log.values[:, 1])
    np.testing.assert_array_equal(table["laser_07_m"], log.laser[:, 7])
    lowest = [log.clearance[:STEPS_PER_CYCLE].min(), log.clearance[STEPS_PER_CYCLE:].min()]
    np.testing.assert_array_equal(table["clearance_min_m"], lowest)


def test_a_folder_s_episodes_are_its_logs(folder):
    place, kept = folder
    table = tables.episodes(place)
    assert [*table["outcome"]] == ["success", "timeout"] and [*table["cycles"]] == [4, 2]
    assert [*table["task"]] == ["bar-swim"] * 2 and [*table["planner"]] == ["greedy"] * 2
    way = np.linalg.norm(np.diff(kept["states"][:, :3], axis=0), axis=1).sum()
    assert table["way_m"][0] == pytest.approx(way)
    assert table["reward_m2"][0] == pytest.approx(kept["reward"].sum())


def test_logs_of_different_bodies_and_spaces_share_a_table(folder, tmp_path):
    place, _ = folder
    from defplan_mj.log.run_files import RunFiles

    body = sample_body()
    files = RunFiles.of(body, *spatial_parts(body))
    record_episode(tmp_path / "space.mcap", cycles=1, scene=spatial_scene(), files=files)
    table = tables.cycles([place / "a.mcap", tmp_path / "space.mcap"])
    assert len({len(column) for column in table.values()}) == 1
    assert np.isnan(table["value_back"][:4]).all() and np.isfinite(table["value_back"][4])
    assert np.isfinite(table["value_left"]).all()
    steps = tables.steps([place / "a.mcap", tmp_path / "space.mcap"])
    assert np.isnan(steps["heading_rad"][-1]) and np.isfinite(steps["heading_rad"][0])


def test_a_filtered_log_has_what_is_left(folder, tmp_path):
    place, kept = folder
    left_out = ("/laser/ranges", "/contacts", "/planner/values")
    path = rewrite(place / "a.mcap", tmp_path / "x.mcap", keep=lambda t, _: t not in left_out)
    table = tables.cycles(path)
    assert not [name for name in table if name.startswith(("laser", "value"))]
    np.testing.assert_array_equal(table["reward_m2"], kept["reward"])
    assert np.isnan(tables.steps(path)["clearance_m"]).all()
    assert tables.episodes(path)["fault"][0].startswith("filtered: without")


def test_csv_holds_every_bit(folder, tmp_path):
    table = tables.steps(folder[0])
    tables.write_table(table, tmp_path / "steps.csv")
    with open(tmp_path / "steps.csv", newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert list(rows[0]) == list(table) and len(rows) == len(table["log"])
    read = np.array([float(row["x_m"]) for row in rows])
    np.testing.assert_array_equal(read.view(np.uint64), table["x_m"].view(np.uint64))
    assert rows[0]["clearance_m"] == "" and rows[0]["collision"] == "false"


def test_parquet_holds_every_bit(folder, tmp_path):
    parquet = pytest.importorskip("pyarrow.parquet")
    table = tables.cycles(folder[0])
    tables.write_table(table, tmp_path / "cycles.parquet")
    read = parquet.read_table(tmp_path / "cycles.parquet")
    assert read.column_names == list(table)
    for name, column in table.items():
        assert read[name].to_pylist() == column.tolist()


def test_what_cannot_be_written_is_one_sentence_before_the_work(folder, tmp_path):
    for name in ("x.xlsx", "x"):
        with pytest.raises(DefplanError, match=r"end its name in \.parquet or \.csv"):
            tables.check_target(tmp_path / name)
    (tmp_path / "f.csv").mkdir()
    with pytest.raises(DefplanError, match="it is a folder"):
        tables.check_target(tmp_path / "f.csv")
    with pytest.raises(DefplanError, match="there is no log"):
        tables.steps(tmp_path)


def test_every_field_of_the_tables_is_documented():
    text = (ROOT / "docs" / "logs.md").read_text()
    for name, fields in TABLES.items():
        for field in fields:
            assert f"| `{field.name}` | {field.what} |" in text, f"{name}: {field.name}"


def test_reading_and_tables_load_neither_tasks_nor_mujoco(folder):
    """Another machine has only the log: no task, no solver, no simulator is asked for."""
    code = (
        "import sys\n"
        "from defplan_mj.log import tables\n"
        f"for make in (tables.steps, tables.cycles, tables.episodes): make({str(folder[0])!r})\n"
        "bad = [m for m in sys.modules if m.startswith(('defplan_tasks', 'defplan_solvers', 'mujoco'))]\n"
        "assert not bad, bad\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT)
    assert done.returncode == 0, done.stderr


def test_the_shipped_layout_is_that_of_a_swimmer_of_five_modes():
    expected = foxglove_layout.layout(5, ("forward", "left", "right"))
    assert json.loads(foxglove_layout.SHIPPED.read_text()) == expected


def test_a_layout_s_lines_are_named_numbers_of_the_log(folder):
    log = read_log(folder[0] / "a.mcap")
    data = foxglove_layout.layout_of(log)
    lines = {
        line["label"]: line["value"]
        for panel in data["configById"].values()
        for line in panel.get("paths", [])
    }
    labels = state_labels(MODES)
    assert lines["q2"] == f"/robot/state.values[{labels.index('q2')}]"
    assert lines["u1"] == f"/robot/state.values[{labels.index('u1')}]"
    assert lines["left"] == "/planner/values.values[1]"
    for value in lines.values():
        topic, _, place = value.partition(".values[")
        assert int(place.rstrip("]")) < log.channel(topic)[1].shape[1]


@pytest.mark.parametrize("speed", [0.0, 0.5])
def test_a_rerun_recording_holds_scene_laser_and_named_plots(tmp_path, speed):
    pytest.importorskip("rerun")
    from defplan_mj.log.rerun_export import write_rerun

    record_episode(tmp_path / "a.mcap", cycles=2, scene=sample_scene(speed=speed))
    log = read_log(tmp_path / "a.mcap")
    write_rerun(log, tmp_path / "a.rrd")
    printed = subprocess.run(
        [sys.executable, "-m", "rerun", "rrd", "print", str(tmp_path / "a.rrd")],
        capture_output=True,
        text=True,
        env={"RERUN_ANALYTICS": "0", "HOME": str(tmp_path)},
    )
    assert printed.returncode == 0, printed.stderr
    rows = {
        (entity, column): int(count)
        for count, entity, columns in re.findall(
            r"with (\d+) rows .* - /(\S+) - data columns: \[(.*)\]", printed.stdout
        )
        for column in columns.split()
    }
    drawn = 2 * STEPS_PER_CYCLE // 2 + 1  # every second state
    assert rows["world/obstacles/2", "Transform3D:translation"] == (drawn if speed else 1)
    assert rows["world/robot", "Mesh3D:vertex_positions"] == drawn
    assert rows["world/laser/hits", "Points3D:positions"] == 2
    assert rows["world/target/goal", "Ellipsoids3D:half_sizes"] == 1
    assert rows["plots/shape", "Scalars:scalars"] == 2 * STEPS_PER_CYCLE + 1
    assert rows["plots/values", "SeriesLines:names"] == 1
