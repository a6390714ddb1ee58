"""Task files: the same task out and in, a sentence for everything wrong, a table of all fields."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from defplan_mj import registry
from defplan_mj.base.errors import DefplanError
from defplan_mj.dynamics.terrain import Heightfield, Terrain
from defplan_mj.task import TaskSpec
from defplan_mj.taskfile.fields import BOUNDS, all_fields, attribute_texts, fields_of, table_of
from defplan_mj.taskfile.find import find_task
from defplan_mj.taskfile.lines import key_lines, line_of
from defplan_mj.taskfile.read import read_task
from defplan_mj.taskfile.write import task_text, write_task

DOCS = Path(__file__).resolve()
while not (DOCS / "docs" / "plugins.md").is_file():
    DOCS = DOCS.parent
PAGE = DOCS / "docs" / "plugins.md"
SHIPPED = (
    *("fish-swim", "fish-tunnel", "quadruped-swim"),
    *("quadruped-walk", "quadruped-run", "tee-walk"),
)

SMALL = """\
name = "shark"
mesh = "shark.stl"
timestep = 0.01
steps_per_cycle = 20

[body]
vertices = 400
modes = 4

[body.material]
youngs_modulus = 5e5

[[gait_tasks]]
name = "forward"
move = [0.5, 0, 0]

[[gait_tasks]]
name = "left"
turn = [0, 0, 0.5]

[weights]
style = "sideways"

