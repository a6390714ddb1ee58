"""An exported gait problem is solved by a plain CasADi script, and what it finds is what simulation says."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest

from defplan_mj.body.model import Body
from defplan_mj.dynamics.external import load_instance
from defplan_mj.dynamics.reduced import ReducedDynamics
from defplan_mj.gait.problem import GaitProblem
from defplan_mj.task import GaitTask

SCRIPT = """
import sys
import casadi as ca
import numpy as np
from defplan_mj.dynamics.external import load_instance

problem = load_instance(sys.argv[1])
w = ca.MX.sym("w", problem.x0.size)
f, g = problem.function(w)
options = {"hessian_approximation": "limited-memory", "max_iter": 6, "print_level": 0, "sb": "yes"}
solver = ca.nlpsol("s", "ipopt", {"x": w, "f": f, "g": g}, {"ipopt": options, "print_time": False})
found = solver(x0=problem.x0, lbx=problem.lbx, ubx=problem.ubx, lbg=problem.lbg, ubg=problem.ubg)
problem.save_body(sys.argv[2])
np.savez(sys.argv[3], w=np.array(found["x"]).ravel(), f=float(found["f"]))
assert not any(name.startswith("defplan_mj.gait") for name in sys.modules)
"""


@pytest.fixture(scope="module")
def problem(small_fish: Body) -> GaitProblem:
    tasks = (GaitTask("forward", move=(0.5, 0.0, 0.0)), GaitTask("left", turn=(0.0, 0.0, 0.5)))
    return GaitProblem(ReducedDynamics(small_fish), tasks, 11, gait_steps=33)


def test_a_plain_script_improves_the_gait_of_a_file(problem, tmp_path):
    path, body, out = (tmp_path / name for name in ("gait.npz", "body.npz", "out.npz"))
    sequences = [[0, 1, 0], [1, 0, 1]]
    problem.export(path, seed=2, sequences=sequences)
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT, path, body, out], capture_output=True, text=True, timeout=200
    )
    assert done.returncode == 0, done.stderr
    found = np.load(out)
    cost = problem.objective(sequences)
    assert float(cost(found["w"])) == pytest.approx(float(found["f"]), rel=1e-12)
    start = load_instance(path).x0
    assert float(found["f"]) < 0.9 * float(cost(start))
    assert Body.load(body).hash == problem.dynamics.body.hash


def test_the_file_says_what_it_is(problem, tmp_path):
    problem.export(tmp_path / "gait.npz", start=np.zeros(problem.n_w))
    instance = load_instance(tmp_path / "gait.npz")
    assert instance.meta["tasks"] == ["forward", "left"]
    assert (instance.x0 == 0).all() and instance.function.size_in(0) == (problem.n_w, 1)
    assert instance.ubg.size == 2 * 11 * problem.dynamics.nu == instance.function.size_out(1)[0]
