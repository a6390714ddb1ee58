"""Episodes of a run: its planner steers the reduced dynamics through scenes, on record if wanted."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from dm_control.rl.control import Environment

    from defplan_mj.log.recorder import Recorder
    from defplan_mj.log.run_files import RunFiles
    from defplan_mj.pipeline.run import Run
    from defplan_mj.planning.planner import Planner
    from defplan_mj.planning.scenes import Scene


@dataclass(frozen=True)
class Recorders:
    """Gives each of the first episodes a recorder; picklable, for evaluations in processes.

    Attributes:
        folder: where the logs go, as '<scenes>-<episode>.mcap'.
        scenes: 'k2' or 'novel'.
        count: how many episodes are logged.
        parts: what is attached to every log; filled in by `evaluate`.
    """

    folder: Path
    scenes: str
    count: int
    parts: RunFiles | None = None

    def __call__(self, index: int, scene: Scene) -> Recorder | None:
        """Return the recorder of episode `index`."""
        from defplan_mj.log.recorder import Recorder

        if index >= self.count or self.parts is None:
            return None
        return Recorder(self.path(index), self.parts)

    def path(self, index: int) -> Path:
        """Return where the log of episode `index` goes."""
        return self.folder / f"{self.scenes}-{index:02d}.mcap"


def evaluate(
    run: Run,
    scenes: str,
    shield: bool,
    *,
    episodes: int | None = None,
    obstacles: int | None = None,
    obstacle_speed: float = 0.0,
    log: Recorders | None = None,
) -> dict[str, Any]:
    """Let the run's planner steer through scenes; the same seed and options give the same scenes.

    Args:
        scenes: 'k2' or 'novel'.
        shield: wrap the planner in the safety shield.
        episodes: how many (None: the task's number of K2 targets, the run's of novel ones).
        obstacles: on the way to each target (None: the task's).
        obstacle_speed: m/s.
        log: where the logs go; None: nowhere.

    Returns:
        JSON-able: number of episodes, rates and their intervals, and 'rows', one an episode.
    """
    from defplan_mj.log.run_files import RunFiles
    from defplan_mj.planning.evaluation import evaluate
    from defplan_mj.planning.scenes import k2_scenes, novel_scenes

    navigation, seed = run.spec.navigation, run.options.seed
    if scenes == "k2":
        chosen = k2_scenes(navigation, seed, episodes, obstacles, obstacle_speed)
    else:
        count = episodes or run.options.episodes
        chosen = novel_scenes(navigation, count, seed, obstacles, obstacle_speed)
    planner = run.planner
    if log is not None:
        parts = RunFiles.of(run.body, run.gait, run.surrogate, run.policy, run.spec.terrain)
        log = dataclasses.replace(log, parts=parts)
    context = {
        "task": run.spec.name,
        "seed": seed,
        "planner": run.planner_solver.name,
        "feedback": run.feedback_solver.name,
        "shield": shield,
        "navigation": dataclasses.asdict(navigation),
    }
    progress = run.progress("evaluation")
    message = f"{scenes}, {'with' if shield else 'without'} shield"
    return evaluate(
        run.body,
        run.gait,
        run.surrogate,
        navigation,
        planner,
        chosen,
        shield=shield,
        feedback=run.feedback_solver,
        terrain=run.spec.terrain,
        recorder=log,
        context=context,
        progress=lambda _, fraction: progress(message, fraction),
    ).to_json()


def steering(run: Run, shield: bool) -> Planner:
    """Return the run's planner, in the safety shield if that is wanted."""
    from defplan_mj.planning.shield import Shield

    if not shield:
        return run.planner
    return Shield(run.planner, run.surrogate, run.spec.navigation)


def environment(run: Run, obstacles: int | None = None) -> Environment:
    """Return the run's navigation environment; it draws novel scenes from the run's seed."""
    from defplan_mj.host.navigation import navigation_environment
    from defplan_mj.planning.scenes import NovelScenes

    navigation = run.spec.navigation
    feedback = run.feedback_solver.prepare(run.dynamics, run.gait, navigation.space)
    return navigation_environment(
        run.body,
        run.gait,
        navigation,
        NovelScenes(navigation, obstacles),
        terrain=run.spec.terrain,
        feedback=feedback,
        random=run.options.seed,
    )
