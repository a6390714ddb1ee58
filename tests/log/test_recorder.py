"""Logs hold every number to the bit, in schemas that viewers know, and survive a stop."""

from __future__ import annotations

import errno

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from scipy.spatial.transform import Rotation

from defplan_mj.base import rotations
from defplan_mj.base.errors import DefplanError
from defplan_mj.dynamics.rigid import RigidDynamics
from defplan_mj.log import channels, schemas
from defplan_mj.log.messages import _towards
from defplan_mj.log.reader import read_log
from defplan_mj.log.recorder import Recorder
from defplan_mj.log.run_files import RunFiles
from defplan_mj.planning.sensors.laser import beam_directions
from tests.samples.logs import (
    MODES,
    STEPS_PER_CYCLE,
    TIMESTEP,
    record_episode,
    sample_body,
    sample_gait,
    sample_scene,
    sample_surrogate,
    spatial_parts,
    spatial_scene,
    surface_of,
)

STEPPING = {"substeps": 2, "integrator": "variational"}


def messages(path):
    """Decode every message by the schemas that are in the file itself, as a viewer does."""
    with open(path, "rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        return [
            (channel.topic, schema.name if schema else "", message.log_time, content)
            for schema, channel, message, content in reader.iter_decoded_messages(
                log_time_order=False
            )
        ]


@pytest.fixture(scope="module")
def logged(tmp_path_factory):
    path = tmp_path_factory.mktemp("log") / "episode.mcap"
    kept = record_episode(path, scene=sample_scene(speed=0.5))
    return path, kept, messages(path)


def test_what_was_recorded_is_read_back_to_the_bit(logged):
    path, kept, _ = logged
    log = read_log(path)
    assert log.whole and log.outcome == "success" and log.reason == "the target was reached"
    for name in ("states", "target_shapes", "clearance", "gait_index", "values", "reward", "laser"):
        np.testing.assert_array_equal(getattr(log, name), kept[name], err_msg=name)
    np.testing.assert_allclose(log.time, kept["time"], atol=1e-9)
    np.testing.assert_array_equal(log.cycle_steps, STEPS_PER_CYCLE * np.arange(9))


def test_configuration_scene_and_parts_are_read_back(logged):
    log = read_log(logged[0])
    assert (log.task, log.seed, log.timestep) == ("bar-swim", "3", TIMESTEP)
    assert log.configuration["planner"] == "greedy" and log.configuration["episode"] == 4
    assert log.versions["numpy"] == np.__version__
    scene = sample_scene(speed=0.5)
    np.testing.assert_array_equal(log.scene.centres, scene.centres)
    np.testing.assert_array_equal(log.scene.velocities, scene.velocities)
    assert log.body.hash == log.body_hash == sample_body().hash
    np.testing.assert_array_equal(log.gait.alpha, sample_gait(sample_body()).alpha)
    np.testing.assert_array_equal(log.surrogate.rotations, sample_surrogate(log.body).rotations)


def test_every_channel_has_its_schema_and_decodes_with_it(logged):
    found = {topic: name for topic, name, _, _ in logged[2]}
    expected = {c.topic: c.message.DESCRIPTOR.full_name for c in channels.CHANNELS}
    # what a planar episode in which nothing pushes has no use for
    for topic in (channels.LASER_POINTS, channels.FORCES, channels.ARROWS):
        expected.pop(topic)
    assert found == expected
    assert expected["/robot/mesh"] == "foxglove.SceneUpdate"


def test_hand_packed_messages_say_what_the_state_says(logged):
    _, kept, decoded = logged
    x = kept["states"][7]
    at = [m for m in decoded if m[2] == round(7 * TIMESTEP * 1e9)]
    by_topic = {topic: content for topic, _, _, content in at}
    transform = by_topic["/tf"].transforms[0]
    pose = by_topic["/robot/com"].pose
    assert (transform.parent_frame_id, transform.child_frame_id) == ("world", "robot")
    for place, turn in (
        (transform.translation, transform.rotation),
        (pose.position, pose.orientation),
    ):
        assert [place.x, place.y, place.z] == x[:3].tolist()
        assert [turn.w, turn.x, turn.y, turn.z] == x[3:7].tolist()
    numbers = by_topic["/robot/state"]
    assert list(numbers.labels) == schemas.state_labels(MODES)
    assert list(numbers.values) == x.tolist()
    assert numbers.timestamp.ToNanoseconds() == round(7 * TIMESTEP * 1e9)


