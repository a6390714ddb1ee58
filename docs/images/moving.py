"""Makes the README's moving pictures: `python docs/images/moving.py TASK...` (default: all four robots).

Each is the start of an episode of the packaged gaits, steered by A* with the collision check.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

from defplan_mj import registry
from defplan_mj.host.evaluation import evaluate
from defplan_mj.log.replay import write_video
from defplan_mj.log.run_files import RunFiles
from defplan_mj.pipeline.trial import Recorders
from defplan_mj.planning.fit import fit_surrogate
from defplan_mj.planning.scenes import novel_scenes
from defplan_mj.studies.check import packaged_robot

SIZE, FPS, SECONDS = (400, 225), 12.0, 6.0
PICTURES = {
    "fish-swim": "chase",
    "quadruped-swim": "chase",
    "quadruped-walk": "chase",
    "tee-walk": "chase",
}


def picture(name: str, path: Path) -> None:
    """Let the packaged robot of a task go to an unseen target, and draw it."""
    spec = registry.get_task(name)
    robot = packaged_robot(spec)
    surrogate = fit_surrogate(robot.dynamics, robot.gait, pairs=200, seed=0)
    solver = registry.get_solver("astar", "planner")
    planner = solver.train(surrogate, spec.navigation, 0).planner
    with tempfile.TemporaryDirectory() as folder:
        parts = RunFiles.of_robot(robot, surrogate)
        recorders = Recorders(Path(folder), "novel", 1, parts)
        scenes = novel_scenes(spec.navigation, 1, 0)
        context = {"task": name, "seed": 0, "planner": "astar", "shield": True}
        evaluate(
            robot, surrogate, spec.navigation, planner, scenes,
            recorder=recorders, context=context,
        )  # fmt: skip
        write_video(recorders.path(0), path, SIZE, FPS, PICTURES[name], seconds=(0, SECONDS))
    print(f"{path}: {path.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    for task in sys.argv[1:] or PICTURES:
        picture(task, Path(__file__).with_name(f"{task}.webp"))
