"""The run: body, gait, surrogate, planner, evaluation, report, each made once and reused while it fits."""

from __future__ import annotations

import contextlib
import dataclasses
import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from defplan_mj import registry
from defplan_mj.base import files, threads
from defplan_mj.base.progress import Progress, no_progress
from defplan_mj.dynamics.terrain import terrain_json
from defplan_mj.rivals import SWITCHING_CYCLES
from defplan_mj.store import RunFolder, file_hash, read_config
from defplan_mj.task import TaskSpec
from defplan_mj.trial import Recorders, evaluate

if TYPE_CHECKING:
    from defplan_mj.body.model import Body
    from defplan_mj.dynamics.reduced import ReducedDynamics
    from defplan_mj.gait.gait import Gait
    from defplan_mj.gait.problem import GaitProblem
    from defplan_mj.planning.planner import Planner
    from defplan_mj.planning.surrogate import Surrogate

STAGES = ("body", "gait", "surrogate", "planner", "evaluation")
GAIT_FILE, EVALUATION_FILE, MOVING_FILE = "gait.json", "evaluation.json", "moving.json"
REPORT_FILE = "report.html"
SPEEDS = (0.25, 0.5, 1.0, 2.0)
"""Of moving obstacles, m/s."""
TRAINING_VERSION = 1
CONFIGURATION = (
    "gait_solver",
    "planner",
    "feedback",
    "rivals",
    "solver_seeds",
    "pairs",
    "episodes",
    "logged",
    "moving",
)  # kept in run.json


@dataclass(frozen=True)
class RunOptions:
    """What a run is asked for besides its task.

    Attributes:
        seed: of everything random.
        gait_solver, planner, feedback: plugins by name (None: the task's).
        rivals: gait solvers that the report compares with (none: ('none',); None: the task's).
        solver_seeds: with how many seeds they are compared.
        pairs: (before, after) pairs a gait that the surrogate is fitted to.
        episodes: novel scenes of the evaluation.
        logged: how many of the novel episodes are logged, beside those of K2.
        moving: K2 episodes among moving obstacles, at each of `SPEEDS` (0: none).
        remake: the stage that is made anew even if it could be reused.
    """

    seed: int = 0
    gait_solver: str | None = None
    planner: str | None = None
    feedback: str | None = None
    rivals: Sequence[str] | None = None
    solver_seeds: int = 1
    pairs: int = 1000
    episodes: int = 200
    logged: int = 4
    moving: int = 40
    remake: str | None = None


