"""The sections of a study's page."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from defplan_mj.base.errors import DefplanError
from defplan_mj.body.model import Body
from defplan_mj.pipeline.making import BODY_FILE
from defplan_mj.planning.outcome import ENDINGS
from defplan_mj.report.content import (
    Block,
    Code,
    Figures,
    Section,
    Table,
    Text,
    drawing,
    duration,
    number,
    percent,
)
from defplan_mj.study import figures
from defplan_mj.study.findings import Findings
from defplan_mj.study.rows import (
    Estimate,
    arrival_rates,
    gait_cost,
    grouped,
    mean,
    rate,
    scores,
    success,
)
from defplan_mj.study.statistics import (
    bootstrap_interval,
    interquartile_mean,
    mean_ranks,
    performance_profiles,
    probability_of_improvement,
)
from defplan_mj.study.table import COLUMNS, SPEEDS, STAGES, Row, moving_name

_INTERVAL = (
    "In brackets the 95% interval over seeds and episodes: the wider of Wilson's over all episodes and of "
    "a bootstrap that draws seeds first and then the episodes of each."
)
_SEEDS = (
    "Mean over seeds, of 2 to 10 of them the interquartile mean, in brackets its 95% bootstrap interval; one "
    "seed has none."
)


def arrivals(findings: Findings) -> Section | None:
    """Return the success of each task and method, with intervals."""
    groups = grouped(findings.rows)
    rows: list[list[str]] = []
    dots: dict[str, dict[str, Estimate]] = {}
    for task, methods in groups.items():
        for label, own in methods.items():
            trained, novel, unchecked = arrival_rates(own)
            if novel is None:
                continue
            dots.setdefault(task, {})[label] = novel
            failed = sum(bool(row["failed"]) for row in own)
            rows.append(
                [
                    f"{task}: {label}",
                    f"{len(own)}" + (f" ({failed} failed)" if failed else ""),
                    share(trained),
                    share(novel),
                    share(unchecked),
                    figure(mean(own, "novel_cycles"), 1),
                    figure(mean(own, "novel_decision"), 2),
                ]
            )
    if not rows:
        return None
    columns = ["task: method", "runs", "training targets", "unseen scenes", "without the check"]
    columns += ["cycles", "ms a decision"]
    return Section(
        "arrivals",
        "Does it arrive?",
        [
            drawing(
                figures.intervals_figure(dots, "episodes in unseen scenes that arrive (%)"),
                f"Success in unseen scenes with the collision check (shield). {_INTERVAL}",
            ),
            Table(
                columns,
                rows,
                f"Success, cycles of the successful episodes, and time of a decision. {_INTERVAL} {_SEEDS}",
            ),
        ],
    )


def comparison(findings: Findings) -> Section | None:
    """Return rank, interquartile mean and probability of improvement of the methods."""
    steers = any(row["novel_success"] is not None for row in findings.rows)
    by_label = scores(findings.rows, success if steers else lambda row: -gait_cost(row))
    if len(by_label) < 2:
        return None
    ranks = mean_ranks(by_label)
    rows = []
    for label, by_task in by_label.items():
        arrays = list(by_task.values())
        flat = np.concatenate(arrays)
        middle = interquartile_mean(flat) if np.isfinite(flat).all() else None
        low, high = (
            bootstrap_interval(arrays, lambda drawn: interquartile_mean(np.concatenate(drawn)))
            if middle is not None
            else (np.nan, np.nan)
        )
        rank = ranks.get(label)
        centre: Estimate | None = None if middle is None else (middle, low, high)
        shown = share(centre) if steers else figure(_negated(centre))
        rows.append([label, figure(rank, 2), shown, str(len(flat))])
    rows.sort(key=lambda row: row[1])
    what = (
        "success in unseen scenes"
        if steers
        else "re-simulated objective of the gaits, less is better"
    )
    blocks: list[Block] = [
        Table(
            ["method", "rank", "interquartile mean", "runs"],
            rows,
            f"By {what}; a failed run counts as the worst. Rank: 1 is the best, ties share, mean over the "
            "tasks that all methods have; interquartile mean over all tasks and seeds. In brackets 95% "
            "bootstrap intervals, each task's runs drawn among themselves.",
        )
    ]
    labels = list(by_label)
    if len(labels) <= 12:
        blocks.append(_improvements(labels, by_label))
    return Section("comparison", "Which is better?", blocks)


def _negated(estimate: Estimate | None) -> Estimate | None:
    return None if estimate is None else (-estimate[0], -estimate[2], -estimate[1])


def _improvements(labels: Sequence[str], by_label: dict[str, dict[str, np.ndarray]]) -> Table:
    rows = []
    for one in labels:
        cells = []
        for other in labels:
            try:
                estimate = probability_of_improvement(by_label[one], by_label[other])
            except ValueError:
                estimate = None
            cells.append("–" if one == other or estimate is None else share(estimate))
        rows.append([one, *cells])
    return Table(
        ["P(row better than column)", *labels],
        rows,
        "Probability that a run of the row's method is better than one of the column's on the same task, "
        "ties counting half (Mann and Whitney), mean over tasks, with 95% bootstrap intervals.",
    )


def gait_solvers(findings: Findings) -> Section | None:
    """Return what the gait solvers make of the same problems."""
    solvers = dict.fromkeys(row["gait_solver"] for row in findings.rows)
    if len(solvers) < 2 and findings.study.page != "optimisers":
        return None
    runs = _gait_runs(findings.rows)
    rows = []
    for (task, solver), own in runs.items():
        failed = sum(row["resimulated"] is None for row in own)
        rows.append(
            [
                f"{task}: {solver}",
                f"{len(own)}" + (f" ({failed} failed)" if failed else ""),
                *(figure(mean(own, name)) for name in ("objective", "resimulated")),
                *(figure(mean(own, name), 0) for name in ("evaluations", "iterations")),
                figure(mean(own, "solver_seconds"), 1),
                *(figure(mean(own, name)) for name in ("advance", "turn")),
                share(_falls(own)),
            ]
        )
    columns = ["task: gait solver", "seeds", "its objective", "re-simulated", "evaluations"]
    columns += ["iterations", "seconds", "advance (m)", "turn (rad)", "failed cycles"]
    blocks: list[Block] = [
        Text(
            "Every solver has the same problem, body and seed. What it claims counts for nothing until its "
            "gaits are simulated again, step by step, over sequences of tasks that no solver saw."
        ),
        Table(columns, rows, f"The gait solvers. {_SEEDS}"),
    ]
    if len(solvers) > 1:
        blocks += _profiles(findings.rows)
    points = {task: _points(findings, task) for task in findings.tasks}
    drawn = [figures.scatter_figure(pairs, task) for task, pairs in points.items() if pairs]
    if not drawn:
        return Section("gait-solvers", "Gait solvers", blocks)
    blocks.append(
        Figures(
            [drawing(figure) for figure in drawn],
            "Objective as re-simulated against the solver's wall time, a dot a seed; below and to the left is "
            "better.",
        )
    )
    return Section("gait-solvers", "Gait solvers", blocks)


def _gait_runs(rows: Sequence[Row]) -> dict[tuple[str, str], list[Row]]:
    """Return one row for each seed of each task and gait solver: runs that share gaits are one."""
    runs: dict[tuple[str, str], dict[int, Row]] = {}
    for row in rows:
        of_seed = runs.setdefault((row["task"], row["gait_solver"]), {})
        if row["seed"] not in of_seed or of_seed[row["seed"]]["resimulated"] is None:
            of_seed[row["seed"]] = row
    return {key: list(of_seed.values()) for key, of_seed in runs.items()}


def _profiles(rows: Sequence[Row]) -> list[Block]:
    runs = _gait_runs(rows)
    solvers = list(dict.fromkeys(solver for _, solver in runs))
    problems = sorted({(task, row["seed"]) for (task, _), own in runs.items() for row in own})
    drawn = []
    for name, label in (("resimulated", "objective"), ("solver_seconds", "seconds")):
        costs = {}
        for solver in solvers:
            costs_of = {
                (task, row["seed"]): row[name]
                for (task, own), many in runs.items()
                if own == solver
                for row in many
            }
            values = [costs_of.get(problem) for problem in problems]
            costs[solver] = [np.inf if v is None or v <= 0 else v for v in values]
        if np.isfinite(np.array(list(costs.values()))).any():
            drawn.append(drawing(figures.profile_figure(*performance_profiles(costs), label)))
    caption = (
        f"Performance profiles (Dolan and Moré) over {len(problems)} problems, a task and a seed each: the share "
        "of problems that a solver does within so many times what the best one needs. A solver that failed, or "
        "was not run, never does."
    )
    return [Figures(drawn, caption)] if drawn else []


def _points(findings: Findings, task: str) -> dict[str, list[tuple[float, float]]]:
    """Return seconds and objective of each run, by solver; only of solvers that have any."""
    pairs_of = {
        solver: [
            (row["solver_seconds"], row["resimulated"])
            for row in own
            if row["solver_seconds"] and row["resimulated"] is not None
        ]
        for (of, solver), own in _gait_runs(findings.rows).items()
        if of == task
    }
    return {solver: pairs for solver, pairs in pairs_of.items() if pairs}


def _falls(rows: Sequence[Row]) -> Estimate | None:
    counted = [dict(row) for row in rows if row["gait_cycles"]]
    for row in counted:
        row["gait_falls"] = row["gait_falls"] / row["gait_cycles"]
    return rate(counted, "gait_falls", "gait_cycles")


def moving(findings: Findings) -> Section | None:
    """Return success among moving obstacles."""
    drawn = []
    for task, methods in grouped(findings.rows).items():
        curves = {}
        for label, own in methods.items():
            rates = [(s, rate(own, moving_name(s), "moving_episodes")) for s in SPEEDS]
            if all(estimate is not None for _, estimate in rates):
                curves[label] = [(s, *estimate) for s, estimate in rates if estimate]
        if curves:
            drawn.append(drawing(figures.moving_figure(curves, task)))
    if not drawn:
        return None
    caption = (
        "Training targets with the collision check, among obstacles that move, each in its own random "
        "direction, as in the paper's Fig. 6. Bands: 95% intervals over seeds and episodes."
    )
    return Section("moving", "Among moving obstacles", [Figures(drawn, caption)])


def failures(findings: Findings) -> Section | None:
    """Return failures by kind: how episodes end, and which runs failed."""
    blocks: list[Block] = []
    shares = {
        f"{task}: {label}": _endings(own)
        for task, methods in grouped(findings.rows).items()
        for label, own in methods.items()
    }
    if any(row["novel_episodes"] for row in findings.rows) and len(shares) <= 60:
        blocks.append(
            drawing(
                figures.endings_figure(shares),
                "How the episodes in unseen scenes end, with the collision check. Not run: those of runs "
                "that failed.",
            )
        )
    failed = [row for row in findings.rows if row["failed"]]
    if failed:
        rows = [[f"{row['folder']} ({row['failed_in']})", row["error"]] for row in failed[:100]]
        more = f" The first 100 of {len(failed)}." if len(failed) > 100 else ""
        blocks.append(Table(["run (stage)", "sentence"], rows, f"Runs that failed.{more}"))
    return Section("failures", "Failures by kind", blocks) if blocks else None


def _endings(rows: Sequence[Row]) -> dict[str, float]:
    """Return the share of each ending among the episodes of all these runs."""
    evaluated = [row for row in rows if row["novel_episodes"]]
    if not evaluated:
        return {"not run": 1.0}
    part = len(evaluated) / len(rows)
    shares = {
        ending.value: part * float(np.mean([row[f"novel_{ending}"] or 0.0 for row in evaluated]))
        for ending in ENDINGS
    }
    return {**shares, "not run": 1 - part}


def robots(findings: Findings) -> Section | None:
    """Return a picture of each robot."""
    drawn = []
    for task in findings.tasks:
        body = _body(findings.root, [row for row in findings.rows if row["task"] == task])
        if body is not None:
            drawn.append(drawing(figures.robot_figure(body, task), shaded=True))
    if not drawn:
        return None
    return Section(
        "robots", "The robots", [Figures(drawn, "The bodies at rest, each made of its mesh.")]
    )


def _body(root: Path, rows: Sequence[Row]) -> Body | None:
    for row in rows:
        try:
            return Body.load(root / row["folder"] / BODY_FILE)
        except DefplanError:
            continue
    return None


def times(findings: Findings) -> Section | None:
    """Return the seconds of each stage."""
    rows = []
    for task, methods in grouped(findings.good).items():
        for label, own in methods.items():
            means = [mean(own, f"{stage}_seconds") for stage in STAGES]
            rows.append(
                [f"{task}: {label}", *("–" if t is None else duration(t[0]) for t in means)]
            )
    if not rows:
        return None
    caption = (
        "Wall time of each stage, mean over seeds (interquartile of 2 to 10). A stage that several runs share "
        "was made once, and counts with the time it took then."
    )
    return Section("times", "Seconds per stage", [Table(["task: method", *STAGES], rows, caption)])


def making(findings: Findings) -> Section | None:
    """Return how the study was made, and what the table's columns are."""
    blocks: list[Block] = []
    if findings.study.file.is_file():
        blocks.append(Code(findings.study.file.read_text(encoding="utf-8")))
    texts = [[f"{c.name}" + (f" ({c.unit})" if c.unit else ""), c.text] for c in COLUMNS]
    caption = (
        "The columns of the table of runs, runs.parquet and runs.csv; episodes.parquet has a row for each "
        "episode."
    )
    return Section("making", "How this was made", [*blocks, Table(["column", ""], texts, caption)])


SECTIONS = (
    arrivals,
    comparison,
    gait_solvers,
    moving,
    failures,
    robots,
    times,
    making,
)


def share(estimate: Estimate | None) -> str:
    """Return a share with its interval, in percent."""
    if estimate is None:
        return "–"
    centre, low, high = estimate
    if not np.isfinite([low, high]).all():
        return percent(centre)
    return f"{percent(centre)} ({100 * low:.0f}–{100 * high:.0f}%)"


def figure(estimate: Estimate | None, digits: int = 3) -> str:
    """Return a number with its interval."""
    if estimate is None:
        return "–"
    centre, low, high = estimate
    if not np.isfinite([low, high]).all() or low == high:
        return number(centre, digits)
    return f"{number(centre, digits)} ({number(low, digits)}–{number(high, digits)})"
