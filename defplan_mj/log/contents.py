"""What stands in the bytes of a log, whole or cut at any of them: records, attachments, the messages we need."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from io import BytesIO
from typing import Any

import zstandard
from google.protobuf.message import DecodeError
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, Metadata, Schema

from defplan_mj.log import bounds, channels, schemas

MAGIC = b"\x89MCAP0\r\n"
_MESSAGE = struct.Struct("<HIQQ")
_OF_CHUNKS = (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE)
_LOOKED_INTO = (Opcode.METADATA, Opcode.ATTACHMENT, Opcode.CHUNK, *_OF_CHUNKS)
_DAMAGE = (
    McapError,
    DecodeError,
    zstandard.ZstdError,
    struct.error,
    ValueError,
    LookupError,
    ArithmeticError,
    RuntimeError,  # of lz4
    TypeError,
    AttributeError,
    EOFError,
    MemoryError,
)


def _needed() -> dict[str, Any]:
    """Return topic -> message class of the channels that are read: numbers, and two that are not."""
    return {
        topic: channel.message
        for topic, channel in channels.by_topic().items()
        if topic in (channels.SURROGATE, channels.FORCES)
        or channel.message is schemas.LabelledNumbers
    }


@dataclass
class Contents:
    """What a file holds, before it is put in order.

    Attributes:
        fault: '' if the file is whole, else what is wrong with it, as half a sentence.
        metadata: of each record, by its name.
        attachments: file name -> bytes.
        episodes: how many were merged into the file.
        schemas, topics: names by the numbers of schemas and channels; '' of a channel that is not ours.
        needed: see `_needed`.
        messages: topic -> (number of the step, time in s, message) of each.
    """

    fault: str = ""
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    attachments: dict[str, bytes] = field(default_factory=dict)
    episodes: int = 1
    schemas: dict[int, str] = field(default_factory=dict)
    topics: dict[int, str] = field(default_factory=dict)
    needed: dict[str, Any] = field(default_factory=_needed)
    messages: dict[str, list[tuple[int, float, Any]]] = field(default_factory=dict)


def contents_of(data: bytes) -> Contents:
    """Return what an MCAP file holds, as far as it can be read; `fault` says where that ends."""
    contents, budget = Contents(), bounds.Budget.of(len(data))
    end = len(MAGIC)
    try:
        for position, opcode, record in _records(data):
            end = position
            # (a checksum of 0 means that its writer made none)
            if opcode == Opcode.DATA_END and _number(record) not in (0, zlib.crc32(data[:end])):
                raise ValueError("the data do not match their checksum")
            budget.look()
            if opcode in _LOOKED_INTO:
                _take(contents, opcode, record, budget)
            end = position + 9 + len(record)
    except bounds.TooMuch as error:
        contents.fault = f"not read from byte {end} on ({error})"
    except _DAMAGE:
        contents.fault = f"damaged at byte {end}"
    if not contents.fault and data[end:] != MAGIC:
        contents.fault = f"cut at byte {len(data)}"
    if not contents.fault and schemas.END_RECORD not in contents.metadata:
        contents.fault = "stopped before the episode ended"
    return contents


def _records(data: bytes) -> Iterator[tuple[int, int, bytes]]:
    """Yield position, opcode and content of every complete record up to the footer."""
    position = len(MAGIC)
    while position + 9 <= len(data):
        opcode, length = struct.unpack_from("<BQ", data, position)
        stop = position + 9 + length
        if stop > len(data):
            return
        yield position, opcode, data[position + 9 : stop]
        if opcode == Opcode.FOOTER:
            return
        position = stop


def _take(contents: Contents, opcode: int, record: bytes, budget: bounds.Budget) -> None:
    """Keep what a record says, if we need it."""
    budget.look(10)
    stream = ReadDataStream(BytesIO(record))
    if opcode == Opcode.METADATA:
        metadata = Metadata.read(stream)
        kept = contents.metadata.setdefault(metadata.name, metadata.metadata)
        if metadata.name == schemas.CONFIGURATION_RECORD and kept != metadata.metadata:
            contents.episodes += 1
    elif opcode == Opcode.ATTACHMENT:
        if _number(record[-4:]) not in (0, zlib.crc32(record[:-4])):
            raise ValueError("attachment does not match its checksum")
        attachment = Attachment.read(stream)
        contents.attachments[attachment.name] = attachment.data
    elif opcode in _OF_CHUNKS:
        _keep(contents, record, [(opcode, 0, len(record))], budget)
    elif opcode == Opcode.CHUNK:
        data = bounds.unpack(Chunk.read(stream), budget)
        _keep(contents, data, bounds.records(data, budget), budget)


def _keep(
    contents: Contents, data: bytes, records: Iterable[tuple[int, int, int]], budget: bounds.Budget
) -> None:
    """Keep the messages that we need: all of a chunk or nothing, as the arrays grow by whole chunks.

    Args:
        data: a chunk's, or one record.
        records: opcode, start and end of the content of each record in it.
    """
    taken: list[tuple[str, int, float, Any]] = []
    for kind, start, stop in records:
        if kind == Opcode.MESSAGE:
            number, sequence, time, _ = _MESSAGE.unpack_from(data, start)
            topic = contents.topics[number]
            if topic in contents.needed:
                budget.keep(stop - start)
                content = contents.needed[topic].FromString(data[start + _MESSAGE.size : stop])
                taken.append((topic, sequence, time * 1e-9, content))
        elif kind in _OF_CHUNKS:
            budget.look(20)
            stream = ReadDataStream(BytesIO(data[start:stop]))
            if kind == Opcode.SCHEMA:
                schema = Schema.read(stream)
                contents.schemas[schema.id] = schema.name
            else:
                channel = Channel.read(stream)
                contents.topics[channel.id] = channel.topic if _ours(contents, channel) else ""
    for topic, *message in taken:
        contents.messages.setdefault(topic, []).append(tuple(message))


def _ours(contents: Contents, channel: Channel) -> bool:
    """Whether a channel holds what we write under its topic: a merged file may use the name, too."""
    if channel.topic not in contents.needed:
        return False
    name = contents.needed[channel.topic].DESCRIPTOR.full_name
    return contents.schemas.get(channel.schema_id, name) == name


def _number(four: bytes) -> int:
    return struct.unpack("<I", four)[0]
