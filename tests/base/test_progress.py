"""How long work still takes is guessed from what is done, for each stage by itself."""

from __future__ import annotations

import pytest

from defplan_mj.base.progress import TimeLeft, duration


def test_time_left_follows_the_pace_of_the_stage():
    now = [100.0]
    left = TimeLeft(lambda: now[0])
    assert left("gait: forward", 0.0) is None
    now[0] += 10
    assert left("gait: forward", 0.01) is None  # too early to say
    now[0] += 10
    assert left("gait: left", 0.2) == pytest.approx(20 * 0.8 / 0.2)  # other detail, same stage
    now[0] += 30
    assert left("gait: left", 0.7) == pytest.approx(50 * 0.3 / 0.7)
    assert left("gait: left", 1.0) is None


def test_another_stage_or_a_step_back_begins_anew():
    now = [0.0]
    left = TimeLeft(lambda: now[0])
    left("body", 0.0)
    now[0] = 50
    assert left("gait: forward", 0.5) is None
    now[0] = 60
    assert left("gait: forward", 0.75) == pytest.approx(10)
    assert left("gait: forward", 0.1) is None
    now[0] = 61
    assert left("gait: forward", 0.4) == pytest.approx(2)


@pytest.mark.parametrize(
    ("seconds", "text"),
    [(0, "5 s"), (7, "5 s"), (42, "40 s"), (58, "1 min"), (150, "2 min"), (4790, "1 h 20 min")],
)
def test_a_duration_is_no_more_exact_than_a_guess(seconds, text):
    assert duration(seconds) == text
