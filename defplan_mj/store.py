"""A run's folder: each stage's files, reused only if whole and made from the same inputs."""

from __future__ import annotations

import fcntl
import hashlib
import json
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from types import TracebackType
from typing import IO, Any

from defplan_mj import __version__
from defplan_mj.base import files
from defplan_mj.base.errors import DefplanError

FORMAT_VERSION = 1
RUN_FILE = "run.json"
_LOCK = ".lock"


@dataclass(frozen=True)
class Record:
    """What run.json says of a finished stage.

    Attributes:
        inputs: hash of everything the stage was made from (its options, the files before it).
        files: name -> SHA-256 of each file it left in the folder.
        seconds: wall time it took.
    """

    inputs: str
    files: dict[str, str]
    seconds: float


def file_hash(path: Path) -> str:
    """Return the SHA-256 of a file's bytes (64 hex digits)."""
    with open(path, "rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def input_hash(inputs: Mapping[str, Any]) -> str:
    """Return the hash of a stage's inputs, this version of defplan among them."""
    text = json.dumps({"defplan": __version__, **inputs}, sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()


class RunFolder:
    """The folder of one run; a context manager that keeps other processes out of it.

    Args:
        path: the folder; made if it is missing.
        config: what the run was asked for; written to run.json.
        fresh: forget what was made before.

    Raises:
        DefplanError: another process is at work in the folder, or it cannot be written.
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
            raise DefplanError(
                f"another defplan is at work in {self.path}: wait for it or choose another --logs"
            ) from error
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
        """Return the path of a file of this run."""
        return self.path / name

    def stage(
        self,
        name: str,
        inputs: Mapping[str, Any],
        make: Callable[[], Iterable[Path]],
        fresh: bool = False,
    ) -> dict[str, str]:
        """Make a stage unless its files are there, whole and of the same inputs.

        Args:
            name: of the stage, e.g. 'gait'.
            inputs: JSON-able; everything that the result depends on.
            make: writes the stage's files into the folder and returns their paths.
            fresh: make it in any case.

        Returns:
            the hashes of its files by name: the inputs of later stages.
        """
        wanted = input_hash(inputs)
        record = self.records.get(name)
        if not fresh and record and record.inputs == wanted and self._whole(record):
            return record.files
        start = time.perf_counter()
        paths = sorted(make())
        seconds = time.perf_counter() - start
        made = {str(path.relative_to(self.path)): file_hash(path) for path in paths}
        for stale in set(record.files if record else ()) - set(made):
            self.file(stale).unlink(missing_ok=True)
        self.records[name] = Record(wanted, made, seconds)
        self._write()
        return made

    def seconds(self, name: str) -> float:
        """Return the wall time a stage took, in this run or in the one that made it; 0: no such."""
        return self.records[name].seconds if name in self.records else 0.0

    def _whole(self, record: Record) -> bool:
        """Return whether the files of `record` are there as they were written."""
        try:
            return all(file_hash(self.file(n)) == h for n, h in record.files.items())
        except OSError:
            return False

    def _sweep(self) -> None:
        """Remove what writers that were killed have left: their files never got a name."""
        for pattern in (".*.npz", ".*.json", ".*.html", ".*.pt"):
            for path in self.path.glob(pattern):
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


def _read(path: Path) -> tuple[dict[str, Any], dict[str, Record]]:
    """Read run.json: configuration and records; one that is damaged counts as not there."""
    try:
        data = json.loads((path / RUN_FILE).read_text(encoding="utf-8"))
        if data["format"] != FORMAT_VERSION:
            return {}, {}
        records = {name: Record(**record) for name, record in data["stages"].items()}
        return dict(data["config"]), records
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return {}, {}
