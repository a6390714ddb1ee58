"""Messages that are made of objects: the scene's entities, laser scans, contact forces."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from foxglove_schemas_protobuf.Color_pb2 import Color
from foxglove_schemas_protobuf.LaserScan_pb2 import LaserScan
from foxglove_schemas_protobuf.PackedElementField_pb2 import PackedElementField
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from foxglove_schemas_protobuf.Pose_pb2 import Pose
from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3
from google.protobuf.timestamp_pb2 import Timestamp

from defplan_mj.base import rotations
from defplan_mj.base.space import OF_DIMENSION, PLANE
from defplan_mj.log import channels
from defplan_mj.log.schemas import WORLD_FRAME
from defplan_mj.planning.scene import Scene
from defplan_mj.planning.sensors.laser import Laser
from defplan_mj.planning.sensors.sensor import sensor_of
from defplan_mj.task import Navigation

_OBSTACLE = Color(r=0.25, g=0.42, b=0.75, a=0.9)
_TARGET = Color(r=0.85, g=0.2, b=0.17, a=0.6)
_FORCE = Color(r=0.85, g=0.54, b=0.12, a=1.0)
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


def laser_scan(
    x: np.ndarray,
    ranges: Sequence[float] | np.ndarray,
    nanoseconds: int,
    seen: np.ndarray | None = None,
) -> bytes:
    """Return a scan at the centre of mass of state x.

    Beams go once around in the horizontal plane, counterclockwise; the first points where the body
    heads (its x axis, projected). Those that met nothing are infinite, so that no viewer draws a
    wall at the laser's range.

    Args:
        seen: (beams,) which of them met something; None: all.
    """
    ranges = np.asarray(ranges, float)
    if seen is not None:
        ranges = np.where(seen, ranges, np.inf)
    w, _, _, z = rotations.level_attitude(rotations.quaternion_heading(x[3:7]))
    turn = Quaternion(w=w, z=z)
    return LaserScan(
        timestamp=_timestamp(nanoseconds),
        frame_id=WORLD_FRAME,
        pose=Pose(position=Vector3(x=x[0], y=x[1], z=x[2]), orientation=turn),
        start_angle=0.0,
        end_angle=2 * np.pi * (len(ranges) - 1) / len(ranges),
        ranges=ranges,
    ).SerializeToString()


def reading_message(
    x: np.ndarray, reading: np.ndarray, navigation: Navigation, nanoseconds: int
) -> tuple[str, bytes]:
    """Return topic and message that show a reading at state x."""
    sensor = sensor_of(navigation)
    points, there = sensor.points(np.asarray(reading, float), navigation)
    if sensor.name == PLANE.sensor:
        return channels.LASER, laser_scan(x, reading, nanoseconds, there)
    distance = reading if isinstance(sensor, Laser) else np.linalg.norm(points, axis=1)
    cloud = sensed_points(x, points[there], distance[there], nanoseconds)
    return channels.LASER_POINTS, cloud


def sensed_points(
    x: np.ndarray, points: np.ndarray, distance: np.ndarray, nanoseconds: int
) -> bytes:
    """Return a cloud of points (p, d), m, in the robot's frame of d dimensions at state x.

    Each point also has its `distance` (m), to be coloured by.
    """
    d = points.shape[1]
    columns = np.pad(points, ((0, 0), (0, 3 - d))).T
    attitude = OF_DIMENSION[d].attitude(x[3:7])
    pose = np.concatenate([x[:3], attitude])
    named = {**dict(zip("xyz", columns, strict=True)), "distance": distance}
    return _point_cloud(named, nanoseconds, pose)


def contact_forces(points: np.ndarray, forces: np.ndarray, nanoseconds: int) -> bytes:
    """Return contacts as a cloud: points (n, 3) in the world, m, and forces (n, 3) on the body, N."""
    columns = np.concatenate([points.T, forces.T])
    names = ("x", "y", "z", "force_x", "force_y", "force_z")
    return _point_cloud(dict(zip(names, columns, strict=True)), nanoseconds)


def contacts_of(cloud: Any) -> tuple[np.ndarray, np.ndarray]:
    """Return points (n, 3) and forces (n, 3) of a decoded message of `contact_forces`."""
    columns = np.frombuffer(cloud.data, "<f8").reshape(-1, 6)
    return columns[:, :3].copy(), columns[:, 3:].copy()


def force_arrows(points: np.ndarray, forces: np.ndarray, scale: float, nanoseconds: int) -> bytes:
    """Return the forces as arrows from their points, one entity for all.

    Args:
        points, forces: (n, 3), m and N.
        scale: length of a newton, m.
    """
    message = SceneUpdate()
    entity = _entity(message, "contacts", nanoseconds)
    for point, force in zip(points, forces, strict=True):
        size = float(np.linalg.norm(force))
        if size == 0:
            continue
        length = scale * size
        entity.arrows.add(
            pose=_pose(point, _towards(force / size)),
            shaft_length=0.8 * length,
            shaft_diameter=0.008,
            head_length=0.2 * length,
            head_diameter=0.02,
            color=_FORCE,
        )
    return message.SerializeToString()


def _point_cloud(
    columns: dict[str, np.ndarray], nanoseconds: int, pose: np.ndarray | None = None
) -> bytes:
    """Return a cloud of float64 columns by name; `pose` (7,) is its frame in the world."""
    here = np.array([0, 0, 0, 1.0, 0, 0, 0]) if pose is None else pose
    cloud = PointCloud(
        timestamp=_timestamp(nanoseconds),
        frame_id=WORLD_FRAME,
        pose=_pose(here[:3], here[3:]),
        point_stride=8 * len(columns),
        data=np.column_stack(list(columns.values())).astype("<f8").tobytes(),
    )
    for i, name in enumerate(columns):
        cloud.fields.add(name=name, offset=8 * i, type=PackedElementField.FLOAT64)
    return cloud.SerializeToString()


def _towards(direction: np.ndarray) -> tuple[float, float, float, float]:
    """Return the quaternion w x y z of the shortest turn from +x, where arrows point, to a unit vector.

    Written out: (1 + x, 0, -z, y) normed. There are thousands of arrows in a log of a walker.
    """
    x, y, z = direction.tolist()
    if x < -1 + 1e-9:  # back: about any axis across
        return 0.0, 0.0, 0.0, 1.0
    norm = math.hypot(1 + x, y, z)
    return (1 + x) / norm, 0.0, -z / norm, y / norm


def _timestamp(nanoseconds: int) -> Timestamp:
    seconds, rest = divmod(nanoseconds, 1_000_000_000)
    return Timestamp(seconds=seconds, nanos=rest)


def _entity(message: Any, name: str, nanoseconds: int) -> Any:
    return message.entities.add(timestamp=_timestamp(nanoseconds), frame_id=WORLD_FRAME, id=name)


def _pose(centre: np.ndarray, attitude: Sequence[float] | np.ndarray = (1.0, 0, 0, 0)) -> Pose:
    x, y, z = centre
    w, a, b, c = attitude
    return Pose(position=Vector3(x=x, y=y, z=z), orientation=Quaternion(w=w, x=a, y=b, z=c))
