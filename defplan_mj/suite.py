"""The task suite, loaded like dm_control's: `suite.load("fish", "swim")`.

Domains are modules with a `SUITE` of tagged tasks, registered as entry points of the group
`defplan_mj.domains`. A domain that cannot be loaded is left out of the lists; `load` says why.
"""

from __future__ import annotations

import collections
import difflib
from typing import Any

from dm_control.rl import control

from defplan_mj import registry
from defplan_mj.base.errors import DefplanError

_DOMAINS: dict[str, Any] = {
    entry.name: entry.value for entry in registry.domains() if hasattr(entry.value, "SUITE")
}

TaskName = tuple[str, str]


def _get_tasks(tag: str | None) -> tuple[TaskName, ...]:
    """Return the (domain, task) pairs that carry `tag`, or all."""
    pairs = []
    for name, domain in sorted(_DOMAINS.items()):
        tasks = domain.SUITE if tag is None else domain.SUITE.tagged(tag)
        pairs += [(name, task) for task in tasks]
    return tuple(pairs)


def _get_tasks_by_domain(tasks: tuple[TaskName, ...]) -> dict[str, tuple[str, ...]]:
    """Return the task names of each domain."""
    result = collections.defaultdict(list)
    for domain, task in tasks:
        result[domain].append(task)
    return {domain: tuple(names) for domain, names in result.items()}


ALL_TASKS = _get_tasks(None)
BENCHMARKING = _get_tasks("benchmarking")
EXTRA = tuple(sorted(set(ALL_TASKS) - set(BENCHMARKING)))
NO_REWARD_VIZ = _get_tasks("no_reward_visualization")
REWARD_VIZ = tuple(sorted(set(ALL_TASKS) - set(NO_REWARD_VIZ)))
TASKS_BY_DOMAIN = _get_tasks_by_domain(ALL_TASKS)


def load(
    domain_name: str,
    task_name: str,
    task_kwargs: dict | None = None,
    environment_kwargs: dict | None = None,
    visualize_reward: bool = False,
) -> control.Environment:
    """Return an environment, as dm_control.suite.load does.

    Args:
        domain_name: e.g. 'fish'.
        task_name: e.g. 'swim'.
        task_kwargs: of the task, e.g. {'random': seed}.
        environment_kwargs: of dm_control's Environment, e.g. {'flat_observation': True}.
        visualize_reward: let the robot's colour show the reward.

    Raises:
        DefplanError: there is no such domain or task; names those there are.
    """
    if domain_name not in _DOMAINS:
        domain = registry.get_domain(domain_name)  # says what is wrong with it
        raise DefplanError(f"the domain {domain_name} ({domain.__name__}) has no SUITE of tasks")
    tasks = _DOMAINS[domain_name].SUITE
    if task_name not in tasks:
        close = difflib.get_close_matches(str(task_name).lower(), tasks, n=1, cutoff=0.5)
        guess = f", did you mean {close[0]}?" if close else ";"
        there = "There" if close else "there"
        raise DefplanError(
            f"the domain {domain_name} has no task {task_name}{guess}"
            f" {there} is: {', '.join(sorted(tasks))}"
        )
    kwargs = dict(task_kwargs or {})
    if environment_kwargs is not None:
        kwargs["environment_kwargs"] = environment_kwargs
    environment = tasks[task_name](**kwargs)
    environment.task.visualize_reward = visualize_reward
    return environment
