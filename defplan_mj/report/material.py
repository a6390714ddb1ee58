"""Everything a run's folder holds for its report; what is missing or damaged is named, not fatal."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from defplan_mj.base.errors import DefplanError
from defplan_mj.base.files import archive_contents, archive_meta
from defplan_mj.base.reading import read_json
from defplan_mj.base.space import PLANE, SPACE
from defplan_mj.body.model import Body
from defplan_mj.dynamics.reduced import ReducedDynamics
from defplan_mj.gait.gait import Gait
from defplan_mj.log.reader import EpisodeLog, read_log
from defplan_mj.log.recorder import PARTIAL_SUFFIX
from defplan_mj.planning.surrogate import Surrogate
from defplan_mj.report.content import Missing
from defplan_mj.task import TaskSpec
from defplan_mj.taskfile.find import task_of_run

_T = TypeVar("_T")


@dataclass
class Material:
    """What was found in a run's folder.

    Attributes:
        folder: of the run.
        body, gait, surrogate: None if missing or damaged.
        curves: of the planner's training, by name; empty if there are none.
        cut_short: whether a limit of wall time ended that training.
        documents: JSON files by name, e.g. 'run', 'evaluation'.
        logs: episodes, in the order of their names.
        faults: file name -> sentence, of files that are there and cannot be read.
    """

    folder: Path
    body: Body | None = None
    gait: Gait | None = None
    surrogate: Surrogate | None = None
    curves: dict[str, np.ndarray] = field(default_factory=dict)
    cut_short: bool = False
    documents: dict[str, Any] = field(default_factory=dict)
    logs: list[EpisodeLog] = field(default_factory=list)
    faults: dict[str, str] = field(default_factory=dict)

    @cached_property
    def dynamics(self) -> ReducedDynamics | None:
        """The body's reduced dynamics, at the gait's time step if there is a gait."""
        if self.body is None:
            return None
        terrain = self.spec.terrain if self.spec else None
        if self.gait is None:
            return ReducedDynamics(self.body, terrain=terrain)
        return ReducedDynamics(self.body, self.gait.timestep, terrain, **self.gait.stepping)

    @property
    def config(self) -> dict[str, Any]:
        """What the run was asked for."""
        config = self.documents.get("run", {}).get("config")
        return config if isinstance(config, dict) else {}

    @property
    def seconds(self) -> dict[str, float]:
        """Wall time of each stage, s; without the report's own, which is not known yet."""
        seconds = self.documents.get("run", {}).get("seconds", {})
        kept: dict[str, float] = {}
        for name, value in seconds.items():
            if name not in ("report", "total"):
                # the comparison of gait solvers has a stage for each solver and seed
                stage = name.split(" ")[0]
                kept[stage] = kept.get(stage, 0.0) + value
        return kept

    @property
    def task(self) -> str:
        """Name of the task, as far as it is known."""
        return str(self.config.get("task") or self.folder.name.rsplit("-seed", 1)[0])

    @cached_property
    def spec(self) -> TaskSpec | None:
        """The task itself, if the folder keeps it or it is installed here."""
        try:
            return task_of_run(self.folder, self.task)
        except DefplanError:
            return None

    @cached_property
    def space(self) -> str:
        """'planar' or 'spatial': where the task navigates."""
        if self.spec is not None:
            return self.spec.navigation.space
        return self.logs[0].space if self.logs else PLANE.name

    @property
    def walks(self) -> bool:
        """Whether the robot stands on something, from which it can fall; as far as it is known."""
        if self.spec is not None:
            return self.spec.world.walks
        return any("terrain.json" in log.attachments for log in self.logs)

    @property
    def legged(self) -> bool:
        """Whether gaits are seen better from the side: in space, and on the ground."""
        return self.space == SPACE.name or self.walks

    @property
    def switching(self) -> dict[str, Any]:
        """What a cycle of each gait does while they are switched: 'tasks' and 'switching'."""
        document = self.documents.get("gait", {})
        return document.get("gait", document)

    @property
    def solvers(self) -> list[dict[str, Any]]:
        """The gait solvers on the same problem, an entry a solver and seed; empty if not compared.

        'name', 'seed' and what `studies.gait_solvers.measure` says; or 'name', 'seed' and 'error'.
        """
        solvers = self.documents.get("gait_solvers", {}).get("solvers")
        return solvers if isinstance(solvers, list) else []

    def is_outdated(self, document: dict[str, Any]) -> bool:
        """Return whether a document of measurements says that it is of other gaits than these."""
        gait_hash = document.get("gait")
        return self.gait is not None and gait_hash is not None and gait_hash != self.gait.hash

    @property
    def paper(self) -> dict[str, Any]:
        """The paper's figures for this task."""
        return self.spec.paper if self.spec else {}


def gather(folder: str | Path) -> Material:
    """Read all that a run has left in its folder.

    Raises:
        DefplanError: there is no such folder.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise DefplanError(f"run folder {folder} does not exist")
    material = Material(folder)

    def read(name: str, load: Callable[[Path], _T]) -> _T | None:
        path = folder / name
        if not path.exists():
            return None
        try:
            return load(path)
        except DefplanError as error:
            material.faults[name] = str(error)
        except (OSError, ValueError) as error:
            material.faults[name] = f"{path} cannot be read: {error}"
        return None

    for path in sorted(folder.glob("[!.]*.json")):
        document = read(path.name, lambda path: read_json(path, "document"))
        if isinstance(document, dict):
            material.documents[path.stem] = document
    material.body = read("body.npz", Body.load)
    material.gait = read("gait.npz", Gait.load)
    material.surrogate = read("surrogate.npz", Surrogate.load)
    # a planner that is not the task's own has curves of its own
    own = read(f"training-{material.config.get('planner')}.npz", _training)
    material.curves, material.cut_short = own or read("training.npz", _training) or ({}, False)
    for path in sorted(folder.glob("**/[!.]*.mcap")):
        if path.name.endswith(PARTIAL_SUFFIX):
            continue  # of an episode that was stopped, or is running
        log = read(str(path.relative_to(folder)), read_log)
        if log is not None:
            material.logs.append(log)
    return material


def training_curves(folder: Path, planner: str) -> dict[str, np.ndarray]:
    """Return the training curves of a run's planner by name; none if they are missing or damaged."""
    for name in (f"training-{planner}.npz", "training.npz"):
        if (folder / name).is_file():
            try:
                return _training(folder / name)[0]
            except DefplanError:
                return {}
    return {}


def missing(material: Material, *names: str) -> Missing:
    """Return the sentence on files that a section needs and does not have."""
    for name in names:
        if name in material.faults:
            return Missing(f"{material.faults[name]}.")
    what = " and ".join(names)
    return Missing(f"Not made yet ({what}): defplan run {material.task} makes it.")


def _training(path: Path) -> tuple[dict[str, np.ndarray], bool]:
    """Return the numeric vectors of an npz archive, and whether it says that it was cut short."""
    try:
        arrays, _ = archive_contents(path)
    except Exception as error:  # zip, zlib and NumPy raise many kinds on damaged files
        raise DefplanError(f"{path} is not a whole training file") from error
    curves = {k: a for k, a in arrays.items() if a.ndim == 1 and a.dtype.kind in "fiu" and len(a)}
    return curves, bool(archive_meta(path).get("cut_short"))
