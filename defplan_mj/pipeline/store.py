"""A run's folder: each stage's files, reused only if whole and made from the same inputs."""

from __future__ import annotations

import errno
import fcntl
import hashlib
import json
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from types import TracebackType
from typing import IO, Any

from defplan_mj import __version__
from defplan_mj.base import files
from defplan_mj.base.errors import DefplanError
from defplan_mj.base.files import file_hash
from defplan_mj.base.reading import read_json
from defplan_mj.pipeline.provenance import content_of, plain_data

FORMAT_VERSION = 1
RUN_FILE = "run.json"
_LOCK = ".lock"
_BUSY = (errno.EWOULDBLOCK, errno.EAGAIN, errno.EACCES)
_NO_LOCKS = (errno.ENOSYS, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOLCK, errno.EINVAL)


@dataclass(frozen=True)
class Record:
    """What run.json says of a finished stage.

    Attributes:
        inputs: hash of everything the stage was made from (its options, the files before it).
        files: name -> SHA-256 of each file it left in the folder.
        seconds: wall time it took.
        contents: name -> hash of what each file says apart from wall times: the inputs of later stages.
        made_from: the inputs themselves, to tell later what differs.
    """

    inputs: str
    files: dict[str, str]
    seconds: float
    contents: dict[str, str] = field(default_factory=dict)
    made_from: dict[str, Any] = field(default_factory=dict)


class FolderBusy(DefplanError):
    """Another process is at work in a run's folder."""


