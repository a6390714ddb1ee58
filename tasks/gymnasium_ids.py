"""The ids that Gymnasium knows our tasks by. Run on `import defplan_mj`: nothing heavy is imported here."""

from __future__ import annotations

from defplan_mj.rl.register import register_task

TASKS = (
    ("fish", "swim"),
    ("fish", "navigate"),
    ("quadruped", "swim"),
    ("quadruped", "walk"),
    ("quadruped", "navigate"),
    ("quadruped", "navigate3d"),
    ("tee", "walk"),
    ("tee", "navigate"),
)
"""Domain and task, as `suite.load` takes them."""


def register() -> None:
    """Register all of them."""
    for domain, task in TASKS:
        register_task(domain, task, many=not task.startswith("navigate"))
