"""Logs that other tools have sorted, rechunked, compressed, filtered or merged are read as they are."""

from __future__ import annotations

import json

import numpy as np
import pytest
from mcap.writer import Writer

from defplan_mj.base.errors import DefplanError
from defplan_mj.log import channels
from defplan_mj.log.compare import compare_logs
from defplan_mj.log.reader import read_log
from defplan_mj.log.replay import replay_log
from tests.samples.logs import STEPS_PER_CYCLE, record_episode, sample_scene
from tests.samples.rewriting import LZ4, NONE, ZSTD, rewrite

ARRAYS = (
    "time states target_shapes clearance cycle_steps gait_index values reward laser surrogate_pose"
).split()


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    path = tmp_path_factory.mktemp("log") / "whole.mcap"
    record_episode(path, cycles=6, contacts=lambda x: (x[None, :3], x[None, 3:6]))
    return path


@pytest.mark.parametrize(
    "options",
    [
        {"order": lambda message: message.log_time},
        {"order": lambda message: -message.log_time},
        {"chunk_size": 300},
        {"compression": LZ4},
        {"compression": NONE, "enable_crcs": False},
        {"compression": ZSTD, "order": lambda message: message.channel_id, "chunk_size": 5000},
        {"use_chunking": False},
        {"use_chunking": False, "order": lambda message: -message.log_time, "enable_crcs": False},
    ],
    ids=["sorted", "backwards", "rechunked", "lz4", "plain", "by topic", "no chunks", "loose"],
)
def test_a_log_that_was_written_again_holds_the_same(whole, tmp_path, options):
    before = read_log(whole)
    after = read_log(rewrite(whole, tmp_path / "again.mcap", **options))
    assert after.whole and after.outcome == before.outcome and not after.missing
    for name in ARRAYS:
        np.testing.assert_array_equal(getattr(after, name), getattr(before, name), err_msg=name)
    for mine, theirs in zip(after.contacts, before.contacts, strict=True):
        assert mine.step == theirs.step
        np.testing.assert_array_equal(mine.points, theirs.points)
    for topic in before.numbers:
        if topic != channels.GAIT:  # many messages share a step there
            np.testing.assert_array_equal(after.channel(topic)[1], before.channel(topic)[1])


def test_a_log_without_chunks_is_used_up_to_a_cut(whole, tmp_path):
    data = rewrite(whole, tmp_path / "loose.mcap", use_chunking=False).read_bytes()
    before, steps = read_log(whole), []
    # metadata comes last here, so that an earlier cut leaves only messages
    for size in np.linspace(len(data) // 2, len(data) - 1, 30).astype(int):
        (tmp_path / "cut.mcap").write_bytes(data[:size])
        try:
            log = read_log(tmp_path / "cut.mcap")
        except DefplanError as error:
            assert "holds no step of its episode" in str(error)
            continue
        n = len(log.target_shapes)
        steps.append(n)
        assert log.fault.startswith("cut")
        np.testing.assert_array_equal(log.states, before.states[: n + 1])
    assert steps


def test_a_filtered_log_says_what_is_missing_and_gives_the_rest(whole, tmp_path):
    before = read_log(whole)
    left_out = {channels.CONTACTS, channels.RANGES, channels.MESH}
    path = rewrite(whole, tmp_path / "some.mcap", keep=lambda topic, _: topic not in left_out)
    log = read_log(path)
    assert log.missing == (channels.CONTACTS, channels.RANGES) and not log.whole
    assert log.fault == "filtered: without /contacts, /laser/ranges"
    np.testing.assert_array_equal(log.states, before.states)
    np.testing.assert_array_equal(log.reward, before.reward)
    assert np.isnan(log.clearance).all() and log.laser.shape == (6, 0)
    assert len(log.clearance) == len(log.target_shapes)
    assert compare_logs([path]).episodes[0].fault == log.fault


def test_a_log_of_a_part_of_the_time_starts_at_its_first_whole_cycle(whole, tmp_path):
    before = read_log(whole)
    begin, end = before.time[STEPS_PER_CYCLE + 4], before.time[-6]

    def inside(topic, message):
        return begin - 1e-6 <= message.log_time * 1e-9 <= end + 1e-6

    log = read_log(rewrite(whole, tmp_path / "part.mcap", keep=inside))
    first = STEPS_PER_CYCLE + 4
    assert log.first == first and log.fault == f"without its first {first} steps"
    np.testing.assert_array_equal(log.states, before.states[first:-5])
    np.testing.assert_array_equal(log.time, before.time[first:-5])
    np.testing.assert_array_equal(log.target_shapes, before.target_shapes[first:-5])
    np.testing.assert_array_equal(log.cycle_steps + first, before.cycle_steps[2:6])
    np.testing.assert_array_equal(log.gait_index, before.gait_index[2:5])
    np.testing.assert_array_equal(log.values, before.values[2:5])


def test_another_program_s_messages_do_not_disturb(whole, tmp_path):
    foreign = tmp_path / "camera.mcap"
    with open(foreign, "wb") as stream:
        writer = Writer(stream)
        writer.start()
        schema = writer.register_schema("Anything", "jsonschema", b"{}")
        for topic in ("/camera", channels.CONTACTS):  # one of them under our own name
            channel = writer.register_channel(topic, "json", schema)
            writer.add_message(channel, 5, json.dumps({"a": 1}).encode(), 5, 7)
        writer.finish()
    log = read_log(rewrite(whole, tmp_path / "merged.mcap", others=[foreign]))
    assert log.whole
    np.testing.assert_array_equal(log.clearance, read_log(whole).clearance)


def test_two_episodes_in_a_file_are_refused(whole, tmp_path):
    record_episode(other := tmp_path / "other.mcap", cycles=3, scene=sample_scene(obstacles=1))
    with pytest.raises(DefplanError, match="merged of several logs"):
        read_log(rewrite(whole, tmp_path / "merged.mcap", others=[other]))


def test_a_log_without_its_metadata_says_which(whole, tmp_path):
    path = rewrite(whole, tmp_path / "bare.mcap", metadata=False)
    with pytest.raises(DefplanError, match="lost its metadata 'defplan' and 'configuration'"):
        read_log(path)


@pytest.mark.parametrize("left", [set(), {channels.MESH}, {channels.CONTACTS}])
def test_a_log_without_states_says_so(whole, tmp_path, left):
    path = rewrite(whole, tmp_path / "x.mcap", keep=lambda topic, _: topic in left)
    with pytest.raises(DefplanError, match="has no messages in /robot/state: keep them"):
        read_log(path)


def test_a_filtered_log_is_replayed_as_far_as_it_can_be(swim_log, tmp_path):
    left_out = {channels.CONTACTS, channels.VALUES}
    log = rewrite(swim_log, tmp_path / "some.mcap", keep=lambda topic, _: topic not in left_out)
    result = replay_log(log)
    assert result.identical and result.simulators == ("kernel", "mujoco")
    none = rewrite(swim_log, tmp_path / "none.mcap", keep=lambda t, _: t != channels.TARGET_SHAPE)
    with pytest.raises(DefplanError, match="without /control/target_shape"):
        replay_log(none)
