"""CasADi functions of the dynamics in files and other processes: the same body, or a refusal that says so."""

from __future__ import annotations

import gc
import pickle
import subprocess
import sys

import casadi as ca
import numpy as np
import pytest

from defplan_mj.base.errors import DefplanError
from defplan_mj.body.model import Body, Medium
from defplan_mj.dynamics import casadi_files, casadi_slots
from defplan_mj.dynamics.external import CasadiDynamics, failure, load_function, save_function
from defplan_mj.dynamics.feet import lowest_feet
from defplan_mj.dynamics.reduced import ReducedDynamics
from tests.samples.kernel_cases import in_medium, random_state


@pytest.fixture(scope="module")
def dynamics(small_fish: Body) -> ReducedDynamics:
    return ReducedDynamics(small_fish)


@pytest.fixture(scope="module")
def other(small_fish: Body) -> ReducedDynamics:
    """A body of the same sizes, so that only its hash tells it apart."""
    return ReducedDynamics(in_medium(small_fish, Medium(density=500.0)))


@pytest.fixture
def at(dynamics: ReducedDynamics) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(0)
    return random_state(dynamics, rng), rng.uniform(-0.5, 0.5, dynamics.nu)


def in_a_process(code: str, *arguments: object) -> subprocess.CompletedProcess[str]:
    """Run Python code elsewhere; `arguments` are its sys.argv[1:]."""
    command = [sys.executable, "-c", code, *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=120)


def gradient_of(dynamics: ReducedDynamics) -> ca.Function:
    """Return a function with a step, rollouts, and their derivatives in it."""
    symbolic = CasadiDynamics(dynamics)
    x, u = ca.MX.sym("x", dynamics.nx), ca.MX.sym("u", dynamics.nu)
    end = symbolic.rollouts(3, 5)(ca.repmat(x, 1, 5), ca.repmat(u, 1, 15))
    jacobian = ca.jacobian(symbolic.step(x, u), u)
    return ca.Function("g", [x, u], [ca.gradient(ca.sumsqr(end), u), jacobian])


def test_a_saved_function_computes_the_same_bits_in_another_process(dynamics, at, tmp_path):
    function = gradient_of(dynamics)
    save_function(tmp_path / "g.npz", function)
    np.savez(tmp_path / "at.npz", x=at[0], u=at[1])
    code = """
import sys, numpy as np
from defplan_mj.dynamics.external import load_function
at = np.load(sys.argv[2])
a, b = load_function(sys.argv[1])(at["x"], at["u"])
np.savez(sys.argv[3], a=np.array(a), b=np.array(b))
"""
    done = in_a_process(code, tmp_path / "g.npz", tmp_path / "at.npz", tmp_path / "out.npz")
    assert done.returncode == 0, done.stderr
    out = np.load(tmp_path / "out.npz")
    for name, wanted in zip("ab", function(*at), strict=True):
        np.testing.assert_array_equal(out[name], np.array(wanted))


def test_functions_load_where_their_slots_are_taken_by_other_bodies(dynamics, other, at, tmp_path):
    function = CasadiDynamics(dynamics).step
    wanted, text = np.array(function(*at)), function.serialize()
    (slot,) = casadi_slots.slots_in(text)
    save_function(tmp_path / "step.npz", function)
    del function
    gc.collect()
    blocker = CasadiDynamics(other).step
    assert casadi_slots.slots_in(blocker.serialize()) == [slot]
    assert np.abs(np.array(blocker(*at)) - wanted).max() > 1e-3
    loaded = load_function(tmp_path / "step.npz")
    np.testing.assert_array_equal(np.array(loaded(*at)), wanted)
    x_next = wanted.ravel()
    for value, exact in zip(
        loaded.jacobian()(*at, x_next), dynamics.step_jacobian(*at, x_next), strict=True
    ):
        np.testing.assert_array_equal(np.array(value), exact)
    # and once more, from what was loaded
    save_function(tmp_path / "again.npz", loaded)
    del loaded
    np.testing.assert_array_equal(np.array(load_function(tmp_path / "again.npz")(*at)), wanted)


def test_casadis_own_way_is_refused_where_the_slot_holds_another_body(dynamics, other, at, capfd):
    texts = [
        f.serialize()
        for f in (
            CasadiDynamics(dynamics).step,
            CasadiDynamics(dynamics).step.jacobian(),
            CasadiDynamics(dynamics).step.reverse(1),
        )
    ]
    gc.collect()
    blocker = CasadiDynamics(other).step
    wanted = np.array(blocker(*at))
    for text in texts:
        with pytest.raises(RuntimeError, match="config failed"):
            ca.Function.deserialize(text)
    assert capfd.readouterr().err.count("holds another one here: load it by") == 3
    np.testing.assert_array_equal(np.array(blocker(*at)), wanted)
    del blocker
    gc.collect()
    with pytest.raises(RuntimeError, match="config failed"):
        ca.Function.deserialize(texts[0])
    assert "is empty here" in capfd.readouterr().err
    # what was refused took no slot
    steps = [CasadiDynamics(dynamics).rollout(n) for n in range(2, 2 + casadi_slots.N_SLOTS)]
    assert len(steps) == casadi_slots.N_SLOTS


