"""Planners judged against the bound: what a row says, and which scenes are drawn."""

import pytest

from defplan_mj import registry
from defplan_mj.body.model import Body
from defplan_mj.cli.text import bound_text
from defplan_mj.dynamics.world import WATER
from defplan_mj.gait.gait import Gait
from defplan_mj.planning.fit import fit_surrogate
from defplan_mj.planning.robot import Robot
from defplan_mj.studies.bound import Setting, bound_solver, judge, settings
from defplan_mj.task import Navigation
from defplan_tasks.environments import ASSETS

NEAR = Navigation(distance=6.0)


def test_speeds_are_those_of_scenes_that_are_no_places():
    assert settings(["novel", "maze"], [0.5, 2.0]) == [
        Setting("novel", 0.5),
        Setting("novel", 2.0),
        Setting("maze"),
    ]
    assert settings(["k2"], []) == [Setting("k2")]


def test_the_bound_comes_first_and_others_are_told_in_units_of_it():
    body, gait = Body.load(ASSETS / "fish_body.npz"), Gait.load(ASSETS / "fish_gait.npz")
    robot = Robot(body, gait, WATER)
    surrogate = fit_surrogate(robot.dynamics, gait, 6)
    greedy = registry.get_solver("greedy", "planner").train(surrogate, NEAR, 0).planner
    rows = judge(robot, surrogate, NEAR, {"greedy": greedy}, [Setting("k2", 0.5)], 2)
    assert [row["planner"] for row in rows] == [bound_solver().name, "greedy"]
    assert rows[0]["success"] == rows[0]["of_bound"] == 1
    assert rows[1]["of_bound"] == pytest.approx(rows[1]["success"])
    assert "of the bound" in bound_text({"task": "fish-swim", "rows": rows})
