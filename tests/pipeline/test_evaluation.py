"""What the evaluation goes through without the collision check."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace
from typing import Any

import pytest

from defplan_mj import registry
from defplan_mj.pipeline import evaluation
from defplan_mj.pipeline.plan import Plan, RunOptions
from defplan_mj.task import Effort


@pytest.mark.parametrize(
    ("share", "episodes", "count"), [(1.0, 7, 7), (0.2, 100, 20), (0.2, 2, 1), (0.5, 5, 2)]
)
def test_a_share_of_the_unseen_scenes_is_gone_through_without_the_check(
    share, episodes, count, monkeypatch, tmp_path
):
    spec = dataclasses.replace(registry.get_task("fish-swim"), effort=Effort(unchecked=share))
    plan = Plan(spec, RunOptions(episodes=episodes, logged=0))
    folder = SimpleNamespace(path=tmp_path)
    run: Any = SimpleNamespace(plan=plan, folder=folder, file=lambda name: tmp_path / name)
    asked = []

    def evaluate(_, scenes, shield, *, episodes=None, log=None):
        asked.append((scenes, shield, episodes))
        return {"episodes": 1}

    monkeypatch.setattr(evaluation, "evaluate", evaluate)
    list(evaluation.EVALUATION.make(run))
    assert asked == [
        ("k2", True, None), ("k2", False, None), ("novel", True, None), ("novel", False, count)
    ]  # fmt: skip
