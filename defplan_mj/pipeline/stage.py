"""What a stage of a run is: a value that says what it is made from, how it is made, read and shown."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from defplan_mj.pipeline.run import Run


def _no_parts(run: Run) -> tuple[Stage, ...]:
    return ()


def _always(run: Run) -> bool:
    return True


def _nothing(run: Run) -> Any:
    return None


@dataclass(frozen=True)
class Stage:
    """One stage of a run. The functions are handed the run, in which all that it needs is finished.

    Attributes:
        name: what it is called.
        inputs: returns what it is made from besides the files of `needs`, as plain data in groups:
            'options' (what the command line chooses), 'task' (what the task says), 'plugins'
            (`provenance.plugin_data` by kind) and others.
        make: makes its files and returns their paths.
        needs: names of the stages whose files it is made from.
        load: returns its result, read from its files.
        figures: returns what the JSON says of it, under its name; None: nothing. `cli.text.STAGE_TEXTS`
            has the same for people.
        sections: names of the report's sections that show it.
        parts: returns stages that it is put together from, before it.
        included: whether a whole run makes it.
        key: its name in run.json, if that is another.
        guarded: it is not made anew for another option unless that is agreed to: it takes long, or
            something that takes long follows from it. Others are made anew without a word.
        timed: its seconds are in the JSON of a run.
        lent: other runs may copy it: it takes longer to make than to copy.
        require: raises a DefplanError if nothing can be made from what it made.
    """

    name: str
    inputs: Callable[[Run], dict[str, Any]]
    make: Callable[[Run], Iterable[Path]]
    needs: tuple[str, ...] = ()
    load: Callable[[Run], Any] = _nothing
    figures: Callable[[Run], Any] = _nothing
    sections: tuple[str, ...] = ()
    parts: Callable[[Run], tuple[Stage, ...]] = _no_parts
    included: Callable[[Run], bool] = _always
    key: Callable[[Run], str] | None = None
    guarded: bool = True
    timed: bool = False
    lent: bool = False
    require: Callable[[Run], Any] = _nothing
