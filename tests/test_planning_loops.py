"""The way out of loops."""

import numpy as np

from defplan_mj.planning.loops import LoopBreaker


def circle(loops, cycles, values=(2.0, 1.0, 0.0)):
    """Return the choices while the robot goes round a target 2 m away, always at the same place."""
    return [
        int(loops.adjust(np.array(values), np.array([2.0, 0.5])).argmax()) for _ in range(cycles)
    ]


def test_on_a_way_that_leads_on_values_stay_as_they_are():
    loops, values = LoopBreaker(), np.array([2.0, 1.0, 0.0])
    for distance in np.arange(20, 1, -0.6):
        assert np.array_equal(loops.adjust(values, np.array([distance, 0.0])), values)


def test_a_robot_that_turns_round_on_the_spot_is_not_in_a_loop_yet():
    loops, values = LoopBreaker(), np.array([2.0, 1.0, 0.0])
    for bearing in np.arange(0, 6, 0.6):
        target = 10 * np.array([np.cos(bearing), np.sin(bearing)])
        assert np.array_equal(loops.adjust(values, target), values)


def test_in_space_a_target_in_another_direction_is_another_place():
    loops, values = LoopBreaker(), np.array([2.0, 1.0, 0.0])
    directions = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [-1, 0, 0], [0, -1, 0], [0, 0, -1.0]])
    for direction in directions:
        assert np.array_equal(loops.adjust(values, 5 * direction), values)
    assert loops.adjust(values, 5 * directions[0])[0] < values[0]  # the first one again


def test_who_comes_back_to_the_same_place_tries_every_gait_in_turn():
    chosen = circle(LoopBreaker(), 30)
    assert chosen[:5] == [0] * 5 and set(chosen) == {0, 1, 2}


def test_the_order_of_first_choices_follows_the_values():
    chosen = circle(LoopBreaker(), 40)
    assert chosen.index(0) < chosen.index(1) < chosen.index(2)


def test_equal_values_do_not_keep_the_robot_in_a_loop():
    assert set(circle(LoopBreaker(), 30, values=(1.0, 1.0, 1.0))) == {0, 1, 2}


def test_a_reset_forgets():
    loops = LoopBreaker()
    circle(loops, 30)
    loops.reset()
    assert circle(loops, 5) == [0] * 5
