"""What it brings to choose the gait more than once a cycle: the surrogate's errors, planners in hard scenes.

    python -m defplan_mj.studies.decisions fish-swim --decisions 1 2 4 --planners NAME ...

prints the tables of docs/planning.md, a row as soon as it is there: of the packaged gaits, all planners in the
collision check.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from defplan_mj import registry
from defplan_mj.host.evaluation import evaluate
from defplan_mj.planning.fit import fit_surrogate
from defplan_mj.planning.outcome import ENDINGS, Outcome
from defplan_mj.planning.planner import Observation, Planner, needs_obstacles
from defplan_mj.planning.robot import Robot
from defplan_mj.planning.shield import Shield
from defplan_mj.planning.surrogate import Surrogate
from defplan_mj.studies.bound import Setting
from defplan_mj.studies.check import packaged_robot
from defplan_mj.task import Navigation


class Timed:
    """A planner whose decisions' CPU time is summed.

    Attributes:
        seconds, decisions: of all since it was made.
    """

    def __init__(self, planner: Planner) -> None:
        self.planner, self.seconds, self.decisions = planner, 0.0, 0

    @property
    def needs_obstacles(self) -> bool:
        """Whether the planner is told all obstacles."""
        return needs_obstacles(self.planner)

    def reset(self) -> None:
        """Begin an episode."""
        self.planner.reset()

    def values(self, observation: Observation) -> np.ndarray:
        """Return the planner's (K,) values."""
        begun = time.process_time()
        values = self.planner.values(observation)
        self.seconds += time.process_time() - begun
        self.decisions += 1
        return values


def judge_decisions(
    robot: Robot,
    surrogate: Surrogate,
    navigation: Navigation,
    planner: Planner,
    setting: Setting,
    episodes: int,
    seed: int,
) -> dict[str, Any]:
    """Return how a planner fares in one setting, in the collision check.

    The share of each ending, 'interval' of the successes (95%, Wilson), 'cycles' of the successful episodes
    and 'decision_ms', CPU time of a decision, both means.
    """
    pilot = Timed(Shield(planner, surrogate, navigation))
    scenes = setting.draw(navigation, episodes, seed, surrogate.radius)
    result = evaluate(
        robot, surrogate, navigation, pilot, scenes, shield=False, workers=1
    ).to_json()
    return {
        **{ending: result[ending] for ending in ENDINGS},
        "interval": result["interval"][Outcome.SUCCESS],
        "cycles": result["cycles_mean"],
        "decision_ms": 1e3 * pilot.seconds / max(pilot.decisions, 1),
    }


def _line(cells: Sequence[Any]) -> None:
    print("| " + " | ".join(map(str, cells)) + " |", flush=True)


def _told(row: Mapping[str, Any], episodes: int) -> list[str]:
    low, high = (100 * bound for bound in row["interval"])
    counts = {ending: round(row[ending] * episodes) for ending in ENDINGS}
    failed = [f"{n} {e}" for e, n in counts.items() if n and e != Outcome.SUCCESS]
    cycles = "-" if row["cycles"] is None else f"{row['cycles']:.1f}"
    success = f"{counts[Outcome.SUCCESS]} of {episodes} ({low:.1f}-{high:.1f})"
    return [success, ", ".join(failed), cycles, f"{row['decision_ms']:.1f}"]


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description="What more decisions in a gait cycle bring.")
    parser.add_argument("task", help="whose packaged gaits are played")
    parser.add_argument("--decisions", type=int, nargs="+", default=[1, 2, 4], help="a cycle")
    parser.add_argument("--planners", nargs="+", help="(default: the task's)")
    parser.add_argument("--scenes", nargs="+", default=["novel:1", "novel:2", "field-40", "gates"],
                        help="kinds of scenes, with :speed of what moves in m/s")  # fmt: skip
    parser.add_argument("--episodes", type=int, default=60)
    parser.add_argument("--pairs", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    spec = registry.get_task(options.task)
    robot = packaged_robot(spec)
    where = [Setting(name, float(speed or 0)) for name, _, speed in
             (scene.partition(":") for scene in options.scenes)]  # fmt: skip
    ready = []
    _line(
        [
            "decisions a cycle",
            "one motion a gait and phase",
            "by the past, too",
            "pasts",
            "fit, CPU s",
        ]
    )
    _line(["---"] * 5)
    for m in options.decisions:
        navigation, begun = replace(spec.navigation, decisions_per_cycle=m), time.process_time()
        surrogate = fit_surrogate(
            robot.dynamics, robot.gait, options.pairs, options.seed, decisions=m
        )
        seconds = time.process_time() - begun
        held_out = surrogate.switching.held_out if surrogate.switching else {}
        off = [
            f"{held_out[f'{key}place_m']:.4f} m, {held_out[f'{key}turn_rad']:.4f} rad"
            for key in ("plain_", "")
        ]
        _line([m, *off, surrogate.rest + 1, f"{seconds:.0f}"])
        ready.append((m, navigation, surrogate))
    heads = ["planner", "decisions a cycle", "scenes", "success (95%)", "failed", "cycles"]
    _line([*heads, "decision, CPU ms", "training, CPU s"])
    _line(["---"] * 8)
    for name in options.planners or [spec.planner]:
        for m, navigation, surrogate in ready:
            begun = time.process_time()
            planner = (
                registry.get_solver(name, "planner")
                .train(surrogate, navigation, options.seed)
                .planner
            )
            trained = time.process_time() - begun
            for setting in where:
                row = judge_decisions(
                    robot, surrogate, navigation, planner, setting, options.episodes, options.seed
                )
                scenes = setting.scenes + (f", {setting.speed:g} m/s" if setting.speed else "")
                _line([name, m, scenes, *_told(row, options.episodes), f"{trained:.0f}"])


if __name__ == "__main__":
    main()
