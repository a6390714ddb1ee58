"""A run of a task in its folder: a loop over its stages, each made once and used again while it fits."""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

from defplan_mj.base import files
from defplan_mj.base.errors import DefplanError
from defplan_mj.base.progress import Progress, no_progress
from defplan_mj.pipeline.outlook import UNASKED, Anew, Consent, Outlook, why_anew
from defplan_mj.pipeline.plan import CONFIGURATION, EFFORT, Plan, RunOptions, kept_options
from defplan_mj.pipeline.provenance import plain_data
from defplan_mj.pipeline.stage import Stage
from defplan_mj.pipeline.stages import STAGES
from defplan_mj.pipeline.store import Record, RunFolder, has_run, input_hash, read_config
from defplan_mj.task import TaskSpec

TASK_FILE = "task_file"
"""What run.json calls the file of its task."""


class Run:
    """A plan and the folder it is carried out in.

    `do` makes stages; `result` reads what they made, and never makes anything.

    Args:
        plan: what is asked for.
        folder: open for the time of the run.
        progress: told what is being made, as 'stage: detail'.
        consent: how the user is told and asked of what is made anew.
        anew: names of stages that are made even if they could be used again.
        whole: the folder holds a whole run, whose stages are not made anew unasked.
        lenders: folders of other runs; a stage that lies there, made from the same inputs, is copied.
    """

    plan: Plan
    folder: RunFolder

    def __init__(
        self,
        plan: Plan,
        folder: RunFolder,
        progress: Progress = no_progress,
        consent: Consent = UNASKED,
        anew: Iterable[str] = (),
        whole: bool = False,
        lenders: Sequence[Path] = (),
    ) -> None:
        self.plan, self.folder = plan, folder
        self.lenders = tuple(lenders)
        self.consent, self.anew, self.whole = consent, frozenset(anew), whole
        self._progress = progress
        self._stages = {stage.name: stage for stage in STAGES}
        self._done: dict[str, Record] = {}
        self._results: dict[str, Any] = {}
        self._place = ""  # of the stage that is being made among those of the command
        self.working = ""
        """Name of the stage that is being made, or was the last; '': none was."""

    # ---- making

    def do_all(self) -> None:
        """Do every stage of a whole run."""
        self.plan.check()
        self.do(*(stage for stage in STAGES if stage.included(self)))

    def do(self, *stages: str | Stage) -> None:
        """Make stages, and those that they need, unless they are there.

        Raises:
            DefplanError: finished stages would be made anew, and that is not agreed to.
        """
        chain = self._chain(stages)
        self.consent.obtain(self._outlook(chain), str(self.folder.path), self.whole)
        for number, stage in enumerate(chain, start=1):
            self._place = f"stage {number} of {len(chain)}" if len(chain) > 1 else ""
            if stage.name not in self._done:
                self._do(stage)
        self._place = ""

    def renew_report(self) -> None:
        """Write the report again if there is one and the folder holds more than it shows."""
        if "report" in self.folder.records:
            self.do("report")

    def _do(self, stage: Stage) -> None:
        self.working = stage.name
        for name in self._needs(stage):
            self._stages[name].require(self)
        before = {name: self._done[name].contents for name in self._needs(stage)}
        inputs = self._inputs(stage, before)
        fresh = stage.name in self.anew
        make = functools.partial(stage.make, self)
        if not fresh and stage.lent:
            any(self.folder.adopt(self._key(stage), inputs, lender) for lender in self.lenders)
        self._done[stage.name] = self.folder.stage(self._key(stage), inputs, make, fresh)

    def _chain(self, stages: Iterable[str | Stage]) -> list[Stage]:
        """Return the given stages, each after those that it needs, none twice."""
        chain: dict[str, Stage] = {}
        for one in stages:
            stage = self._stages[one] if isinstance(one, str) else one
            self._stages.setdefault(stage.name, stage)
            earlier = self._chain([*stage.needs, *stage.parts(self)])
            chain |= {s.name: s for s in (*earlier, stage) if s.name not in chain}
        return list(chain.values())

    def _needs(self, stage: Stage) -> list[str]:
        return [*stage.needs, *(part.name for part in stage.parts(self))]

    def _inputs(self, stage: Stage, before: Mapping[str, Mapping[str, str]]) -> dict[str, Any]:
        """Return everything a stage is made from."""
        return plain_data({**stage.inputs(self), "before": before})

    def _key(self, stage: Stage) -> str:
        return stage.key(self) if stage.key else stage.name

    # ---- what is about to be made anew

    def _outlook(self, chain: list[Stage]) -> Outlook:
        anew: list[Anew] = []
        moved: set[str] = set()  # stages that may come out differently from what is there
        for stage in chain:
            if stage.name in self._done or not stage.guarded:
                continue
            reason = self._reason(stage, moved)
            if reason is not None or not moved.isdisjoint(self._needs(stage)):
                moved.add(stage.name)
            if reason is not None and self._key(stage) in self.folder.records:
                anew.append(reason)
        return Outlook(anew, self._followers(moved, {entry.stage for entry in anew}))

    def _reason(self, stage: Stage, moved: set[str]) -> Anew | None:
        """Return why a stage has to be made, apart from what it follows from; None: it has not."""
        record = self.folder.records.get(self._key(stage))
        if record is None:
            return Anew(stage.name, "missing")
        if stage.name in self.anew:
            return Anew(stage.name, "asked for")
        inputs = self._inputs(stage, self._before(stage, record, moved))
        if record.inputs == input_hash(inputs):
            whole = self.folder.whole(self._key(stage))
            return None if whole else Anew(stage.name, "its files are missing or damaged")
        of_file = self.plan.spec.file is not None
        reason, asks = why_anew(record.made_from, inputs, of_file)
        return Anew(stage.name, reason, asks and stage.guarded)

    def _before(self, stage: Stage, record: Record, moved: set[str]) -> dict[str, Any]:
        """Return the files before a stage: as they are, or as they were if they are still to be made."""
        before = record.made_from.get("before")
        was = before if isinstance(before, dict) else {}
        contents = {}
        for name in self._needs(stage):
            key = self._key(self._stages[name])
            there = name not in moved and key in self.folder.records
            contents[name] = self.folder.records[key].contents if there else was.get(name, {})
        return contents

    def _followers(self, moved: set[str], named: set[str]) -> list[str]:
        """Return the finished stages that follow from those in `moved`."""
        follow = set(moved)
        for stage in STAGES:
            if not follow.isdisjoint(stage.needs):
                follow.add(stage.name)
        finished = [s.name for s in STAGES if s.guarded and self._key(s) in self.folder.records]
        return [name for name in finished if name in follow - named]

    # ---- reading

    def result(self, stage: str | Stage) -> Any:
        """Return what a stage that is done has made.

        Raises:
            KeyError: it is not done.
        """
        name = stage if isinstance(stage, str) else stage.name
        if name not in self._done:
            raise KeyError(f"stage {name} is not done yet")
        if name not in self._results:
            with files.fields_of(self.folder.path, f"run ({name})"):
                self._results[name] = self._stages[name].load(self)
        return self._results[name]

    def figures(self, name: str) -> Any:
        """Return what the JSON says of a stage that is done."""
        with files.fields_of(self.folder.path, f"run ({name})"):
            return self._stages[name].figures(self)

    def is_done(self, name: str) -> bool:
        """Return whether a stage was done in this process."""
        return name in self._done

    def file(self, name: str) -> Path:
        """Return the path of a file of this run."""
        return self.folder.file(name)

    @property
    def files(self) -> list[str]:
        """Names of all files of the stages that are done."""
        return sorted(name for record in self._done.values() for name in record.files)

    def seconds(self, name: str) -> float:
        """Return the wall time a stage took when it was made, s; 0: it is not done."""
        return self._done[name].seconds if name in self._done else 0.0

    def total_seconds(self) -> float:
        """Return the wall time of all stages that this run's results are made of, s."""
        return sum(record.seconds for record in self._done.values())

    def progress_of(self, stage: str) -> Progress:
        """Return a Progress that names the stage, and which one of how many it is."""

        def show(message: str, fraction: float) -> None:
            detail = message.removeprefix(stage.split()[0]).lstrip(": ")
            name = f"{stage} ({self._place})" if self._place else stage
            self._progress(f"{name}: {detail}" if detail else name, fraction)

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
    consent: Consent = UNASKED,
    anew: Iterable[str] = (),
    lenders: Sequence[Path] = (),
) -> Iterator[Run]:
    """Open the folder `logs/<task>-seed<seed>` and yield its run.

    Args:
        chosen: fields of `RunOptions`; what is missing or None is as the folder's run was asked for,
            or else as the task says.
        whole: the folder is for a whole run: what is not chosen is as the task says, whatever the folder's
            run was asked for before.
        fresh: forget everything made before.
        consent, anew, lenders: see `Run`.

    Raises:
        DefplanError: the folder is in use or cannot be written, or another task's of the same name.
    """
    path = logs / f"{spec.name}-seed{seed}"
    before = read_config(path)
    _check_task(path, spec, before, consent, fresh)
    given = {name: value for name, value in chosen.items() if value is not None}
    kept = kept_options(before)
    usual = {name: getattr(spec.effort, name) for name in EFFORT}
    plan = Plan(spec, RunOptions(seed=seed, **{**usual, **({} if whole else kept), **given}))
    if fresh and whole:
        plan.check()  # before anything is forgotten
    was_whole = before.get("whole") is True or has_run(path)
    with RunFolder(path, _configuration(plan, before, whole, was_whole), fresh) as folder:
        if before and before.get(TASK_FILE) != folder.config.get(TASK_FILE):
            folder.keep_config()
        yield Run(plan, folder, progress, consent, anew, was_whole, lenders)


