"""Scores on the suite: what they mean, and that learning and its files are as said."""

from __future__ import annotations

import csv

import numpy as np
import pytest

from defplan_mj import suite
from defplan_mj.studies import scores, scores_navigate


@pytest.fixture(autouse=True)
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    """Episodes of 5 s."""
    monkeypatch.setattr(scores, "EPISODE_S", 5.0)


def test_a_score_is_the_mean_reward_of_whole_episodes_of_the_suite():
    def act(observations, step):
        return np.full((len(observations), 5), 0.3 * np.sin(0.5 * step))

    found = scores.episodes("FishSwim", act, robots=2)
    for i, value in enumerate(found):
        env = suite.load(
            "fish", "swim", {"random": scores.EPISODE_SEED + i, "time_limit": scores.EPISODE_S}
        )
        step, rewards = env.reset(), list[float]()
        while not step.last():
            step = env.step(np.full(5, 0.3 * np.sin(0.5 * len(rewards))))
            rewards.append(step.reward)
        assert value == pytest.approx(np.mean(rewards), rel=1e-12)


def test_the_packaged_gaits_swim_and_rest_does_not():
    by = {p: scores.score("FishSwim", p, robots=4) for p in ("rest", "gaits")}
    assert by["gaits"].mean > 0.2 > 0.01 > by["rest"].mean
    assert by["gaits"].decisions == 0 and by["gaits"].curve == []


@pytest.mark.parametrize(("policy", "decisions"), [("ppo", 4096), ("sac", 4128)])
def test_learning_has_a_curve_and_is_the_same_again(policy, decisions, tmp_path, monkeypatch):
    monkeypatch.setattr(scores, "_SECONDS", 2.0)
    first = scores.score("FishSwim", policy, decisions, robots=2)
    if policy == "ppo":  # the same seeds; SAC's updates take long
        again = scores.score("FishSwim", policy, decisions, robots=2)
        assert first.curve == again.curve and first.mean == again.mean
    assert [n for n, _ in first.curve] == [4096] and first.steps == 4 * decisions
    scores.write(tmp_path, [first])
    with open(tmp_path / "scores.csv") as stream:
        (row,) = csv.DictReader(stream)
    assert row["policy"] == policy and float(row["reward"]) == pytest.approx(first.mean, abs=1e-4)
    with open(tmp_path / "curves.csv") as stream:
        (row,) = csv.DictReader(stream)
    assert float(row["reward"]) == pytest.approx(first.curve[0][1], abs=1e-4)


def test_ppo_on_navigation_chooses_gaits_and_repeats(monkeypatch):
    monkeypatch.setattr(scores_navigate, "EPISODES", 2)
    first, again = (scores.score("FishNavigate", "ppo", 2048) for _ in range(2))
    assert first.curve == again.curve and first.mean == again.mean
    assert [n for n, _ in first.curve] == [2048] and first.steps == 32 * 2048
    known = scores.score("FishNavigate", "random")
    assert 0.0 <= known.mean <= 1.0 and known.half > 0.0 and known.curve == []


def test_an_arrival_is_the_suite_s_own_success():
    forward = scores_navigate.arrivals("FishNavigate", lambda observation: 0, 40, 3)
    for i, reached in enumerate(forward):
        env = suite.load("fish", "navigate", {"random": 40 + i})
        step = env.reset()
        while not step.last():
            step = env.step(0)
        assert reached == (env.task.outcome == "success")


def test_the_table_has_a_row_a_task_and_a_column_a_policy():
    some = [
        scores.Score("FishSwim", "rest", 0.1, 0.02),
        scores.Score("FishSwim", "ppo", 0.5, 0.03),
        scores.Score("TeeWalk", "rest", 0.0, 0.0),
    ]
    assert scores.table(some).splitlines() == [
        "| task | rest | ppo |",
        "| --- | --- | --- |",
        "| `FishSwim` | 0.100 ± 0.020 | 0.500 ± 0.030 |",
        "| `TeeWalk` | 0.000 ± 0.000 | – |",
    ]
