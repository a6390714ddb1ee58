"""Files that mean harm, written by script: sizes that lie, bombs, and valid frames of senseless content."""

from __future__ import annotations

import functools
import json
import struct
import zipfile
import zlib
from collections.abc import Callable, Mapping
from io import BytesIO
from typing import Any

import lz4.frame
import numpy as np
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.writer import Writer

from defplan_mj.base import files
from defplan_mj.log import schemas

MAGIC = b"\x89MCAP0\r\n"
GIB = 1 << 30


# ---- logs, record by record


def record(opcode: int, content: bytes, length: int | None = None) -> bytes:
    """Return an MCAP record; `length` is what it says of itself."""
    return struct.pack("<BQ", opcode, len(content) if length is None else length) + content


def string(text: str) -> bytes:
    """Return a text as MCAP writes it."""
    return struct.pack("<I", len(text.encode())) + text.encode()


def chunk(data: bytes, compression: str = "", claimed: int = 0) -> bytes:
    """Return a chunk record of `data` as it is stored, which says it unpacks to `claimed` bytes."""
    head = struct.pack("<QQQI", 0, 0, claimed, 0)
    return record(Opcode.CHUNK, head + string(compression) + struct.pack("<Q", len(data)) + data)


def metadata(name: str, entries: Mapping[str, str]) -> bytes:
    """Return a metadata record."""
    pairs = b"".join(string(key) + string(value) for key, value in entries.items())
    return record(Opcode.METADATA, string(name) + struct.pack("<I", len(pairs)) + pairs)


def attachment(name: str, data: bytes) -> bytes:
    """Return an attachment record with the right checksum."""
    content = struct.pack("<QQ", 0, 0) + string(name) + string("") + struct.pack("<Q", len(data))
    content += data
    return record(Opcode.ATTACHMENT, content + struct.pack("<I", zlib.crc32(content)))


def message(channel: int, data: bytes = b"") -> bytes:
    """Return a message record."""
    return record(Opcode.MESSAGE, struct.pack("<HIQQ", channel, 0, 0, 0) + data)


def before(log: bytes, *records: bytes) -> bytes:
    """Return a log that starts with other records than its own."""
    return MAGIC + b"".join(records) + log[len(MAGIC) :]


def zstd_bomb(size: int, says: int | None) -> bytes:
    """Return a zstd frame of `size` zeros: 4 bytes for each 128 KiB; `says` is its own size, or None."""
    blocks, block = size >> 17, 1 << 17
    head = b"\x28\xb5\x2f\xfd"
    # one segment with a size of 8 bytes, or a window of 128 KiB and no size
    head += b"\xe0" + struct.pack("<Q", says) if says is not None else b"\x00\x38"
    run, last = (
        struct.pack("<I", (block << 3) | 2)[:3] + b"\0",
        struct.pack("<I", (block << 3) | 3)[:3] + b"\0",
    )
    return head + run * (blocks - 1) + last


def lz4_bomb(size: int) -> bytes:
    """Return an lz4 frame of `size` zeros, without its size."""
    block = lz4.frame.compress(
        bytes(4 << 20),
        block_size=lz4.frame.BLOCKSIZE_MAX4MB,
        block_linked=False,
        store_size=False,
    )
    head, body = block[:7], block[7:-4]
    return head + body * (size >> 22) + block[-4:]