def _check_task(
    path: Path, spec: TaskSpec, before: Mapping[str, Any], consent: Consent, fresh: bool
) -> None:
    """Make sure that a folder is not shared by two tasks of one name, unless that is agreed to."""
    file = before.get(TASK_FILE)
    there = Path(file) if isinstance(file, str) else None
    moved = there is not None and not there.is_file()
    if not before or moved or _same(there, spec.file) or fresh or consent.remake:
        return
    other = f"the installed task {spec.name}" if there is None else f"the task file {there}"
    own = "the installed task" if spec.file is None else str(spec.file)
    sentence = f"{path} holds a run of {other}, not of {own}"
    if consent.ask is None:
        raise DefplanError(
            f"{sentence}: choose another --logs or another name in the file, or add --remake to"
            " take the folder over"
        )
    if not consent.ask(f"{sentence}. Take the folder over?"):
        raise DefplanError(f"nothing in {path} was changed")


def _same(one: Path | None, other: Path | None) -> bool:
    """Return whether two tasks are of one file, or both of none."""
    if one is None or other is None:
        return one is other
    return one == other or (other.exists() and one.samefile(other))


def _configuration(
    plan: Plan, before: Mapping[str, Any], whole: bool, was_whole: bool
) -> dict[str, Any]:
    """Return what run.json says the run was asked for.

    Args:
        whole, was_whole: a whole run is asked for now; the folder holds one.
    """
    config: dict[str, Any] = {"task": plan.spec.name, "seed": plan.options.seed}
    config |= {name: getattr(plan.options, name) for name in CONFIGURATION}
    if plan.spec.file is not None:
        config[TASK_FILE] = str(plan.spec.file)
    config["whole"] = whole or was_whole
    if not whole:  # what is tried beside the run's own does not take its place
        config |= {name: kept_options(before).get(name) for name in ("planner", "feedback")}
    return config
