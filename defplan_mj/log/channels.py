"""The channels of a log, in one list: topic, schema, unit, and where what they carry comes from."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.LaserScan_pb2 import LaserScan
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate

from defplan_mj.log.schemas import LabelledNumbers, shape_labels, state_labels

TF = "/tf"
SCENE = "/scene"
MESH = "/robot/mesh"
COM = "/robot/com"
STATE = "/robot/state"
SURROGATE = "/surrogate/com"
LASER = "/laser"
LASER_POINTS = "/laser/points"
RANGES = "/laser/ranges"
CONTACTS = "/contacts"
FORCES = "/contacts/forces"
ARROWS = "/contacts/arrows"
TARGET_SHAPE = "/control/target_shape"
GAIT = "/control/gait"
VALUES = "/planner/values"
REWARD = "/planner/reward"


@dataclass(frozen=True)
class Names:
    """What labels are made of: the number of modes, the gaits' names, and what a reading's numbers are."""

    modes: int
    gaits: tuple[str, ...] = ()


@dataclass(frozen=True)
class Step:
    """A physics step: the state (nx,) it led to, its control (r,), the clearance there, m."""

    x: np.ndarray
    target_shape: np.ndarray
    clearance: float


@dataclass(frozen=True)
class Cycle:
    """A gait cycle: the state (nx,) and reading (size,) at its decision, the gaits' values (K,), its reward."""

    x: np.ndarray
    reading: np.ndarray
    values: np.ndarray
    reward: float


@dataclass(frozen=True)
class Channel:
    """What is written under one topic.

    A channel of labelled numbers that come from a step or a cycle is all said here: the recorder
    writes it and `EpisodeLog.channel` reads it. Others are drawings, which the recorder makes.

    Attributes:
        topic: its name.
        message: class of its messages.
        unit: of its numbers; '' if they have several, or none.
        what: where it comes from.
        labels: of its numbers.
        of_step: the numbers of a `Step`, written at every one.
        at_decision, at_end: the numbers of a `Cycle`, written with the time of its start, or of its end.
    """

    topic: str
    message: Any
    unit: str
    what: str
    labels: Callable[[Names], list[str]] = lambda names: []
    of_step: Callable[[Step], np.ndarray] | None = None
    at_decision: Callable[[Cycle], np.ndarray] | None = None
    at_end: Callable[[Cycle], np.ndarray] | None = None


CHANNELS: list[Channel] = [
    Channel(TF, FrameTransforms, "m", "the state: world -> robot, the body frame"),
    Channel(SCENE, SceneUpdate, "m", "the scene: target and obstacles where they are"),
    Channel(MESH, SceneUpdate, "m", "the state: the deformed surface, to look at"),
    Channel(COM, PoseInFrame, "m", "the state: centre of mass and attitude"),
    Channel(
        STATE,
        LabelledNumbers,
        "",
        "qpos, qvel and act, to the bit",
        labels=lambda names: state_labels(names.modes),
    ),
    Channel(
        TARGET_SHAPE,
        LabelledNumbers,
        "1",
        "the feedback: the control of the step that led here, to the bit",
        labels=lambda names: shape_labels(names.modes),
        of_step=lambda step: step.target_shape,
    ),
    Channel(
        CONTACTS,
        LabelledNumbers,
        "m, 1",
        "distance query: clearance of the obstacles, negative in contact; whether in collision",
        labels=lambda names: ["clearance", "collision"],
        of_step=lambda step: np.array([step.clearance, step.clearance < 0]),
    ),
    Channel(FORCES, PointCloud, "m, N", "the kernel: where the terrain pushes, and how"),
    Channel(ARROWS, SceneUpdate, "m", "the same to look at"),
    Channel(
        GAIT,
        LabelledNumbers,
        "1",
        "the planner's choice: gait, phase in its cycle, cycle",
        labels=lambda names: ["gait", "phase", "cycle"],
    ),
    Channel(
        RANGES,
        LabelledNumbers,
        "m",
        "the sensor's reading, to the bit",
        at_decision=lambda cycle: cycle.reading,
    ),
    Channel(LASER, LaserScan, "m", "the reading of a planar laser, to look at"),
    Channel(LASER_POINTS, PointCloud, "m", "the points that another sensor tells of, to look at"),
    Channel(
        VALUES,
        LabelledNumbers,
        "",
        "the planner: its value of each gait",
        labels=lambda names: list(names.gaits),
        at_decision=lambda cycle: cycle.values,
    ),
    Channel(
        REWARD,
        LabelledNumbers,
        "m^2",
        "the task: Eq. 2",
        labels=lambda names: ["reward"],
        at_end=lambda cycle: np.array([cycle.reward], float),
    ),
    Channel(SURROGATE, PoseInFrame, "m", "f_fit: where it expects the body at the cycle's end"),
]
"""Every channel that a log may have; it has those that its episode needs."""


def by_topic() -> dict[str, Channel]:
    """Return the channels by their topics."""
    return {channel.topic: channel for channel in CHANNELS}