[navigation]
space = "planar"
"""


@pytest.fixture
def small(tmp_path):
    """Return a function that writes the small file with changes, its mesh beside it."""
    (tmp_path / "shark.stl").write_bytes(b"solid")

    def put(*changes: tuple[str, str], text: str = SMALL) -> Path:
        for old, new in changes:
            assert old in text
            text = text.replace(old, new, 1)
        path = tmp_path / "shark.toml"
        path.write_text(text, encoding="utf-8")
        return path

    return put


@pytest.mark.parametrize("name", SHIPPED)
def test_a_shipped_task_comes_back_from_its_file_as_it_was(name, tmp_path):
    spec = registry.get_task(name)
    path = write_task(spec, tmp_path / "deep" / "er" / "task.toml")
    assert read_task(path) == spec
    assert read_task(path).file == path
    assert task_text(read_task(path), path) == path.read_text()  # and from there on


def test_all_shipped_tasks_are_tried():
    assert {e.name for e in registry.tasks() if e.package == "defplan"} <= set(SHIPPED)


def test_what_no_shipped_task_has_comes_back_too(tmp_path):
    fish = registry.get_task("quadruped-walk")
    field = Heightfield(np.array([[0.0, 0.1, 0.2], [0.3, 0.4, 0.5]]), (2.0, 3.0))
    spec = dataclasses.replace(
        fish,
        description='quotes " and \\ and\nlines, ü',
        body=dataclasses.replace(fish.body, length=None, up="-y", forward="z"),
        terrain=Terrain(geoms=(), heightfield=field, thickness=0.02),
        skin=None,
        shipped=None,
        paper={"a key": {"deep": (1, 2.5)}},
    )
    found = read_task(write_task(spec, tmp_path / "task.toml"))
    assert found.terrain is not None and found.terrain.heightfield is not None
    assert np.array_equal(found.terrain.heightfield.heights, field.heights)
    again, given = dataclasses.asdict(found.terrain.heightfield), dataclasses.asdict(field)
    assert {**again, "heights": None} == {**given, "heights": None}
    level: dict[str, Any] = {"terrain": registry.get_task("quadruped-walk").terrain}
    assert dataclasses.replace(found, **level) == dataclasses.replace(spec, **level)
    assert found.terrain.geoms == () and found.terrain.thickness == 0.02


def test_what_is_left_out_has_its_default(small):
    spec = read_task(small())
    assert spec.name == "shark" and spec.mesh.name == "shark.stl" and spec.mesh.is_absolute()
    assert spec.body.vertices == 400 and spec.body.basis == 24
    assert spec.gait_tasks[1].turn == (0.0, 0.0, 0.5)
    assert isinstance(spec.gait_tasks[0].move[1], float)
    assert spec.gait_solver == registry.default_solver("gait")
    assert spec.terrain is None and spec.file == small()
    assert read_task(small(('name = "shark"\n', ""))).name == "shark"  # the file's


WRONG = [
    (("vertices = 400", "vertexes = 400"),
     "line 7: there is no field `vertexes` in [body], did you mean vertices?"),
    (("modes = 4", "youngs_modulus = 4"),
     "line 8: there is no field `youngs_modulus` in [body]: it belongs in [body.material]"),
    (("timestep", "time_step"), "line 3: there is no field `time_step` at the top, did you mean timestep?"),
    (("[weights]", "[weigths]"), "line 21: there is no field `weigths` at the top, did you mean weights?"),
    (("vertices = 400", 'vertices = "many"'),
     "line 7: `vertices` in [body] is 'many': it must be a whole number"),
    (("vertices = 400", "vertices = 400.5"),
     "line 7: `vertices` in [body] is 400.5: it must be a whole number"),
    (("vertices = 400", "vertices = true"), "line 7: `vertices` in [body] is true: it must be a whole number"),
    (("modes = 4", "modes = 99"), "line 8: `modes` in [body] is 99: it must be between 1 and 16"),
    (("modes = 4", "length = -1"), "line 8: `length` in [body] is -1: it must be above 0"),
    (("modes = 4", 'length = "long"'),
     "line 8: `length` in [body] is 'long': it must be a number, or 'none'"),
    (("timestep = 0.01", "timestep = nan"), "line 3: `timestep` is nan: it must be a finite number"),
    (("timestep = 0.01", f"timestep = 1{'0' * 400}"), "it must be a finite number"),
    (("timestep = 0.01\n", ""), "line 1: `timestep` is missing: of a control step, s"),
    (("move = [0.5, 0, 0]", "move = [0.5, 0]"),
     "line 15: `move` in [[gait_tasks]] has 2 entries: it must have 3"),
    (("turn = [0, 0, 0.5]", 'turn = [0, 0, "x"]'),
     "line 19: an entry of `turn` in [[gait_tasks]] is 'x': it must be a number"),
    (("turn = [0, 0, 0.5]", "turn = [0, 0.5, 0]"), "line 19: the gait left turns out of the plane"),
    (('name = "left"', 'name = "forward"'), "line 18: there are two gait tasks of the name forward"),
    (('"planar"', '"flat"'), "line 25: `space` in [navigation] is 'flat': it must be planar or spatial"),
    (('"sideways"', '"sidewise"'),
     "line 22: `style` in [weights] is 'sidewise': it must be any or sideways or pulse"),
    (('"planar"', '"planar"\nsensor = "planer-laser"'),
     "line 26: there is no sensor planer-laser, did you mean planar-laser?"),
    (('"planar"', '"planar"\nsensor = "spherical-laser"'),
     "line 26: the sensor spherical-laser is for a spatial space, not for a planar one"),
    (("timestep", 'gait_solver = "shoting"\ntimestep'),
     "line 3: there is no gait solver shoting, did you mean shooting?"),
    (("timestep", 'planner = "shooting"\ntimestep'), "line 3: shooting is a gait solver, not a planner"),
    (("timestep", 'rivals = ["altern"]\ntimestep'), "line 3: there is no gait solver altern"),
    (("timestep", 'skin = "fish"\ntimestep'), "line 3: there is no task fish, did you mean fish-swim?"),
    (("timestep", "axis = [1, 1, 0]\ntimestep"), "line 3: `axis` is an array: it must be a vector of length 1"),
    (('"shark.stl"', '"shrak.stl"'), "did you mean shark.stl?"),
    (('"shark.stl"', '"no/shark.stl"'), "line 2: the mesh file"),
    (('name = "shark"', 'name = "../shark"'), "line 1: `name` is '../shark': it must be letters, digits"),
    (("modes = 4", 'up = "x"\nforward = "-x"'), "line 9: up is x and forward is -x: they must be two different"),
    (("[weights]", "[terrain]\n[weights]"), "line 21: nothing holds a body of gravity 0"),
    (("[weights]", "[[weights]]"), "line 21: `weights` is a table, not an array"),
    (("[[gait_tasks]]", "[gait_task]"), "line 13: there is no field `gait_task` at the top"),
    (("timestep = 0.01", "timestep 0.01"), "line 3: this is no TOML: expected '='"),
    (("timestep = 0.01", "timestep = 0.01\ntimestep = 0.02"), "line 4: this is no TOML: cannot overwrite"),
    (('style = "sideways"', "turn = -1"), "line 22: `turn` in [weights] is -1: it must be 0 or more"),
]  # fmt: skip


@pytest.mark.parametrize(("change", "sentence"), WRONG, ids=[s[:40] for _, s in WRONG])
def test_what_is_wrong_is_one_sentence_with_its_line(small, change, sentence):
    path = small(change)
    with pytest.raises(DefplanError) as error:
        read_task(path)
    told = str(error.value)
    assert told.startswith(f"{path}, line ") and "\n" not in told
    assert sentence in told


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"\xff\xfe",
        b"= 3",
        b"[" * 3000,
        b"x = " + b"[" * 3000,
        b"\0",
        b'name = "' + b"a" * 9999,
    ],
)
def test_whatever_a_file_holds_is_one_sentence(tmp_path, content):
    path = tmp_path / "task.toml"
    path.write_bytes(content)
    with pytest.raises(DefplanError) as error:
        read_task(path)
    assert str(error.value).startswith(str(path)) or str(path) in str(error.value)
    assert len(str(error.value)) < 400 and "\n" not in str(error.value)


def test_a_file_that_is_not_there_says_how_to_write_one(tmp_path):
    for path, told in ((tmp_path / "no.toml", "defplan new MESH"), (tmp_path, "is a folder")):
        with pytest.raises(DefplanError, match=told):
            read_task(path)


def test_every_value_of_a_file_is_checked_for_its_type(small):
    """A table in the place of every field is refused, whatever the field is."""
    for field in all_fields():
        if table_of(field.kind) is not None or field.path == "paper":
            continue
        many = field.table in ("gait_tasks", "terrain.geoms")
        head = f"[[{field.table}]]" if many else f"[{field.table}]" if field.table else ""
        text = f"{field.name}.nothing = 1\n" if not head else f"{head}\n{field.name}.nothing = 1\n"
        path = small(text=text)
        with pytest.raises(DefplanError, match=r"line \d+: "):
            read_task(path)


def test_bounds_are_of_fields_that_there_are():
    for cls, bounds in BOUNDS.items():
        assert set(bounds) <= {field.name for field in fields_of(cls)}


def test_lines_are_found_whatever_the_file_s_style():
    text = '''# a comment with [brackets] = and "quotes
top = """two
lines"""
a.b = 1
"quoted key" = 2

[body] # here
inline = { x = 1, y = [1,
  2] }
[[list]]
one = 1
[[list]]
two = [
  # [not] = a table
  "]", 2,
]
  [list.inner]
  three = 3
'''
    lines = key_lines(text)
    wanted = {
        ("top",): 2, ("a", "b"): 4, ("quoted key",): 5, ("body",): 7, ("body", "inline"): 8,
        ("list", 0): 10, ("list", 0, "one"): 11, ("list", 1): 12, ("list", 1, "two"): 13,
        ("list", 1, "inner"): 17, ("list", 1, "inner", "three"): 18,
    }  # fmt: skip
    assert {path: lines[path] for path in wanted} == wanted
    assert line_of(("body", "inline", "y", 1), lines) == 8
    assert key_lines(text.replace("\n", "\r\n")) == lines


def test_every_field_is_said_in_words():
    for field in all_fields():
        assert field.text, field.path
    assert attribute_texts(TaskSpec)["timestep"] == "of a control step, s"


def test_the_page_has_a_table_of_all_fields_with_their_defaults():
    rows = re.findall(r"^\| `([\w.]+)` \| ([^|]*) \| (.*) \|$", PAGE.read_text(), re.MULTILINE)
    told = {path: default.strip() for path, default, _ in rows}
    wanted = {f.path: shown_default(f) for f in all_fields() if table_of(f.kind) is None}
    assert told == wanted
    assert list(told) == list(wanted)  # in the order of a file that `defplan new` writes
    assert all(text.strip() for _, _, text in rows)


def test_the_page_s_short_file_is_enough(tmp_path):
    block = re.search(r"```toml\n(mesh = .*?)```", PAGE.read_text(), re.DOTALL)
    assert block is not None
    (tmp_path / "eel.stl").write_bytes(b"solid")
    (tmp_path / "eel.toml").write_text(block[1])
    spec = read_task(tmp_path / "eel.toml")
    assert spec.body.material.youngs_modulus == 5e5 and len(spec.gait_tasks) == 3


def shown_default(field) -> str:
    """Return a default as the table shows it."""
    if field.default is dataclasses.MISSING:
        return "needed"
    if field.default is None:
        return "none"
    if isinstance(field.default, tuple):
        return str(list(field.default))
    return "" if field.default in ("", {}) else str(field.default)


def test_one_place_finds_a_task_by_name_and_by_file(small, tmp_path, monkeypatch):
    assert find_task("fish-swim") == registry.get_task("fish-swim")
    assert find_task(str(small())).name == "shark"
    monkeypatch.chdir(tmp_path)
    assert find_task("shark.toml").mesh == tmp_path / "shark.stl"
    with pytest.raises(DefplanError, match="is a mesh and no task"):
        find_task("shark.stl")
    (tmp_path / "shark").write_text("")
    with pytest.raises(DefplanError, match=r"ends in \.toml"):
        find_task("shark")


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("a = " + "[" * 5000, "nested too deeply"),
        ("[a" + ".a" * 50_000 + "]", "nested too deeply"),
        ("a." * 100_000 + "b = 1", "nested too deeply"),
        ("".join(f"[a{i}]\n" for i in range(30_000)), "more than 20000 brackets"),
        ('x = "' + "a" * 1_000_000 + '"', "too large for a task file"),
        ('mesh = "' + "a" * 100_000 + '"', "is longer than 1000 letters"),
        ("steps_per_cycle = 99999999999", "it can be 1000000 at most"),
    ],
)
def test_a_file_that_asks_for_too_much_is_refused(tmp_path, text, why):
    path = tmp_path / "x.toml"
    if "=" in text and text.startswith(("mesh", "steps")):
        rest = {"mesh": "x.stl", "timestep": 0.02, "steps_per_cycle": 30}
        own = text.partition(" ")[0]
        text += "".join(f"\n{k} = {v!r}" for k, v in rest.items() if k != own)
        text += '\n[[gait_tasks]]\nname = "forward"\nmove = [1.0, 0, 0]'
    path.write_text(text)
    with pytest.raises(DefplanError, match=why) as told:
        read_task(path)
    assert len(str(told.value)) < 500
