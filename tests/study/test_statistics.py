"""Statistics of studies, against textbook values and exact counts."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy import stats

from defplan_mj.study.statistics import (
    bootstrap_interval,
    interquartile_mean,
    mean_over_seeds,
    mean_ranks,
    performance_profiles,
    probability_of_improvement,
    rate_over_seeds,
)


def test_the_interquartile_mean_is_scipys_trimmed_mean_and_ignores_one_odd_seed():
    values = np.random.default_rng(0).normal(size=40)
    assert interquartile_mean(values) == pytest.approx(stats.trim_mean(values, 0.25))
    assert interquartile_mean([1.0, 1.0, 1.0, 1000.0, 1.0]) == 1.0
    assert interquartile_mean([0.0, 3.0, 9.0]) == pytest.approx((0.25 * 0 + 1 * 3 + 0.25 * 9) / 1.5)
    assert interquartile_mean([7.0]) == 7.0
    with pytest.raises(ValueError, match="no values"):
        interquartile_mean([])


def test_a_bootstrap_interval_of_a_mean_is_about_the_normal_one():
    values = np.random.default_rng(1).normal(5, 2, size=200)
    low, high = bootstrap_interval([values], lambda groups: float(groups[0].mean()))
    half = 1.96 * values.std() / np.sqrt(200)
    assert (low, high) == pytest.approx(
        (values.mean() - half, values.mean() + half), abs=0.1 * half
    )


def test_one_seed_has_no_interval_over_seeds():
    mean, low, high = mean_over_seeds([3.0])
    assert mean == 3.0 and np.isnan([low, high]).all()


def test_a_rate_over_seeds_is_less_sure_than_its_pooled_episodes_if_the_seeds_differ():
    rate, low, high = rate_over_seeds([200, 0, 200, 0], [200, 200, 200, 200])
    assert rate == 0.5 and high - low > 0.5
    rate, low, high = rate_over_seeds([50], [100])  # one seed: the binomial's own interval
    assert (low, high) == pytest.approx(stats.binom(100, 0.5).ppf([0.025, 0.975]) / 100, abs=0.02)


def test_the_probability_of_improvement_is_mann_whitneys_u():
    rng = np.random.default_rng(2)
    x, y = rng.integers(0, 6, 7), rng.integers(0, 6, 5)
    u = stats.mannwhitneyu(x, y).statistic / (7 * 5)
    p, low, high = probability_of_improvement({"a": x}, {"a": y})
    assert p == pytest.approx(u) and low <= p <= high
    assert probability_of_improvement({"a": [2.0], "b": [0.0]}, {"a": [1.0], "b": [1.0]})[0] == 0.5
    with pytest.raises(ValueError, match="no task"):
        probability_of_improvement({"a": [1.0]}, {"b": [1.0]})


def test_ranks_share_ties_and_are_the_mean_of_the_tasks():
    scores = {
        "one": {"a": [3.0, 3.0], "b": [1.0]},
        "two": {"a": [2.0, 2.0], "b": [1.0]},
        "three": {"a": [1.0, 1.0], "b": [2.0], "alone": [9.0]},
    }
    ranks = mean_ranks(scores)
    assert {name: rank[0] for name, rank in ranks.items()} == {
        "one": 1.75,
        "two": 2.25,
        "three": 2.0,
    }
    assert ranks["one"] == (1.75, 1.75, 1.75)  # nothing varies


def test_performance_profiles_are_counted_as_dolan_and_more_define_them():
    costs = {"fast": [1.0, 2.0, np.inf, np.inf], "slow": [2.0, 2.0, 5.0, np.nan]}
    taus, shares = performance_profiles(costs)
    assert taus.tolist() == [1.0, 2.0]
    for name, tau in itertools.product(costs, taus):
        best = [1.0, 2.0, 5.0, np.inf]
        within = [c <= tau * b for c, b in zip(costs[name], best, strict=True) if np.isfinite(c)]
        assert shares[name][list(taus).index(tau)] == sum(within) / 4
    with pytest.raises(ValueError, match="above 0"):
        performance_profiles({"a": [0.0]})
