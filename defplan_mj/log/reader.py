"""Read an episode's log into plain arrays, whole or cut at any byte."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Protocol, TypeVar

import numpy as np

from defplan_mj.base import files
from defplan_mj.base.errors import DefplanError
from defplan_mj.base.reading import Packed, first_line, parse_json, read_bytes
from defplan_mj.body.model import Body
from defplan_mj.dynamics.terrain import Terrain, terrain_of
from defplan_mj.gait.gait import Gait
from defplan_mj.kernel.pack import MAX_SUBSTEPS
from defplan_mj.log import bounds, channels, schemas, validate
from defplan_mj.log.contents import MAGIC, Contents, contents_of
from defplan_mj.log.messages import contacts_of
from defplan_mj.planning.scene import Scene
from defplan_mj.planning.surrogate import Surrogate

_MOST_HEIGHTS = 10_000_000  # numbers of a terrain
_NEEDED_RECORDS = (schemas.IDENTITY_RECORD, schemas.CONFIGURATION_RECORD)
_EVERY_STEP = frozenset([channels.TARGET_SHAPE, channels.CONTACTS])
_EVERY_CYCLE = frozenset([channels.VALUES, channels.REWARD, channels.RANGES])

Numbers = dict[str, dict[int, np.ndarray]]
"""Topic -> number of the step -> numbers, of channels of labelled numbers."""


class _Saved(Protocol):
    """A part of a run that is loaded from its own file."""

    @classmethod
    def load(cls, path: files.Source) -> Any: ...


_Part = TypeVar("_Part", bound=_Saved)


@dataclass(frozen=True)
class LoggedContacts:
    """What pushes on the body in one physics step.

    Attributes:
        step: the one that led to state `step`.
        points: (n, 3) in the world, m.
        forces: (n, 3) on the body, N.
    """

    step: int
    points: np.ndarray
    forces: np.ndarray


@dataclass(frozen=True)
class EpisodeLog:
    """One episode: n steps from state 0 to state n, m gait cycles.

    Where the gait may be switched within a cycle, 'cycle' stands for the part of one that a decision plays.

    Attributes:
        path: where it was read from.
        fault: '' if the log is whole, else what is wrong with it, as half a sentence.
        outcome: one of `planning.outcome.ENDINGS`, or '' if the log does not hold the end.
        reason: why, for people.
        task, seed: what was run.
        body_hash: of the body that moved.
        timestep: of a control step, s.
        stepping: 'substeps' and 'integrator' of the dynamics.
        configuration: what the run was told to do, as it was given to the recorder.
        versions: what it was run with.
        attachments: file name -> bytes: 'body.npz', 'gait.npz', 'surrogate.npz', 'policy...',
            'terrain.json'.
        scene: the navigation problem.
        time: (n + 1,) s.
        states: (n + 1, nx), to the bit.
        target_shapes: (n, r); row i led from state i to state i + 1.
        clearance: (n,) m, at states 1 to n.
        cycle_steps: (m + 1,) index of the state at which each cycle starts, and the last one ends.
        gait_index: (m,) chosen gait.
        values: (m, K) the planner's value of each gait.
        reward: (m,).
        laser: (m, beams) m, at the cycle's start.
        surrogate_pose: (m, 7) position and quaternion (w x y z) that the surrogate predicted for the
            cycle's end from its true start; NaN if it was not logged.
        decisions_per_cycle: of the robot, in a gait cycle.
        contacts: of the steps that they were logged at; empty if nothing ever pushes.
        numbers: topic -> number of the step -> numbers, of all channels of labelled numbers; see
            `channel`.
        first: number of the step that led to state 0: not 0 if the log's beginning was filtered out.
        first_cycle: number of the first cycle; not 0 then, either.
        missing: topics that were filtered out; above, their numbers are NaN, or there are no columns.
    """

    path: Path
    fault: str
    outcome: str
    reason: str
    task: str
    seed: str
    body_hash: str
    timestep: float
    stepping: dict[str, Any]
    configuration: dict[str, Any]
    versions: dict[str, str]
    attachments: dict[str, bytes]
    scene: Scene
    time: np.ndarray
    states: np.ndarray
    target_shapes: np.ndarray
    clearance: np.ndarray
    cycle_steps: np.ndarray
    gait_index: np.ndarray
    values: np.ndarray
    reward: np.ndarray
    laser: np.ndarray
    surrogate_pose: np.ndarray
    decisions_per_cycle: int = 1
    contacts: tuple[LoggedContacts, ...] = ()
    numbers: Numbers = field(default_factory=dict, repr=False)
    first: int = 0
    first_cycle: int = 0
    missing: tuple[str, ...] = ()

    @property
    def space(self) -> str:
        """'planar' or 'spatial': where the robot navigates."""
        return self.scene.space

    @property
    def whole(self) -> bool:
        """Whether nothing is missing: the file is complete and the episode came to its end."""
        return not self.fault

    @cached_property
    def body(self) -> Body:
        """The attached body. Raises DefplanError if the log has none, or another than the one that moved."""
        body = self._part(Body, "body.npz")
        validate.check_body(self, body.hash)
        return body

    @cached_property
    def gait(self) -> Gait:
        """The attached gait. Raises DefplanError if the log has none."""
        gait = self._part(Gait, "gait.npz")
        validate.check_body(self, gait.body_hash)
        return gait

    @cached_property
    def surrogate(self) -> Surrogate:
        """The attached surrogate. Raises DefplanError if the log has none."""
        surrogate = self._part(Surrogate, "surrogate.npz")
        validate.check_body(self, surrogate.body_hash)
        return surrogate

    @cached_property
    def terrain(self) -> Terrain | None:
        """What the body walks on; None: it swims."""
        if "terrain.json" not in self.attachments:
            return None
        name = f"terrain.json of log {self.path}"
        with files.fields_of(Packed(name, b""), "terrain"):
            return terrain_of(parse_json(self.attachments["terrain.json"], _MOST_HEIGHTS))

    def channel(self, topic: str) -> tuple[np.ndarray, np.ndarray]:
        """Return the steps (k,) and numbers (k, n) of a channel of labelled numbers.

        Raises:
            DefplanError: the log has none of that topic.
        """
        if topic not in self.numbers:
            there = ", ".join(sorted(self.numbers))
            raise DefplanError(f"log {self.path} has no numbers in {topic}: there are {there}")
        rows = dict(sorted(self.numbers[topic].items()))
        return np.array(list(rows), int), np.array(list(rows.values()))

    @property
    def task_names(self) -> tuple[str, ...]:
        """Names of the gaits, as far as the log knows them."""
        return self.gait.task_names if "gait.npz" in self.attachments else ()

    def _part(self, kind: type[_Part], name: str) -> _Part:
        if name not in self.attachments:
            raise DefplanError(f"log {self.path} holds no {name}")
        return kind.load(Packed(f"{name} of log {self.path}", self.attachments[name]))


def read_log(path: str | Path) -> EpisodeLog:
    """Read a log. What is there before a cut or a damaged place is returned, and `fault` says so.

    Raises:
        DefplanError: it is missing, not a log of ours, of another version, or cut before its first step.
    """
    path = Path(path)
    data = read_bytes(path, "log", bounds.MOST_BYTES)
    if data[: len(MAGIC)] != MAGIC[: len(data)]:
        raise DefplanError(f"{path} is not an MCAP log")
    contents = contents_of(data)
    try:
        return _episode(path, contents)
    except files.WRONG_FIELDS as error:
        what = f"{error} is missing" if isinstance(error, KeyError) else first_line(error)
        raise DefplanError(f"log {path} is damaged ({what}): record it anew") from error


def _episode(path: Path, contents: Contents) -> EpisodeLog:
    """Make arrays of what a file holds."""
    cut = contents.fault.startswith(("cut", "damaged", "not read"))
    identity = _identity(path, contents, cut)
    numbers = {
        topic: {sequence: np.array(message.values) for sequence, _, message in messages}
        for topic, messages in contents.messages.items()
        if contents.needed[topic] is schemas.LabelledNumbers
    }
    _check_steps(path, contents, numbers, cut)
    configuration, scene = _configuration(contents)

    first = min(numbers[channels.STATE])
    steps, missing = _whole_steps(numbers, first, cut)
    ending = contents.metadata.get(schemas.END_RECORD, {})
    fault = _fault(contents.fault, first, steps, ending)
    modes = validate.whole_number(identity, "modes", 1, validate.MOST_MODES)
    cycles, of_cycles = _cycles(contents, numbers, first, steps, cut)
    missing += of_cycles
    if not fault and missing:
        fault = f"filtered: without {', '.join(missing)}"
    log = EpisodeLog(
        path=path,
        fault=fault,
        outcome=ending.get("outcome", ""),
        reason=ending.get("reason", ""),
        task=identity["task"],
        seed=identity["seed"],
        body_hash=identity["body_hash"],
        timestep=validate.positive(identity, "timestep"),
        stepping={
            "substeps": validate.whole_number(identity, "substeps", 1, MAX_SUBSTEPS),
            "integrator": identity["integrator"],
        },
        configuration=configuration,
        versions=contents.metadata.get(schemas.VERSIONS_RECORD, {}),
        attachments=contents.attachments,
        scene=scene,
        numbers=numbers,
        first=first,
        missing=missing,
        decisions_per_cycle=validate.whole_number(
            {"decisions_per_cycle": "1", **identity}, "decisions_per_cycle", 1, validate.MOST_CYCLES
        ),
        **_step_arrays(contents, numbers, first, steps, modes),
        **cycles,
    )
    validate.validate_log(log, modes)
    return log


def _identity(path: Path, contents: Contents, cut: bool) -> dict[str, str]:
    """Return the record that says whose log it is.

    Args:
        cut: the file is not there to its end.

    Raises:
        DefplanError: it is none of ours, of several, of another version, or without its records.
    """
    identity = contents.metadata.get(schemas.IDENTITY_RECORD)
    if not cut and channels.STATE in contents.messages:
        lost = [name for name in _NEEDED_RECORDS if name not in contents.metadata]
        if lost:
            raise DefplanError(
                f"log {path} has lost its metadata {' and '.join(map(repr, lost))}: a tool that "
                "filters must be told to keep metadata and attachments"
            )
    if identity is None:
        if cut:
            raise _no_step(path, contents)
        raise DefplanError(f"{path} is an MCAP file, but not a log of this program")
    if contents.episodes > 1:
        raise DefplanError(
            f"{path} is merged of several logs, whose steps cannot be told apart: read each of them"
        )
    if identity.get("format") != str(schemas.FORMAT_VERSION):
        raise DefplanError(
            f"{path} has log format {identity.get('format')}, this version reads "
            f"{schemas.FORMAT_VERSION}: record it anew"
        )
    return identity


def _check_steps(path: Path, contents: Contents, numbers: Numbers, cut: bool) -> None:
    """Raise DefplanError if a log holds no state, or not what was run."""
    states = numbers.get(channels.STATE)
    if not states and (not contents.fault or (contents.messages and not cut)):
        raise DefplanError(
            f"log {path} has no messages in {channels.STATE}: keep them in filtering"
        )
    if not states or schemas.CONFIGURATION_RECORD not in contents.metadata:
        raise _no_step(path, contents)


def _no_step(path: Path, contents: Contents) -> DefplanError:
    return DefplanError(
        f"log {path} holds no step of its episode ({contents.fault}): record it anew"
    )


def _configuration(contents: Contents) -> tuple[dict[str, Any], Scene]:
    """Return what the run was told to do, and the navigation problem."""
    configuration = parse_json(contents.metadata[schemas.CONFIGURATION_RECORD]["json"])
    if not isinstance(configuration, dict):
        raise ValueError("the configuration is no object")
    scene = validate.scene_of(configuration.pop("scene"))
    validate.check_navigation(configuration)
    return configuration, scene


def _whole_steps(numbers: Numbers, first: int, cut: bool) -> tuple[int, tuple[str, ...]]:
    """Return how many steps follow state `first`, up to one that misses something, and topics that all miss.

    The latter were left out by a filter: these do not end the steps.
    """
    states = numbers[channels.STATE]
    missing = () if cut or len(states) == 1 else tuple(sorted(_EVERY_STEP - numbers.keys()))
    parts = [states, *(numbers.get(topic, {}) for topic in _EVERY_STEP.difference(missing))]
    steps = 0
    while all(first + steps + 1 in part for part in parts):
        steps += 1
    return steps, missing


def _fault(fault: str, first: int, steps: int, ending: dict[str, str]) -> str:
    """Return what is wrong with a log: that with the file, else with what it holds; '': nothing."""
    if not fault and first:
        fault = f"without its first {first} steps"
    if not fault and steps != validate.whole_number(ending, "steps", 0, validate.MOST_STEPS):
        fault = f"incomplete: {steps} of {ending.get('steps')} steps are there"
    return fault


def _step_arrays(
    contents: Contents, numbers: Numbers, first: int, steps: int, modes: int
) -> dict[str, Any]:
    """Return the arrays of the steps; NaN for what a filter has left out."""
    states = numbers[channels.STATE]
    shapes, contacts = numbers.get(channels.TARGET_SHAPE, {}), numbers.get(channels.CONTACTS, {})
    times = {sequence: time for sequence, time, _ in contents.messages[channels.STATE]}
    taken = range(first + 1, first + steps + 1)
    target_shapes = [shapes.get(i, np.full(modes, np.nan)) for i in taken]
    pushes = sorted(contents.messages.get(channels.FORCES, []), key=lambda message: message[0])
    return {
        "time": np.array([times[first + i] for i in range(steps + 1)]),
        "states": np.array([states[first + i] for i in range(steps + 1)]),
        "target_shapes": np.array(target_shapes).reshape(steps, modes),
        "clearance": np.array([contacts.get(i, [np.nan])[0] for i in taken], float),
        "contacts": tuple(
            LoggedContacts(sequence - first, *contacts_of(message))
            for sequence, _, message in pushes
            if sequence <= first + steps
        ),
    }


def _cycles(
    contents: Contents, numbers: Numbers, first: int, steps: int, cut: bool
) -> tuple[dict[str, Any], tuple[str, ...]]:
    """Return the arrays of the cycles, and the topics that a filter has left out of them.

    Messages of a cycle carry the number of its last step. A cycle counts if all of it is there.
    """
    gaits = numbers.get(channels.GAIT, {})
    missing = tuple(sorted(_EVERY_CYCLE - numbers.keys())) if gaits and not cut else ()
    there = [numbers.get(topic, {}) for topic in _EVERY_CYCLE.difference(missing)]
    poses = {n: _pose(m) for n, _, m in contents.messages.get(channels.SURROGATE, [])}
    bounds = sorted(n for n in gaits if n <= first + steps)
    ends = [n for n in bounds if all(n in part for part in there)]
    start = max((n for n in bounds if ends and n < ends[0]), default=first)
    m = len(ends)

    def rows(topic: str) -> np.ndarray:
        """Return the numbers of each cycle; none if the topic is missing."""
        entries: list[Any] = [numbers[topic][n] if topic not in missing else [] for n in ends]
        return np.array(entries, float).reshape(m, -1 if m and topic not in missing else 0)

    reward = rows(channels.REWARD)
    return {
        "cycle_steps": np.array([start, *ends], int) - first,
        "first_cycle": int(gaits[ends[0]][2]) if ends else 0,
        "gait_index": np.array(validate.gait_numbers([gaits[n][0] for n in ends]), int),
        "values": rows(channels.VALUES),
        "reward": reward[:, 0] if reward.shape[1] else np.full(m, np.nan),
        "laser": rows(channels.RANGES),
        "surrogate_pose": np.array([poses.get(n, np.full(7, np.nan)) for n in ends]).reshape(m, 7),
    }, missing


def _pose(message: Any) -> np.ndarray:
    p, q = message.pose.position, message.pose.orientation
    return np.array([p.x, p.y, p.z, q.w, q.x, q.y, q.z])
