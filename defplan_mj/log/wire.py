"""Protobuf bytes of the messages that are written at every physics step, packed without message objects.

A message object a step would cost more than the step itself; these write the same bytes from arrays.
Field numbers are those of foxglove's schemas; the tests decode every message with the schemas again.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence

import numpy as np

_THREE = struct.Struct("<BdBdBd")
_FOUR = struct.Struct("<BdBdBdBd")
_POINT = np.dtype(
    {"names": ["x", "y", "z"], "formats": ["<f8"] * 3, "offsets": [3, 12, 21], "itemsize": 29}
)  # a Point3 in a list: tag, length, then three tagged doubles
_SMALL = [bytes([i]) for i in range(128)]
_BYTES = 2  # the wire type of everything with a length


def varint(value: int) -> bytes:
    """Return an unsigned integer in protobuf's base-128 form."""
    if value < 128:
        return _SMALL[value]
    out = bytearray()
    while value > 127:
        out.append(value & 127 | 128)
        value >>= 7
    out.append(value)
    return bytes(out)


def field(number: int, data: bytes) -> bytes:
    """Return a length-delimited field (string, message or packed numbers)."""
    return varint(number << 3 | _BYTES) + varint(len(data)) + data


def text(number: int, value: str) -> bytes:
    """Return a string field."""
    return field(number, value.encode())


def timestamp(nanoseconds: int) -> bytes:
    """Return field 1 of every message here: its google.protobuf.Timestamp."""
    seconds, rest = divmod(nanoseconds, 1_000_000_000)
    return field(1, b"\x08" + varint(seconds) + b"\x10" + varint(rest))


def position(number: int, xyz: Sequence[float]) -> bytes:
    """Return a Vector3 or Point3 field."""
    x, y, z = xyz
    return field(number, _THREE.pack(0x09, x, 0x11, y, 0x19, z))


def orientation(number: int, wxyz: Sequence[float]) -> bytes:
    """Return a Quaternion field (foxglove orders x y z w) from MuJoCo's w x y z."""
    w, x, y, z = wxyz
    return field(number, _FOUR.pack(0x09, x, 0x11, y, 0x19, z, 0x21, w))


def pose_in_frame(stamp: bytes, frame: bytes, pose: Sequence[float]) -> bytes:
    """Return a foxglove.PoseInFrame of position and quaternion (w x y z).

    `stamp` is `timestamp(...)`, `frame` is `text(2, name)`.
    """
    return stamp + frame + field(3, position(1, pose[:3]) + orientation(2, pose[3:7]))


def frame_transform(stamp: bytes, frames: bytes, pose: Sequence[float]) -> bytes:
    """Return a foxglove.FrameTransforms of one; `frames` is `text(2, parent) + text(3, child)`."""
    return field(1, stamp + frames + position(4, pose[:3]) + orientation(5, pose[3:7]))


def labels(names: Sequence[str]) -> bytes:
    """Return the constant part of a LabelledNumbers message."""
    return b"".join(text(2, name) for name in names)


def labelled_numbers(stamp: bytes, names: bytes, values: np.ndarray) -> bytes:
    """Return a defplan.LabelledNumbers; `names` is `labels(...)`, the numbers are kept to the bit."""
    return stamp + names + field(3, values.astype("<f8", copy=False).tobytes())


class TriangleMesh:
    """A foxglove.SceneUpdate of one deforming triangle mesh: everything but the points is packed once.

    Args:
        entity: stable id of the entity.
        frame: its frame; the entity moves along with it.
        faces: (f, 3) indices of its points.
        colour: (4,) red, green, blue, opacity.
    """

    def __init__(self, entity: str, frame: str, faces: np.ndarray, colour: Sequence[float]) -> None:
        n = int(faces.max()) + 1 if len(faces) else 0
        rows = np.zeros((n, _POINT.itemsize), np.uint8)
        rows[:, [0, 1, 2, 11, 20]] = 2 << 3 | _BYTES, 27, 0x09, 0x11, 0x19
        self._rows = rows
        self._points = rows.view(_POINT)[:, 0]
        r, g, b, a = colour
        still = position(1, (0, 0, 0)) + orientation(2, (1, 0, 0, 0))
        self._head = field(1, still)
        packed = _FOUR.pack(0x09, r, 0x11, g, 0x19, b, 0x21, a)
        self._tail = field(3, packed) + field(5, np.asarray(faces, "<u4").tobytes())
        self._names = text(2, frame) + text(3, entity) + b"\x28\x01"  # frame_locked

    def encode(self, stamp: bytes, points: np.ndarray) -> bytes:
        """Return the message with the mesh's `points` (n, 3)."""
        self._points["x"], self._points["y"], self._points["z"] = points.T
        triangles = field(12, self._head + self._rows.tobytes() + self._tail)
        return field(2, stamp + self._names + triangles)
