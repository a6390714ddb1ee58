"""What adding each kind touches (docs/plugins.md, 'What adding touches'): each row, tried."""

from __future__ import annotations

import re
import sys
import types
from dataclasses import replace
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path

import numpy as np
import pytest
from dm_control.utils import containers

from defplan_mj import registry
from defplan_mj.base.errors import DefplanError
from defplan_mj.body.build import build_body
from defplan_mj.body.model import Medium
from defplan_mj.body.options import BodyOptions
from defplan_mj.dynamics.reduced import ReducedDynamics
from defplan_mj.dynamics.terrain import Terrain, TerrainGeom
from defplan_mj.feedback import drive
from defplan_mj.log import channels
from defplan_mj.log.channels import Channel
from defplan_mj.log.reader import read_log
from defplan_mj.log.schemas import LabelledNumbers
from defplan_mj.planning.sensors.sensor import sensor_of
from defplan_mj.report import report
from defplan_mj.report.content import Section, Text
from defplan_mj.task import Navigation
from tests.samples.logs import record_episode
from tests.samples.paths import ROOT

PAGE = (ROOT / "docs/plugins.md").read_text()
BLOCKS = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)


@pytest.fixture
def install(monkeypatch):
    """Return a function that installs a module of names and its entry points, as a package would."""
    added: dict[str, list[EntryPoint]] = {}

    def found(group):
        return [*entry_points(group=group), *added.get(group, [])]

    def put(group: str, name: str, **names) -> None:
        module = types.ModuleType(f"added_{name.replace('-', '_')}")
        module.__dict__.update(names)
        monkeypatch.setitem(sys.modules, module.__name__, module)
        value = f"{module.__name__}:VALUE" if "VALUE" in names else module.__name__
        added.setdefault(group, []).append(EntryPoint(name, value, group))

    monkeypatch.setattr(registry, "entry_points", found)
    sensor_of.cache_clear()
    yield put
    sensor_of.cache_clear()


def page_names(word: str, **given) -> dict:
    """Run the page's block with `word` in it."""
    names = dict(given)
    exec(next(block for block in BLOCKS if word in block), names)
    return names


def test_body(tmp_path):
    import trimesh

    trimesh.creation.capsule(height=0.6, radius=0.15).export(tmp_path / "eel.stl")
    options = BodyOptions(vertices=150, modes=2, basis=8, samples=8, drag_points=16, length=1.0)
    assert build_body(tmp_path / "eel.stl", options).length == pytest.approx(1.0, rel=0.02)


def test_task(install):
    spec = page_names("TaskSpec(", __file__=__file__)["SWIM"]
    install(registry.TASKS, "eel-swim", VALUE=spec)
    assert registry.get_task("eel-swim").gait_tasks == spec.gait_tasks
    assert registry.get_task("eel-swim").planner == registry.default_solver("planner")


@pytest.mark.parametrize(
    ("kind", "word", "name"),
    [
        ("gait", "class HillClimber", "hill-climber"),
        ("planner", "class StraightSolver", "straight"),
        ("feedback", "class PushingSolver", "pushing"),
    ],
    ids=["gait solver", "planner", "feedback"],
)
def test_gait_solver_planner_feedback(install, kind, word, name):
    names = page_names(word)
    install(registry.SOLVERS, name, VALUE=names["SOLVER"])
    assert registry.get_solver(name, kind) is names["SOLVER"]


def test_the_page_s_feedback_pushes_where_the_body_lags(fish_dynamics, fish_gait):
    solver = page_names("class PushingSolver")["SOLVER"]
    feedback = solver.prepare(fish_dynamics, fish_gait)
    start, n = fish_dynamics.rest_state(), fish_gait.steps_per_cycle
    states, shapes = drive(fish_dynamics, feedback, [0, 0], n, start)
    u = np.tile(fish_gait.table()[0], (2, 1))
    wanted = u + 0.2 * (u - states[:-1, 7 : 7 + u.shape[1]])
    assert shapes == pytest.approx(np.clip(wanted, -fish_gait.amplitude, fish_gait.amplitude))


