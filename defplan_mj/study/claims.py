"""The paper's claims, each with a verdict and the figures it rests on."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from defplan_mj.base.statistics import wilson_interval
from defplan_mj.planning.surrogate import Surrogate
from defplan_mj.report.content import duration, percent
from defplan_mj.report.sections.paper import paper_calls
from defplan_mj.study.measures import PUSH, falls
from defplan_mj.study.rows import Estimate, arrival_rates, mean, rate
from defplan_mj.study.sections import share
from defplan_mj.study.table import SPEEDS, Row, moving_name
from defplan_mj.task import TaskSpec

HOLDS, PART, NOT, OPEN = "holds", "holds in part", "does not hold here", "not measured"
UNDECIDED = "not decided by so few episodes"
_ITERATIONS = 10_000  # of DQL (paper, section V)
_LARGE = 0.25  # a deviation is small if it is below this share of the mean ...
_SMALL = 0.1  # ... or below this: rad and m


@dataclass(frozen=True)
class Claim:
    """A claim of the paper's.

    Attributes:
        text: what it says, in our words.
        verdict: HOLDS, PART, NOT, UNDECIDED or OPEN.
        evidence: figures.
    """

    text: str
    verdict: str
    evidence: str


@dataclass(frozen=True)
class Robot:
    """What there is on one of the paper's robots.

    Attributes:
        spec: the task.
        rows: of its runs, by the role of their planner.
        measures: of `measures.measured`; empty if there are none.
        surrogate: of the first run with the learned planner, or None.
    """

    spec: TaskSpec
    rows: Mapping[str, Sequence[Row]]
    measures: Mapping[str, Any]
    surrogate: Surrogate | None

    def of(self, role: str) -> Sequence[Row]:
        """Return the rows of a role."""
        return self.rows.get(role, ())

    @property
    def calls(self) -> tuple[float, float]:
        """How often an iteration of DQL calls f reduced and f_fit (Table II), by this task's figures."""
        navigation = self.spec.navigation
        cycles = float(navigation.k2 * navigation.max_cycles)
        return cycles * self.spec.steps_per_cycle, cycles


def _verdict(answers: Sequence[bool | None]) -> str:
    """Return the verdict of all robots; None: so few episodes do not decide it."""
    if not answers:
        return OPEN
    if all(one is None for one in answers):
        return UNDECIDED
    if all(answers):
        return HOLDS
    return NOT if not any(answers) and None not in answers else PART


def _evidence(how: str, figures: Sequence[str]) -> str:
    return (
        f"{how}: {'; '.join(figures)}"
        if figures
        else f"no run of this study has what it takes ({how})"
    )


def training_targets(robots: Sequence[Robot]) -> Claim:
    """All training targets are reached without a touch."""
    figures: list[str] = []
    good: list[bool | None] = []
    for robot in robots:
        checked = rate(robot.of("learned"), "k2_success", "k2_episodes")
        bare = rate(robot.of("learned"), "k2_unchecked_success", "k2_unchecked_episodes")
        if checked and bare:
            good.append(bare[0] == 1.0)
            figures.append(
                f"{robot.spec.name} {share(bare)}, with the collision check {share(checked)}"
            )
    return Claim("All training targets are reached without touching an obstacle.",
                 _verdict(good), _evidence("without the collision check", figures))  # fmt: skip


def surrogate_valid(robots: Sequence[Robot]) -> Claim:
    """The deviations of Table III are small."""
    figures: list[str] = []
    good: list[bool | None] = []
    for robot in robots:
        s = robot.surrogate
        if s is None:
            continue
        turns = (s.rotation_sd <= _SMALL) | (s.rotation_sd <= _LARGE * s.rotation_mean)
        ways = (s.translation_sd <= _SMALL) | (s.translation_sd <= _LARGE * s.translation_mean)
        good.append(bool(turns.all() and ways.all()))
        figures.append(
            f"{robot.spec.name} {int((turns & ways).sum())} of {len(turns)} gaits (largest"
            f" {s.rotation_sd.max():.3f} rad, {s.translation_sd.max():.3f} m)"
        )
    return Claim(
        "A cycle is nearly one rigid motion: the deviations of Table III are small beside the means, or small.",
        _verdict(good),
        _evidence(
            f"small: below {_SMALL} rad or m, or {percent(_LARGE)} of the mean",
            figures,
        ),
    )


