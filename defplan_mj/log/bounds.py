"""What reading a log may cost: sizes are known before anything is unpacked, and work and memory end."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass

import zstandard
from lz4.frame import LZ4FrameDecompressor
from mcap.records import Chunk

MOST_BYTES = 4 << 30
"""Of a log's file."""
MOST_CHUNK = 128 << 20
"""Of what one chunk unpacks to: a simulated second in steps of a tenth of a millisecond."""
_WINDOW = 128 << 20  # of zstd's memory for a frame
_RECORD = struct.Struct("<BQ")


class TooMuch(ValueError):
    """A log holds more than its size lets expect."""


@dataclass
class Budget:
    """What may still be taken from a log; grows with its file.

    Attributes:
        unpacked: bytes that chunks may unpack to.
        kept: bytes of memory that messages may take.
        work: records that may be looked at, those that are decoded counting more.
    """

    unpacked: int
    kept: int
    work: int

    @classmethod
    def of(cls, size: int) -> Budget:
        """Return that of a file of `size` bytes."""
        return cls((256 << 20) + 8 * size, (192 << 20) + 4 * size, 3_000_000 + size // 32)

    def look(self, work: int = 1) -> None:
        """Take work. Raises TooMuch: there is none left."""
        self.work -= work
        if self.work < 0:
            raise TooMuch("too many records")

    def keep(self, size: int) -> None:
        """Take memory for a message of `size` bytes, decoded and as arrays. Raises as `look`."""
        self.look(4)
        self.kept -= 700 + 3 * size
        if self.kept < 0:
            raise TooMuch("too many numbers")


def unpack(chunk: Chunk, budget: Budget) -> bytes:
    """Return what a chunk holds; no more memory is taken than it says, and not if it says too much.

    Raises:
        TooMuch: it says more than can be.
        ValueError, RuntimeError, zstandard.ZstdError: it is damaged.
    """
    size = chunk.uncompressed_size
    budget.unpacked -= size
    if size > MOST_CHUNK or budget.unpacked < 0:
        raise TooMuch("too large a chunk")
    if chunk.compression == "zstd":
        reader = zstandard.ZstdDecompressor(max_window_size=_WINDOW).stream_reader(chunk.data)
        data = reader.read(size + 1)
    elif chunk.compression == "lz4":
        data = LZ4FrameDecompressor().decompress(chunk.data, max_length=size + 1)
    elif chunk.compression == "":
        data = chunk.data
    else:
        raise ValueError(f"unknown compression {chunk.compression[:20]!r}")
    if len(data) != size:
        raise ValueError("a chunk is not of the size that it says")
    # (a checksum of 0 means that its writer made none)
    if chunk.uncompressed_crc not in (0, zlib.crc32(data)):
        raise ValueError("a chunk does not match its checksum")
    return data


def records(data: bytes, budget: Budget) -> Iterator[tuple[int, int, int]]:
    """Yield opcode, start and end of the content of each record in a chunk's data.

    Raises:
        ValueError: one ends beyond the data.
    """
    position = 0
    while position < len(data):
        budget.look()
        opcode, length = _RECORD.unpack_from(data, position)
        start, position = position + 9, position + 9 + length
        if position > len(data):
            raise ValueError("a record is larger than its chunk")
        yield opcode, start, position
