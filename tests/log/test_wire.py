"""Hand-packed protobuf bytes say what the messages' own classes read from them, whatever the numbers."""

from __future__ import annotations

import numpy as np
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from google.protobuf.timestamp_pb2 import Timestamp
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from defplan_mj.log import wire
from defplan_mj.log.schemas import LabelledNumbers

NUMBER = st.floats(allow_nan=True, allow_infinity=True)
NANOSECONDS = st.integers(0, 2**62)
POSE = hnp.arrays(float, 7, elements=NUMBER)
NAME = st.text(st.characters(codec="utf-8"), max_size=300)


def _xyz(message) -> list[float]:
    return [message.x, message.y, message.z]


def _wxyz(message) -> list[float]:
    return [message.w, message.x, message.y, message.z]


@given(st.integers(0, 2**63 - 1))
def test_a_varint_is_the_one_protobuf_writes(value):
    own = Timestamp(seconds=value).SerializeToString()
    assert (b"\x08" + wire.varint(value) if value else b"") == own


@given(NANOSECONDS)
def test_a_time_is_read_to_the_nanosecond(nanoseconds):
    stamp = PoseInFrame.FromString(wire.timestamp(nanoseconds)).timestamp
    assert stamp.ToNanoseconds() == nanoseconds


@given(NANOSECONDS, NAME, POSE)
def test_a_pose_is_read_to_the_bit(nanoseconds, name, pose):
    stamp, frame = wire.timestamp(nanoseconds), wire.text(2, name)
    message = PoseInFrame.FromString(wire.pose_in_frame(stamp, frame, pose))
    assert message.frame_id == name
    read = np.array(_xyz(message.pose.position) + _wxyz(message.pose.orientation))
    np.testing.assert_array_equal(read.view(np.int64), pose.view(np.int64))


@given(NANOSECONDS, NAME, NAME, POSE)
def test_a_frames_pose_is_read_to_the_bit(nanoseconds, parent, child, pose):
    names = wire.text(2, parent) + wire.text(3, child)
    data = wire.frame_transform(wire.timestamp(nanoseconds), names, pose)
    (one,) = FrameTransforms.FromString(data).transforms
    assert (one.parent_frame_id, one.child_frame_id) == (parent, child)
    read = np.array(_xyz(one.translation) + _wxyz(one.rotation))
    np.testing.assert_array_equal(read.view(np.int64), pose.view(np.int64))


@given(
    NANOSECONDS, st.lists(NAME, max_size=5), hnp.arrays(float, st.integers(0, 40), elements=NUMBER)
)
def test_labelled_numbers_are_the_bytes_protobuf_writes(nanoseconds, names, values):
    data = wire.labelled_numbers(wire.timestamp(nanoseconds), wire.labels(names), values)
    message = LabelledNumbers.FromString(data)
    assert list(message.labels) == names
    read = np.array(message.values)
    np.testing.assert_array_equal(read.view(np.int64), values.view(np.int64))


@given(st.integers(1, 200), st.randoms(use_true_random=False))
def test_a_mesh_is_read_point_for_point(count, random):
    rng = np.random.default_rng(random.randrange(2**32))
    faces = np.append(rng.integers(0, count, (5, 3)), [[count - 1, 0, 0]], axis=0)
    points = rng.normal(size=(count, 3))
    mesh = wire.TriangleMesh("robot", "world", faces, (0.1, 0.2, 0.3, 1.0))
    (entity,) = SceneUpdate.FromString(mesh.encode(wire.timestamp(5), points)).entities
    (triangles,) = entity.triangles
    assert (entity.id, entity.frame_id, entity.frame_locked) == ("robot", "world", True)
    np.testing.assert_array_equal([_xyz(p) for p in triangles.points], points)
    np.testing.assert_array_equal(triangles.indices, faces.ravel())
    assert (triangles.color.r, triangles.color.a) == (0.1, 1.0)
