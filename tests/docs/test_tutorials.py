"""The tutorials: their Python blocks run, one after the other, as a reader would run them."""

from __future__ import annotations

import contextlib
import csv
import io
import re

import pytest

from tests.samples.paths import ROOT

PAGE = ROOT / "docs" / "tutorials.md"


def test_the_blocks_run_from_top_to_bottom(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    blocks = re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.DOTALL)
    assert len(blocks) == 5
    page: dict = {"__name__": "tutorials"}
    told = io.StringIO()
    with contextlib.redirect_stdout(told):
        for block in blocks:
            exec(block, page)
    assert page["gait"].meta["objective"] == min(page["gait"].meta["history"])
    assert page["body"].n_modes == 3 and page["body"].length == pytest.approx(1.0, abs=0.01)
    # the log says what the evaluation, which is the same again, has said
    outcomes = [str(episode.outcome) for episode in page["result"].episodes]
    assert [*page["episodes"]["outcome"]] == outcomes and str(outcomes) in told.getvalue()
    with open("steps.csv", newline="") as stream:
        assert len(list(csv.DictReader(stream))) == page["episodes"]["steps"].sum() + 2
    assert page["total"].shape == (8,) and page["total"].max() > 0
