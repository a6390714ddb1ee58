"""The study of the paper: its claims, Tables I to III and Figures 4 to 7, beside what is measured here.

The paper is Pan and Manocha, Realtime Planning for High-DOF Deformable Bodies using Two-Stage Learning; its
figures are those of the tasks' `paper`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from defplan_mj.base.errors import DefplanError
from defplan_mj.body.model import Body
from defplan_mj.gait.gait import Gait
from defplan_mj.log.reader import EpisodeLog, read_log
from defplan_mj.pipeline.making import BODY_FILE, GAIT_FILE, SURROGATE_FILE
from defplan_mj.planning.surrogate import Surrogate
from defplan_mj.report.content import (
    Block,
    Figures,
    Missing,
    Section,
    Table,
    Text,
    drawing,
    duration,
)
from defplan_mj.report.figures.gaits import controls_figure, path_figures, play
from defplan_mj.report.figures.planning import overview_figures, reward_figure
from defplan_mj.report.material import training_curves
from defplan_mj.report.sections.paper import paper_calls
from defplan_mj.report.sections.surrogate import COLUMNS as TABLE_THREE
from defplan_mj.report.sections.surrogate import table_three
from defplan_mj.study.claims import CLAIMS, Robot, open_loop, tunnel
from defplan_mj.study.findings import Findings
from defplan_mj.study.measures import measured
from defplan_mj.study.rows import arrival_rates, mean
from defplan_mj.study.sections import moving, share
from defplan_mj.study.table import Row
from defplan_mj.taskfile.find import find_task

PLANNERS = ("learned", "memoryless", "sampling", "bound", "recipe")


def sections(findings: Findings) -> list[Section]:
    """Return the sections on the paper; what a run did not leave is named."""
    open_water: list[str] = []
    places: list[str] = []
    for source in findings.study.tasks:
        (places if find_task(source).navigation.scenes else open_water).append(source)
    robots = [_robot(findings, source) for source in open_water]
    return [
        _claims(findings, robots, _in_places(findings, places)),
        _table_one(robots),
        _table_two(robots),
        _table_three(robots),
        _figure_four(findings, robots),
        _figure_five(findings, robots),
        _figure_six(findings, robots),
        _figure_seven(findings, places),
    ]


def _robot(findings: Findings, source: str) -> Robot:
    spec, roles = find_task(source), findings.study.roles
    own = [row for row in findings.good if row["task"] == spec.name]
    rows = {role: [row for row in own if row["planner"] == roles.get(role)] for role in PLANNERS}
    folder = _folder(findings, rows["learned"] or own)
    measures: dict[str, Any] = {}
    surrogate = None
    if folder is not None:
        try:
            surrogate = Surrogate.load(folder / SURROGATE_FILE)
            feedback = roles.get("feedback", "")
            measures = measured(findings.root, spec, folder, feedback, findings.progress)
        except DefplanError:
            pass  # the page names what is missing
    return Robot(spec, rows, measures, surrogate)


def _folder(findings: Findings, rows: Sequence[Row]) -> Path | None:
    return findings.root / rows[0]["folder"] if rows else None


def _in_places(findings: Findings, places: Sequence[str]) -> dict[str, list[Row]]:
    """Return the runs in scenes that gaits were not made for, by task and planner."""
    by_label: dict[str, list[Row]] = {}
    for source in places:
        name = find_task(source).name
        for row in findings.good:
            if row["task"] == name:
                by_label.setdefault(f"{name}, {row['planner']}", []).append(row)
    return by_label


def _claims(
    findings: Findings, robots: Sequence[Robot], in_places: Mapping[str, Sequence[Row]]
) -> Section:
    claims = [claim(robots) for claim in CLAIMS]
    claims.append(tunnel(in_places))
    claims.insert(7, open_loop(robots, findings.study.roles.get("feedback", "")))
    rows = [[claim.text, f"{claim.verdict.capitalize()}. {claim.evidence}."] for claim in claims]
    return Section(
        "claims",
        "The claims",
        [
            Text(
                "The paper's claims in our words, each with a verdict and what it rests on. Bodies, drag, contact "
                "and periods of the paper's robots are not all given, so equal figures are not to be expected; "
                "in brackets 95% intervals over seeds and episodes."
            ),
            Table(["claim", "verdict and evidence"], rows),
        ],
    )


def _table_one(robots: Sequence[Robot]) -> Section:
    rows = []
    for robot in robots:
        paper, spec = robot.spec.paper, robot.spec
        learned = robot.of("learned")
        hours = {
            n: 3600 * paper[f"{n}_h"] for n in ("gait", "planner", "features") if f"{n}_h" in paper
        }
        learning = mean(learned, "planner_seconds")
        gait = mean(learned, "solver_seconds")
        rows.append(
            [
                f"{spec.name}, paper",
                str(paper.get("vertices", "–")),
                str(paper.get("dof", "–")),
                duration(paper.get("full_step_s")),
                duration(paper.get("reduced_step_s")),
                str(len(paper.get("tasks", ()))),
                str(paper.get("gait_steps", "–")),
                str(paper.get("wavelets", "–")),
                duration(hours.get("gait")),
                duration(hours.get("planner")),
                duration(hours.get("features")),
            ]
        )
        one = learned[0] if learned else {}
        rows.append(
            [
                f"{spec.name}, here",
                str(one.get("vertices", "–")),
                str(6 + one["modes"]) if one.get("modes") else "–",
                duration(robot.measures.get("full_step_s")),
                duration(robot.measures.get("reduced_step_s")),
                str(one.get("gaits", "–")),
                str(spec.gait_steps),
                str(robot.measures.get("elements", "–")),
                duration(gait[0] if gait else None),
                duration(learning[0] if learning else None),
                "–",
            ]
        )
    columns = ["robot", "vertices", "|x̄|", "f", "f̄", "K₁", "N₁", "D", "gaits", "DQL", "CNN"]
    caption = (
        "Table I. Costs of a step of the full dynamics f and the reduced f̄, of gaits, of deep Q-learning and of "
        "the CNN's pretraining. The paper's machine had 8 cores; here a step is processor time. The planner "
        "here has no CNN that is trained before. Seconds of packaged gaits are those of when they were made."
    )
    return Section("table-1", "Table I: costs", [Table(columns, rows, caption)])


def _table_two(robots: Sequence[Robot]) -> Section:
    rows = []
    for robot in robots:
        spec, paper = robot.spec, robot.spec.paper
        navigation, theirs = spec.navigation, paper_calls(paper)
        if theirs:
            rows.append(
                [f"{spec.name}, paper", str(paper["k2"]), str(paper["n2_cycles"]), _thousands(paper["memory"]),
                 str(paper["steps_per_cycle"]), _thousands(theirs[0]), _thousands(theirs[1])]
            )  # fmt: skip
        reduced, fit = robot.calls
        rows.append(
            [f"{spec.name}, here", str(navigation.k2), str(navigation.max_cycles), _thousands(10 * fit),
             str(spec.steps_per_cycle), _thousands(reduced), _thousands(fit)]
        )  # fmt: skip
    columns = ["robot", "K₂", "N₂ (cycles)", "memory", "steps a cycle", "# f̄", "# f_fit"]
    caption = (
        "Table II. Deep Q-learning by iterations as the paper does it: training targets, cycles of a trajectory, "
        "transitions kept, and calls of either dynamics in an iteration, K₂ N₂ times the steps of a cycle or "
        "once. Here: what the same scheme would call with this task's figures; the default planner "
        "here trains otherwise."
    )
    return Section(
        "table-2", "Table II: parameters of the training", [Table(columns, rows, caption)]
    )


def _thousands(value: float) -> str:
    return f"{value / 1000:g}k"


def _table_three(robots: Sequence[Robot]) -> Section:
    rows = []
    for robot in robots:
        if robot.surrogate is not None:
            rows += table_three(robot.surrogate, robot.spec.paper, f"{robot.spec.name}: ")
    caption = "Table III. A cycle's rotation and translation, mean ± standard deviation, of the first seed."
    blocks: list[Block] = (
        [Table(TABLE_THREE, rows, caption)] if rows else [Missing("No surrogate is there.")]
    )
    return Section("table-3", "Table III: the surrogate", blocks)


def _figure_four(findings: Findings, robots: Sequence[Robot]) -> Section:
    blocks: list[Block] = []
    for robot in robots:
        folder = _folder(findings, robot.of("learned"))
        if folder is None:
            continue
        try:
            body, gait = Body.load(folder / BODY_FILE), Gait.load(folder / GAIT_FILE)
        except DefplanError as error:
            blocks.append(Missing(f"{error}."))
            continue
        dynamics, space = robot.spec.dynamics(body), robot.spec.navigation.space
        drawn = []
        for task in range(len(gait.task_names)):
            states = play(gait, task, dynamics, 5 * gait.steps_per_cycle)
            drawn.append(drawing(controls_figure(gait, task)))
            drawn.append(drawing(path_figures(gait, task, dynamics, states, space)[0]))
        blocks.append(
            Figures(
                drawn,
                f"{robot.spec.name}: the commands of each gait over two cycles, and the path of the centre of "
                "mass over five cycles from rest, as in the paper's Fig. 4.",
            )
        )
    return Section("figure-4", "Figure 4: gaits", blocks or [Missing("No gaits are there.")])


def _figure_five(findings: Findings, robots: Sequence[Robot]) -> Section:
    drawn = []
    for robot in robots:
        for row in robot.of("learned")[:1]:
            figure = reward_figure(training_curves(findings.root / row["folder"], row["planner"]))
            if figure is not None:
                figure.axes[0].set_title(robot.spec.name, loc="left")
                drawn.append(drawing(figure))
    if not drawn:
        return Section("figure-5", "Figure 5: learning", [Missing("No training curves are there.")])
    caption = (
        "Reward (Eq. 2) at the training targets during the training, first seed: mean in red between minimum and "
        "maximum, as in the paper's Fig. 5, whose abscissa is iterations."
    )
    return Section("figure-5", "Figure 5: learning", [Figures(drawn, caption)])


def _figure_six(findings: Findings, robots: Sequence[Robot]) -> Section:
    section = Section("figure-6", "Figure 6: moving obstacles, and trajectories")
    above = moving(findings)
    section.blocks += (
        above.blocks if above else [Missing("Nothing was tried among moving obstacles.")]
    )
    for robot in robots:
        for row in robot.of("learned")[:1]:
            logs = _logs(findings.root / row["folder"])
            if logs:
                section.blocks.append(
                    Figures(
                        [drawing(figure) for figure in overview_figures(logs)],
                        f"{robot.spec.name}: {len(logs)} logged episodes in unseen scenes and at training "
                        "targets, paths green, obstacles blue, targets red.",
                    )
                )
    return section


def _figure_seven(findings: Findings, places: Sequence[str]) -> Section:
    """Return how the robot fares in scenes that its gaits were not made for."""
    title = "Figure 7: a tunnel"
    rows: list[list[str]] = []
    blocks: list[Block] = []
    for source in places:
        spec = find_task(source)
        mine = _in_places(findings, [source])
        for own in mine.values():
            shares = [share(figure) for figure in arrival_rates(own)]
            rows.append([spec.name, own[0]["planner"], spec.navigation.scenes, *shares])
        first = next(iter(mine.values()), [])
        if first and (logs := _logs(findings.root / first[0]["folder"])):
            drawn = [drawing(figure) for figure in overview_figures(logs)]
            blocks.append(
                Figures(drawn, f"{spec.name}: {len(logs)} logged episodes, as in Fig. 7.")
            )
    if not rows:
        missing = "The paper's fish swims through a tunnel; this study has no run in such scenes."
        return Section("figure-7", title, [Missing(missing)])
    columns = [
        "robot",
        "planner",
        "scenes",
        "training targets",
        "unseen scenes",
        "without the check",
    ]
    caption = (
        "Scenes that the gaits were not made for: only the planner is trained anew, the CNN end to end. With the "
        "collision check, and unseen scenes without it."
    )
    return Section("figure-7", title, [Table(columns, rows, caption), *blocks])


def _logs(folder: Path) -> list[EpisodeLog]:
    logs = []
    for path in sorted(folder.glob("[!.]*.mcap")):
        try:
            logs.append(read_log(path))
        except DefplanError:
            continue
    return logs
