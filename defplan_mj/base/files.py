"""Files that are either whole or absent: atomic writes, and npz archives with a format, a version and a hash."""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import json
import math
import os
import shutil
import struct
import tempfile
import zipfile
from collections.abc import Iterator, Mapping
from io import BytesIO
from pathlib import Path
from typing import IO, Any

import numpy as np

from defplan_mj.base.errors import DefplanError
from defplan_mj.base.reading import Packed, first_line, parse_json

Source = str | Path | Packed
"""What an archive is read from."""

_HEADER = "header.json"
# Of an archive's arrays: a million vertices with all the basis that the kernel takes.
MOST_BYTES = 4 << 30
# Numbers of a mesh hardly shrink; what unpacks to far more than its file was made to.
SMALL_BYTES, MOST_GROWTH = 128 << 20, 4
MOST_ARRAYS = 1000
_MOST_DIRECTORY, _DIRECTORY_END = 1 << 20, 22
_NUMBERS, _TEXTS = "biufc", "SU"


@contextlib.contextmanager
def atomic_path(path: str | Path) -> Iterator[Path]:
    """Yield a temporary path beside `path`; move it there when the block ends without an error.

    The temporary file is removed on any error, Ctrl-C included, so `path` is never half-written.
    """
    target = Path(path)
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(
            prefix=f".{target.name}.", suffix=target.suffix, dir=target.parent
        )
        os.close(handle)
    except OSError as error:
        raise DefplanError(f"cannot write {target}: {error.strerror}") from error
    temporary = Path(name)
    try:
        yield temporary
        with open(temporary, "rb") as written:
            os.fsync(written.fileno())
        os.chmod(temporary, 0o644)
        os.replace(temporary, target)
    except OSError as error:
        raise DefplanError(f"cannot write {target}: {error.strerror or error}") from error
    finally:
        temporary.unlink(missing_ok=True)


def check_writable(path: str | Path) -> None:
    """Raise DefplanError if a file could not be written at `path`; to be asked before long work."""
    if Path(path).is_dir():
        raise DefplanError(f"cannot write {path}: it is a folder")
    try:
        Path(path).parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=Path(path).parent):
            pass
    except OSError as error:
        raise DefplanError(f"cannot write {path}: {error.strerror}") from error


def write_text(path: str | Path, text: str) -> None:
    """Write `text` to `path` atomically (UTF-8)."""
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def write_bytes(path: str | Path, data: bytes) -> None:
    """Write `data` to `path` atomically."""
    with atomic_path(path) as temporary:
        temporary.write_bytes(data)


def copy_file(source: str | Path, path: str | Path) -> None:
    """Copy a file's bytes to `path` atomically."""
    with atomic_path(path) as temporary:
        shutil.copyfile(source, temporary)


def plain(value: Any) -> Any:
    """Return what JSON can hold for a NumPy scalar, an array, a path or a dataclass (json's `default`).

    Raises:
        TypeError: it is none of these.
    """
    if hasattr(value, "tolist"):
        return value.tolist()
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return dataclasses.asdict(value)
    raise TypeError(f"cannot write a {type(value).__name__} as JSON")


def content_hash(arrays: Mapping[str, np.ndarray], meta: Mapping[str, Any]) -> str:
    """Return the SHA-256 of names, types, shapes and bytes of `arrays` and of `meta` (64 hex digits).

    Wall times, which `meta` holds under the name 'seconds' at any depth, have no part in it: the same
    work done twice has the same hash.
    """
    return _content_hash(arrays, without_times(meta))


def without_times(meta: Any) -> Any:
    """Return plain data without the entries called 'seconds', at any depth."""
    if isinstance(meta, Mapping):
        return {name: without_times(value) for name, value in meta.items() if name != "seconds"}
    return [without_times(value) for value in meta] if isinstance(meta, list | tuple) else meta


def _content_hash(arrays: Mapping[str, np.ndarray], meta: Mapping[str, Any]) -> str:
    digest = hashlib.sha256(json.dumps(meta, sort_keys=True).encode())
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        digest.update(f"{name}{array.dtype.str}{array.shape}".encode())
        # a copy of its bytes would double the memory
        if array.itemsize:
            digest.update(array.reshape(-1).view(np.uint8).data)
    return digest.hexdigest()


def save_archive(
    path: str | Path,
    kind: str,
    version: int,
    arrays: Mapping[str, np.ndarray],
    meta: Mapping[str, Any],
) -> str:
    """Save arrays of any shapes and JSON-able `meta` as one npz archive; return its content hash.

    The archive says its `kind` (e.g. 'body'), the `version` of that format and the hash of its content.
    """
    digest = content_hash(arrays, meta)
    header = json.dumps({"kind": kind, "version": version, "hash": digest, "meta": meta})
    contents: dict[str, Any] = {_HEADER: np.frombuffer(header.encode(), np.uint8), **arrays}
    with atomic_path(path) as temporary, open(temporary, "wb") as stream:
        np.savez_compressed(stream, **contents)
    return digest


WRONG_FIELDS = (
    TypeError,
    LookupError,
    AttributeError,
    ValueError,
    ArithmeticError,
    RecursionError,
    AssertionError,
)
"""What Python and NumPy raise where content is not what it should be."""


@contextlib.contextmanager
def fields_of(path: Source, kind: str) -> Iterator[None]:
    """Say in one sentence that the content of an archive lacks fields, or has others, than its kind."""
    try:
        yield
    except WRONG_FIELDS as error:
        raise DefplanError(
            f"{path} has not the fields of a {kind} ({first_line(error)}): make it anew"
        ) from error


