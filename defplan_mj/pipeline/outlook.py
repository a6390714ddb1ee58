"""What a run is about to make anew of what is finished, and why: said before it is done."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from defplan_mj.base.errors import DefplanError

_ANOTHER_VERSION = "made by another version of defplan"


@dataclass(frozen=True)
class Anew:
    """A finished stage that is to be made anew.

    Attributes:
        stage: its name.
        reason: why, as a clause.
        asks: it is not to be lost for this reason unasked: an option differs, or defplan itself.
    """

    stage: str
    reason: str
    asks: bool = False


@dataclass(frozen=True)
class Outlook:
    """What is about to be lost.

    Attributes:
        anew: finished stages that are made anew for a reason of their own.
        after: finished stages that follow from these, and are made anew if these come out differently.
    """

    anew: Sequence[Anew] = ()
    after: Sequence[str] = ()

    @property
    def text(self) -> str:
        """What is said; nothing if nothing is lost."""
        stages: dict[str, list[str]] = {}
        for entry in self.anew:
            stages.setdefault(entry.reason, []).append(entry.stage)
        reasons = "; ".join(f"{', '.join(names)} ({reason})" for reason, names in stages.items())
        after = ", ".join(self.after)
        if not self.anew:
            return f"made anew if it comes out differently: {after}" if after else ""
        return f"made anew: {reasons}" + (f"; what follows from it: {after}" if after else "")

    def asking(self) -> Outlook:
        """Return what is not to be made anew unasked."""
        return Outlook([entry for entry in self.anew if entry.asks], self.after)


@dataclass(frozen=True)
class Consent:
    """How the user is told and asked.

    Attributes:
        remake: finished stages may be made anew without a question.
        say: tells a sentence.
        ask: asks a question that is answered by yes or no; None: there is nobody to ask.
    """

    remake: bool = False
    say: Callable[[str], None] = lambda text: None
    ask: Callable[[str], bool] | None = None

    def obtain(self, outlook: Outlook, folder: str, whole: bool) -> None:
        """Say what is made anew; of a whole run, ask first where that is due.

        Raises:
            DefplanError: it is not agreed to.
        """
        asking = outlook.asking()
        guarded = whole and bool(asking.anew) and not self.remake
        if guarded and self.ask is None:
            raise DefplanError(_refusal(asking, folder))
        if outlook.text:
            self.say(outlook.text)
        if guarded and self.ask is not None and not self.ask("Go on?"):
            raise DefplanError(f"nothing in {folder} was changed")


UNASKED = Consent()
"""Nobody is told or asked: a whole run's stages are not made anew for another option."""


def _refusal(outlook: Outlook, folder: str) -> str:
    return (
        f"finished stages of {folder} would be {outlook.text}; nothing was changed: add --remake to"
        " do it, --fresh to make everything anew, or choose another --logs"
    )


def why_anew(
    was: Mapping[str, Any], now: Mapping[str, Any], of_file: bool = False
) -> tuple[str, bool]:
    """Return why a stage made from `was` is to be made anew from `now`, and whether to ask first.

    What the user has edited, a plugin or its task, is meant to have its effect; an option may be a slip,
    and so may be a field of a task file.

    Args:
        of_file: the task is a file's.
    """
    if not was:
        return _ANOTHER_VERSION, True
    options = _changed(was, now, "options")
    if options:
        old, new = _group(was, "options"), _group(now, "options")
        values = ", ".join(
            f"{n} is {_value_text(new.get(n))}, was {_value_text(old.get(n))}" for n in options
        )
        return values, True
    fields = _differences(_group(was, "task"), _group(now, "task"))
    if of_file and fields and not _changed(was, now, "plugins"):
        return ", ".join(fields), True
    reason = _other_reason(was, now)
    return reason, reason == _ANOTHER_VERSION


def _differences(was: Mapping[str, Any], now: Mapping[str, Any], before: str = "") -> list[str]:
    """Return what differs between the fields of a task, table by table."""
    clauses = []
    for name in [*now, *(name for name in was if name not in now)]:
        old, new = was.get(name), now.get(name)
        if old == new:
            continue
        if isinstance(old, Mapping) and isinstance(new, Mapping):
            clauses += _differences(old, new, f"{before}{name}.")
        elif any(isinstance(value, Mapping | list) for value in (old, new)):
            clauses.append(f"{before}{name} changed")
        else:
            clauses.append(f"{before}{name} is {_value_text(new)}, was {_value_text(old)}")
    return clauses


def _other_reason(was: Mapping[str, Any], now: Mapping[str, Any]) -> str:
    for kind in _changed(was, now, "plugins"):
        name = _group(_group(now, "plugins"), kind).get("name", "")
        return f"the {kind.replace('_', ' ')} {name} has changed"
    if parts := _changed(was, now, "task"):
        return f"the task's {', '.join(parts)} changed"
    others = [name for name in sorted({*was, *now} - {"before"}) if was.get(name) != now.get(name)]
    if others:
        return f"{', '.join(others)} changed"
    if was.get("before") != now.get("before"):
        return "the files it was made from changed"
    return _ANOTHER_VERSION


def _changed(was: Mapping[str, Any], now: Mapping[str, Any], group: str) -> list[str]:
    """Return the names in a group of inputs whose values differ."""
    old, new = _group(was, group), _group(now, group)
    return [name for name in sorted({*old, *new}) if old.get(name) != new.get(name)]


def _group(data: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    """Return a group of inputs; run.json may say anything."""
    group = data.get(name)
    return group if isinstance(group, Mapping) else {}


def _value_text(value: Any) -> str:
    if isinstance(value, Collection) and not isinstance(value, str):
        return " and ".join(map(str, value)) or "none"
    return "not set" if value is None else str(value)
