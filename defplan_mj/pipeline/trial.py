"""Episodes of a run: its planner steers the reduced dynamics through scenes, on record if wanted."""

from __future__ import annotations

import dataclasses
import itertools
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from defplan_mj.pipeline.making import policy_file

if TYPE_CHECKING:
    from dm_control.rl.control import Environment

    from defplan_mj.log.live import Server
    from defplan_mj.log.recorder import Recorder
    from defplan_mj.log.run_files import RunFiles
    from defplan_mj.pipeline.run import Run
    from defplan_mj.planning.planner import Planner
    from defplan_mj.planning.robot import Robot
    from defplan_mj.planning.scene import Scene


@dataclass(frozen=True)
class Recorders:
    """Gives each of the first episodes a recorder; picklable, for evaluations in processes.

    Attributes:
        folder: where the logs go, as '<scenes>-<episode>.mcap'.
        scenes: 'k2' (training targets) or 'novel' (unseen scenes).
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


def robot(run: Run) -> Robot:
    """Return the run's robot."""
    from defplan_mj.planning.robot import Robot

    plan = run.plan
    return Robot(run.result("body"), run.result("gait"), plan.spec.world, plan.feedback)


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
        run: its planner is finished.
        scenes: 'k2' (training targets), 'novel' (unseen scenes) or a name of `planning.places`.
        shield: wrap the planner in the safety shield.
        episodes: how many (None: the task's number of training targets, the run's of unseen scenes).
        obstacles: on the way to each target (None: the task's).
        obstacle_speed: m/s.
        log: where the logs go; None: nowhere.

    Returns:
        JSON-able: number of episodes, rates and their intervals, and 'rows', one an episode.
    """
    from defplan_mj.host.evaluation import evaluate
    from defplan_mj.log.run_files import RunFiles

    who, surrogate, navigation = robot(run), run.result("surrogate"), run.plan.spec.navigation
    if log is not None:
        parts = RunFiles.of_robot(who, surrogate, policy_file(run))
        # absolute: another process may have another folder
        log = dataclasses.replace(log, parts=parts, folder=log.folder.absolute())
    progress = run.progress_of("evaluation")
    message = f"{scenes}, {'with' if shield else 'without'} shield"
    return evaluate(
        who,
        surrogate,
        navigation,
        run.result("planner"),
        _scenes(run, scenes, episodes, obstacles, obstacle_speed),
        shield=shield,
        recorder=log,
        context=_context(run, shield),
        progress=lambda _, fraction: progress(message, fraction),
    ).to_json()


def _scenes(
    run: Run, scenes: str, episodes: int | None, obstacles: int | None, speed: float
) -> list[Scene]:
    from defplan_mj.planning.scenes import draw_scenes

    options, navigation = run.plan.options, run.plan.spec.navigation
    count = episodes if scenes == "k2" else episodes or options.episodes
    radius = run.result("surrogate").radius
    return draw_scenes(scenes, navigation, options.seed, count, radius, obstacles, speed)


def _context(run: Run, shield: bool) -> dict[str, Any]:
    """Return what a log says of its episode's making."""
    plan = run.plan
    return {
        "task": plan.spec.name,
        "seed": plan.options.seed,
        "planner": plan.planner.name,
        "feedback": plan.feedback.name,
        "shield": shield,
        "navigation": dataclasses.asdict(plan.spec.navigation),
    }


def steering(run: Run, shield: bool) -> Planner:
    """Return the run's planner, in the safety shield if that is wanted."""
    from defplan_mj.planning.shield import Shield

    if not shield:
        return run.result("planner")
    return Shield(run.result("planner"), run.result("surrogate"), run.plan.spec.navigation)


def environment(run: Run, obstacles: int | None = None) -> Environment:
    """Return the run's navigation environment; it draws unseen scenes from the run's seed."""
    from defplan_mj.host.navigation import robot_environment
    from defplan_mj.planning.scenes import NovelScenes

    spec, seed = run.plan.spec, run.plan.options.seed
    scenes = NovelScenes(spec.navigation, obstacles)
    return robot_environment(
        robot(run), spec.navigation, scenes, random=seed, texture=spec.texture()
    )


def stream(
    run: Run,
    server: Server,
    shield: bool = True,
    obstacles: int | None = None,
    episodes: int | None = None,
    speed: float = 1.0,
) -> list[str]:
    """Let the run's planner steer through unseen scenes and stream it, held to wall time.

    Args:
        episodes: None: until Ctrl-C.
        speed: simulated seconds a second of wall time; 0: as fast as it goes.

    Returns:
        The outcomes.
    """
    from defplan_mj.host.evaluation import run_episode
    from defplan_mj.log.live import Live
    from defplan_mj.log.run_files import RunFiles

    env, planner = environment(run, obstacles), steering(run, shield)
    files = RunFiles.of_robot(robot(run), run.result("surrogate"))
    scenes = _scenes(run, "novel", episodes or run.plan.options.episodes, obstacles, 0.0)
    outcomes: list[str] = []
    numbered = enumerate(scenes if episodes else itertools.cycle(scenes))
    for number, scene in numbered:
        with Live(server, files, speed) as live:
            done = run_episode(env, scene, planner, live, _context(run, shield), number)
        outcomes.append(done.outcome)
    return outcomes