def two_orders(robots: Sequence[Robot]) -> Claim:
    """f_fit is at least two orders of magnitude faster than f reduced, a cycle for a cycle."""
    figures: list[str] = []
    good: list[bool | None] = []
    for robot in robots:
        if not robot.measures:
            continue
        cycle = robot.measures["reduced_step_s"] * robot.spec.steps_per_cycle
        fit = robot.measures["surrogate_cycle_s"]
        good.append(cycle >= 100 * fit)
        figures.append(
            f"{robot.spec.name} {duration(cycle)} against {duration(fit)}, {cycle / fit:.0f}×"
        )
    return Claim(
        "The surrogate is at least two orders of magnitude faster than the reduced dynamics.",
        _verdict(good),
        _evidence(
            "processor time of a cycle of the reduced dynamics, without laser, against one of the "
            "surrogate, with it",
            figures,
        ),
    )


def direct_learning(robots: Sequence[Robot]) -> Claim:
    """DQL on the reduced dynamics itself takes more than 48 hours."""
    figures: list[str] = []
    good: list[bool | None] = []
    for robot in robots:
        if not robot.measures:
            continue
        reduced, _ = robot.calls
        seconds = _ITERATIONS * reduced * robot.measures["reduced_step_s"]
        good.append(seconds > 48 * 3600)
        text = f"{robot.spec.name} {duration(seconds)}"
        theirs = robot.spec.paper.get("reduced_step_s")
        calls = paper_calls(robot.spec.paper)
        if theirs and calls:
            text += f" (by the paper's own figures {duration(_ITERATIONS * calls[0] * theirs)})"
        figures.append(text)
    return Claim(
        "Deep Q-learning on the reduced dynamics itself takes more than 48 hours.",
        _verdict(good),
        _evidence(
            f"extrapolated, not run: {_ITERATIONS} iterations times the steps of one (Table II) times the "
            "processor seconds of a step, for the dynamics alone",
            figures,
        ),
    )


def faster_than_sampling(robots: Sequence[Robot]) -> Claim:
    """Much faster than a sampling-based planner."""
    figures: list[str] = []
    good: list[bool | None] = []
    for robot in robots:
        ours = mean(robot.of("learned"), "novel_decision")
        theirs = mean(robot.of("sampling"), "novel_decision")
        if ours and theirs:
            good.append(theirs[0] > 10 * ours[0])
            arrive = rate(robot.of("sampling"), "novel_success", "novel_episodes")
            figures.append(
                f"{robot.spec.name} {ours[0]:.2f} ms against {theirs[0]:.2f} ms a decision (it reaches"
                f" {share(arrive)})"
            )
    return Claim(
        "Much faster than a conventional sampling-based planner such as RRT.",
        _verdict(good),
        _evidence(
            "ten times counts as much; the median decision in unseen scenes, both with the collision check; "
            "the RRT has the full map, grows a tree over the surrogate's gaits and follows its way while that "
            "is free",
            figures,
        ),
    )


def open_loop(robots: Sequence[Robot], feedback: str) -> Claim:
    """Open loop is not robust enough for walkers."""
    figures: list[str] = []
    good: list[bool | None] = []
    for robot in robots:
        bare, closed = falls(dict(robot.measures), ("none", feedback))
        if bare is None or closed is None:
            continue
        apart = wilson_interval(*bare)[0] > wilson_interval(*closed)[1]
        good.append(True if apart else None if bare[0] > closed[0] else False)
        figures.append(f"{robot.spec.name} {bare[0]} falls of {bare[1]} cycles against {closed[0]}")
    return Claim(
        "An open-loop gait is not robust for walking; feedback is needed.",
        _verdict(good),
        _evidence(
            f"pushes of {PUSH} m/s once a cycle, open loop against feedback {feedback}; holds where the 95% "
            "intervals (Wilson) are apart",
            figures,
        ),
    )


def gets_stuck(robots: Sequence[Robot]) -> Claim:
    """Without global information it gets stuck."""
    figures: list[str] = []
    good: list[bool | None] = []
    for robot in robots:
        memoryless = rate(robot.of("memoryless"), "novel_timeout", "novel_episodes")
        bound = rate(robot.of("bound"), "novel_timeout", "novel_episodes")
        learned = rate(robot.of("learned"), "novel_timeout", "novel_episodes")
        if memoryless and bound:
            more = memoryless[0] > bound[0]
            good.append(True if memoryless[1] > bound[2] else None if more else False)
            figures.append(
                f"{robot.spec.name} {share(memoryless)} without memory, {share(learned)} learned,"
                f" {share(bound)} with the full map"
            )
    return Claim(
        "Without global information the body sometimes gets stuck.",
        _verdict(good),
        _evidence(
            "time-outs in unseen scenes, with the collision check; the learned planner here remembers where it "
            "was, the paper's did not",
            figures,
        ),
    )


