"""The kernel and its Python face with wrong, absurd and unfinite arguments: an error or `failed`, soon.

Every case runs in a process of its own kind (`hostile`): a crash or a hang is a failure of the case, not
of the tests. The bound on the time is a promise of kernel.h, not a measurement; it is of processor time,
since a machine may be busy with something else.
"""

from __future__ import annotations

import ctypes
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from defplan_mj.body.model import Body
from defplan_mj.dynamics.feet import lowest_feet
from defplan_mj.dynamics.reduced import ReducedDynamics
from defplan_mj.dynamics.terrain import HEADER, Heightfield, Terrain
from defplan_mj.kernel import library
from defplan_mj.kernel.library import Geom, Info, Model, kernel

# Of processor time: an answer to anything comes within this; longer with what sanitizers add.
SECONDS = 2.0 if library.FOLDER else 0.1
STARTUP = 60.0

# What runs in the other process: CASE is an expression of d (dynamics), x, u, n, r, np, bad (a function that
# puts a value into a copy). It prints one JSON line: error, or the numbers that came back.
PROGRAM = """
import json, sys, time
import numpy as np
from defplan_mj.body.model import Body
from defplan_mj.dynamics.feet import lowest_feet
from defplan_mj.dynamics.reduced import ReducedDynamics
from defplan_mj.dynamics.terrain import Terrain
from defplan_mj.base.errors import DefplanError

def bad(array, index, value):
    array = np.array(array, float)
    array[index] = value
    return array

def flat(value):
    if hasattr(value, "_fields_"):
        return [float(getattr(value, name)) for name, *_ in value._fields_]
    if isinstance(value, dict):
        return [n for v in value.values() for n in flat(v)]
    if isinstance(value, (tuple, list)):
        return [n for v in value for n in flat(v)]
    if hasattr(value, "__dataclass_fields__"):
        return [n for name in value.__dataclass_fields__ for n in flat(getattr(value, name))]
    return np.ravel(value).astype(float).tolist()

body = Body.load(sys.argv[1])
kinds = {
    "swims": lambda: ReducedDynamics(body),
    "walks": lambda: ReducedDynamics(body, terrain=Terrain()),
    "feet": lambda: ReducedDynamics(body, feet=lowest_feet(body)),
}
d = kinds[sys.argv[2]]()
r, n = body.n_modes, 4
x, u = d.rest_state(), np.full(d.nu, 0.1)
us = np.tile(u, (n, 1))
states = d.rollout(x, us)
for case in json.load(sys.stdin):
    print(json.dumps({"begun": case}), flush=True)
    start = time.process_time()
    try:
        value = eval(case)
        answer = {"values": flat(value)}
        if isinstance(value, tuple) and hasattr(value[-1], "failed"):
            answer = {"values": flat(value[0]), "failed": int(value[-1].failed)}
        elif "rollout_count" in case:
            # the states after the given one
            answer = {"values": flat(value[0][1:]), "failed": int(value[1])}
    except DefplanError as error:
        answer = {"error": str(error)}
    answer["seconds"] = time.process_time() - start
    answer["finite"] = bool(np.isfinite(answer.pop("values", [0.0])).all())
    print(json.dumps(answer), flush=True)
"""


def hostile(body: Path, kind: str, cases: list[str]) -> dict[str, dict]:
    """Return the answer to each case; {} to one that crashed its process or did not come back."""
    answers: dict[str, dict] = {}
    left = list(cases)
    while left:
        command = [sys.executable, "-c", PROGRAM, str(body), kind]
        allowed = STARTUP + 3 * SECONDS * len(left)
        try:
            done = subprocess.run(
                command, input=json.dumps(left), capture_output=True, text=True, timeout=allowed
            )
            out = done.stdout
            if not out:
                raise AssertionError(done.stderr)
        except subprocess.TimeoutExpired as late:
            out = (late.stdout or b"").decode()
        lines = [json.loads(line) for line in out.splitlines()]
        if not lines:
            raise AssertionError("the process did not begin with the first case")
        for begun, answer in zip(lines[::2], [*lines[1::2], {}][: len(lines[::2])], strict=True):
            answers[begun["begun"]] = answer
        left = [case for case in left if case not in answers]
    return answers


