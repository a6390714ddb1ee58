"""Statistics of studies: intervals over seeds and episodes, ranks, probability of improvement, profiles.

The estimates for few seeds are those of Agarwal et al., Deep Reinforcement Learning at the Edge of the
Statistical Precipice (2021); performance profiles those of Dolan and More (2002).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

DRAWS = 2000
FEW = 10
"""Up to so many seeds the interquartile mean stands for the mean: one odd seed does not move it."""

Sample = Sequence[float] | np.ndarray


def interquartile_mean(values: Sample | np.ndarray) -> float:
    """Return the mean of the middle half of values (n,); one that is cut counts with its share.

    Raises:
        ValueError: there are none.
    """
    ordered = np.sort(np.asarray(values, float).ravel())
    n = len(ordered)
    if n == 0:
        raise ValueError("there is no mean of no values")
    edges = np.arange(n + 1) / n
    weight = np.clip(np.minimum(edges[1:], 0.75) - np.maximum(edges[:-1], 0.25), 0, None)
    return float(weight @ ordered / weight.sum())


def bootstrap_interval(
    groups: Sequence[Sample],
    statistic: Callable[[Sequence[np.ndarray]], float],
    seed: int = 0,
    draws: int = DRAWS,
) -> tuple[float, float]:
    """Return the 95% percentile interval of a statistic, each group drawn from itself (stratified).

    Args:
        groups: values of each task, one a seed.
        statistic: of such groups.
    """
    rng = np.random.default_rng(seed)
    arrays = [np.asarray(group, float) for group in groups]
    values = [
        statistic([array[rng.integers(len(array), size=len(array))] for array in arrays])
        for _ in range(draws)
    ]
    low, high = np.quantile(values, (0.025, 0.975))
    return float(low), float(high)


def mean_over_seeds(values: Sample, seed: int = 0) -> tuple[float, float, float]:
    """Return the mean over seeds and its 95% bootstrap interval; of few seeds the interquartile mean.

    Of one seed there is no interval: its ends are nan.
    """
    array = np.asarray(values, float)
    mean = interquartile_mean if 1 < len(array) <= FEW else lambda a: float(np.mean(a))
    centre = float(mean(array))
    if len(array) == 1:
        return centre, float("nan"), float("nan")
    low, high = bootstrap_interval([array], lambda groups: float(mean(groups[0])), seed)
    return centre, low, high


def rate_over_seeds(
    successes: Sample, episodes: Sample, seed: int = 0, draws: int = DRAWS
) -> tuple[float, float, float]:
    """Return a rate over seeds and episodes, and its 95% interval by a bootstrap of two levels.

    Seeds are drawn first, then the episodes of each: an interval over pooled episodes alone would take the
    episodes of one training for as many trainings. Of one seed it is that of its episodes.

    Args:
        successes: of each seed.
        episodes: of each seed.
    """
    won, of = np.asarray(successes, int), np.asarray(episodes, int)
    rng = np.random.default_rng(seed)
    chosen = rng.integers(len(won), size=(draws, len(won)))
    again = rng.binomial(of[chosen], won[chosen] / of[chosen])
    rates = again.sum(1) / of[chosen].sum(1)
    low, high = np.quantile(rates, (0.025, 0.975))
    return float(won.sum() / of.sum()), float(low), float(high)


def probability_of_improvement(
    one: Mapping[str, Sample], other: Mapping[str, Sample], seed: int = 0
) -> tuple[float, float, float]:
    """Return how probable it is that a run of `one` is better than one of `other`, and the 95% interval.

    The mean over the tasks that both have of P(x > y) + P(x = y) / 2 (Mann and Whitney's U).

    Args:
        one, other: scores by task, one a seed; more is better.

    Raises:
        ValueError: they have no task in common.
    """
    tasks = [task for task in one if task in other]
    if not tasks:
        raise ValueError("they have no task in common")
    pairs = [*(one[task] for task in tasks), *(other[task] for task in tasks)]

    def chance(groups: Sequence[np.ndarray]) -> float:
        half = len(groups) // 2
        return float(
            np.mean([_above(x, y) for x, y in zip(groups[:half], groups[half:], strict=True)])
        )

    low, high = bootstrap_interval(pairs, chance, seed)
    return chance([np.asarray(group, float) for group in pairs]), low, high


def _above(x: np.ndarray, y: np.ndarray) -> float:
    """Return P(x > y) + P(x = y) / 2 of two samples."""
    return float(np.mean(np.sign(x[:, None] - y[None]) + 1) / 2)


def mean_ranks(scores: Mapping[str, Mapping[str, Sample]], seed: int = 0) -> dict[str, tuple]:
    """Return each method's rank (1: the best, ties share), mean of the tasks, and its 95% interval.

    Args:
        scores: by method and task, one a seed; more is better. Only tasks that all have count.
    """
    methods = list(scores)
    tasks = [t for t in scores[methods[0]] if all(t in scores[method] for method in methods)]
    if not tasks:
        return {}
    rng = np.random.default_rng(seed)
    samples = {m: [np.asarray(scores[m][t], float) for t in tasks] for m in methods}
    drawn = np.array([_ranks(samples, rng) for _ in range(DRAWS)])
    middle = _ranks(samples, None)
    low, high = np.quantile(drawn, (0.025, 0.975), axis=0)
    return {m: (float(middle[i]), float(low[i]), float(high[i])) for i, m in enumerate(methods)}


def _ranks(
    samples: Mapping[str, Sequence[np.ndarray]], rng: np.random.Generator | None
) -> np.ndarray:
    """Return (methods,) mean ranks over the tasks, of the samples or of a draw from each."""
    means = np.array(
        [
            [np.mean(a if rng is None else a[rng.integers(len(a), size=len(a))]) for a in arrays]
            for arrays in samples.values()
        ]
    )
    better = (means[None] > means[:, None]).sum(1)
    equal = (means[None] == means[:, None]).sum(1)
    return (1 + better + (equal - 1) / 2).mean(1)


def performance_profiles(costs: Mapping[str, Sample]) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Return performance profiles: the share of problems that each solver does within tau times the best.

    Args:
        costs: by solver, one a problem, all of the same problems, above 0; not finite: it failed.

    Returns:
        The ratios tau (n,), from 1 on, at which anything changes, and of each solver the shares (n,).
    """
    names = list(costs)
    table = np.array([costs[name] for name in names], float)
    table[~np.isfinite(table)] = np.inf
    if (table <= 0).any():
        raise ValueError("costs must be above 0")
    best = table.min(0)
    solved = np.isfinite(best)
    ratios = np.full(table.shape, np.inf)
    ratios[:, solved] = table[:, solved] / best[solved]
    taus = np.unique(np.concatenate([[1.0], ratios[np.isfinite(ratios)]]))
    shares = (ratios[:, :, None] <= taus).mean(1)
    return taus, dict(zip(names, shares, strict=True))