class Run:
    """One run of a task in its folder. A stage is made, or read again, when it is first asked for.

    Args:
        spec: the task.
        folder: open for the time of the run.
        options: see `RunOptions`.
        progress: told what is being made, as 'stage: detail'.
    """

    def __init__(
        self,
        spec: TaskSpec,
        folder: RunFolder,
        options: RunOptions = RunOptions(),
        progress: Progress = no_progress,
    ) -> None:
        self.spec = spec
        self.folder = folder
        self.options = options
        self._progress = progress
        self.hashes: dict[str, str] = {}
        self._used: set[str] = set()

    @cached_property
    def gait_solver(self) -> Any:
        """The gait solver plugin."""
        return registry.get_solver(self.options.gait_solver or self.spec.gait_solver, "gait")

    @cached_property
    def planner_solver(self) -> Any:
        """The planner plugin."""
        return registry.get_solver(self.options.planner or self.spec.planner, "planner")

    @cached_property
    def feedback_solver(self) -> Any:
        """The feedback plugin."""
        return registry.get_solver(self.options.feedback or self.spec.feedback, "feedback")

    # ---- the stages

    @cached_property
    def body(self) -> Body:
        """The body of the task's mesh."""
        from defplan_mj.body.build import build_body
        from defplan_mj.body.model import Body

        path = self.folder.file("body.npz")

        def make() -> Iterable[Path]:
            body = build_body(self.spec.mesh, self.spec.body, self.progress("body"))
            body.save(path)
            return [path]

        mesh = file_hash(self.spec.mesh) if self.spec.mesh.is_file() else "missing"
        self.make("body", {"mesh": mesh, "options": dataclasses.asdict(self.spec.body)}, make)
        return Body.load(path)

    @cached_property
    def dynamics(self) -> ReducedDynamics:
        """The reduced dynamics of the body at the task's time step."""
        from defplan_mj.dynamics.reduced import ReducedDynamics

        spec = self.spec
        return ReducedDynamics(self.body, spec.timestep, spec.terrain, **spec.stepping)

    @cached_property
    def gait(self) -> Gait:
        """The task's gaits, optimised by the gait solver, and how they fare when they are switched."""
        from defplan_mj.gait.gait import Gait
        from defplan_mj.gait.switching import evaluate_switching

        solver = self.gait_solver
        path, switching = self.folder.file("gait.npz"), self.folder.file(GAIT_FILE)

        def make() -> Iterable[Path]:
            gait = self.solve(solver, "gait", self.options.seed)
            gait.save(path)
            measured = evaluate_switching(self.problem, gait, SWITCHING_CYCLES, self.options.seed)
            write_json(switching, {"gait": measured.to_json()})
            return [path, switching]

        self.make("gait", self.gait_inputs(solver, self.options.seed), make)
        return Gait.load(path)

    def gait_inputs(self, solver: Any, seed: int) -> dict[str, Any]:
        """Return all that gaits depend on."""
        _, spec = self.body, self.spec
        return {
            "body": self.hashes["body.npz"],
            "solver": solver.name,
            "seed": seed,
            "tasks": [dataclasses.asdict(task) for task in spec.gait_tasks],
            "timestep": spec.timestep,
            **spec.stepping,
            "steps_per_cycle": spec.steps_per_cycle,
            "steps": spec.gait_steps,
            "space": spec.navigation.space,
            "weights": dataclasses.asdict(spec.weights),
            "axis": spec.axis,
            "terrain": None if spec.terrain is None else terrain_json(spec.terrain),
            "switching": SWITCHING_CYCLES,
        }

    @cached_property
    def surrogate(self) -> Surrogate:
        """The rigid surrogate of the gaits."""
        from defplan_mj.planning.fit import fit_surrogate
        from defplan_mj.planning.surrogate import Surrogate

        path = self.folder.file("surrogate.npz")

        def make() -> Iterable[Path]:
            pairs, seed = self.options.pairs, self.options.seed
            progress = self.progress("surrogate")
            fit_surrogate(self.dynamics, self.gait, pairs, seed, progress).save(path)
            return [path]

        _ = self.gait
        inputs = {
            "gait": self.hashes["gait.npz"],
            "pairs": self.options.pairs,
            "seed": self.options.seed,
        }
        self.make("surrogate", inputs, make)
        return Surrogate.load(path)

    @cached_property
    def planner(self) -> Planner:
        """The planner, trained on the surrogate."""
        solver, surrogate, navigation = self.planner_solver, self.surrogate, self.spec.navigation

        def make() -> Iterable[Path]:
            result = solver.train(
                surrogate, navigation, self.options.seed, progress=self.progress("planner")
            )
            solver.save(result.planner, self.policy)
            files.save_archive(
                self.training,
                "training",
                TRAINING_VERSION,
                {name: np.asarray(curve) for name, curve in result.curves.items()},
                {"planner": solver.name, "seconds": result.seconds},
            )
            return [self.policy, self.training]

        inputs = {
            "surrogate": self.hashes["surrogate.npz"],
            "planner": solver.name,
            "navigation": dataclasses.asdict(navigation),
            "seed": self.options.seed,
        }
        self.make("planner", inputs, make)
        return solver.load(self.policy, surrogate, navigation)

    # ---- the rest

    def evaluation(self) -> dict[str, Any]:
        """Evaluate the planner on the K2 and the novel scenes, with and without the shield.

        The K2 episodes with the shield are logged, and some of the novel ones.

        Returns:
            {'k2' | 'novel': {'with_shield' | 'without_shield': evaluation}}.
        """
        path = self.folder.file(EVALUATION_FILE)

        def make() -> Iterable[Path]:
            found: dict[str, dict[str, Any]] = {}
            logs: set[Path] = set()
            logged = {"k2": self.spec.navigation.k2, "novel": self.options.logged}
            for scenes, count in logged.items():
                for shield in (True, False):
                    name = "with_shield" if shield else "without_shield"
                    episodes = self.options.episodes if scenes == "novel" else None
                    log = Recorders(self.folder.path, scenes, count) if shield else None
                    result = evaluate(self, scenes, shield, episodes=episodes, log=log)
                    found.setdefault(scenes, {})[name] = result
                    if log is not None:
                        logs |= {log.path(i) for i in range(min(count, result["episodes"]))}
            for stale in set(self.folder.path.glob("*.mcap")) - logs:
                stale.unlink()
            write_json(path, found)
            return [path, *logs]

        _ = self.planner
        wanted = {"episodes": self.options.episodes, "logged": self.options.logged}
        self.make("evaluation", {**self._evaluated(), **wanted}, make)
        return json.loads(path.read_text(encoding="utf-8"))

    def moving(self) -> list[dict[str, Any]]:
        """Evaluate the planner, in the shield, on K2 scenes whose obstacles move (the paper's Fig. 6).

        Returns:
            an evaluation without its episodes for each of `SPEEDS`, with its 'speed' (m/s).
        """
        if not self.options.moving:
            return []
        path = self.folder.file(MOVING_FILE)

        def make() -> Iterable[Path]:
            rows = []
            for speed in SPEEDS:
                result = evaluate(
                    self, "k2", True, episodes=self.options.moving, obstacle_speed=speed
                )
                del result["rows"]
                rows.append({"speed": speed, **result})
            write_json(path, {"moving": rows})
            return [path]

        _ = self.planner
        self.make("moving", {**self._evaluated(), "episodes": self.options.moving}, make)
        return json.loads(path.read_text(encoding="utf-8"))["moving"]

    def report(self) -> Path:
        """Write the report, or find it as it was written of the same files."""
        from defplan_mj.report.report import write_report

        path = self.folder.file(REPORT_FILE)

        def make() -> Iterable[Path]:
            return [write_report(self.folder.path, self.progress("report"))]

        self.make("report", dict(sorted(self.hashes.items())), make)
        return path

    # ---- helpers

    @cached_property
    def problem(self) -> GaitProblem:
        """Eq. 1 for the task's body."""
        from defplan_mj.gait.problem import GaitProblem

        return GaitProblem.of(self.spec, self.dynamics)

    def _evaluated(self) -> dict[str, Any]:
        """Return what every evaluation depends on."""
        return {
            "surrogate": self.hashes["surrogate.npz"],
            "policy": self.hashes[self.policy.name],
            "planner": self.planner_solver.name,
            "feedback": self.feedback_solver.name,
            "navigation": dataclasses.asdict(self.spec.navigation),
            "seed": self.options.seed,
        }

    def solve(self, solver: Any, stage: str, seed: int) -> Gait:
        """Let a gait solver solve the problem; Ctrl-C is heard meanwhile."""
        problem, progress = self.problem, self.progress(stage)
        return threads.interruptible(lambda: solver.solve(problem, seed, progress))

    def total_seconds(self) -> float:
        """Return the wall time of all stages that this run's results are made of, s."""
        return sum(self.folder.seconds(key) for key in self._used)

    def seconds(self, stage: str) -> float:
        """Return the wall time a stage took when it was made, s."""
        return self.folder.seconds(self._key(stage))

    @property
    def policy(self) -> Path:
        """Where the planner lies; one that is not the task's own lies beside it."""
        return self.folder.file(f"{self._of_planner('policy')}.npz")

    @property
    def training(self) -> Path:
        """Where the planner's training curves lie."""
        return self.folder.file(f"{self._of_planner('training')}.npz")

    def _of_planner(self, name: str) -> str:
        chosen = self.options.planner or self.spec.planner
        return name if chosen == self.spec.planner else f"{name}-{chosen}"

    def _key(self, stage: str) -> str:
        return self._of_planner(stage) if stage == "planner" else stage

    def make(self, stage: str, inputs: dict[str, Any], make: Callable[[], Iterable[Path]]) -> None:
        """Make a stage or find it; remember the hashes of its files."""
        fresh = self.options.remake == stage
        self._used.add(self._key(stage))
        self.hashes.update(self.folder.stage(self._key(stage), inputs, make, fresh))

    def progress(self, stage: str) -> Progress:
        """Return a Progress that names the stage."""

        def show(message: str, fraction: float) -> None:
            detail = message.removeprefix(stage.split()[0]).lstrip(": ")
            self._progress(f"{stage}: {detail}" if detail else stage, fraction)

        return show


