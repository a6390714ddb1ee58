"""The registry: what is installed is found; what is unknown or broken is named and harms no other."""

from dataclasses import replace
from importlib.metadata import EntryPoint

import pytest

from defplan_mj import registry
from defplan_mj.base.errors import DefplanError


class Solver:
    """A solver plugin of somebody else's package."""

    kind = "planner"
    name = "mine"
    summary = "always straight ahead"


class Preferred(Solver):
    """One that is meant if none is named."""

    name = "preferred"
    default = True


class Shapeless:
    """A plugin that forgot to say its kind."""


SOLVER = Solver()
PREFERRED = Preferred()
SHAPELESS = Shapeless()


@pytest.fixture
def installed(monkeypatch):
    """Return a function that puts entry points in the place of the installed ones."""

    def put(**values: str) -> None:
        points = [EntryPoint(n.replace("_", "-"), v, registry.SOLVERS) for n, v in values.items()]
        monkeypatch.setattr(
            registry, "entry_points", lambda group: points if group == registry.SOLVERS else []
        )

    return put


def test_none_of_our_own_plugins_is_broken():
    entries = [*registry.tasks(), *registry.solvers(), *registry.domains()]
    assert [f"{e.name}: {e.error}" for e in entries if e.package == "defplan" and e.error] == []


def test_a_plugin_of_another_package_is_found_by_its_name_and_kind(installed):
    installed(mine=f"{__name__}:SOLVER")
    assert registry.get_solver("mine", "planner") is SOLVER
    assert [e.name for e in registry.solvers("planner")] == ["mine"]
    assert registry.solvers("gait") == []


def test_an_unknown_name_lists_what_exists_and_what_was_probably_meant(installed):
    installed(mine=f"{__name__}:SOLVER")
    with pytest.raises(DefplanError, match=r"no planner mnie, did you mean mine\? There is: mine"):
        registry.get_solver("mnie", "planner")
    with pytest.raises(DefplanError, match=r"no planner zzzzz; there is: mine"):
        registry.get_solver("zzzzz", "planner")


def test_a_solver_of_another_kind_is_refused_by_kind(installed):
    installed(mine=f"{__name__}:SOLVER")
    with pytest.raises(DefplanError, match="mine is a planner solver, not a gait solver"):
        registry.get_solver("mine", "gait")


@pytest.mark.parametrize(
    ("value", "reason"),
    [
        ("no_such_module_anywhere:SOLVER", "ModuleNotFoundError"),
        (f"{__name__}:NOTHING", "AttributeError"),
        (f"{__name__}:SHAPELESS", "its `kind` must be one of"),
    ],
)
def test_a_broken_plugin_is_reported_by_name_and_leaves_the_others_alone(installed, value, reason):
    installed(broken=value, mine=f"{__name__}:SOLVER")
    with pytest.raises(
        DefplanError, match=f"broken of package unknown cannot be loaded .*{reason}"
    ):
        registry.get_solver("broken", "planner")
    assert registry.get_solver("mine", "planner") is SOLVER
    entries = {e.name: e for e in registry.solvers("planner")}
    assert reason in entries["broken"].error
    assert entries["mine"].value is SOLVER


def test_a_name_of_another_package_goes_before_our_own(monkeypatch):
    class Distribution:
        def __init__(self, name):
            self.name = name

    def point(value, package):
        entry = EntryPoint("mine", value, registry.SOLVERS)
        vars(entry)["dist"] = Distribution(package)
        return entry

    points = [point(f"{__name__}:SHAPELESS", "defplan"), point(f"{__name__}:SOLVER", "other")]
    for order in (points, points[::-1]):
        monkeypatch.setattr(registry, "entry_points", lambda group, order=order: order)
        assert registry.get_solver("mine", "planner") is SOLVER


def test_a_task_that_names_no_solvers_has_the_default_ones_and_one_that_does_keeps_them(
    monkeypatch,
):
    spec = registry.get_task("fish-swim")
    named = replace(spec, gait_solver="", planner="greedy", feedback="")
    monkeypatch.setattr(registry, "_get", lambda group, label, name: named)
    found = registry.get_task("mine")
    assert (found.gait_solver, found.planner, found.feedback) == ("shooting", "greedy", "none")


def test_a_default_solver_of_another_package_goes_before_ours(installed):
    installed(mine=f"{__name__}:SOLVER", preferred=f"{__name__}:PREFERRED")
    assert registry.default_solver("planner") == "preferred"
    with pytest.raises(
        DefplanError, match="no gait solver is the default one: name one in the task"
    ):
        registry.default_solver("gait")
