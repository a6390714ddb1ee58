"""How a study goes on: its order, what it shares, what is a row, and ten thousand runs of nothing."""

from __future__ import annotations

import csv
import io
import time

from defplan_mj.study.conduct import conduct, write_tables
from defplan_mj.study.matrix import Lenders
from defplan_mj.study.run import failed_row
from defplan_mj.study.table import COLUMNS, complete, csv_text, read_parquet
from tests.samples.study import Straight, toy_cells, toy_job


def test_rows_come_in_the_order_of_the_runs_whatever_is_done_first(tmp_path):
    cells = toy_cells()
    rows = conduct(cells, tmp_path, Straight(room=3))
    assert [row["folder"] for row in rows] == [cell.folder.as_posix() for cell in cells]


def test_runs_that_share_gaits_wait_for_the_one_that_makes_them(tmp_path):
    cells = toy_cells(tasks=2, seeds=1, planners=3)
    engine = Straight(room=2)
    conduct(cells, tmp_path, engine)
    begun = [job.cell.folder for job in engine.jobs]
    assert set(begun[:2]) == {cells[0].folder, cells[3].folder}  # one of each gaits
    assert len(begun) == len(cells)


def test_a_run_borrows_from_those_with_its_gaits_and_from_one_of_its_task():
    cells = toy_cells(tasks=2, seeds=2, planners=2)
    told = Lenders(cells).of(cells[1])
    assert told[0] == cells[0].folder  # the same gaits
    assert cells[2].folder in told  # another seed: the same body
    assert not any("toy-1" in str(folder) for folder in told)


def test_a_study_that_grows_by_a_row_makes_only_that(tmp_path):
    made = []

    def counted(job):
        begun = (job.root / job.cell.folder / "run.json").exists()
        made.append(not begun)
        return toy_job(job)

    first = conduct(toy_cells(planners=1), tmp_path, Straight(work=counted))
    made.clear()
    second = conduct(toy_cells(planners=2), tmp_path, Straight(work=counted))
    assert sum(made) == 4 and len(second) == 8
    assert [row for row in second if row["planner"] == "planner-0"] == first  # seconds, too


def test_the_table_is_the_same_as_parquet_and_as_csv(tmp_path):
    cells = toy_cells()
    rows = conduct(cells, tmp_path, Straight())
    rows[1] = failed_row(cells[1], 'no "gait", no way', "gait")
    paths = write_tables(tmp_path, cells, rows)
    assert read_parquet(paths["table"]) == rows
    text = paths["csv"].read_bytes().decode()
    assert text == csv_text(rows)
    read = list(csv.DictReader(io.StringIO(text)))
    assert [row["error"] for row in read] == [row["error"] for row in rows]
    assert float(read[0]["resimulated"]) == rows[0]["resimulated"]  # all digits
    assert read[1]["resimulated"] == "" and read[1]["failed"] == "true"
    assert read_parquet(paths["episodes"]) == []


def test_columns_say_their_units_in_the_parquet_file_and_nothing_twice(tmp_path):
    import pyarrow.parquet

    cells = toy_cells(1, 1, 1)
    paths = write_tables(tmp_path, cells, conduct(cells, tmp_path, Straight()))
    schema = pyarrow.parquet.read_schema(paths["table"])
    told = {f.name: f.metadata[b"unit"].decode() for f in schema}
    assert told == {column.name: column.unit for column in COLUMNS}
    assert len(told) == len(COLUMNS) and told["total_seconds"] == "s"
    assert all(column.text for column in COLUMNS)


def test_ten_thousand_runs_are_handed_out_in_moments(tmp_path):
    cells = toy_cells(tasks=20, seeds=100, planners=5)
    engine = Straight(room=64, work=lambda job: complete({"task": job.cell.task, "failed": False}))
    began = time.process_time()
    rows = conduct(cells, tmp_path, engine)
    assert len(rows) == 10_000 == len({job.cell.folder for job in engine.jobs})
    print(f"{time.process_time() - began:.1f} s")
