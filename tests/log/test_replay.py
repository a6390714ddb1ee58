"""A replay repeats a log to the bit, and finds the one bit that was changed."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from defplan_mj import registry
from defplan_mj.base import rotations
from defplan_mj.base.errors import DefplanError
from defplan_mj.body.model import Medium
from defplan_mj.dynamics.reduced import ReducedDynamics
from defplan_mj.dynamics.terrain import (
    Heightfield,
    Terrain,
    TerrainGeom,
    terrain_json,
    terrain_of,
)
from defplan_mj.log.reader import read_log
from defplan_mj.log.recorder import Recorder
from defplan_mj.log.replay import Difference, ReplayResult, replay_log, write_video
from defplan_mj.log.run_files import RunFiles
from tests.samples.bodies import pebble
from tests.samples.logs import (
    TIMESTEP,
    record_swim,
    sample_scene,
    spatial_scene,
    swimming_gait,
    tumbling_gait,
)

AIR = Medium(name="air", density=1.2, gravity=-9.81, righting_height=0.0)
FLAT = (0.5, 0.2, 0.12)
RIDGE = (TerrainGeom("plane"), TerrainGeom("box", (0.5, 0.1, 0.2), (3.0, 0.0, 0.0)))


@pytest.fixture
def path(swim_log):
    return swim_log


def flip(values: np.ndarray, *place: int) -> np.ndarray:
    """Return a copy with the last bit of one number flipped."""
    changed = values.copy()
    changed.view(np.uint64)[place] ^= 1
    return changed


def difference_of(result: ReplayResult) -> Difference:
    assert result.difference is not None
    return result.difference


def test_a_log_replays_to_the_bit_in_kernel_and_mujoco(path):
    result = replay_log(path)
    assert result.identical, result.sentence()
    assert result.simulators == ("kernel", "mujoco")
    assert result.steps == 66 and result.largest == 0 and result.changed == ()
    assert "identical to the bit" in result.sentence()
    assert json.loads(json.dumps(result.to_json(), allow_nan=False))["identical"] is True


def test_a_spatial_log_replays_to_the_bit_laser_and_all(tmp_path):
    body = pebble()
    path = tmp_path / "tumble.mcap"
    record_swim(path, RunFiles.of(body, tumbling_gait(body)), cycles=12, scene=spatial_scene())
    log = read_log(path)
    assert log.space == "spatial" and log.laser.min() < 8.0
    # it lies on its side from the start
    assert abs(rotations.matrix(log.states[0, 3:7])[2, 2]) < 0.1
    result = replay_log(log)
    assert result.identical, result.sentence()
    assert result.simulators == ("kernel", "mujoco") and result.largest == 0
    result = replay_log(replace(log, laser=flip(log.laser, 3, 5)))
    assert (difference_of(result).quantity, difference_of(result).label) == ("laser", "beam 5")


def test_a_log_with_feedback_replays_its_target_shapes_to_the_bit(path, tmp_path):
    solver = registry.get_solver("ilqg", "feedback")
    body = pebble()
    record_swim(tmp_path / "fed.mcap", RunFiles.of(body, swimming_gait(body)), 3, feedback=solver)
    log = read_log(tmp_path / "fed.mcap")
    assert not (log.target_shapes == read_log(path).target_shapes[: len(log.target_shapes)]).all()
    result = replay_log(log)
    assert result.identical, result.sentence()
    assert result.simulators == ("kernel", "mujoco") and result.steps == 33


def test_a_log_of_a_body_on_the_ground_holds_the_ground_and_its_forces(tmp_path):
    body, ground = pebble(AIR, FLAT), Terrain(friction=0.55, geoms=RIDGE)
    dynamics = ReducedDynamics(body, TIMESTEP, ground)
    x = dynamics.rest_state()
    path = tmp_path / "ground.mcap"
    with Recorder(path, RunFiles.of(body, terrain=ground)) as recorder:
        recorder.begin(
            {"timestep": TIMESTEP, "substeps": 2, "integrator": "variational", "state": x},
            sample_scene(),
        )
        for i in range(120):
            shape = np.array([0.3 * np.sin(0.5 * i), 0, 0]) * (i < 60)  # then it comes to rest
            x = dynamics.step(x, shape)
            recorder.step((i + 1) * TIMESTEP, x, shape, 1.0)
        recorder.end("timeout")
    log = read_log(path)
    assert log.terrain == ground
    assert np.ptp([contact.forces[:, 2].sum() for contact in log.contacts[:30]]) > 1
    weight = body.mass * 9.81
    np.testing.assert_allclose(log.contacts[-1].forces.sum(0), [0, 0, weight], atol=0.02 * weight)
    assert np.abs(log.contacts[-1].points[:, 2]).max() < 0.02  # on the ground, not on the ridge
    result = replay_log(log)
    assert result.identical and result.steps == 120
    parts = {name: data for name, data in log.attachments.items() if name != "terrain.json"}
    assert not replay_log(replace(log, attachments=parts)).identical  # without it the body falls


def test_an_episode_on_the_ground_replays_to_the_bit_in_kernel_and_mujoco(tmp_path):
    body, ground = pebble(AIR, FLAT), Terrain(friction=0.55)
    path = tmp_path / "walk.mcap"
    gait = swimming_gait(body)
    gait = replace(gait, alpha=0.1 * gait.alpha)  # so that it stays on its feet
    gait = replace(gait, substeps=1)  # contacts are those of a step's last substep
    record_swim(path, RunFiles.of(body, gait, terrain=ground))
    log = read_log(path)
    assert log.whole and len(log.gait_index) == 6 and len(log.contacts) == 33
    assert np.ptp(log.states[:, :2], axis=0).max() > 1e-3
    # what the kernel says pushes, sums up to the change of momentum over the step
    for contact in log.contacts[:5]:
        before, after = log.states[contact.step - 1], log.states[contact.step]
        change = body.mass * (after[10:13] - before[10:13]) / TIMESTEP
        weight = np.array([0, 0, -9.81]) * (body.mass - 1.2 * body.mass / 1000)
        drag = 0.02 * body.mass * 9.81  # of the air, and what floats in it
        np.testing.assert_allclose(contact.forces.sum(0) + weight, change, atol=drag)
    result = replay_log(log)
    assert result.identical, result.sentence()
    assert result.simulators == ("kernel", "mujoco")


def test_a_terrain_is_the_same_after_a_way_through_a_file():
    heights = np.random.default_rng(0).normal(size=(4, 5))
    ground = Terrain(RIDGE, Heightfield(heights, (2.0, 3.0), (0.1, 0.2, 0.3)), 0.7, thickness=0.02)
    again = terrain_of(json.loads(json.dumps(terrain_json(ground))))
    assert again.heightfield is not None
    assert replace(again, heightfield=None) == replace(ground, heightfield=None)
    np.testing.assert_array_equal(again.heightfield.heights, heights)
    assert again.heightfield.half_size == (2.0, 3.0)
    assert again.heightfield.position == (0.1, 0.2, 0.3)


def test_the_body_did_move(path):
    # else the tests below would compare standing still with standing still
    states = read_log(path).states
    assert np.ptp(states[:, :3], axis=0).max() > 1e-3
    assert np.ptp(states[:, 7:10], axis=0).max() > 0.1


def test_a_single_flipped_bit_is_found_at_its_step(path):
    log = read_log(path)
    result = replay_log(replace(log, states=flip(log.states, 37, 8)))
    assert not result.identical
    assert (difference_of(result).step, difference_of(result).label) == (37, "q2")
    assert difference_of(result).quantity == "state"
    assert difference_of(result).logged != difference_of(result).replayed
    assert "state q2 differs at step 37" in result.sentence()
    assert json.loads(json.dumps(result.to_json()))["difference"]["step"] == 37


def test_a_changed_control_is_found_one_step_later(path):
    log = read_log(path)
    # not a single bit: the solver stops at a tolerance and may not see one
    shapes = log.target_shapes.copy()
    shapes[20, 1] += 1e-3
    result = replay_log(replace(log, target_shapes=shapes))
    assert difference_of(result).step == 21 and result.largest > 0


@pytest.mark.parametrize(
    ("name", "place", "step", "label"),
    [("clearance", (12,), 13, ""), ("laser", (2, 7), 22, "beam 7"), ("reward", (3,), 44, "")],
)
def test_a_changed_measurement_is_found(path, name, place, step, label):
    log = read_log(path)
    changed: dict[str, Any] = {name: flip(getattr(log, name), *place)}
    result = replay_log(replace(log, **changed))
    assert (difference_of(result).quantity, difference_of(result).step) == (name, step)
    assert difference_of(result).label == label and difference_of(result).simulator == "mujoco"


def test_another_gait_than_the_logged_one_is_found(path):
    log = read_log(path)
    chosen = log.gait_index.copy()
    chosen[4] = (chosen[4] + 1) % 3
    result = replay_log(replace(log, gait_index=chosen))
    assert difference_of(result).simulator == "mujoco" and difference_of(result).step == 45


def test_a_cut_log_is_replayed_as_far_as_it_goes(path, tmp_path):
    data = path.read_bytes()
    (tmp_path / "cut.mcap").write_bytes(data[: int(len(data) * 0.7)])
    result = replay_log(tmp_path / "cut.mcap")
    assert result.identical and 0 < result.steps < 66
    assert "cut at byte" in result.sentence()


def test_versions_that_changed_are_named_beside_a_difference(path):
    log = read_log(path)
    log = replace(log, versions={**log.versions, "numpy": "1.0"}, states=flip(log.states, 3, 0))
    assert "numpy 1.0 -> " in replay_log(log).sentence()


def test_a_log_without_its_body_is_one_sentence(path):
    with pytest.raises(DefplanError, match=r"holds no body\.npz"):
        replay_log(replace(read_log(path), attachments={}))


def test_a_video_is_written(path, tmp_path, rendering):
    write_video(path, tmp_path / "swim.gif", size=(64, 48), fps=5)
    assert (tmp_path / "swim.gif").read_bytes().startswith(b"GIF8")
