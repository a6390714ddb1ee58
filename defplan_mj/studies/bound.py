"""Planners judged against one that knows everything: which share of what can be reached they reach."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from defplan_mj import registry
from defplan_mj.base.errors import DefplanError
from defplan_mj.base.places import PLACES
from defplan_mj.base.progress import Progress, no_progress
from defplan_mj.host.evaluation import evaluate
from defplan_mj.planning.outcome import ENDINGS
from defplan_mj.planning.planner import Planner
from defplan_mj.planning.robot import Robot
from defplan_mj.planning.scene import Scene
from defplan_mj.planning.scenes import draw_scenes
from defplan_mj.planning.surrogate import Surrogate
from defplan_mj.task import Navigation


@dataclass(frozen=True)
class Setting:
    """Scenes to be judged in.

    Attributes:
        scenes: 'k2' (training targets), 'novel' (unseen scenes) or a name of `planning.places`.
        speed: of the obstacles, m/s; those of places stand still.
    """

    scenes: str
    speed: float = 0.0

    def draw(self, navigation: Navigation, n: int, seed: int, radius: float) -> list[Scene]:
        """Return n scenes for a robot whose disc or ball has this radius, m."""
        return draw_scenes(self.scenes, navigation, seed, n, radius, obstacle_speed=self.speed)


def bound_solver() -> Any:
    """Return the planner plugin that says of itself that it is the bound (`bound = True`).

    Raises:
        DefplanError: none is installed.
    """
    for entry in registry.solvers("planner"):
        if getattr(entry.value, "bound", False):
            return entry.value
    raise DefplanError("no planner is installed that is a bound: reinstall defplan")


def settings(scenes: Sequence[str], speeds: Sequence[float]) -> list[Setting]:
    """Return each kind of scenes, those that are no place at each speed."""
    return [
        Setting(name, speed)
        for name in scenes
        for speed in ((0.0,) if name in PLACES else speeds or (0.0,))
    ]


def judge(
    robot: Robot,
    surrogate: Surrogate,
    navigation: Navigation,
    planners: Mapping[str, Planner],
    where: Sequence[Setting],
    episodes: int,
    seed: int = 0,
    progress: Progress = no_progress,
) -> list[dict[str, Any]]:
    """Return a row for each setting and planner, the bound first; planners are in the collision check.

    'scenes', 'speed', 'planner', 'episodes', the share of each ending, 'interval' of the successes (95%,
    Wilson), 'of_bound': successes in units of the bound's (None: the bound has none), 'decision_ms'.
    """
    solver = bound_solver()
    bound = solver.train(surrogate, navigation, seed).planner
    rows: list[dict[str, Any]] = []
    total = len(where) * (len(planners) + 1)
    for setting in where:
        scenes, reached = setting.draw(navigation, episodes, seed, surrogate.radius), 0.0
        for name, planner in {solver.name: bound, **planners}.items():
            result = evaluate(
                robot, surrogate, navigation, planner, scenes, shield=name != solver.name
            ).to_json()
            reached = result["success"] if name == solver.name else reached
            rows.append(
                {
                    "scenes": setting.scenes,
                    "speed": setting.speed,
                    "planner": name,
                    "episodes": result["episodes"],
                    **{ending: result[ending] for ending in ENDINGS},
                    "interval": result["interval"]["success"],
                    "of_bound": result["success"] / reached if reached else None,
                    "decision_ms": result["decision_ms"],
                }
            )
            progress(f"{setting.scenes}, {setting.speed:g} m/s: {name}", len(rows) / total)
    return rows
