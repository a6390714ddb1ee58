"""The layout of a log: our own schema of labelled numbers, its records, the labels of a state."""

from __future__ import annotations

from typing import Any

from google.protobuf import descriptor_pb2, descriptor_pool, message_factory, timestamp_pb2

FORMAT_VERSION = 3
"""Version of the log's layout, in the metadata record `defplan`."""


def _labelled_numbers() -> Any:
    """Build the message class `defplan.LabelledNumbers` without a protobuf compiler."""
    field = descriptor_pb2.FieldDescriptorProto
    proto = descriptor_pb2.FileDescriptorProto(
        name="defplan/LabelledNumbers.proto",
        package="defplan",
        syntax="proto3",
        dependency=[timestamp_pb2.DESCRIPTOR.name],
    )
    message = proto.message_type.add(name="LabelledNumbers")
    message.field.add(
        name="timestamp",
        number=1,
        type=field.TYPE_MESSAGE,
        type_name=".google.protobuf.Timestamp",
        label=field.LABEL_OPTIONAL,
    )
    message.field.add(name="labels", number=2, type=field.TYPE_STRING, label=field.LABEL_REPEATED)
    message.field.add(name="values", number=3, type=field.TYPE_DOUBLE, label=field.LABEL_REPEATED)
    pool = descriptor_pool.Default()
    pool.Add(proto)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName("defplan.LabelledNumbers"))


LabelledNumbers = _labelled_numbers()

WORLD_FRAME = "world"
ROBOT_FRAME = "robot"

IDENTITY_RECORD = "defplan"
CONFIGURATION_RECORD = "configuration"
VERSIONS_RECORD = "versions"
END_RECORD = "end"
"""Names of the metadata records; a log without the last one was not finished."""


def state_labels(modes: int) -> list[str]:
    """Return the names of the 13 + 3r numbers of a state, in MuJoCo's order (qpos, qvel, act)."""
    position = ["x", "y", "z", "qw", "qx", "qy", "qz", *shape_labels(modes)]
    velocity = ["vx", "vy", "vz", "wx", "wy", "wz", *(f"dq{i + 1}" for i in range(modes))]
    return position + velocity + [f"u{i + 1}" for i in range(modes)]


def shape_labels(modes: int) -> list[str]:
    """Return the names of r modal coordinates."""
    return [f"q{i + 1}" for i in range(modes)]
