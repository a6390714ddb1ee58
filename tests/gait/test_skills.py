"""The verdict on gaits: sign, size, spread, falls; and whether what is left can steer."""

from __future__ import annotations

import numpy as np
import pytest

from defplan_mj.base.space import SPACES
from defplan_mj.gait.skills import can_steer, faults, goes, judge
from defplan_mj.gait.switching import Switching
from defplan_mj.task import GaitTask

FORWARD = GaitTask("forward", move=(0.5, 0, 0))
LEFT = GaitTask("left", turn=(0, 0, 0.6), move=(0.3, 0, 0))
RIGHT = GaitTask("right", turn=(0, 0, -0.6), move=(0.3, 0, 0))
BACK = GaitTask("back", move=(-0.5, 0, 0))


def switched(tasks, advance, turn, spread=0.0, fallen=0, space="planar"):
    """Return a switching in which task j advances and turns as told, plus and minus a spread."""
    cycles = 20
    task = np.repeat(np.arange(len(tasks)), cycles)
    sign = np.tile([1.0, -1.0], len(task) // 2)
    move, turns = np.zeros((len(task), 3)), np.zeros((len(task), 3))
    for j, one in enumerate(tasks):
        mine = task == j
        move[mine] = np.outer(advance[j] + spread * sign[mine], one.direction)
        axis = (0, 0, 1) if space == "planar" else one.turn_axis
        turns[mine] = np.outer(turn[j] + spread * sign[mine], axis)
    tilt = np.zeros(len(task))
    tilt[2 : 2 + fallen] = 1.0
    down = np.zeros(len(task), bool)
    return Switching(tuple(tasks), SPACES[space], 1.0, task, move, turns, tilt, down)


def test_gaits_that_do_what_they_are_called_are_kept():
    skills = judge(switched((FORWARD, LEFT, RIGHT, BACK), (0.3, 0.1, 0.1, 0.4), (0, 0.35, -0.9, 0)))
    assert all(skill.kept for skill in skills) and not faults(skills)
    told = skills[2].to_json()
    assert told["wanted"] == {"advance_m": 0.3, "turn_rad": -0.6}
    assert told["got"]["turn_rad"] == pytest.approx(-0.9) and told["kept"] is True
    assert (told["got"]["falls"], told["got"]["cycles"]) == (0, 20)


@pytest.mark.parametrize(
    ("change", "fault"),
    [
        ({"turn": (0, 0.6, 0.21)}, "right turns the wrong way: +0.21 rad a cycle, wanted -0.60"),
        ({"turn": (0, 0.19, -0.6)}, "left turns 0.19 rad a cycle, under a third of the 0.60 wanted"),
        ({"advance": (-0.1, 0.3, 0.3)}, "forward goes the wrong way: -0.10 m a cycle"),
        ({"advance": (0.16, 0.3, 0.3)}, "forward goes 0.16 m a cycle, under a third of the 0.50 wanted"),
        ({"fallen": 5}, "forward falls in 5 of 20 cycles"),
        ({"spread": 0.55}, "forward goes 0.50 m a cycle, but varies by 0.55"),
    ],
)  # fmt: skip
def test_a_gait_that_does_not_is_called_that(change, fault):
    given = {"advance": (0.5, 0.3, 0.3), "turn": (0, 0.6, -0.6), **change}
    skills = judge(switched((FORWARD, LEFT, RIGHT), **given))
    assert fault in faults(skills)
    assert sum(not skill.kept for skill in skills) == 1


def test_in_space_a_turn_is_about_the_task_s_own_axis():
    front = GaitTask("front", turn=(0, 0.4, 0), move=(0, 0, 0))
    back = GaitTask("back", turn=(0, -0.4, 0), move=(0, 0, 0))
    skills = judge(switched((front, back), (0, 0), (0.3, -0.3), space="spatial"))
    assert [skill.kept for skill in skills] == [True, False]
    assert skills[1].wanted["turn_rad"] == pytest.approx(0.4)  # about its own axis


def test_gaits_that_only_turn_get_nowhere():
    turning = judge(switched((FORWARD, LEFT, RIGHT), (0.02, 0.02, 0.02), (0, 0.6, -0.6)))
    assert [skill.kept for skill in turning] == [False, True, True] and not goes(turning)
    bent = judge(switched((FORWARD, LEFT, RIGHT), (0.02, 0.2, 0.2), (0, 0.6, -0.6)))
    assert not bent[0].kept and goes(bent)


def test_what_can_steer():
    axis = (1.0, 0.0, 0.0)
    planar = lambda *tasks: can_steer(tasks, "planar", axis)  # noqa: E731
    assert planar(FORWARD, LEFT, RIGHT) and planar(LEFT, RIGHT) and planar(FORWARD, LEFT)
    assert not planar(FORWARD) and not planar(LEFT) and not planar()
    aside = [GaitTask(n, move=(0, y, 0)) for n, y in (("left", 0.4), ("right", -0.4))]
    assert planar(FORWARD, BACK, *aside)
    assert not planar(FORWARD, *aside) and not planar(FORWARD, BACK)
    tilts = [GaitTask(str(i), turn=t, move=(0, 0, 0)) for i, t in enumerate(np.eye(3) * 0.4)]
    spatial = lambda *tasks: can_steer(tasks, "spatial", axis)  # noqa: E731
    assert spatial(FORWARD, tilts[1], tilts[2])
    assert not spatial(FORWARD, tilts[1]) and not spatial(tilts[1], tilts[2])
    assert not spatial(FORWARD, tilts[0], tilts[1])  # a roll tilts nothing
