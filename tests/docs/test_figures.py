"""Figures in the documentation are those of the files that they come from."""

from __future__ import annotations

import csv
import re

import numpy as np
import pytest

from defplan_mj.log.schemas import FORMAT_VERSION
from defplan_mj.registry import get_task
from defplan_mj.studies import check, scores, scores_navigate
from tests.samples.paths import ROOT

README = (ROOT / "README.md").read_text()
ROBOTS = ("fish-swim", "quadruped-swim", "tee-walk", "quadruped-walk")
"""In the order of the README's columns."""


def row(text: str, start: str) -> list[str]:
    """Return the cells of the table row whose first cell starts so, without that one."""
    found = re.search(rf"^\| {re.escape(start)}[^|]*\|(.*)\|$", text, re.MULTILINE)
    assert found, start
    return [cell.strip() for cell in found[1].split("|")]


def numbers(text: str) -> list[float]:
    """Return the numbers of a text."""
    return [float(number) for number in re.findall(r"-?\d+(?:\.\d+)?", text)]


def test_the_readme_s_sizes_are_those_of_the_packaged_bodies():
    told = [numbers(cell) for cell in row(README, "vertices / modal coordinates")]
    robots = [check.packaged_robot(get_task(name)) for name in ROBOTS]
    assert told == [[len(r.body.vertices), r.body.n_modes] for r in robots]


@pytest.mark.parametrize(
    ("start", "name"), [("full FEM step", "full_step_s"), ("gaits ", "gait_h")]
)
def test_the_readme_s_figures_of_the_paper_are_those_of_the_tasks(start, name):
    told = [numbers(cell)[0] for cell in row(README, start)]
    assert told == [get_task(robot).paper[name] for robot in ROBOTS]


@pytest.mark.parametrize(
    ("start", "name", "gaits", "kinds"),
    [
        ("fish: forward", "fish-swim", ("forward", "left", "right"), ("advance", "turn")),
        ("4-legged swimmer: front", "quadruped-swim", ("front", "back", "left", "right"), ("turn",)),
        ("4-legged swimmer: forward", "quadruped-swim", ("forward",), ("advance",)),
        ("4-legged walker: forward", "quadruped-walk", ("forward", "back", "left", "right"), ("advance",)),
        ("T: forward", "tee-walk", ("forward", "back", "left", "right"), ("advance",)),
    ],
)  # fmt: skip
def test_the_readme_s_gaits_do_what_it_says(start, name, gaits, kinds):
    spec = get_task(name)
    robot = check.packaged_robot(spec)
    told = re.findall(r"-?\d+\.\d+", row(README, start)[0])
    does = []
    for gait in gaits:
        shapes = robot.gait.table()[robot.gait.task_names.index(gait)]
        shapes = np.tile(shapes, (check.SETTLE + check.CYCLES, 1))
        states = robot.dynamics.rollout(robot.dynamics.rest_state(), shapes)
        motion = check._judged(spec, check._task(spec, gait), states, robot.gait)
        does += [getattr(motion, kind) for kind in kinds]
    assert len(told) == len(does)
    for text, value in zip(told, does, strict=True):
        last = 10.0 ** -len(text.partition(".")[2])  # what the last digit stands for
        # signs of turns are told where they say to which side
        assert abs(float(text)) == pytest.approx(abs(value), abs=0.6 * last), (text, value)


SHAPES = {
    "FishSwim": "fish-swim",
    "QuadrupedSwim": "quadruped-swim",
    "QuadrupedWalk": "quadruped-walk",
}
GAITS = {
    "FishNavigate": "fish-swim",
    "QuadrupedNavigate3d": "quadruped-swim",
    "QuadrupedNavigate": "quadruped-walk",
}


@pytest.mark.parametrize(("title", "name"), [*SHAPES.items(), *GAITS.items()])
def test_the_gymnasium_page_s_steps_and_actions_are_those_of_the_packaged_gaits(title, name):
    page = (ROOT / "docs" / "gymnasium.md").read_text()
    *_, action, step = row(page, f"`defplan/{title}-v0`")
    gait = check.packaged_robot(get_task(name)).gait
    if title in SHAPES:
        assert f"({gait.table().shape[2]},)" in action
        assert numbers(step) == [pytest.approx(gait.timestep)]
    else:
        assert action == f"`Discrete({len(gait.task_names)})`: {', '.join(gait.task_names)}"
        assert numbers(step) == [pytest.approx(gait.cycle_seconds, abs=0.006)]


def test_the_log_page_names_today_s_format():
    assert f"log format ({FORMAT_VERSION})" in (ROOT / "docs" / "logs.md").read_text()


def test_the_readme_s_moving_pictures_are_small():
    pictures = sorted((ROOT / "docs" / "images").glob("*.webp"))
    assert [path.stem for path in pictures] == sorted(ROBOTS)
    assert all(path.stat().st_size < 1_000_000 for path in pictures)
    assert all(f"docs/images/{path.name}" in README for path in pictures)


@pytest.mark.parametrize(
    ("start", "name"),
    [
        ("fish", "fish-swim"),
        ("4-legged swimmer", "quadruped-swim"),
        ("4-legged walker, in air", "quadruped-walk"),
        ("T, in air", "tee-walk"),
    ],
)
def test_the_drag_points_of_the_packaged_bodies_have_the_errors_that_the_page_says(start, name):
    page = (ROOT / "docs" / "body.md").read_text()
    table = page[page.index("| body | points of triangles") :]
    points, force, mean, areas, mirrors = row(table, start)
    drag = check.packaged_robot(get_task(name)).body.source["drag"]
    assert numbers(points) == [drag["points"], drag["triangles"]]
    for told, key in ((force, "error"), (mean, "mean_error"), (areas, "area_error")):
        digits = len(told.rstrip("%").partition(".")[2])
        assert numbers(told) == [round(100 * drag[key], digits)]
    assert mirrors.split(", ") == list(drag["mirrors"])


def test_the_suite_s_scores_are_those_of_their_file():
    page = (ROOT / "docs" / "suite.md").read_text()
    with open(ROOT / "docs" / "data" / "scores.csv") as stream:
        rows = list(csv.DictReader(stream))
    kept = [
        scores.Score(r["task"], r["policy"], float(r["reward"]), float(r["half_interval"]))
        for r in rows
    ]
    assert {s.task for s in kept} == {*scores.TASKS, *scores_navigate.TASKS}
    assert scores.table(kept) in page
