"""The verdicts on the paper's claims follow the figures, and say so where these do not decide."""

from __future__ import annotations

import pytest

from defplan_mj import registry
from defplan_mj.report.sections.paper import paper_calls
from defplan_mj.study import claims
from defplan_mj.study.claims import HOLDS, NOT, OPEN, PART, UNDECIDED, Robot
from defplan_mj.study.table import Row, complete
from tests.samples import planning as samples


def robot(measures=None, surrogate=None, **rows) -> Robot:
    """Return what there is on the fish; `rows` are columns by role."""
    told: dict[str, list[Row]] = {
        role: [complete({"task": "fish-swim", "seed": 0, "failed": False, **columns})]
        for role, columns in rows.items()
    }
    return Robot(registry.get_task("fish-swim"), told, measures or {}, surrogate)


def k2(share: float, n: int = 10) -> dict:
    """Return a row's columns of training targets."""
    told: dict[str, float] = {}
    for name in ("k2", "k2_unchecked"):
        told |= {f"{name}_episodes": n, f"{name}_success": share}
    return told


def test_training_targets_are_judged_without_the_collision_check():
    all_of_them, most = robot(learned=k2(1.0)), robot(learned=k2(0.9))
    assert claims.training_targets([all_of_them]).verdict == HOLDS
    assert claims.training_targets([most]).verdict == NOT
    told = claims.training_targets([all_of_them, most])
    assert told.verdict == PART and "fish-swim 90%" in told.evidence
    assert claims.training_targets([robot()]).verdict == OPEN


@pytest.mark.parametrize(("scatter", "verdict"), [(0.05, HOLDS), (0.4, NOT)])
def test_a_surrogate_is_valid_if_its_deviations_are_small(scatter, verdict):
    found = robot(surrogate=samples.surrogate(scatter=scatter))
    assert claims.surrogate_valid([found]).verdict == verdict


def test_speed_and_hours_are_those_of_the_measured_steps():
    slow = {"reduced_step_s": 1e-3, "surrogate_cycle_s": 1e-6}
    told = claims.two_orders([robot(slow)])
    assert told.verdict == HOLDS and f"{32 * 1000}×" in told.evidence
    assert claims.two_orders([robot({**slow, "surrogate_cycle_s": 1e-3})]).verdict == NOT
    # 10,000 iterations of 10 targets, 200 cycles, 32 steps: 640 million steps
    assert "177.8 h" in claims.direct_learning([robot(slow)]).evidence
    assert claims.direct_learning([robot({**slow, "reduced_step_s": 1e-5})]).verdict == NOT


def test_the_papers_own_counts_are_those_of_its_table_two():
    counted = {
        name: paper_calls(registry.get_task(name).paper) for name in ("fish-swim", "tee-walk")
    }
    assert counted == {"fish-swim": (22_000, 2_000), "tee-walk": (92_000, 4_000)}
    assert paper_calls(registry.get_task("quadruped-swim").paper) == (216_000, 24_000)


def timeouts(share: float, n: int) -> dict:
    return {"novel_episodes": n, "novel_timeout": share}


def test_getting_stuck_is_decided_only_by_enough_episodes():
    few = robot(memoryless=timeouts(0.2, 10), bound=timeouts(0.0, 10))
    many = robot(memoryless=timeouts(0.2, 400), bound=timeouts(0.0, 400))
    none = robot(memoryless=timeouts(0.0, 400), bound=timeouts(0.0, 400))
    verdicts = [claims.gets_stuck([one]).verdict for one in (few, many, none)]
    assert verdicts == [UNDECIDED, HOLDS, NOT]


def test_open_loop_is_compared_with_feedback_among_pushes():
    rows = [
        {"condition": condition, "feedback": feedback, "falls": falls, "cycles": 60}
        for condition, feedback, falls in (
            ("calm", "none", 60), ("pushes", "none", 40), ("pushes", "ilqg", 2)
        )
    ]  # fmt: skip
    told = claims.open_loop([robot({"robustness": rows})], "ilqg")
    assert told.verdict == HOLDS and "40 falls of 60 cycles against 2" in told.evidence
    assert claims.open_loop([robot({"robustness": rows[:1]})], "ilqg").verdict == OPEN


def test_a_limit_among_moving_obstacles_needs_an_interval_below_all():
    speeds = {
        f"moving_{s:g}_success": v for s, v in zip((0.25, 0.5, 1, 2), (1, 1, 1, 0.5), strict=True)
    }
    many = robot(learned={**speeds, "moving_episodes": 200})
    few = robot(learned={**speeds, "moving_2_success": 0.5, "moving_episodes": 2})
    assert claims.moving_limits([many]).verdict == HOLDS
    assert claims.moving_limits([few]).verdict == UNDECIDED


def test_a_tunnel_is_gone_through_or_not_by_its_own_runs():
    name, unseen = "fish-tunnel, dql-cnn", {"novel_episodes": 16, "novel_success": 0.75}
    unseen |= {"novel_unchecked_episodes": 16, "novel_unchecked_success": 0.5}
    through, stuck = ({name: [k2(share) | unseen]} for share in (1.0, 0.5))
    told = claims.tunnel(through)
    assert told.verdict == HOLDS and f"{name} 100%" in told.evidence and "75%" in told.evidence
    assert claims.tunnel(stuck).verdict == NOT
    assert claims.tunnel({}).verdict == OPEN


def test_every_claim_is_told_even_if_nothing_was_run():
    for claim in claims.CLAIMS:
        told = claim([robot()])
        assert told.verdict == OPEN and told.text and told.evidence