def input_hash(inputs: Mapping[str, Any]) -> str:
    """Return the hash of a stage's inputs, this version of defplan among them."""
    text = json.dumps({"defplan": __version__, **plain_data(inputs)}, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


class RunFolder:
    """The folder of one run; a context manager that keeps other processes out of it.

    Only plain names inside the folder are read, written or removed, whatever its run.json says.

    Args:
        path: the folder; made if it is missing.
        config: what the run was asked for; written to run.json.
        fresh: forget what was made before.

    Raises:
        DefplanError: another process is at work in the folder, it cannot be written or locked.
    """

    def __init__(self, path: Path, config: Mapping[str, Any], fresh: bool = False) -> None:
        self.path = path
        self.config = dict(config)
        self.fresh = fresh
        self.records: dict[str, Record] = {}
        self._lock: IO[str] | None = None

    def __enter__(self) -> RunFolder:
        try:
            self.path.mkdir(parents=True, exist_ok=True)
            self._lock = open(self.path / _LOCK, "a")
        except OSError as error:
            raise DefplanError(f"cannot write into {self.path}: {error.strerror}") from error
        try:
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            self._lock.close()
            kind = FolderBusy if error.errno in _BUSY else DefplanError
            raise kind(_lock_sentence(self.path, error)) from error
        self._sweep()
        self.records = {} if self.fresh else _read(self.path)[1]
        if self.fresh:
            self._write()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._lock is not None:
            self._lock.close()

    def file(self, name: str) -> Path:
        """Return the path of a file of this run.

        Raises:
            DefplanError: the name would lead out of the folder.
        """
        if not _is_plain(name):
            raise DefplanError(f"{name!r} is no name for a file of a run: it must be a plain one")
        return self.path / name

    def stage(
        self,
        name: str,
        inputs: Mapping[str, Any],
        make: Callable[[], Iterable[Path]],
        fresh: bool = False,
    ) -> Record:
        """Make a stage unless its files are there, whole and of the same inputs.

        Args:
            name: of the stage, e.g. 'gait'.
            inputs: plain data; everything that the result depends on.
            make: writes the stage's files into the folder and returns their paths.
            fresh: make it in any case.

        Returns:
            what is there now.
        """
        record = self.records.get(name)
        if not fresh and record and record.inputs == input_hash(inputs) and self.whole(name):
            return record
        start = time.perf_counter()
        paths = sorted(make())
        seconds = time.perf_counter() - start
        hashes = {str(path.relative_to(self.path)): file_hash(path) for path in paths}
        contents = {str(path.relative_to(self.path)): content_of(path) for path in paths}
        self._remove(set(record.files if record else ()) - set(hashes))
        made = Record(input_hash(inputs), hashes, seconds, contents, plain_data(inputs))
        self.records[name] = made
        self._write()
        return made

    def adopt(self, name: str, inputs: Mapping[str, Any], lender: Path) -> bool:
        """Copy a stage from another run's folder if it is there, whole and of the same inputs.

        Returns:
            whether it was. A stage that is here already with these inputs stays.
        """
        own, asked_for = self.records.get(name), input_hash(inputs)
        if own is not None and own.inputs == asked_for and self.whole(name):
            return False
        record = _read(lender)[1].get(name)
        if record is None or record.inputs != asked_for:
            return False
        try:
            for file, digest in record.files.items():
                if file_hash(lender / file) != digest:
                    return False
            for file in record.files:
                files.copy_file(lender / file, self.file(file))
        except OSError:  # it is being written, or was removed
            return False
        self._remove(set(own.files if own else ()) - set(record.files))
        self.records[name] = record
        self._write()
        return self.whole(name)

    def keep_config(self) -> None:
        """Write what the run is asked for now, whatever is made of it."""
        self._write()

    def seconds(self, name: str) -> float:
        """Return the wall time a stage took, in this run or in the one that made it; 0: no such."""
        return self.records[name].seconds if name in self.records else 0.0

    def whole(self, name: str) -> bool:
        """Return whether a stage's files are there as they were written."""
        try:
            hashes = self.records[name].files
            return all(file_hash(self.file(n)) == h for n, h in hashes.items())
        except (OSError, KeyError):
            return False

    def _remove(self, names: Iterable[str]) -> None:
        """Remove files that a stage no longer makes."""
        for name in names:
            if not self.file(name).is_dir():
                self.file(name).unlink(missing_ok=True)

    def _sweep(self) -> None:
        """Remove what writers that were killed have left: their files never got a name."""
        for suffix in (".npz", ".json", ".html", ".pt"):
            for path in self.path.glob(f".*{suffix}.*{suffix}"):
                path.unlink(missing_ok=True)

    def _write(self) -> None:
        from defplan_mj.log.recorder import versions  # here: it loads a lot

        data = {
            "format": FORMAT_VERSION,
            "config": self.config,
            "versions": versions(),
            "seconds": {name: record.seconds for name, record in self.records.items()},
            "stages": {name: asdict(record) for name, record in self.records.items()},
        }
        files.write_text(self.file(RUN_FILE), json.dumps(data, indent=1, default=str) + "\n")


def read_config(path: Path) -> dict[str, Any]:
    """Return what the run in the folder `path` was asked for; empty if there is none."""
    return _read(path)[0]


def stage_seconds(path: Path) -> dict[str, float]:
    """Return the wall time of each finished stage of the run in the folder `path`, by its key, s."""
    return {name: float(record.seconds) for name, record in _read(path)[1].items()}


def has_run(path: Path) -> bool:
    """Return whether the folder `path` holds a run that was reported."""
    return "report" in _read(path)[1]


def _read(path: Path) -> tuple[dict[str, Any], dict[str, Record]]:
    """Read run.json: configuration and records; one that is damaged counts as not there."""
    try:
        data = read_json(path / RUN_FILE, "run")
        if data["format"] != FORMAT_VERSION:
            return {}, {}
        records = {name: Record(**record) for name, record in data["stages"].items()}
        kept = {name: record for name, record in records.items() if _is_sound(record)}
        return dict(data["config"]), kept
    except (DefplanError, *files.WRONG_FIELDS):
        return {}, {}


def _is_sound(record: Record) -> bool:
    """Return whether a record is of the right types and names nothing outside the folder."""
    return (
        isinstance(record.inputs, str)
        and isinstance(record.seconds, int | float)
        and all(isinstance(part, dict) for part in (record.files, record.contents))
        and isinstance(record.made_from, dict)
        and all(_is_plain(name) for name in (*record.files, *record.contents))
    )


def _is_plain(name: str) -> bool:
    """Return whether `name` is that of a visible file right in a folder."""
    return bool(name) and name == Path(name).name and not name.startswith(".") and "\0" not in name


def _lock_sentence(path: Path, error: OSError) -> str:
    """Return what is the matter if a folder cannot be locked."""
    if error.errno in _BUSY:
        return f"another defplan is at work in {path}: wait for it or choose another --logs"
    if error.errno in _NO_LOCKS:
        return (
            f"the file system of {path} knows no locks (flock: {error.strerror}), so two runs could"
            " spoil each other: choose a --logs on another one"
        )
    return f"cannot lock {path}: {error.strerror}"


def write_json(path: Path, data: Any) -> None:
    """Write `data` as JSON, atomically."""
    files.write_text(path, json.dumps(data, indent=1, default=files.plain, allow_nan=False) + "\n")