def test_medium(fish_dynamics, fish_gait):
    body = fish_dynamics.body
    honey = replace(body, medium=Medium(name="honey", density=1400.0, drag_tangential=1.0))
    ways = [
        np.linalg.norm(ReducedDynamics(b, fish_gait.timestep).rollout(x, u)[-1, :3])
        for b in (body, honey)
        for x, u in [(fish_dynamics.rest_state(), np.tile(fish_gait.table()[0], (3, 1)))]
    ]
    assert ways[1] < 0.7 * ways[0]


def test_terrain(small_walker):
    step = TerrainGeom("box", (5.0, 5.0, 0.5), (0.0, 0.0, -0.2))  # its top is at 0.3 m
    level, raised = (
        ReducedDynamics(small_walker, 0.015, terrain).rest_state()
        for terrain in (Terrain(), Terrain(geoms=(step,)))
    )
    assert raised[2] - level[2] == pytest.approx(0.3, abs=1e-3)
    swims = registry.get_task("fish-swim")
    with pytest.raises(DefplanError, match="nothing holds a body of gravity 0"):
        replace(swims, terrain=Terrain())


def test_sensor(install):
    names: dict = {}
    exec((ROOT / "docs/examples/sensor.py").read_text(), names)
    install(registry.SENSORS, "nearest-obstacle", VALUE=names["SENSOR"])
    assert sensor_of(Navigation(sensor="nearest-obstacle")) is names["SENSOR"]


def test_log_channel(tmp_path, monkeypatch):
    height = Channel(
        "/robot/height",
        LabelledNumbers,
        "m",
        "the state",
        labels=lambda names: ["height"],
        of_step=lambda step: step.x[2:3],
    )
    monkeypatch.setattr(channels, "CHANNELS", [*channels.CHANNELS, height])
    kept = record_episode(tmp_path / "mine.mcap")
    steps, numbers = read_log(tmp_path / "mine.mcap").channel("/robot/height")
    assert np.array_equal(steps, np.arange(1, len(kept["states"])))
    assert np.array_equal(numbers[:, 0], kept["states"][1:, 2])


def test_report_section(tmp_path, monkeypatch):
    def greeting(material):
        return Section("greeting", "A section of mine", [Text(f"Hello from {material.task}.")])

    monkeypatch.setattr(report, "SECTIONS", (*report.SECTIONS, greeting))
    (tmp_path / "mine-seed0").mkdir()
    page = report.write_report(tmp_path / "mine-seed0").read_text()
    assert '<section id="greeting">' in page and "Hello from mine." in page


def test_study(install, tmp_path):
    install(registry.STUDIES, "mine", VALUE=tmp_path / "mine.toml")
    assert registry.get_study("mine") == tmp_path / "mine.toml"


def test_suite_domain(install):
    tasks = containers.TaggedTasks()
    install(registry.DOMAINS, "eel", SUITE=tasks)
    assert registry.get_domain("eel").SUITE is tasks


def test_every_row_of_the_page_is_tried_here():
    table = PAGE[PAGE.index("## What adding touches") : PAGE.index("## A task")]
    rows = re.findall(r"^\| ([a-z ]+) \|", table, re.MULTILINE)
    tried = Path(__file__).read_text()
    assert len(rows) == 13 and rows[0] == "to add"
    for row in rows[1:]:
        assert f"def test_{row.replace(' ', '_')}(" in tried or f'"{row}"' in tried, row


def test_every_channel_is_on_the_logs_page():
    page = (ROOT / "docs/logs.md").read_text()
    for channel in channels.CHANNELS:
        row = next(line for line in page.splitlines() if line.startswith(f"| `{channel.topic}`"))
        assert channel.message.DESCRIPTOR.full_name in row
        assert channel.what
