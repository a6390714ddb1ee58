"""Study files: what they say, and for every mistake one sentence with file, line and what was meant."""

from __future__ import annotations

from pathlib import Path

import pytest

from defplan_mj import registry
from defplan_mj.base.errors import DefplanError
from defplan_mj.study.matrix import cells
from defplan_mj.study.spec import find_study, read_study

GOOD = """
description = "Two ways."
tasks = ["fish-swim", "tee-walk"]
seeds = [3, 1]
planners = ["", "greedy"]

[options]
episodes = 20

[[variants]]
name = "few"
pairs = 100

[[variants]]
name = "many"
episodes = 30

[[leave_out]]
task = "tee-walk"
variant = "many"

[quick]
tasks = ["fish-swim"]
seeds = 1
until = "gait"
"""


@pytest.fixture
def write(tmp_path):
    """Return a function that writes a study file."""

    def put(text: str) -> Path:
        path = tmp_path / "mine.toml"
        path.write_text(text)
        return path

    return put


def test_a_study_is_its_matrix_without_what_is_left_out(write):
    study = read_study(write(GOOD))
    assert study.name == "mine" and study.seeds == (3, 1)
    assert [v.options for v in study.variants] == [
        {"episodes": 20, "pairs": 100},
        {"episodes": 30},
    ]
    made = cells(study)
    assert len(made) == 2 * 2 * (2 + 1)
    assert made[0].folder == Path(
        "shooting+dql+none+few/fish-swim-seed3"
    )  # the task's own, by name
    tee = [cell for cell in made if cell.task == "tee-walk"]
    assert {cell.variant for cell in tee} == {"few"}


def test_a_plugin_and_the_tasks_own_of_the_same_name_are_one_run(write):
    study = read_study(write('tasks = ["fish-swim"]\nplanners = ["", "dql", "greedy"]\n'))
    assert [cell.planner for cell in cells(study)] == ["dql", "greedy"]


def test_the_quick_form_says_what_it_says_instead(write):
    study = read_study(write(GOOD), quick=True)
    assert (study.name, study.seeds, study.tasks) == ("mine-quick", (0,), ("fish-swim",))
    assert study.planners == ("", "greedy") and study.until == "gait"
    with pytest.raises(DefplanError, match="has no quick form"):
        read_study(write('tasks = ["fish-swim"]\n'), quick=True)


def test_runs_that_end_before_a_planner_do_not_differ_by_it(write):
    text = 'tasks = ["fish-swim"]\nplanners = ["greedy", "astar"]\nuntil = "gait"\n'
    made = cells(read_study(write(text)))
    assert [cell.folder for cell in made] == [Path("shooting/fish-swim-seed0")]


def test_a_task_file_is_named_from_the_studys_folder_on(write, tmp_path):
    from defplan_mj.taskfile.write import write_task

    (tmp_path / "tasks").mkdir()
    write_task(registry.get_task("fish-swim"), tmp_path / "tasks/other.toml")
    study = read_study(write('tasks = ["tasks/other.toml"]\n'))
    assert study.tasks == (str(tmp_path / "tasks/other.toml"),)
    with pytest.raises(DefplanError, match=r"line 1: `tasks` has two of the name fish-swim"):
        read_study(write('tasks = ["fish-swim", "tasks/other.toml"]\n'))


def test_a_study_of_meshes_has_a_run_for_each_whose_task_is_guessed_later(write, tmp_path):
    for name in ("a cow.obj", "shark.stl"):
        (tmp_path / name).write_text("")
    text = 'meshes = ["a cow.obj", "shark.stl"]\nmedium = "ground"\ntasks = ["fish-swim"]\n'
    made = cells(read_study(write(text)))
    assert [cell.task for cell in made] == ["fish-swim", "a-cow-walk", "shark-walk"]
    assert [cell.medium for cell in made] == ["", "ground", "ground"]
    assert made[1].source == str(tmp_path / "a cow.obj")
    assert made[1].method == "shooting-quick+astar+lqr"
    swims = cells(read_study(write('meshes = ["shark.stl"]\nmedium = "water"\n')))
    assert swims[0].method == "shooting-quick+astar+none"  # as `defplan new` has it
    (tmp_path / "shark.obj").write_text("")
    with pytest.raises(DefplanError, match=r"line 1: `meshes` has two of the name shark-swim"):
        read_study(write('meshes = ["shark.stl", "shark.obj"]\nmedium = "water"\n'))