@contextlib.contextmanager
def open_run(
    spec: TaskSpec,
    logs: Path,
    seed: int = 0,
    chosen: Mapping[str, Any] = MappingProxyType({}),
    progress: Progress = no_progress,
    *,
    whole: bool = False,
    fresh: bool = False,
) -> Iterator[Run]:
    """Open the folder `logs/<task>-seed<seed>` and yield its run.

    Args:
        chosen: fields of `RunOptions`; what is missing or None is as the folder's run was asked for,
            or else the default.
        whole: the folder is for a whole run: what is not chosen is the default, whatever the folder's
            run was asked for before.
        fresh: forget everything made before.

    Raises:
        DefplanError: the folder is in use or cannot be written.
    """
    path = logs / f"{spec.name}-seed{seed}"
    before = {} if whole else read_config(path)
    given = {name: value for name, value in chosen.items() if value is not None}
    kept = {name: before[name] for name in CONFIGURATION if name in before}
    options = RunOptions(seed=seed, **{**kept, **given})
    config = {"task": spec.name, "seed": seed}
    config |= {name: getattr(options, name) for name in CONFIGURATION}
    if not whole:  # what is tried beside the run's own does not take its place
        config |= {name: kept.get(name) for name in ("planner", "feedback")}
    with RunFolder(path, config, fresh) as folder:
        yield Run(spec, folder, options, progress)


def write_json(path: Path, data: Any) -> None:
    """Write `data` as JSON, atomically."""
    files.write_text(path, json.dumps(data, indent=1, default=files.plain, allow_nan=False) + "\n")