def moving_limits(robots: Sequence[Robot]) -> Claim:
    """Limited capability with moving obstacles."""
    figures: list[str] = []
    good: list[bool | None] = []
    for robot in robots:
        rates = [rate(robot.of("learned"), moving_name(s), "moving_episodes") for s in SPEEDS]
        if all(rates):
            slow, fast = rates[0], rates[-1]
            assert slow is not None and fast is not None
            good.append(True if fast[2] < 1.0 else None if fast[0] < 1.0 else False)
            figures.append(
                f"{robot.spec.name} {share(slow)} at {SPEEDS[0]:g}, {share(fast)} at {SPEEDS[-1]:g} m/s"
            )
    return Claim(
        "A planner that was trained among still obstacles has limited success among moving ones.",
        _verdict(good),
        _evidence(
            "training targets, with the collision check",
            figures,
        ),
    )


def real_time(robots: Sequence[Robot]) -> Claim:
    """The planner runs in real time."""
    figures: list[str] = []
    good: list[bool | None] = []
    for robot in robots:
        factor: Estimate | None = mean(robot.of("learned"), "novel_real_time")
        if factor:
            good.append(factor[0] > 1)
            figures.append(f"{robot.spec.name} {factor[0]:.1f}×")
    return Claim(
        "Planning and the reduced simulation together run in real time.",
        _verdict(good),
        _evidence(
            "simulated seconds a second of decision, physics and collision checks on one core",
            figures,
        ),
    )


def within_a_day(robots: Sequence[Robot]) -> Claim:
    """Training takes less than a day."""
    figures: list[str] = []
    good: list[bool | None] = []
    for robot in robots:
        gait = mean(robot.of("learned"), "solver_seconds")
        planner = mean(robot.of("learned"), "planner_seconds")
        if gait and planner:
            good.append(gait[0] + planner[0] < 86400)
            figures.append(
                f"{robot.spec.name} {duration(gait[0])} gaits and {duration(planner[0])} planner"
            )
    return Claim(
        "Both stages of learning take less than a day on a desktop machine.",
        _verdict(good),
        _evidence(
            "wall time on this machine; of packaged gaits when they were made",
            figures,
        ),
    )


def recipe(robots: Sequence[Robot]) -> Claim:
    """The paper's own recipe gives such planners."""
    figures: list[str] = []
    good: list[bool | None] = []
    for robot in robots:
        arrivals = rate(robot.of("recipe"), "k2_unchecked_success", "k2_unchecked_episodes")
        if arrivals:
            good.append(arrivals[0] == 1.0)
            figures.append(f"{robot.spec.name} {share(arrivals)}")
    return Claim(
        "Its own recipe of deep Q-learning gives planners that reach all training targets.",
        _verdict(good),
        _evidence("trained by the paper's own recipe, all iterations", figures),
    )


def tunnel(runs: Mapping[str, Sequence[Row]]) -> Claim:
    """The CNN trained end to end steers through a tunnel; runs by what they are called, task and planner."""
    figures: list[str] = []
    good: list[bool | None] = []
    for name, rows in runs.items():
        rates = arrival_rates(rows)
        if rates[0] is None:
            continue
        good.append(rates[0][0] == 1.0)
        shares = [share(one) if one else "not run" for one in rates]
        figures.append(f"{name} {shares[0]}, unseen {shares[1]}, without the check {shares[2]}")
    return Claim(
        "The same gaits, with the planner trained anew end to end, swim through a tunnel (Fig. 7).",
        _verdict(good),
        _evidence(
            "holds if all training tunnels are gone through, with the collision check", figures
        ),
    )


CLAIMS: tuple[Callable[[Sequence[Robot]], Claim], ...] = (
    training_targets,
    surrogate_valid,
    two_orders,
    direct_learning,
    real_time,
    within_a_day,
    faster_than_sampling,
    gets_stuck,
    moving_limits,
    recipe,
)
