"""What all tests share: one thread, no screen, and a way to render that works on this machine."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from defplan_mj.base import threads

threads.set_environment(1)  # before a test loads numpy

# Not the task itself: it loads MuJoCo, which must know first how to render.
from defplan_mj.body.model import Body  # noqa: E402
from defplan_mj.dynamics.reduced import ReducedDynamics  # noqa: E402
from defplan_mj.gait.gait import Gait  # noqa: E402
from tests.samples import bodies  # noqa: E402
from tests.samples.leftovers import left_in  # noqa: E402
from tests.samples.paths import ASSETS  # noqa: E402

_RENDER = """
import mujoco
model = mujoco.MjModel.from_xml_string("<mujoco><worldbody><geom size='1'/></worldbody></mujoco>")
with mujoco.Renderer(model, 16, 16) as renderer:
    renderer.update_scene(mujoco.MjData(model))
    renderer.render()
"""


def _renders(backend: str) -> bool:
    """Return whether MuJoCo renders with `backend` here; tried in a process that may crash."""
    environment = {**os.environ, "MUJOCO_GL": backend, "PYOPENGL_PLATFORM": backend}
    try:
        done = subprocess.run(
            [sys.executable, "-c", _RENDER], env=environment, capture_output=True, timeout=60
        )
    except subprocess.TimeoutExpired:
        return False
    return done.returncode == 0


def pytest_configure(config: pytest.Config) -> None:
    """Choose how to render without a screen: what MUJOCO_GL says, else EGL, else OSMesa."""
    wanted = os.environ.get("MUJOCO_GL")
    config.defplan_renders = False  # type: ignore[attr-defined]
    for backend in dict.fromkeys([*([wanted] if wanted else []), "egl", "osmesa"]):
        if _renders(backend):
            os.environ["MUJOCO_GL"] = os.environ["PYOPENGL_PLATFORM"] = backend
            config.defplan_renders = True  # type: ignore[attr-defined]
            return
    os.environ["MUJOCO_GL"] = "disable"


@pytest.fixture(scope="session", autouse=True)
def temporary_files(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Give the tests, and what they start, a folder for temporary files, in which they may leave none."""
    folder = tmp_path_factory.mktemp("temporary")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("TMPDIR", str(folder))
        patch.setattr(tempfile, "tempdir", None)  # it is asked for anew
        yield folder
    left = left_in(folder)
    assert not left, f"tests have left temporary files: {', '.join(left)}"


@pytest.fixture(scope="session")
def fish_gait() -> Gait:
    """The packaged fish's gait."""
    return Gait.load(ASSETS / "fish_gait.npz")


@pytest.fixture(scope="session")
def fish_dynamics(fish_gait: Gait) -> ReducedDynamics:
    """The packaged fish's dynamics."""
    return ReducedDynamics(Body.load(ASSETS / "fish_body.npz"), fish_gait.timestep)


@pytest.fixture
def rendering(pytestconfig: pytest.Config) -> None:
    """Skip the test on a machine where MuJoCo renders with neither EGL nor OSMesa."""
    if not pytestconfig.defplan_renders:  # type: ignore[attr-defined]
        pytest.skip("MuJoCo renders with neither EGL nor OSMesa here: is libEGL installed?")


@pytest.fixture(scope="session")
def small_fish() -> Body:
    """Return the fish on a coarse mesh."""
    return bodies.small_fish()


@pytest.fixture(scope="session")
def small_walker() -> Body:
    """Return the 4-legged body in air on a coarse mesh."""
    return bodies.small_walker()


@pytest.fixture(scope="session")
def fish() -> Body:
    """Return the fish of the paper's size; takes some seconds, so for slow tests."""
    return bodies.fish()


@pytest.fixture(scope="session")
def swim_log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the log of an episode of `bodies.pebble()`; a test that changes it works on a copy."""
    from tests.samples import logs  # loads MuJoCo

    path = tmp_path_factory.mktemp("swim") / "swim.mcap"
    logs.record_swim(path, logs.swimming_files(bodies.pebble()))
    return path