def test_logged_surface_is_the_deformed_one_in_the_robots_frame(logged):
    _, kept, decoded = logged
    body = sample_body()
    meshes = [(t, m.entities[0]) for topic, _, t, m in decoded if topic == "/robot/mesh"]
    assert len(meshes) == 1 + 8 * STEPS_PER_CYCLE // 2
    time, entity = meshes[5]
    step = round(time * 1e-9 / TIMESTEP)
    assert step == 10 and entity.frame_id == "robot" and entity.frame_locked
    x = kept["states"][step]
    triangles = entity.triangles[0]
    points = np.array([[p.x, p.y, p.z] for p in triangles.points]) @ rotations.matrix(x[3:7]).T
    np.testing.assert_allclose(points + x[:3], surface_of(body)(x), atol=2.0**-12)
    np.testing.assert_array_equal(np.reshape(triangles.indices, (-1, 3)), body.faces)


def test_entities_keep_their_ids_and_obstacles_move(logged):
    scenes = [(t, m) for topic, _, t, m in logged[2] if topic == "/scene"]
    ids = {tuple(entity.id for entity in m.entities) for _, m in scenes}
    assert ids == {("target", "obstacle/0", "obstacle/1", "obstacle/2")}
    assert {e.id for topic, *_, m in logged[2] if topic == "/robot/mesh" for e in m.entities} == {
        "robot"
    }
    scene = sample_scene(speed=0.5)
    time, last = scenes[-1]
    centre = scene.centres[1] + scene.velocities[1] * time * 1e-9
    drawn = last.entities[2].cylinders[0].pose.position
    np.testing.assert_allclose([drawn.x, drawn.y, drawn.z], centre, atol=1e-12)


def test_still_obstacles_are_drawn_once(tmp_path):
    record_episode(tmp_path / "still.mcap")
    assert [m[0] for m in messages(tmp_path / "still.mcap")].count("/scene") == 1


def test_laser_scan_points_where_the_body_heads(logged):
    _, kept, decoded = logged
    scan = [m for topic, _, _, m in decoded if topic == "/laser"][3]
    x = kept["states"][3 * STEPS_PER_CYCLE]
    turn = scan.pose.orientation
    heading = rotations.heading(rotations.matrix(np.array([turn.w, turn.x, turn.y, turn.z])))
    assert heading == pytest.approx(rotations.heading(rotations.matrix(x[3:7])))
    # beams that met nothing are infinite
    expected = np.where(kept["laser"][3] < 8.0, kept["laser"][3], np.inf)
    assert np.isinf(expected).any()
    assert list(scan.ranges) == expected.tolist()
    # n beams once around: the last one is one beam short of a full turn
    assert scan.end_angle - scan.start_angle == pytest.approx(2 * np.pi * 63 / 64)


@pytest.fixture(scope="module")
def spatial(tmp_path_factory):
    """A spatial episode in which four points push, as numbers, messages and what was recorded."""
    path = tmp_path_factory.mktemp("spatial") / "episode.mcap"
    body = sample_body()
    files = RunFiles.of(body, *spatial_parts(body))
    kept = record_episode(path, scene=spatial_scene(), files=files, contacts=pushing)
    return path, kept, messages(path)


def pushing(x):
    """Return points and forces of a state; in some of them nothing touches."""
    rng = np.random.default_rng(x.view(np.uint64))
    n = rng.choice([0, 4, 5])
    return rng.normal(size=(n, 3)), rng.normal(size=(n, 3)) * 50


def test_a_spatial_log_is_read_back_to_the_bit(spatial):
    path, kept, decoded = spatial
    log = read_log(path)
    assert log.whole and log.space == "spatial"
    for name in ("states", "target_shapes", "clearance", "gait_index", "values", "reward", "laser"):
        np.testing.assert_array_equal(getattr(log, name), kept[name], err_msg=name)
    np.testing.assert_array_equal(log.scene.orientation, spatial_scene().orientation)
    entities = next(m for topic, _, _, m in decoded if topic == "/scene").entities
    spheres = [e.spheres[0] for e in entities if e.id.startswith("obstacle")]
    assert [s.size.x / 2 for s in spheres] == log.scene.radii.tolist()
    assert [s.pose.position.z for s in spheres] == log.scene.centres[:, 2].tolist()


