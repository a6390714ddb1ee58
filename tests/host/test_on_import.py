"""`import defplan_mj` is enough for saved and pickled models: without the plugin they crash the process."""

from __future__ import annotations

import os
import pickle
import subprocess
import sys

import mujoco
import numpy as np
import pytest

from defplan_mj.host.scene import build_spec, compile_model
from tests.samples import host as samples
from tests.samples.paths import ROOT


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    """The sample's model as .mjb and as a pickle, and where a step takes it."""
    folder = tmp_path_factory.mktemp("models")
    model = compile_model(build_spec(samples.fish(), 0.04))
    mujoco.mj_saveModel(model, str(folder / "fish.mjb"))
    (folder / "fish.pkl").write_bytes(pickle.dumps(model))
    data = mujoco.MjData(model)
    data.ctrl[:] = 0.5
    for _ in range(3):
        mujoco.mj_step(model, data)
    return folder, data.qpos.copy()


STEP = """
data = mujoco.MjData(model)
data.ctrl[:] = 0.5
for _ in range(3):
    mujoco.mj_step(model, data)
print(data.qpos.tobytes().hex())
"""
READ = {
    "mjb": "model = mujoco.MjModel.from_binary_path('fish.mjb')",
    "pickle": "import pickle\nmodel = pickle.load(open('fish.pkl', 'rb'))",
}


@pytest.mark.parametrize(
    ("kind", "imports"),
    [("mjb", "import mujoco\nimport defplan_mj"), ("pickle", "import defplan_mj\nimport mujoco")],
)
def test_a_plain_script_reads_a_model_after_import_defplan_mj(saved, kind, imports):
    folder, expected = saved
    done = subprocess.run(
        [sys.executable, "-c", f"{imports}\n{READ[kind]}\n{STEP}"],
        cwd=folder,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    np.testing.assert_array_equal(np.frombuffer(bytes.fromhex(done.stdout.strip())), expected)


def test_import_defplan_mj_does_not_import_mujoco():
    code = (
        "import sys, defplan_mj; assert 'mujoco' not in sys.modules and 'numpy' not in sys.modules"
    )
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0


@pytest.mark.parametrize("first", ["defplan_mj.host.plugin", "defplan_mj.host.physics"])
def test_whichever_module_comes_first_the_plugin_is_loaded_once(saved, first):
    folder, expected = saved
    code = f"import {first}\nfrom defplan_mj.host.plugin import load_plugin\nload_plugin()\nimport mujoco"
    done = subprocess.run(
        [sys.executable, "-c", f"{code}\n{READ['mjb']}\n{STEP}"],
        cwd=folder,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    np.testing.assert_array_equal(np.frombuffer(bytes.fromhex(done.stdout.strip())), expected)


@pytest.mark.parametrize("gpu", [False, True])
def test_triton_is_kept_out_where_there_is_no_gpu(gpu, tmp_path):
    """A stand-in for triton is on the path; an optimiser would load it through torch's dynamo."""
    (tmp_path / "triton.py").write_text("loaded = True\n")
    code = (
        "import sys\n"
        "from defplan_mj.host import on_import\n"
        f"on_import._GPUS = ({str(tmp_path)!r},) if {gpu} else ()\n"
        "sys.modules.pop('triton', None)\n"
        "on_import.keep_triton_out()\n"
        "try:\n    import triton\nexcept ModuleNotFoundError:\n    print('out')\n"
        "else:\n    print('in')\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": f"{tmp_path}{os.pathsep}{ROOT}"},
    )
    assert done.stdout.strip() == ("in" if gpu else "out"), done.stderr