def edited(
    log: bytes,
    records: Mapping[str, Callable[[dict[str, str]], Any]] | None = None,
    attachments: Mapping[str, bytes | None] | None = None,
    messages: Callable[[str, int, Any], Any] | None = None,
) -> bytes:
    """Return a whole and valid log that says something else.

    Args:
        records: by the name of a metadata record, what changes its entries in place.
        attachments: by name; None: it is left out.
        messages: (topic, sequence, decoded numbers or None) -> numbers, None (left out) or the same.
    """
    reader, out = make_reader(BytesIO(log)), BytesIO()
    writer = Writer(out)
    writer.start()
    for attached in reader.iter_attachments():
        data = (attachments or {}).get(attached.name, attached.data)
        if data is not None:
            writer.add_attachment(0, 0, attached.name, "", data)
    for name in set(attachments or {}) - {
        a.name for a in make_reader(BytesIO(log)).iter_attachments()
    }:
        writer.add_attachment(0, 0, name, "", (attachments or {})[name] or b"")
    for said in make_reader(BytesIO(log)).iter_metadata():
        entries = dict(said.metadata)
        (records or {}).get(said.name, lambda entries: None)(entries)
        writer.add_metadata(said.name, entries)
    ids: dict[str, int] = {}
    for schema, channel, one in make_reader(BytesIO(log)).iter_messages(log_time_order=False):
        if channel.topic not in ids:
            assert schema is not None
            number = writer.register_schema(schema.name, schema.encoding, schema.data)
            ids[channel.topic] = writer.register_channel(channel.topic, "protobuf", number)
        data = one.data
        if messages is not None:
            numbers = None
            if schema is not None and schema.name == "defplan.LabelledNumbers":
                numbers = list(schemas.LabelledNumbers.FromString(data).values)
            changed = messages(channel.topic, one.sequence, numbers)
            if changed is None and numbers is not None:
                continue
            if changed is not None:
                data = schemas.LabelledNumbers(values=changed).SerializeToString()
        writer.add_message(ids[channel.topic], one.log_time, data, one.publish_time, one.sequence)
    writer.finish()
    return out.getvalue()


def setting(name: str, value: Any) -> Callable[[dict[str, str]], None]:
    """Return what sets an entry of a metadata record."""
    return lambda entries: entries.__setitem__(name, value)


def configured(change: Callable[[dict[str, Any]], Any]) -> Callable[[dict[str, str]], None]:
    """Return what changes the configuration of a log; `change` may return another one."""

    def edit(entries: dict[str, str]) -> None:
        data = json.loads(entries["json"])
        changed = change(data)
        entries["json"] = json.dumps(data if changed is None else changed)

    return edit


# ---- archives


def archive(
    kind: str,
    version: int,
    arrays: Mapping[str, np.ndarray],
    meta: Any,
    header: bytes | None = None,
) -> bytes:
    """Return an archive as `base.files.save_archive` writes it, whatever its content is."""
    digest = files.content_hash(arrays, meta) if header is None else ""
    said = {"kind": kind, "version": version, "hash": digest, "meta": meta}
    text = json.dumps(said).encode() if header is None else header
    out = BytesIO()
    np.savez_compressed(out, **{"header.json": np.frombuffer(text, np.uint8), **arrays})  # type: ignore[arg-type]
    return out.getvalue()


def claiming(shape: tuple[int, ...], content: bytes, method: int = zipfile.ZIP_DEFLATED) -> bytes:
    """Return an archive with one array that claims a shape and holds `content`."""
    head = BytesIO()
    np.lib.format.write_array_header_1_0(
        head, {"descr": "<f8", "fortran_order": False, "shape": shape}
    )
    out = BytesIO()
    with zipfile.ZipFile(out, "w", method) as target:
        target.writestr("a.npy", head.getvalue() + content)
    return out.getvalue()