def test_points_of_a_spherical_laser_lie_where_its_beams_end(spatial):
    _, kept, decoded = spatial
    cloud = [m for topic, _, _, m in decoded if topic == "/laser/points"][3]
    assert [f.name for f in cloud.fields] == ["x", "y", "z", "distance"]
    assert {f.type for f in cloud.fields} == {8} and cloud.point_stride == 32  # float64
    points = np.frombuffer(cloud.data, "<f8").reshape(-1, 4)
    ranges = kept["laser"][3]
    hit = ranges < 8.0
    assert 0 < hit.sum() < 64 and len(points) == hit.sum()  # a beam that meets nothing has no point
    np.testing.assert_array_equal(points[:, 3], ranges[hit])
    # in the world: from the centre of mass along the beams, which turn with the whole body
    x = kept["states"][3 * STEPS_PER_CYCLE]
    turn, place = cloud.pose.orientation, cloud.pose.position
    attitude = Rotation.from_quat([turn.x, turn.y, turn.z, turn.w])
    body = Rotation.from_quat(x[3:7], scalar_first=True)
    assert (attitude.inv() * body).magnitude() < 1e-12
    seen = attitude.apply(points[:, :3].copy()) + [place.x, place.y, place.z]
    ends = x[:3] + ranges[hit, None] * body.apply(beam_directions(64, "spatial")[hit].copy())
    np.testing.assert_allclose(seen, ends, atol=1e-12)


def test_contacts_are_read_back_to_the_bit_every_second_step(spatial):
    path, _, _ = spatial
    log = read_log(path)
    steps = [c.step for c in log.contacts]
    assert steps == list(range(2, 8 * STEPS_PER_CYCLE + 1, 2))
    for contact in log.contacts:
        points, forces = pushing(log.states[contact.step])
        np.testing.assert_array_equal(contact.points, points)
        np.testing.assert_array_equal(contact.forces, forces)


def test_force_arrows_point_along_the_forces(spatial):
    _, kept, decoded = spatial
    time, message = next(
        (t, m) for topic, _, t, m in decoded if topic == "/contacts/arrows" and m.entities[0].arrows
    )
    points, forces = pushing(kept["states"][round(time * 1e-9 / TIMESTEP)])
    assert len(message.entities[0].arrows) == len(points)
    weight = sample_body().mass * 9.81
    for arrow, point, force in zip(message.entities[0].arrows, points, forces, strict=True):
        turn, place = arrow.pose.orientation, arrow.pose.position
        assert [place.x, place.y, place.z] == point.tolist()
        along = Rotation.from_quat([turn.x, turn.y, turn.z, turn.w]).apply([1.0, 0, 0])
        length = arrow.shaft_length + arrow.head_length
        np.testing.assert_allclose(along * length, force / weight, atol=1e-12)


def test_an_arrow_is_turned_to_any_direction_even_back():
    ways = [*np.random.default_rng(0).normal(size=(20, 3)), *np.eye(3), *-np.eye(3), [-1, 1e-7, 0]]
    for way in ways:
        unit = np.array(way) / np.linalg.norm(way)
        w, x, y, z = _towards(unit)
        turned = Rotation.from_quat([x, y, z, w]).apply([1.0, 0, 0])
        np.testing.assert_allclose(turned, unit, atol=1e-6)


def test_time_never_runs_backwards_on_a_channel(logged):
    for topic in channels.by_topic():
        times = [t for name, _, t, _ in logged[2] if name == topic]
        assert times == sorted(times), topic


def test_surrogate_prediction_is_logged_at_the_end_of_its_cycle(logged):
    _, kept, decoded = logged
    found = [(t, m.pose.position) for topic, _, t, m in decoded if topic == "/surrogate/com"]
    body = sample_body()
    start = kept["states"][2 * STEPS_PER_CYCLE]
    pose = RigidDynamics(sample_surrogate(body)).step(start[:7], kept["gait_index"][2])
    time, place = found[2]
    assert time == round(3 * STEPS_PER_CYCLE * TIMESTEP * 1e9)
    np.testing.assert_allclose([place.x, place.y, place.z], pose[:3], atol=1e-15)


def test_a_log_without_end_keeps_its_partial_name_and_is_not_whole(tmp_path):
    path = tmp_path / "stopped.mcap"
    kept = record_episode(path, outcome=None)
    assert not path.exists()
    log = read_log(tmp_path / "stopped.partial.mcap")
    assert not log.whole and log.fault == "stopped before the episode ended" and log.outcome == ""
    np.testing.assert_array_equal(log.states, kept["states"])