TASK = 'tasks = ["fish-swim"]\n'


@pytest.mark.parametrize(
    ("text", "line", "sentence"),
    [
        ("tasks = [", 1, "this is no TOML"),
        ("seeds = 2\n", 1, "`tasks` is missing"),
        ('tasks = ["fish-swm"]\n', 1, "did you mean fish-swim"),
        ("tasks = []\n", 1, "`tasks` must be a list of one or more"),
        ('meshes = ["a.obj"]\n', 1, "`meshes` need a `medium`: water or ground"),
        ('medium = "air"\nmeshes = ["a.obj"]\n', 1, "water or ground, not 'air'"),
        ('medium = "water"\nmeshes = ["a.obj"]\n', 2, "there is no such file"),
        ('medium = "water"\nmeshes = ["a.toml"]\n', 2, "paths of mesh files in quotes"),
        ('medium = "water"\n', 1, "`meshes` must be a list of one or more"),
        (TASK + "seed = 3\n", 2, "no field `seed` at the top, did you mean seeds"),
        (TASK + "seeds = 0\n", 2, "`seeds` is 0: it must be 1 or more"),
        (TASK + "seeds = [1, -1]\n", 2, "`seeds` has -1"),
        (TASK + "seeds = [1, 1]\n", 2, "`seeds` has 1 twice"),
        (TASK + "seeds = true\n", 2, "`seeds` must be a list"),
        (TASK + '\nplanners = ["astr"]\n', 3, "did you mean astar"),
        (TASK + 'planners = ["shooting"]\n', 2, "shooting is a gait solver, not a planner"),
        (TASK + 'until = "plan"\n', 2, "`until` is 'plan': it must be gait, surrogate"),
        (
            TASK + "[options]\nepisode = 3\n",
            3,
            "no field `episode` in [options], did you mean episodes",
        ),
        (TASK + "[options]\npairs = 0\n", 3, "`pairs` is 0: it must be a whole number, 1 or more"),
        (TASK + "[options]\npairs = 1.5\n", 3, "`pairs` is 1.5"),
        (TASK + "[options]\ntraining_seconds = 0\n", 3, "a number, above 0"),
        (TASK + "[[variants]]\npairs = 3\n", 2, "a variant is a table"),
        (TASK + '[[variants]]\nname = "../up"\n', 3, "`name` is '../up'"),
        (TASK + '[[leave_out]]\ntasks = "x"\n', 3, "did you mean task"),
        (TASK + 'name = "a b"\n', 2, "letters, digits"),
        (TASK + "quick = 3\n", 2, "`quick` is a table"),
    ],
)
def test_a_mistake_is_a_sentence_with_file_and_line(write, text, line, sentence):
    path = write(text)
    with pytest.raises(DefplanError) as caught:
        read_study(path)
    told = str(caught.value)
    assert told.startswith(f"{path}, line {line}: ") or "no TOML" in told
    assert sentence in told and "\n" not in told


def test_a_file_that_is_not_there_and_a_name_that_is_none_are_sentences(tmp_path):
    with pytest.raises(DefplanError, match="study file .* does not exist"):
        find_study(str(tmp_path / "none.toml"))
    with pytest.raises(DefplanError, match="there is no study papr, did you mean paper"):
        find_study("papr")


@pytest.mark.parametrize("name", registry.names(registry.STUDIES))
@pytest.mark.parametrize("quick", [False, True])
def test_the_shipped_studies_are_sound(name, quick):
    study = find_study(name, quick)
    assert cells(study)
    for planner in set(study.roles.values()) - {study.roles.get("feedback")}:
        registry.get_solver(planner, "planner")


def test_a_study_whose_runs_are_all_left_out_is_a_sentence(write):
    text = TASK + '[[leave_out]]\ntask = "fish-swim"\n'
    with pytest.raises(DefplanError, match="all runs are left out"):
        cells(read_study(write(text)))