def unpacking_to(size: int) -> bytes:
    """Return an archive whose arrays are `size` zeros in all, deflated."""
    out, part = BytesIO(), min(size, 64 << 20)
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as target:
        for i in range(max(size // part, 1)):
            with target.open(f"a{i}.npy", "w") as stream:
                np.lib.format.write_array(stream, np.zeros(part // 8))
    return out.getvalue()


def many_entries(count: int) -> bytes:
    """Return an archive of `count` empty entries."""
    out = BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_STORED) as target:
        for i in range(count):
            target.writestr(zipfile.ZipInfo(f"{i:07d}.npy"), b"")
    return out.getvalue()


def nested(depth: int) -> bytes:
    """Return JSON of lists in lists."""
    return b"[" * depth + b"]" * depth


# ---- sizes: each a file below 50 MB that asks for far more


def gait_archive(**changes: Any) -> bytes:
    """Return a gait file of one task and two modes in which something else is said."""
    arrays = {
        "alpha": np.ones((1, 2, 2)),
        "beta": np.ones((1, 2, 2)),
        "mu": np.zeros((2, 2)),
        "amplitude": np.ones(2),
    }
    meta: dict[str, Any] = {
        "body_hash": "0" * 64,
        "task_names": ["forward"],
        "timestep": 0.04,
        "steps_per_cycle": 11,
        "substeps": 2,
        "integrator": "variational",
        "meta": {},
    }
    for name, value in changes.items():
        (arrays if isinstance(value, np.ndarray) else meta)[name] = value
    return archive("gait", 2, arrays, meta)


def archive_bombs() -> dict[str, Callable[[], bytes]]:
    """Return makers of archives that ask for too much, by name."""
    many = {"header.json": np.frombuffer(b"[" + b"[]," * 40_000_000 + b"[]]", np.uint8)}
    return {
        "unpacks to 5 GB": lambda: unpacking_to(5 * GIB),
        "unpacks to 1 GB": lambda: unpacking_to(GIB),
        "claims a shape": lambda: claiming((1 << 40,), b"\0" * 800),
        "claims a product of 2^64": lambda: claiming((1 << 32, 1 << 32), b"\0" * 800),
        "claims a negative shape": lambda: claiming((-1, 100), b"\0" * 800),
        "lzma": lambda: claiming((100,), b"\0" * 800, zipfile.ZIP_LZMA),
        "400,000 entries": lambda: many_entries(400_000),
        "JSON of 120 MB": lambda: _zipped(many),
        "JSON nested 100,000 deep": lambda: archive("gait", 2, {}, {}, nested(100_000)),
        "JSON nested 900 deep": lambda: archive(
            "gait",
            2,
            {},
            {},
            b'{"kind":"gait","version":2,"hash":"","meta":{"a":%s}}' % nested(900),
        ),
        "10^9 steps a cycle": lambda: gait_archive(steps_per_cycle=10**9),
        "10^5 steps, 10^5 wavelets": lambda: gait_archive(
            steps_per_cycle=10**5,
            alpha=np.ones((1, 10**5, 16)),
            beta=np.ones((1, 10**5, 16)),
            mu=np.ones((10**5, 16)),
            amplitude=np.ones(16),
        ),
    }


def _zipped(arrays: Mapping[str, np.ndarray]) -> bytes:
    out = BytesIO()
    np.savez_compressed(out, **arrays)  # type: ignore[arg-type]
    return out.getvalue()


def log_bombs(log: bytes) -> dict[str, Callable[[], bytes]]:
    """Return makers of logs that ask for too much, by name; `log` is a whole one."""
    small = message(1)
    channel = record(
        Opcode.CHANNEL,
        struct.pack("<HH", 1, 0) + string("/robot/state") + string("protobuf") + bytes(4),
    )
    doubles = b"\x1a" + _varint(8 << 10) + bytes(8 << 10)
    flood = channel + message(1, doubles) * (1 << 12)

    def packed(data: bytes, times: int) -> bytes:
        import zstandard

        one = chunk(zstandard.compress(data), "zstd", len(data))
        return before(log, *([one] * times))

    return {
        "zstd frame of 5 GB": lambda: before(
            log, chunk(zstd_bomb(5 * GIB, 5 * GIB), "zstd", 5 * GIB)
        ),
        "zstd frame of 5 GB, chunk of 1 MB": lambda: before(
            log, chunk(zstd_bomb(5 * GIB, 5 * GIB), "zstd", 1 << 20)
        ),
        "zstd frame that says 5 GB": lambda: before(
            log, chunk(zstd_bomb(1 << 20, 5 * GIB), "zstd", 1 << 20)
        ),
        "zstd frame without a size": lambda: before(
            log, chunk(zstd_bomb(5 * GIB, None), "zstd", 1 << 30)
        ),
        "lz4 of 2 GB": lambda: before(log, chunk(lz4_bomb(2 * GIB), "lz4", 1 << 20)),
        "chunk that says 2^62": lambda: before(log, chunk(b"", "zstd", 1 << 62)),
        "chunk that says 1 GiB": lambda: before(log, chunk(zstd_bomb(1 << 17, None), "zstd", GIB)),
        "record that says 2^63": lambda: before(log, record(Opcode.CHUNK, b"", 1 << 63)),
        "chunk whose data say 2^63": lambda: before(
            log,
            record(
                Opcode.CHUNK,
                struct.pack("<QQQI", 0, 0, 8, 0) + string("") + struct.pack("<Q", 1 << 63),
            ),
        ),
        "60 chunks of 16 MB": lambda: packed(bytes(9) * ((16 << 20) // 9), 60),
        "60,000,000 empty messages": lambda: packed(small * 1_000_000, 60),
        "800 MB of numbers": lambda: packed(flood, 24),
        "4,000,000 empty records": lambda: before(log, record(0x7F, b"") * 4_000_000),
        "1,000,000 metadata records": lambda: before(
            log, *(metadata(f"{i}", {}) for i in range(1_000_000))
        ),
        "JSON of 45 MB": lambda: edited(
            log,
            {"configuration": setting("json", '{"scene":[' + "[]," * 15_000_000 + "[]]}")},
        ),
        "JSON nested 100,000 deep": lambda: edited(
            log, {"configuration": setting("json", nested(100_000).decode())}
        ),
        "terrain of 45 MB": lambda: edited(
            log, attachments={"terrain.json": b"[" + b"[]," * 15_000_000 + b"[]]"}
        ),
        **{
            f"{name}.npz: {what}": functools.partial(_attaching, log, f"{name}.npz", make)
            for name in ("body", "gait")
            for what, make in archive_bombs().items()
        },
    }


def _attaching(log: bytes, name: str, make: Callable[[], bytes]) -> bytes:
    return edited(log, attachments={name: make()})


def _varint(number: int) -> bytes:
    out = bytearray()
    while number > 0x7F:
        out.append(number & 0x7F | 0x80)
        number >>= 7
    return bytes([*out, number])


# ---- valid frames whose content makes no sense


def resaved(path: Any, kind: str, version: int, change: Callable[[dict, dict], Any]) -> bytes:
    """Return an archive with other arrays and another meta, and the right hash of them."""
    arrays, meta, _ = files.load_archive(path, kind, version)
    change(arrays, meta)
    return archive(kind, version, arrays, meta)


def senseless_logs(log: bytes) -> dict[str, bytes]:
    """Return whole logs of senseless content by name; `log` has two modes or more and some cycles."""
    return {
        **_identities(log),
        **_configurations(log),
        **_endings(log),
        **_numbers(log),
        **_attachments(log),
    }


def _identities(log: bytes) -> dict[str, bytes]:
    made = {}
    for field, values in {
        "timestep": ("0", "-0.04", "nan", "inf", "1e999", "", "x", "0x1"),
        "substeps": ("0", "-1", "65", "1e9", "2.5", "", "9" * 5000),
        "integrator": ("", "euler", "\x1b[2J"),
        "modes": ("0", "-1", "1", "17", "1000000000000", "x", ""),
        "body_hash": ("", "0" * 64, "<script>alert(1)</script>"),
    }.items():
        for value in values:
            made[f"{field} {value[:20]!r}"] = edited(log, {"defplan": setting(field, value)})
        made[f"no {field}"] = edited(log, {"defplan": functools.partial(_without, field)})
    return made


def _without(field: str, entries: dict[str, str]) -> None:
    del entries[field]


_TEXTS = ("null", "[]", "3", '"x"', "{}", "", "{", '{"scene": null}', '{"scene": []}')
_NOT_A_NUMBER = float("nan")
_SCENES: dict[str, tuple[Any, ...]] = {
    "target": (None, [], [1.0], [1.0, "x", 2.0], [1e308, 0, 0], [_NOT_A_NUMBER, 0, 0], {}),
    "centres": (None, [[1.0]], [[0, 0, 0]] * 2, 3.0),
    "radii": (None, [0.0, 1.0, 1.0], [-1.0] * 3, [float("inf")] * 3, "xxx", [[1.0]] * 3),
    "velocities": (None, [], [[0, 0, 0]]),
    "orientation": (None, [], [0, 0, 0, 0], [1, 1, 0, 0], [[1, 0, 0, 0]]),
    "shape": (None, "cube", 3, []),
    "goal_radius": (None, "1", 0, -1, _NOT_A_NUMBER),
    "max_cycles": (None, 0, -1, 1.5, 10**15, True),
    "meta": (None, []),
    "surprise": (1,),
}
_NAVIGATIONS: tuple[Any, ...] = (
    *([], 3, {"beams": -1}, {"beams": 10**12}, {"beams": "64"}, {"laser_range": 0}),
    *({"laser_range": "x"}, {"laser_range": _NOT_A_NUMBER}, {"sensor": 3}, {"sensor": "\x1b[2J"}),
)


def _configurations(log: bytes) -> dict[str, bytes]:
    made = {}
    for text in (*_TEXTS, nested(100_000).decode(), nested(500).decode()):
        edits = {"configuration": setting("json", text)}
        made[f"configuration {text[:20]!r} ({len(text)})"] = edited(log, edits)
    for field, values in _SCENES.items():
        for value in values:
            change = configured(functools.partial(_set_in_scene, field, value))
            made[f"scene {field} {value!r:.30}"] = edited(log, {"configuration": change})
    for value in _NAVIGATIONS:
        change = configured(functools.partial(_set, "navigation", value))
        made[f"navigation {value!r:.40}"] = edited(log, {"configuration": change})
    return made


def _set_in_scene(field: str, value: Any, configuration: dict[str, Any]) -> None:
    configuration["scene"][field] = value


def _set(field: str, value: Any, configuration: dict[str, Any]) -> None:
    configuration[field] = value


def _endings(log: bytes) -> dict[str, bytes]:
    made = {}
    for value in ("won", "running", "\x1b[31msuccess"):
        made[f"outcome {value!r}"] = edited(log, {"end": setting("outcome", value)})
    for value in ("-1", "x", "", "1e9", "9" * 5000):
        made[f"steps {value[:20]!r}"] = edited(log, {"end": setting("steps", value)})
    return made


_CHANGES: dict[str, dict[str, Callable[[list[float]], list[float] | None]]] = {
    "/robot/state": {
        "shorter": lambda v: v[:-1],
        "longer": lambda v: [*v, 0.0],
        "empty": lambda v: [],
        "NaN": lambda v: [_NOT_A_NUMBER, *v[1:]],
        "infinite": lambda v: [*v[:-1], float("inf")],
        "without attitude": lambda v: [*v[:3], 0, 0, 0, 0, *v[7:]],
        "missing": lambda v: None,
    },
    "/control/target_shape": {
        "shorter": lambda v: v[:-1],
        "NaN": lambda v: [_NOT_A_NUMBER, *v[1:]],
        "missing": lambda v: None,
    },
    "/contacts": {"empty": lambda v: [], "NaN": lambda v: [_NOT_A_NUMBER]},
    "/control/gait": {
        "negative": lambda v: [-1.0, *v[1:]],
        "too large": lambda v: [1e9, *v[1:]],
        "larger": lambda v: [float(2**40), *v[1:]],
        "half": lambda v: [0.5, *v[1:]],
        "NaN": lambda v: [_NOT_A_NUMBER, *v[1:]],
        "empty": lambda v: [],
    },
    "/planner/values": {"shorter": lambda v: v[:1], "empty": lambda v: []},
    "/planner/reward": {"NaN": lambda v: [_NOT_A_NUMBER], "empty": lambda v: []},
    "/laser/ranges": {"NaN": lambda v: [_NOT_A_NUMBER, *v[1:]]},
}


def _numbers(log: bytes) -> dict[str, bytes]:
    made = {}
    for topic, kinds in _CHANGES.items():
        for kind, change in kinds.items():
            made[f"{topic} {kind}"] = edited(
                log, messages=functools.partial(_changed_in, topic, change)
            )
    made["one state is shorter"] = edited(
        log, messages=lambda t, n, v: v[:-1] if t == "/robot/state" and n == 3 else v
    )
    return made


def _changed_in(topic: str, change: Callable, here: str, sequence: int, numbers: Any) -> Any:
    return change(numbers) if here == topic and numbers is not None else numbers


def _attachments(log: bytes) -> dict[str, bytes]:
    made = {"no body.npz": edited(log, attachments={"body.npz": None})}
    for name in ("body.npz", "gait.npz", "surrogate.npz", "terrain.json"):
        for data in (b"", b"null", b"PK\5\6" + bytes(18), nested(100_000)):
            made[f"{name} {data[:8]!r} ({len(data)})"] = edited(log, attachments={name: data})
    for data in (
        b"{}",
        b"[]",
        b'{"geoms": 3, "heightfield": null}',
        b'{"geoms": [3], "heightfield": null}',
        b'{"geoms": [], "heightfield": {"heights": [[NaN]], "half_size": 1, "position": 0}}',
    ):
        made[f"terrain.json {data!r:.60}"] = edited(log, attachments={"terrain.json": data})
    return made
