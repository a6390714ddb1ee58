"""Messages that are written once a cycle or less: the scene's entities and laser scans."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from foxglove_schemas_protobuf.Color_pb2 import Color
from foxglove_schemas_protobuf.LaserScan_pb2 import LaserScan
from foxglove_schemas_protobuf.Pose_pb2 import Pose
from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3
from google.protobuf.timestamp_pb2 import Timestamp

from defplan_mj.log.poses import rotation_matrix, yaw
from defplan_mj.log.schemas import WORLD_FRAME
from defplan_mj.planning.scenes import Scene

_OBSTACLE = Color(r=0.25, g=0.42, b=0.75, a=0.9)
_TARGET = Color(r=0.85, g=0.2, b=0.17, a=0.6)
_CYLINDER_HEIGHT = 2.0  # m; obstacles are upright and endless, this is what is drawn


def scene_update(scene: Scene, nanoseconds: int) -> bytes:
    """Return the target and all obstacles where they are at that time, ids `target`, `obstacle/0`...

    All of them are in every message, so that a viewer that starts in the middle sees the scene.
    """
    message = SceneUpdate()
    radius = scene.goal_radius
    target = _entity(message, "target", nanoseconds)
    target.spheres.add(
        pose=_pose(scene.target),
        size=Vector3(x=2 * radius, y=2 * radius, z=2 * radius),
        color=_TARGET,
    )
    centres = scene.centres + scene.velocities * (nanoseconds * 1e-9)
    for i, (centre, radius) in enumerate(zip(centres, scene.radii, strict=True)):
        entity = _entity(message, f"obstacle/{i}", nanoseconds)
        if scene.shape == "sphere":
            size = Vector3(x=2 * radius, y=2 * radius, z=2 * radius)
            entity.spheres.add(pose=_pose(centre), size=size, color=_OBSTACLE)
        else:
            size = Vector3(x=2 * radius, y=2 * radius, z=_CYLINDER_HEIGHT)
            entity.cylinders.add(
                pose=_pose(centre), size=size, bottom_scale=1, top_scale=1, color=_OBSTACLE
            )
    return message.SerializeToString()


def laser_scan(x: np.ndarray, ranges: Sequence[float] | np.ndarray, nanoseconds: int) -> bytes:
    """Return a scan at the centre of mass of state x.

    Beams go once around in the horizontal plane, counterclockwise; the first points where the body
    heads (its x axis, projected).
    """
    ranges = np.asarray(ranges, float)
    heading = float(yaw(rotation_matrix(x[3:7])))
    turn = Quaternion(w=np.cos(heading / 2), z=np.sin(heading / 2))
    return LaserScan(
        timestamp=_timestamp(nanoseconds),
        frame_id=WORLD_FRAME,
        pose=Pose(position=Vector3(x=x[0], y=x[1], z=x[2]), orientation=turn),
        start_angle=0.0,
        end_angle=2 * np.pi * (len(ranges) - 1) / len(ranges),
        ranges=ranges,
    ).SerializeToString()


def _timestamp(nanoseconds: int) -> Timestamp:
    seconds, rest = divmod(nanoseconds, 1_000_000_000)
    return Timestamp(seconds=seconds, nanos=rest)


def _entity(message: Any, name: str, nanoseconds: int) -> Any:
    return message.entities.add(timestamp=_timestamp(nanoseconds), frame_id=WORLD_FRAME, id=name)


def _pose(centre: np.ndarray) -> Pose:
    x, y, z = centre
    return Pose(position=Vector3(x=x, y=y, z=z), orientation=Quaternion(w=1))
