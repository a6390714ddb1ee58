"""A planner in scenes: of the gaits that the shield lets pass, argmax_j V_j(observation), cycle after cycle.

python docs/examples/plan.py [planner]
"""

from __future__ import annotations

import sys

from defplan_mj.body.model import Body
from defplan_mj.gait.gait import Gait
from defplan_mj.host.evaluation import EvaluationResult, evaluate
from defplan_mj.planning.fit import fit_surrogate
from defplan_mj.planning.robot import Robot
from defplan_mj.planning.scenes import novel_scenes
from defplan_mj.registry import get_solver, get_task
from defplan_mj.task import Navigation

NAVIGATION = Navigation(distance=6.0, novel_obstacles=2, max_cycles=40)


def main(name: str = "greedy", episodes: int = 3) -> EvaluationResult:
    """Let the fish swim to some targets among cylinders, and return how the episodes ended."""
    spec = get_task("fish-swim")
    assert spec.shipped is not None
    robot = Robot(Body.load(spec.shipped[0]), Gait.load(spec.shipped[1]), spec.world)
    fit = fit_surrogate(robot.dynamics, robot.gait, pairs=60)
    planner = get_solver(name, "planner").train(fit, NAVIGATION, seed=0).planner
    scenes = novel_scenes(NAVIGATION, episodes, seed=0)
    result = evaluate(robot, fit, NAVIGATION, planner, scenes)
    for episode in result.episodes:
        print(f"{episode.outcome} after {episode.cycles} cycles, {episode.path:.1f} m")
    return result


if __name__ == "__main__":
    main(*sys.argv[1:2])