def test_a_function_pickled_to_another_process_is_refused_there(dynamics, tmp_path):
    (tmp_path / "step.pickle").write_bytes(pickle.dumps(CasadiDynamics(dynamics).step))
    code = "import pickle, sys; pickle.load(open(sys.argv[1], 'rb'))"
    done = in_a_process(code, tmp_path / "step.pickle")
    assert done.returncode == 1  # not a crash
    assert "load_function" in done.stderr


def test_a_function_moves_to_another_installation(dynamics, at, tmp_path, monkeypatch):
    path = casadi_slots.library.PATH
    elsewhere = tmp_path / "elsewhere" / path.name
    elsewhere.parent.mkdir()
    elsewhere.symlink_to(path)
    monkeypatch.setattr(casadi_slots.library, "PATH", elsewhere)
    function = CasadiDynamics(dynamics).step
    assert casadi_slots.encode(str(elsewhere)) in function.serialize()
    save_function(tmp_path / "step.npz", function)
    elsewhere.unlink()
    monkeypatch.setattr(casadi_slots.library, "PATH", path)
    np.testing.assert_array_equal(
        np.array(load_function(tmp_path / "step.npz")(*at)), np.array(function(*at))
    )


def test_a_whole_solver_is_saved_with_its_body(dynamics, tmp_path):
    u = ca.MX.sym("u", dynamics.nu)
    end = CasadiDynamics(dynamics).rollout(5)(dynamics.rest_state(), ca.repmat(u, 1, 5))[:, -1]
    cost = ca.sumsqr(end[7 : 7 + dynamics.nu] - 0.1)
    options = {
        "print_time": False,
        "ipopt": {"print_level": 0, "hessian_approximation": "limited-memory"},
    }
    solver = ca.nlpsol("solver", "ipopt", {"x": u, "f": cost}, options)
    wanted = np.array(solver(x0=0)["x"])
    save_function(tmp_path / "solver.npz", solver)
    del solver, cost, end
    gc.collect()
    np.testing.assert_array_equal(
        np.array(load_function(tmp_path / "solver.npz")(x0=0)["x"]), wanted
    )


def test_files_that_are_not_whole_functions_are_named(dynamics, tmp_path):
    with pytest.raises(DefplanError, match="does not exist"):
        load_function(tmp_path / "none.npz")
    (tmp_path / "bad.npz").write_bytes(b"not an archive")
    with pytest.raises(DefplanError, match="not a whole CasADi function file"):
        load_function(tmp_path / "bad.npz")
    save_function(tmp_path / "step.npz", CasadiDynamics(dynamics).step)
    arrays, meta, _ = casadi_files.files.load_archive(tmp_path / "step.npz", "CasADi function", 1)
    arrays["function"] = arrays["function"][:-40]
    casadi_files.files.save_archive(tmp_path / "short.npz", "CasADi function", 1, arrays, meta)
    with pytest.raises(DefplanError, match="make it anew"):
        load_function(tmp_path / "short.npz")


def test_dynamics_pickle_with_terrain_feet_and_options(small_walker):
    feet = ReducedDynamics(small_walker, 0.03, feet=lowest_feet(small_walker), tolerance=1e-9)
    copy = pickle.loads(pickle.dumps(feet))
    np.testing.assert_array_equal(copy.par, feet.par)
    np.testing.assert_array_equal(copy.blob, feet.blob)
    x, u = feet.rest_state(), np.full(feet.nu, 0.1)
    np.testing.assert_array_equal(copy.step(x, u), feet.step(x, u))
    symbolic = pickle.loads(pickle.dumps(CasadiDynamics(feet)))
    np.testing.assert_array_equal(np.array(symbolic.step(x, u)).ravel(), feet.step(x, u))


def test_failures_are_told_apart(dynamics, at, small_fish, capfd):
    step, (x, u) = CasadiDynamics(dynamics).step, at
    assert failure(step) is None
    cases = [
        (np.where(np.arange(dynamics.nx) == 8, np.nan, x), u, "not finite"),
        (x, np.full(dynamics.nu, np.inf), "not finite"),
        (np.concatenate([x[:3], np.zeros(4), x[7:]]), u, "quaternion"),
        (np.concatenate([x[:3], np.full(4, 1e300), x[7:]]), u, "quaternion"),
    ]
    for state, shape, reason in cases:
        with pytest.raises(RuntimeError, match="Evaluation failed"):
            step(state, shape)
        assert reason in (failure(step) or "")
    assert failure(step) is None
    hurried = CasadiDynamics(ReducedDynamics(small_fish, max_newton=1, tolerance=1e-30)).step
    with pytest.raises(RuntimeError):
        hurried(dynamics.rest_state(), np.ones(dynamics.nu))
    assert failure(hurried) == "a step was not solved"
    said = capfd.readouterr().err
    assert said.count("not finite") == said.count("quaternion") == said.count("not solved") == 1
    with pytest.raises(RuntimeError):  # derivatives as well
        step.reverse(1)(x, u, np.full(dynamics.nx, np.nan), np.ones(dynamics.nx))
    assert "not finite" in (failure(step) or "")


def test_functions_of_one_step_of_a_body_share_a_slot(dynamics, at):
    steps = [CasadiDynamics(dynamics).step for _ in range(casadi_slots.N_SLOTS + 6)]
    assert len({f.name() for f in steps}) == 1
    np.testing.assert_array_equal(np.array(steps[-1](*at)), np.array(steps[0](*at)))