@pytest.fixture(scope="module")
def fish_file(small_fish: Body, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("honest") / "fish.npz"
    small_fish.save(path)
    return path


SHAPES = [
    *(f"d.step({state}, u)" for state in ("x[:-1]", "x[None]", "np.append(x, 0)", "[]", "1.0")),
    *(f"d.step(x, {shape})" for shape in ("u[:-1]", "us", "np.append(u, 0)", "[]", "1.0")),
    "d.step_info(x, u, x[:-1])",
    "d.step_info(x, u, states)",
    "d.rollout(x[:-1], us)",
    "d.rollout(x, u)",
    "d.rollout(x, us[:, :-1])",
    "d.rollout_count(x, us[None])",
    "d.step_jacobian(x[1:], u, x)",
    "d.step_jacobian(x, u[1:], x)",
    "d.step_jacobian(x, u, x[1:])",
    "d.step_adjoint(x, u, x, x[1:])",
    "d.step_adjoint(x, u, x[1:], x)",
    "d.rollout_adjoint(us, states[:-1], states[:-1])",
    "d.rollout_adjoint(us, states, states[:-1])",
    "d.rollout_adjoint(us[:-1], states, states)",
    "d.rollout_adjoint(us[:, 1:], states, states)",
    "d.rollout_adjoint(us, states[:, 1:], states[:, 1:])",
    "d.rollout_adjoint(u, states, states)",
    "d.energy(x[:-1])",
    "d.surface(x[:5])",
    "d.surface(np.zeros(0))",
    "d.surface(states)",
]
BAD_PLACES = ["0", "4", "7", "7 + r", "-1"]
UNFINITE = [
    *(
        f"d.step_info(bad(x, {i}, {value}), u)"
        for i in BAD_PLACES
        for value in ("np.nan", "np.inf", "-np.inf")
    ),
    *(f"d.step_info(x, bad(u, {i}, {value}))" for i in (0, -1) for value in ("np.nan", "np.inf")),
    "d.step_info(x, u, bad(x, 3, np.nan))",
    "d.rollout_count(x, bad(us, (1, 0), np.nan))",
    "d.rollout_count(bad(x, 8, np.inf), us)",
]
QUATERNIONS = [
    f"d.step_info(bad(x, slice(3, 7), {value}), u)"
    for value in ("0.0", "1e300", "[1e-300, 0, 0, 0]", "[1e200, 1e-200, 0, 0]")
]
ABSURD = [
    "d.step_info(x, np.full(d.nu, 1e6))",
    "d.step_info(x, np.full(d.nu, 1e150))",
    "d.step_info(x, np.full(d.nu, 1e308))",
    *(f"d.step_info(bad(x, {i}, {value}), u)" for i in BAD_PLACES for value in ("1e30", "1e150")),
    "d.step_info(bad(x, slice(7 + r, 13 + r), 1e150), u)",
    "d.step_info(bad(x, slice(7, 7 + r), 1e6), u)",
    *(f"d.step_info(bad(x, slice(10 + r, 13 + r), {w}), u)" for w in ("1e2", "1e4", "1e15")),
    *(f"d.step_info(bad(x, slice(7, 7 + r), {q}), u)" for q in ("10.0", "100.0")),
    "d.step_info(bad(x, slice(7 + r, 13 + 2 * r), 1e3), u)",
    "ReducedDynamics(body, substeps=64).step_info(x, np.full(d.nu, 1e3))",
    "ReducedDynamics(body, integrator='implicit-euler', substeps=4).step_info(x, 1e6 * u)",
    "d.rollout_count(x, np.full_like(us, 1e6))",
]
# Derivatives and measures of what is not a state: finite or an error, never foreign memory.
DERIVED = [
    "d.step_jacobian(bad(x, 8, np.nan), u, x)",
    "d.step_jacobian(x, bad(u, 0, np.nan), x)",
    "d.step_adjoint(x, u, bad(x, 3, np.nan), x)",
    "d.step_adjoint(x, u, states[1], bad(x, 0, np.nan))",
    "d.rollout_adjoint(us, bad(states, (2, 3), np.nan), states)",
    "d.rollout_adjoint(us, states, bad(states, (2, 3), np.inf))",
]
OPTIONS = [
    f"ReducedDynamics(body, {option}).step_info(x, u)"
    for option in (
        *("0.0", "-0.04", "np.nan", "np.inf", "1e-300", "1e300"),
        *("tolerance=0.0", "tolerance=np.nan", "tolerance=-1.0"),
        *("max_newton=0", "max_newton=-3", "max_newton=2**31", "max_newton=np.nan"),
        *("substeps=0", "substeps=65", "substeps=1.5", "substeps=np.nan", "integrator='none'"),
    )
]
TERRAINS = [
    f"ReducedDynamics(body, terrain=Terrain({option})).step_info(x, u)"
    for option in (
        *("friction=np.nan", "friction=-1.0", "friction=np.inf", "slip_speed=0.0"),
        *("slip_speed=np.nan", "thickness=0.0", "thickness=np.nan", "stiffness=-1.0"),
        *("stiffness=np.inf", "thickness=-0.01", "damping=np.nan", "damping=-1.0"),
    )
]


def named(answers: dict[str, dict], wrong) -> list[str]:
    """Return the cases whose answer is wrong, with it."""
    return [
        f"{case}: {answer or 'crashed or hung'}"
        for case, answer in answers.items()
        if wrong(answer)
    ]


@pytest.mark.parametrize("kind", ["swims", "walks", "feet"])
def test_arrays_of_a_wrong_shape_are_one_sentence(fish_file, kind):
    answers = hostile(fish_file, kind, SHAPES)
    assert not named(answers, lambda a: "error" not in a or a["seconds"] > SECONDS)
    assert all(a["error"].count("\n") == 0 for a in answers.values())


@pytest.mark.parametrize("kind", ["swims", "walks"])
@pytest.mark.parametrize("cases", [UNFINITE, QUATERNIONS], ids=["unfinite", "quaternions"])
def test_what_is_not_a_state_fails_with_finite_numbers(fish_file, kind, cases):
    def wrong(answer):
        refused = "error" in answer or (answer.get("failed") and answer["finite"])
        return not refused or answer["seconds"] > SECONDS

    assert not named(hostile(fish_file, kind, cases), wrong)


@pytest.mark.parametrize("kind", ["swims", "walks"])
def test_absurd_but_finite_numbers_are_answered_soon(fish_file, kind):
    def wrong(answer):
        return not answer or not answer["finite"] or answer["seconds"] > SECONDS

    assert not named(hostile(fish_file, kind, ABSURD), wrong)


@pytest.mark.parametrize("kind", ["swims", "walks"])
def test_derivatives_are_finite_or_an_error(fish_file, kind):
    def wrong(answer):
        return not answer or not answer["finite"] or answer["seconds"] > SECONDS

    assert not named(hostile(fish_file, kind, DERIVED), wrong)


@pytest.mark.parametrize("cases", [OPTIONS, TERRAINS], ids=["options", "terrains"])
def test_options_that_make_no_sense_are_refused(fish_file, cases):
    def wrong(answer):
        refused = "error" in answer or (answer.get("failed") and answer["finite"])
        return not refused

    answers = hostile(fish_file, "swims", cases)
    # a small or large time step makes sense
    accepted = ("1e-300", "1e300", "max_newton=2**31")
    answers = {c: a for c, a in answers.items() if a == {} or not any(o in c for o in accepted)}
    assert not named(answers, wrong)


def test_sensible_arguments_pass_the_same_way(fish_file):
    cases = ["d.step_info(x, u)", "d.rollout_count(x, us)", "d.step_jacobian(x, u, states[1])"]
    answers = hostile(fish_file, "swims", cases)
    assert not named(answers, lambda a: "error" in a or not a["finite"] or a.get("failed", 0))


def test_a_crash_and_a_hang_are_seen(fish_file, monkeypatch):
    monkeypatch.setattr(sys.modules[__name__], "STARTUP", 8.0)
    cases = ["__import__('os').abort()", "time.sleep(600)", "d.step_info(x, u)"]
    answers = hostile(fish_file, "swims", cases)
    assert answers[cases[0]] == answers[cases[1]] == {}
    assert answers[cases[2]]["finite"] and np.isfinite(answers[cases[2]]["seconds"])


# --- a model whose arrays were changed behind its back, as a C program could


@pytest.fixture(scope="module")
def rough(small_walker: Body) -> ReducedDynamics:
    """A walker on a heightfield that it stands on everywhere."""
    heights = 0.01 * np.random.default_rng(0).normal(size=(5, 5))
    return ReducedDynamics(
        small_walker, terrain=Terrain((), heightfield=Heightfield(heights, (2.0, 2.0)))
    )


def spoilt(dynamics: ReducedDynamics, name: str, index: int, value: float) -> Model:
    """Return the model with one number of one of its arrays replaced."""
    names = ("body", "par", "terrain", "feet")
    arrays: dict[str, Any] = dict(zip(names, dynamics.model.arrays, strict=True))
    arrays[name] = arrays[name].copy()
    arrays[name][index] = value
    return Model(**arrays)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("name", ["body", "par", "terrain", "feet"])
def test_every_number_of_a_model_is_looked_at_where_it_is_loaded(rough, name, value):
    dynamics = rough.with_feet(lowest_feet(rough.body)) if name == "feet" else rough
    check = kernel().dp_check_model
    assert check(dynamics.model) == 0
    array = dynamics.model.arrays[("body", "par", "terrain", "feet").index(name)]
    some = np.random.default_rng(1).integers(0, array.size, 300)
    for index in {*range(min(array.size, 40)), *some.tolist(), array.size - 1}:
        assert check(spoilt(dynamics, name, index, value)) < 0, (name, index)


@pytest.mark.parametrize("name", ["par", "terrain"])
def test_a_step_with_a_number_that_is_none_fails_with_a_finite_state(rough, name):
    lib, x, u = kernel(), rough.rest_state(), np.full(rough.nu, 0.1)
    size = rough.model.arrays[1 if name == "par" else 2].size
    failures = 0
    for index in range(size):
        model, x_next, info = spoilt(rough, name, index, np.nan), np.full(rough.nx, np.nan), Info()
        failed = lib.dp_step(model, x, u, x_next, ctypes.byref(info))
        failures += failed
        assert failed == info.failed and np.isfinite(x_next).all()
        states = np.concatenate([[x], np.full((2, rough.nx), np.nan)])
        lib.dp_rollout(model, 2, np.tile(u, (2, 1)), states, None)
        assert np.isfinite(states).all()
        # heights that the body is not near do not take part
        assert failed or index >= HEADER
    assert failures > HEADER if name == "terrain" else failures == size


def test_a_model_without_a_body_is_refused_and_nothing_is_written(rough):
    lib, x, u = kernel(), rough.rest_state(), np.full(rough.nu, 0.1)
    for index, value in [(0, 0.0), (2, np.nan), (2, 1e300), (3, -1.0), (3, 1e300), (4, np.nan)]:
        x_next = np.full(rough.nx, 7.0)
        model = spoilt(rough, "body", index, value)
        assert lib.dp_step(model, x, u, x_next, ctypes.byref(Info())) == 1
        assert (x_next == 7.0).all()
        states = np.full((3, rough.nx), 7.0)
        assert lib.dp_rollout(model, 2, np.tile(u, (2, 1)), states, None) == 2
        assert (states == 7.0).all()


def test_a_spin_beyond_half_a_turn_a_substep_is_divided_until_it_is_none(small_fish):
    dynamics = ReducedDynamics(small_fish, 0.04, substeps=2)
    for spin, division in ((150.0, 1), (200.0, 2), (390.0, 4)):  # rad/s; a substep is 0.02 s
        x = dynamics.rest_state()
        x[12 + small_fish.n_modes] = spin
        _, info = dynamics.step_info(x, np.zeros(dynamics.nu))
        assert info.failed or info.division >= division


def test_a_clearance_that_is_no_number_is_not_called_free(rough):
    geoms = (Geom * 1)()
    geoms[0].type, geoms[0].size[0], geoms[0].mat[:] = 2, 0.1, np.eye(3).ravel()
    x = rough.rest_state()
    assert kernel().dp_clearance(rough.blob, x, 1, geoms, 1.0, None, None) <= 1.0
    x[0] = np.nan
    assert np.isnan(kernel().dp_clearance(rough.blob, x, 1, geoms, 1.0, None, None))
