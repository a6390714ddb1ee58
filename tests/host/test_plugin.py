"""The engine plugin steps exactly like the kernel, in every way that MuJoCo can step a model."""

from __future__ import annotations

import concurrent.futures
import copy
import pickle
import subprocess
import sys

import mujoco
import numpy as np
import pytest
from mujoco import rollout
from mujoco.batch import Batch

from defplan_mj.base.errors import DefplanError
from defplan_mj.dynamics.reduced import ReducedDynamics
from defplan_mj.dynamics.terrain import Terrain
from defplan_mj.host.plugin import load_plugin
from defplan_mj.host.scene import build_spec, compile_model
from defplan_mj.registry import get_task
from defplan_mj.studies import check
from tests.samples import host as samples

FULL = mujoco.mjtState.mjSTATE_FULLPHYSICS


@pytest.fixture(scope="module")
def model() -> mujoco.MjModel:
    return compile_model(build_spec(samples.fish(), 0.04, max_obstacles=2))


@pytest.fixture(scope="module")
def controls() -> np.ndarray:
    generator = np.random.default_rng(0)
    walk = np.cumsum(generator.normal(0, 0.25, (120, samples.fish().n_modes)), axis=0)
    return np.sin(walk)


def _state(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    state = np.empty(mujoco.mj_stateSize(model, FULL))
    mujoco.mj_getState(model, data, state, FULL)
    return state


def _run(model: mujoco.MjModel, data: mujoco.MjData, controls: np.ndarray) -> np.ndarray:
    states = []
    for control in controls:
        data.ctrl[:] = control
        mujoco.mj_step(model, data)
        states.append(_state(model, data))
    return np.array(states)


def test_steps_equal_the_python_face_to_the_bit(model, controls):
    data, dynamics = mujoco.MjData(model), samples.dynamics()
    x = dynamics.rest_state()
    for control in controls:
        data.ctrl[:] = control
        mujoco.mj_step(model, data)
        x = dynamics.step(x, samples.fish().amplitude * control)
        assert np.array_equal(np.concatenate([data.qpos, data.qvel, data.act]), x)
    assert np.linalg.norm(x[:3]) > 1e-3  # it did move


def test_raw_controls_are_the_target_shape_itself(controls):
    spec = build_spec(samples.fish(), 0.04, normalised_controls=False)
    raw = compile_model(spec)
    data, dynamics = mujoco.MjData(raw), samples.dynamics()
    shapes = 0.77 * controls[:30]
    states = dynamics.rollout(dynamics.rest_state(), shapes)
    _run(raw, data, shapes)
    assert np.array_equal(np.concatenate([data.qpos, data.qvel, data.act]), states[-1])


def test_controls_are_clipped_to_their_range(model):
    inside, outside = mujoco.MjData(model), mujoco.MjData(model)
    inside.ctrl[:], outside.ctrl[:] = 1.0, 7.0
    for _ in range(5):
        mujoco.mj_step(model, inside)
        mujoco.mj_step(model, outside)
    assert np.array_equal(inside.qpos, outside.qpos)


def test_time_step_is_the_models(model):
    finer = copy.copy(model)
    finer.opt.timestep = 0.01
    data, dynamics = mujoco.MjData(finer), samples.dynamics(0.01)
    data.ctrl[:] = 0.3
    for _ in range(4):
        mujoco.mj_step(finer, data)
    shapes = np.tile(0.3 * samples.fish().amplitude, (4, 1))
    states = dynamics.rollout(dynamics.rest_state(), shapes)
    assert np.array_equal(data.qpos, states[-1, : len(data.qpos)])


def test_split_steps_equal_whole_steps(model, controls):
    whole, split = mujoco.MjData(model), mujoco.MjData(model)
    for control in controls[:20]:
        whole.ctrl[:] = split.ctrl[:] = control
        mujoco.mj_step(model, whole)
        mujoco.mj_step1(model, split)
        mujoco.mj_step2(model, split)
        assert np.array_equal(_state(model, whole), _state(model, split))


def test_saved_state_replays_to_the_bit(model, controls):
    data = mujoco.MjData(model)
    _run(model, data, controls[:20])
    saved = _state(model, data)
    first = _run(model, data, controls[20:60])
    mujoco.mj_setState(model, data, saved, FULL)
    assert np.array_equal(_run(model, data, controls[20:60]), first)


def test_copies_and_pickles_step_alike(model, controls):
    data = mujoco.MjData(model)
    _run(model, data, controls[:20])
    twins = [copy.copy(data), copy.deepcopy(data), pickle.loads(pickle.dumps(data))]
    expected = _run(model, data, controls[20:50])
    for twin in twins:
        assert np.array_equal(_run(twin.model, twin, controls[20:50]), expected)


def test_saved_model_steps_alike(model, controls, tmp_path):
    path = str(tmp_path / "fish.mjb")
    mujoco.mj_saveModel(model, path)
    loaded = mujoco.MjModel.from_binary_path(path)
    expected = _run(model, mujoco.MjData(model), controls[:20])
    assert np.array_equal(_run(loaded, mujoco.MjData(loaded), controls[:20]), expected)


@pytest.mark.parametrize("threads", [1, 2])
def test_rollout_equals_single_steps(model, controls, threads):
    states = []
    for _ in range(6):
        data = mujoco.MjData(model)
        states.append(_run(model, data, controls[:40]))
    start = np.tile(_state(model, mujoco.MjData(model)), (6, 1))
    batch = [mujoco.MjData(model) for _ in range(threads)]
    rolled, _ = rollout.rollout(model, batch, start, np.tile(controls[:40], (6, 1, 1)))
    assert np.array_equal(rolled, np.array(states))


def test_mujocos_batch_equals_single_steps(model, controls):
    expected = _run(model, mujoco.MjData(model), controls[:40])
    simulations = Batch(model, nsim=4, nthread=2)
    qpos, qvel, ctrl = (simulations.bind(name) for name in ("qpos", "qvel", "ctrl"))
    for control, state in zip(controls[:40], expected, strict=True):
        ctrl[:] = control
        simulations.step()
        assert np.array_equal(qpos, np.tile(state[1 : 1 + model.nq], (4, 1)))
        assert np.array_equal(qvel, np.tile(state[1 + model.nq :][: model.nv], (4, 1)))


def test_python_threads_step_alike(model, controls):
    expected = _run(model, mujoco.MjData(model), controls[:60])
    with concurrent.futures.ThreadPoolExecutor(2) as pool:
        jobs = [pool.submit(_run, model, mujoco.MjData(model), controls[:60]) for _ in range(4)]
        for job in jobs:
            assert np.array_equal(job.result(), expected)


def _attached(world: mujoco.MjSpec, robot: mujoco.MjSpec, prefix: str, place=(0, 0, 0)) -> None:
    frame = world.worldbody.add_frame(pos=place)
    world.attach(robot, prefix=prefix, suffix="_1", frame=frame)


@pytest.mark.filterwarnings("ignore:Attach conflict")
def test_robots_attached_with_prefixes_do_what_they_do_alone(model, controls):
    """A swimmer and a walker in one world: terrain, body and options are each one's own."""
    ground, body = Terrain(), check.packaged_robot(get_task("quadruped-walk")).body
    walker = build_spec(body, 0.015, terrain=ground)
    walking = compile_model(walker)
    world = mujoco.MjSpec()
    world.option.timestep = 0.015
    world.option.integrator = mujoco.mjtIntegrator.mjINT_EULER
    world.worldbody.add_geom(size=[0.2, 0, 0], pos=[0, 0, 40])
    _attached(world, build_spec(samples.fish(), 0.015), "fish/", (0, 0, 30))
    _attached(world, walker, "walker/")
    together = compile_model(world)
    data, alone = mujoco.MjData(together), mujoco.MjData(walking)
    swimming = samples.dynamics(0.015)
    r = samples.fish().n_modes
    alone.qpos[:] = ReducedDynamics(body, 0.015, ground).rest_state()[: walking.nq]
    data.qpos[7 + r :] = alone.qpos
    x = swimming.rest_state()
    x[2] = 30.0
    for control in controls[:40]:
        data.ctrl[:r] = control
        data.ctrl[r:] = alone.ctrl[:] = 0.1 * np.resize(control, walking.nu)
        mujoco.mj_step(together, data)
        mujoco.mj_step(walking, alone)
        x = swimming.step(x, samples.fish().amplitude * control)
    assert np.array_equal(data.qpos[: 7 + r], x[: 7 + r])
    assert np.array_equal(data.qpos[7 + r :], alone.qpos)
    assert np.array_equal(data.act, np.concatenate([x[-r:], alone.act]))
    assert data.sensor("fish/clearance_1").data == 1.0


@pytest.mark.filterwarnings("ignore:Attach conflict")
def test_an_attached_robot_wears_its_own_deformed_skin(model, controls):
    world = mujoco.MjSpec()
    world.option.timestep = 0.04
    _attached(world, build_spec(samples.fish(), 0.04), "a")
    attached = compile_model(world)
    drawn = []
    for each in (attached, copy.copy(model)):
        data = mujoco.MjData(each)
        _run(each, data, controls[:10])
        scene = mujoco.MjvScene(each, maxgeom=100)
        options, camera = mujoco.MjvOption(), mujoco.MjvCamera()
        perturb, everything = mujoco.MjvPerturb(), mujoco.mjtCatBit.mjCAT_ALL
        mujoco.mjv_updateScene(each, data, options, perturb, camera, everything, scene)
        drawn.append(each.skin_vert.copy())
    assert np.array_equal(*drawn)
    points = samples.fish().vertices[samples.fish().surface]
    assert not np.allclose(drawn[0], points, atol=1e-3)


def test_other_bodies_keep_mujocos_dynamics(controls):
    spec = build_spec(samples.fish(), 0.04)
    ball = spec.worldbody.add_body(name="ball", pos=[0, 3, 0])
    ball.add_freejoint()
    ball.add_geom(size=[0.1, 0, 0])
    together = compile_model(spec)
    data, dynamics = mujoco.MjData(together), samples.dynamics()
    n = 20
    for control in controls[:n]:
        data.ctrl[:] = control
        mujoco.mj_step(together, data)
    fall = -9.81 * 0.04**2 * n * (n + 1) / 2  # semi-implicit Euler
    assert data.body("ball").xpos[2] == pytest.approx(fall, abs=0.5)
    assert data.qpos[-5] == pytest.approx(fall, rel=1e-9)
    x = dynamics.rollout(dynamics.rest_state(), samples.fish().amplitude * controls[:n])[-1]
    assert np.array_equal(data.qpos[:-7], x[: 7 + dynamics.nu])


def test_kernels_mass_and_inertia_are_the_models(model):
    assert model.body("robot").mass[0] == pytest.approx(samples.fish().mass, rel=1e-12)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    assert np.allclose(data.body("robot").subtree_com, 0, atol=1e-9)


def test_bad_control_counts_as_none(model):
    data, calm = mujoco.MjData(model), mujoco.MjData(model)
    data.ctrl[:] = 0.5
    data.ctrl[0] = np.nan
    mujoco.mj_step(model, data)
    calm.ctrl[1:] = 0.5
    mujoco.mj_step(model, calm)
    assert np.array_equal(data.qpos, calm.qpos)
    assert data.warning[mujoco.mjtWarning.mjWARN_BADCTRL].number == 1


def test_disabled_actuation_leaves_the_joints_to_mujoco(model):
    data = mujoco.MjData(model)
    data.qvel[0] = 1.0
    model_off = copy.copy(model)
    model_off.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_ACTUATION
    data.ctrl[:] = 1.0
    mujoco.mj_step(model_off, data)
    assert data.qpos[0] == pytest.approx(0.04) and not data.qpos[7:].any()


def test_runge_kutta_is_refused(model):
    wrong = copy.copy(model)
    wrong.opt.integrator = mujoco.mjtIntegrator.mjINT_RK4
    data = mujoco.MjData(wrong)
    with pytest.raises(mujoco.FatalError, match="RK4 is not supported, use Euler"):
        mujoco.mj_step(wrong, data)


def test_body_of_another_version_is_refused():
    spec = build_spec(samples.fish(), 0.04)
    blob = spec.numeric("defplan_body")
    data = np.array(blob.data)
    data[1] += 1
    blob.data = data
    with pytest.raises(DefplanError, match="no valid body numeric"):
        compile_model(spec)


def test_missing_library_is_one_sentence(tmp_path):
    with pytest.raises(DefplanError, match="is not built: install defplan"):
        load_plugin(tmp_path / "libdefplan_plugin.so")


def test_physics_unpickles_in_a_fresh_process(tmp_path):
    physics = samples.physics(0)
    physics.set_control(np.full(physics.n_modes, 0.2))
    physics.step(5)
    (tmp_path / "physics.pkl").write_bytes(pickle.dumps(physics))
    program = (
        "import pickle, sys; physics = pickle.load(open(sys.argv[1], 'rb'));"
        "physics.step(5); sys.stdout.buffer.write(physics.reduced_state().tobytes())"
    )
    done = subprocess.run(
        [sys.executable, "-c", program, str(tmp_path / "physics.pkl")],
        capture_output=True,
        check=True,
    )
    physics.step(5)
    assert done.stdout == physics.reduced_state().tobytes()


@pytest.mark.parametrize("numeric", ["defplan_body", "defplan_options", "defplan_scale"])
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_model_with_a_number_that_is_none_is_refused(model, numeric, value):
    spoilt = copy.copy(model)
    found = spoilt.numeric(numeric)
    spoilt.numeric_data[found.adr[0] + found.size[0] - 1] = value
    with pytest.raises(mujoco.FatalError, match="plugin->init failed"):
        mujoco.MjData(spoilt)


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_an_activation_that_is_no_number_fails_with_a_finite_state(model, value):
    data = mujoco.MjData(model)
    data.act[0] = value
    mujoco.mj_step(model, data)
    assert data.plugin_state[3] == 1  # ST_FAILED
    assert np.isfinite(np.concatenate([data.qpos, data.qvel, data.act])).all()