def test_an_interrupted_episode_leaves_a_readable_log(tmp_path):
    body = sample_body()
    x = np.concatenate([[0, 0, 0, 1, 0, 0, 0], np.zeros(6 + 3 * MODES)])
    with (
        pytest.raises(KeyboardInterrupt),
        Recorder(tmp_path / "a.mcap", RunFiles.of(body), surface_of(body)) as recorder,
    ):
        recorder.begin({"timestep": TIMESTEP, **STEPPING, "state": x}, sample_scene())
        for i in range(40):
            recorder.step((i + 1) * TIMESTEP, x, np.zeros(MODES), 1.0)
        raise KeyboardInterrupt
    assert [p.name for p in tmp_path.iterdir()] == ["a.partial.mcap"]
    assert len(read_log(tmp_path / "a.partial.mcap").states) == 41


def test_what_is_on_disk_while_running_is_at_most_a_second_behind(tmp_path):
    body = sample_body()
    x = np.concatenate([[0, 0, 0, 1, 0, 0, 0], np.zeros(6 + 3 * MODES)])
    recorder = Recorder(tmp_path / "a.mcap", RunFiles.of(body), surface_of(body))
    recorder.begin({"timestep": TIMESTEP, **STEPPING, "state": x}, sample_scene())
    steps = 90
    for i in range(steps):
        recorder.step((i + 1) * TIMESTEP, x, np.zeros(MODES), 1.0)
    found = read_log(recorder.partial)  # as if the machine had died now
    assert found.fault.startswith("cut")
    assert steps * TIMESTEP - found.time[-1] <= 1.0 + 1e-9
    recorder.end("timeout")
    assert len(read_log(tmp_path / "a.mcap").states) == steps + 1


def test_a_cycle_that_does_not_start_where_the_last_one_ended_is_refused(tmp_path):
    body = sample_body()
    x = np.concatenate([[0, 0, 0, 1, 0, 0, 0], np.zeros(6 + 3 * MODES)])
    with Recorder(tmp_path / "a.mcap", RunFiles.of(body), surface_of(body)) as recorder:
        recorder.begin({"timestep": TIMESTEP, **STEPPING, "state": x}, sample_scene())
        recorder.step(TIMESTEP, x + 1, np.zeros(MODES), 1.0)
        with pytest.raises(ValueError, match="not the state at the cycle's start"):
            recorder.cycle(0, TIMESTEP, x + 1, 0, np.zeros(3), 0.0, np.ones(64))


def test_a_full_disk_is_one_sentence(tmp_path, monkeypatch):
    body = sample_body()
    x = np.concatenate([[0, 0, 0, 1, 0, 0, 0], np.zeros(6 + 3 * MODES)])
    recorder = Recorder(tmp_path / "a.mcap", RunFiles.of(body), surface_of(body))
    recorder.begin({"timestep": TIMESTEP, **STEPPING, "state": x}, sample_scene())

    def full():
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(recorder._writer, "flush", full)
    with pytest.raises(DefplanError, match=r"cannot write log .*: No space left on device"):
        for i in range(60):
            recorder.step((i + 1) * TIMESTEP, x, np.zeros(MODES), 1.0)
    with pytest.raises(DefplanError, match="No space left"):
        recorder.end("success")
    assert not (tmp_path / "a.mcap").exists()


def test_an_unwritable_folder_is_one_sentence(tmp_path):
    (tmp_path / "file").write_text("in the way")
    body = sample_body()
    recorder = Recorder(tmp_path / "file" / "a.mcap", RunFiles.of(body), surface_of(body))
    x = np.zeros(13 + 3 * MODES)
    with pytest.raises(DefplanError, match="cannot write log"):
        recorder.begin({"timestep": TIMESTEP, **STEPPING, "state": x}, sample_scene())


def test_chunks_do_not_overlap_in_time_and_end_with_a_cycle(tmp_path):
    record_episode(tmp_path / "a.mcap", cycles=9)
    with open(tmp_path / "a.mcap", "rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    chunks = summary.chunk_indexes
    spans = [(c.message_start_time, c.message_end_time) for c in chunks]
    assert len(spans) > 3
    assert all(a[1] <= b[0] for a, b in zip(spans, spans[1:], strict=False))
    assert max(b - a for a, b in spans) <= 1e9
    cycle = round(STEPS_PER_CYCLE * TIMESTEP * 1e9)
    assert all(end % cycle == 0 for _, end in spans)


def test_a_log_holds_each_schema_once(logged):
    with open(logged[0], "rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    names = [s.name for s in summary.schemas.values()]
    assert sorted(names) == sorted({schema for _, schema, *_ in logged[2]})


def test_the_same_episode_gives_the_same_log_to_the_byte(tmp_path):
    for name in ("a", "b"):
        record_episode(tmp_path / f"{name}.mcap")
    assert (tmp_path / "a.mcap").read_bytes() == (tmp_path / "b.mcap").read_bytes()