class _Refused(ValueError):
    """An archive that is whole, but asks for more than it can need."""


def _opened(source: Path | Packed) -> Path | BytesIO:
    """Return what zipfile and NumPy read an archive from."""
    return BytesIO(source.data) if isinstance(source, Packed) else source


def _check_sizes(source: Path | Packed) -> None:
    """Raise _Refused if an archive has too much in it, or an array says it is larger than its bytes."""
    size = len(source.data) if isinstance(source, Packed) else source.stat().st_size
    _check_directory(source, size)
    with zipfile.ZipFile(_opened(source)) as archive:
        items = archive.infolist()
        if len(items) > MOST_ARRAYS:
            raise _Refused("it has too many arrays")
        if sum(item.file_size for item in items) > min(
            MOST_BYTES, SMALL_BYTES + MOST_GROWTH * size
        ):
            raise _Refused("it unpacks to far more than its size")
        for item in items:
            # other methods ask for as much memory as the file says
            if item.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
                raise _Refused("its compression is unknown")
            with archive.open(item) as stream:
                _check_array(stream, item.file_size)


def _check_directory(source: Path | Packed, size: int) -> None:
    """Raise _Refused if an archive's own list of entries is large: zipfile reads all of it."""
    if isinstance(source, Packed):
        end = source.data[-_DIRECTORY_END:]
    else:
        with open(source, "rb") as stream:
            stream.seek(max(size - _DIRECTORY_END, 0))
            end = stream.read(_DIRECTORY_END)
    if len(end) < _DIRECTORY_END or end[:4] != b"PK\5\6":
        raise ValueError("no archive, or one with a comment")
    if struct.unpack_from("<I", end, 12)[0] > _MOST_DIRECTORY:
        raise _Refused("it has too many arrays")


def _check_array(stream: IO[bytes], size: int) -> None:
    """Raise _Refused if an array is none of numbers or letters, or claims more than `size` bytes."""
    version = np.lib.format.read_magic(stream)
    reader = (
        np.lib.format.read_array_header_1_0
        if version == (1, 0)
        else np.lib.format.read_array_header_2_0
    )
    shape, _, kind = reader(stream)
    if kind.kind not in _NUMBERS and not (kind.kind in _TEXTS and kind.itemsize):
        raise _Refused("an array in it has neither numbers nor letters")
    if min(shape, default=0) < 0 or math.prod(shape) * kind.itemsize > size:
        raise _Refused("an array in it says that it is larger than its bytes")


def load_archive(
    path: Source, kind: str, version: int, remake: str = "make it anew"
) -> tuple[dict[str, np.ndarray], dict[str, Any], str]:
    """Read an archive of `save_archive`: arrays, meta, hash. Nothing is unpickled.

    Args:
        remake: how a file of another version is made anew, for the error.

    Raises:
        DefplanError: the file is missing, cut short, of another kind or version, or altered.
    """
    source = path if isinstance(path, Packed) else Path(path)
    if isinstance(source, Path) and not source.is_file():
        raise DefplanError(f"{kind} file {source} does not exist")
    try:
        contents, header = archive_contents(source)
        digest = header["hash"]
    except PermissionError as error:
        raise DefplanError(f"cannot read {source}: {error.strerror}") from error
    except _Refused as error:
        raise DefplanError(f"{source} is not a whole {kind} file: {error}") from error
    except Exception as error:  # a damaged archive makes zipfile and NumPy raise a dozen kinds
        raise DefplanError(f"{source} is not a whole {kind} file (cut short or damaged)") from error
    if header.get("kind") != kind:
        raise DefplanError(f"{source} is a {header.get('kind')} file, not a {kind} file")
    if header.get("version") != version:
        raise DefplanError(
            f"{source} has {kind} format {header.get('version')}, this version reads {version}: {remake}"
        )
    meta = header["meta"]
    # files from before wall times were left out are hashed with them
    if digest not in (content_hash(contents, meta), _content_hash(contents, meta)):
        raise DefplanError(
            f"{source} is damaged: its content does not match its hash; make it anew"
        )
    return contents, meta, digest


def archive_contents(source: Path | Packed) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Return arrays and header of an archive, unjudged; raises many kinds of error."""
    _check_sizes(source)  # before memory is taken for what a damaged header asks for
    with np.load(_opened(source), allow_pickle=False) as archive:
        header = parse_json(archive[_HEADER].tobytes())
        if not isinstance(header, dict) or not isinstance(header["meta"], dict):
            raise ValueError("no header")
        return {name: archive[name] for name in archive.files if name != _HEADER}, header


def archive_hash(path: str | Path) -> str:
    """Return the content hash that an archive of `save_archive` says it has; '' if it is none."""
    return str(_header(path).get("hash", ""))


def archive_meta(path: str | Path) -> dict[str, Any]:
    """Return what an archive of `save_archive` says beside its arrays; nothing if it is none."""
    meta = _header(path).get("meta", {})
    return meta if isinstance(meta, dict) else {}


def _header(path: str | Path) -> dict[str, Any]:
    try:
        _check_sizes(Path(path))
        with np.load(path, allow_pickle=False) as archive:
            header = parse_json(archive[_HEADER].tobytes())
    except Exception:  # of another kind, or damaged: np.load raises a dozen kinds
        return {}
    return header if isinstance(header, dict) else {}


def file_hash(path: Path) -> str:
    """Return the SHA-256 of a file's bytes (64 hex digits)."""
    with open(path, "rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()
