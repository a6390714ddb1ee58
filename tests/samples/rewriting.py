"""Logs as other tools leave them: read by the `mcap` package and written again in another way."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer


def rewrite(
    source: Path,
    target: Path,
    *,
    order: Callable[[Any], Any] | None = None,
    keep: Callable[[str, Any], bool] = lambda topic, message: True,
    metadata: bool = True,
    attachments: bool = True,
    others: Sequence[Path] = (),
    **options: Any,
) -> Path:
    """Write the messages of `source` (and of `others`, as a merge does) to `target`.

    Args:
        order: key that messages are sorted by; None: as they stand in the file.
        keep: (topic, message) -> whether it stays.
        metadata, attachments: whether they stay.
        options: of the writer: chunk_size, compression, use_chunking, enable_crcs, ...
    """
    messages, records, files = [], [], []
    for path in (source, *others):
        with open(path, "rb") as stream:
            reader = make_reader(stream)
            found = reader.iter_messages(log_time_order=False)
            messages += [(path, *item) for item in found if keep(item[1].topic, item[2])]
            records += list(reader.iter_metadata()) if metadata else []
            files += list(reader.iter_attachments()) if attachments else []
    if order is not None:
        messages.sort(key=lambda item: order(item[3]))
    with open(target, "wb") as stream:
        writer = Writer(stream, **options)
        writer.start()
        known: dict[Any, int] = {}
        for path, schema, channel, message in messages:
            assert schema is not None
            if (path, schema.name) not in known:
                known[path, schema.name] = writer.register_schema(
                    schema.name, schema.encoding, schema.data
                )
            if (path, channel.topic) not in known:
                known[path, channel.topic] = writer.register_channel(
                    channel.topic, channel.message_encoding, known[path, schema.name]
                )
            writer.add_message(
                known[path, channel.topic],
                message.log_time,
                message.data,
                message.publish_time,
                message.sequence,
            )
        for record in records:
            writer.add_metadata(record.name, record.metadata)
        for file in files:
            writer.add_attachment(
                file.create_time, file.log_time, file.name, file.media_type, file.data
            )
        writer.finish()
    return target


NONE, LZ4, ZSTD = CompressionType.NONE, CompressionType.LZ4, CompressionType.ZSTD
