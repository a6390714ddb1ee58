"""Stream one episode to an MCAP log while it runs."""

from __future__ import annotations

import dataclasses
import importlib.metadata
import json
import os
import platform
from collections.abc import Callable, Mapping
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from mcap.writer import Writer
from mcap_protobuf.schema import register_schema

import defplan_mj
from defplan_mj.base import files, rotations
from defplan_mj.base.errors import DefplanError
from defplan_mj.dynamics.rigid import RigidDynamics
from defplan_mj.log import channels, schemas, wire
from defplan_mj.log.channels import Cycle, Names, Step
from defplan_mj.log.messages import (
    contact_forces,
    force_arrows,
    reading_message,
    scene_update,
)
from defplan_mj.log.run_files import RunFiles
from defplan_mj.planning.scene import Scene
from defplan_mj.task import Navigation

if TYPE_CHECKING:
    from defplan_mj.dynamics.reduced import Contacts

CHUNK_SECONDS = 1.0
"""Simulated seconds in a chunk: what a log that is cut loses at most."""

PARTIAL_SUFFIX = ".partial.mcap"
"""How the name of a log ends while its episode has not."""

_PACKAGES = (
    "mujoco",
    "dm-control",
    "numpy",
    "scipy",
    "casadi",
    "torch",
    "stable-baselines3",
    "mcap",
)
_MESH_GRID = 2.0**-12  # m; drawn points are rounded to it, so that they compress
_MESH_COLOUR = (0.16, 0.55, 0.62, 1.0)
_WEIGHT_ARROW, _GRAVITY = 1.0, 9.81  # m; how long a force as large as the body's weight is drawn


class Recorder:
    """Writes `path` (MCAP) while an episode runs: `begin`, then `step`s and `cycle`s, then `end`.

    The log grows as `<name>.partial.mcap`, a chunk a simulated second, and gets its name `<name>.mcap`
    when `end` has written how the episode ended: a log under its final name is whole, and one of a
    run that was stopped can still be read. As a context manager, it closes the file in any case.

    Args:
        path: the log's final name.
        files: what is attached: body, gait, surrogate, policy.
        surface: x -> (n_s, 3) world points of `body.surface`; None: of the reduced dynamics.
        contacts: x -> points (n, 3) at which the terrain pushes, m, and the forces (n, 3) on the
            body of the step that led to x, N; None: of the reduced dynamics, if there is a terrain.
        mesh_every: the drawn surface is logged every so many steps (0: never).
    """

    def __init__(
        self,
        path: str | Path,
        files: RunFiles,
        surface: Callable[[np.ndarray], np.ndarray] | None = None,
        contacts: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]] | None = None,
        mesh_every: int = 2,
    ) -> None:
        self.path = Path(path)
        self.partial = self.path.with_suffix(PARTIAL_SUFFIX)
        self._files = files
        self._given_surface, self._contacts = surface, contacts
        self._mesh_every = mesh_every
        self._writer: Writer | None = None

    def begin(self, context: Mapping[str, Any], scene: Scene) -> None:
        """Open the log and write all that is known before the first step.

        Args:
            context: JSON-able configuration (task, seed, planner, shield, navigation, ...), with
                'timestep' (s), 'substeps', 'integrator', 'state' (nx,) at the start and optionally
                'time' (s, default 0).
            scene: the navigation problem.

        Raises:
            DefplanError: the file cannot be written.
        """
        given = dict(context)
        x = np.array(given.pop("state"), float)
        time = float(given.pop("time", 0.0))
        modes = self._files.body.n_modes
        if x.shape != (13 + 3 * modes,):
            raise ValueError(f"state has shape {x.shape}, the body's is ({13 + 3 * modes},)")
        if self._given_surface is not None:
            self._surface = self._given_surface
        else:
            # here, not above: reading a log needs no compiled kernel
            from defplan_mj.dynamics.reduced import ReducedDynamics

            dynamics = ReducedDynamics(
                self._files.body,
                given["timestep"],
                self._files.terrain,
                substeps=given["substeps"],
                integrator=given["integrator"],
            )
            self._surface = dynamics.surface
            if self._contacts is None and dynamics.world.walks:
                self._contacts = lambda x: _pair(dynamics.contacts(x))
        self._scene = scene
        self._moving = bool(np.any(scene.velocities))
        self._navigation = _navigation(given, scene)
        self._steps = self._cycles = 0
        self._decisions = self._decisions_of(given)
        surrogate = self._files.surrogate
        self._past = None if surrogate is None else surrogate.rest  # what came before the decision
        self._cycle_times = [time]  # of the states since the running cycle began
        self._start = self._last = x
        self._chunk_time = time
        self._prepare(modes)

        identity = {
            "format": schemas.FORMAT_VERSION,
            "task": given.get("task", ""),
            "seed": given.get("seed", ""),
            "timestep": given["timestep"],
            "substeps": given["substeps"],
            "integrator": given["integrator"],
            "modes": modes,
            "body_hash": self._files.body.hash,
            **({"decisions_per_cycle": self._decisions} if self._decisions != 1 else {}),
        }
        configuration = {**given, "scene": dataclasses.asdict(scene)}
        try:
            self._writer = self._open()
            self._writer.add_metadata(
                schemas.IDENTITY_RECORD, {key: str(value) for key, value in identity.items()}
            )
            self._writer.add_metadata(schemas.VERSIONS_RECORD, versions())
            self._writer.add_metadata(
                schemas.CONFIGURATION_RECORD, {"json": json.dumps(configuration, default=_named)}
            )
            for name, data in self._files.attachments.items():
                self._writer.add_attachment(0, 0, name, "application/octet-stream", data)
        except OSError as error:
            raise self._failure(error) from error
        self._kinds: dict[Any, int] = {}
        self._channels: dict[str, int] = {}
        now = _ns(time)
        self._write(channels.SCENE, now, scene_update(scene, now))
        self._write_state(now, wire.timestamp(now), x)
        self._flush(time)

    def _decisions_of(self, context: Mapping[str, Any]) -> int:
        """Return how many decisions a gait cycle has: as a context's navigation says, or the surrogate."""
        navigation = context.get("navigation", {})
        if dataclasses.is_dataclass(navigation) and not isinstance(navigation, type):
            navigation = dataclasses.asdict(navigation)
        surrogate = self._files.surrogate
        return navigation.get(
            "decisions_per_cycle", surrogate.decisions_per_cycle if surrogate else 1
        )

    def _open(self) -> Writer:
        """Open the file; return what writes it."""
        self.partial.parent.mkdir(parents=True, exist_ok=True)
        self._stream = open(self.partial, "wb")  # noqa: SIM115 (as long as the episode)
        # a chunk ends where `_flush` says, between two steps, not at a size
        writer = Writer(self._stream, chunk_size=1 << 30, enable_data_crcs=True)
        writer.start(library=f"defplan {defplan_mj.__version__}")
        return writer

    def step(self, time: float, x: np.ndarray, target_shape: np.ndarray, clearance: float) -> None:
        """Log one physics step.

        Args:
            time: at its end, s.
            x: (nx,) state at its end; kept to the bit.
            target_shape: (r,) control that led to x; kept to the bit.
            clearance: smallest distance from body to obstacle at x, m (negative: in collision).
        """
        if time - self._chunk_time >= CHUNK_SECONDS:
            self._flush(time)
        now = _ns(time)
        stamp = wire.timestamp(now)
        self._steps += 1
        self._cycle_times.append(time)
        x = self._last = np.array(x, float)
        self._write_state(now, stamp, x)
        here = Step(x, target_shape, clearance)
        for channel, numbers in self._of_step:
            self._numbers(channel.topic, now, stamp, numbers(here))
        if self._contacts is not None and self._drawn:
            points, forces = self._contacts(x)
            self._write(channels.FORCES, now, contact_forces(points, forces, now))
            scale = _WEIGHT_ARROW / (self._files.body.mass * _GRAVITY)
            self._write(channels.ARROWS, now, force_arrows(points, forces, scale, now))

    def cycle(
        self,
        index: int,
        time: float,
        x: np.ndarray,
        gait_index: int,
        values: np.ndarray,
        reward: float,
        laser: np.ndarray,
        surrogate_pose: np.ndarray | None = None,
    ) -> None:
        """Log one gait cycle, or the part of it that a decision plays, after its last step.

        Args:
            index: of the decision, from 0.
            time: of the decision, that is at the start of what it plays, s.
            x: (nx,) state at the decision.
            gait_index: the gait that was chosen.
            values: (K,) the planner's value of each gait.
            reward: of the decision.
            laser: (beams,) distances that were measured at the decision, m.
            surrogate_pose: (7,) position and quaternion the surrogate predicts for the end
                (None: computed here from the run's surrogate, if it has one).
        """
        if not np.array_equal(x, self._start):
            raise ValueError(f"cycle {index}: x is not the state at the cycle's start")
        moments = [_ns(at) for at in self._cycle_times]
        for number, at in enumerate(moments[:-1]):
            phase = (index % self._decisions + number / (len(moments) - 1)) / self._decisions
            where = np.array([gait_index, phase, index], float)
            self._numbers(channels.GAIT, at, wire.timestamp(at), where)
        start, end = _ns(time), moments[-1]
        stamp = wire.timestamp(end)
        topic, drawing = reading_message(x, laser, self._navigation, start)
        self._write(topic, start, drawing)
        done = Cycle(x, np.asarray(laser, float), np.asarray(values, float), reward)
        for channel, numbers in self._at_decision:
            self._numbers(channel.topic, start, wire.timestamp(start), numbers(done))
        for channel, numbers in self._at_end:
            self._numbers(channel.topic, end, stamp, numbers(done))
        if surrogate_pose is None and self._files.surrogate is not None:
            surrogate = RigidDynamics(self._files.surrogate)
            surrogate_pose = surrogate.step(x[:7], gait_index, self._past)
        if surrogate_pose is not None:
            message = wire.pose_in_frame(stamp, self._frame, surrogate_pose.tolist())
            self._write(channels.SURROGATE, end, message)
        last = self._cycle_times[-1]
        if 2 * last - self._cycle_times[0] - self._chunk_time > CHUNK_SECONDS:
            # another such cycle would not fit; between cycles, chunks do not overlap in time
            self._flush(last)
        self._cycles += 1
        if self._files.surrogate is not None and self._past is not None:
            self._past = int(self._files.surrogate.past.then[self._past, gait_index])
        self._cycle_times = [last]
        self._start = self._last

    def end(self, outcome: str, reason: str = "") -> None:
        """Write how the episode ended, close the log and give it its final name.

        Args:
            outcome: one of `planning.outcome.ENDINGS`.
            reason: a sentence, for people.
        """
        self._close({"outcome": outcome, "reason": reason})
        try:
            os.replace(self.partial, self.path)
        except OSError as error:
            raise self._failure(error) from error

    def __enter__(self) -> Recorder:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if self._writer is None:
            return
        # the episode did not get to its end: leave what there is, readable, under the partial name
        try:
            self._close(None)
        except DefplanError:
            if kind is None:
                raise

    def _close(self, ending: Mapping[str, str] | None) -> None:
        """Write the last chunk, the end record (if the episode ended) and the index; close."""
        assert self._writer is not None, "begin was not called, or the log is closed already"
        writer, self._writer = self._writer, None
        try:
            with self._stream:
                writer.flush()
                if ending is not None:
                    counts = {"steps": str(self._steps), "cycles": str(self._cycles)}
                    writer.add_metadata(schemas.END_RECORD, {**ending, **counts})
                writer.finish()
                self._stream.flush()
                os.fsync(self._stream.fileno())
        except OSError as error:
            raise self._failure(error) from error

    def _prepare(self, modes: int) -> None:
        """Pack the parts of messages that stay the same."""
        names = Names(modes, tuple(self._files.gait.task_names) if self._files.gait else ())
        self._known = channels.by_topic()
        self._labels = {c.topic: wire.labels(c.labels(names)) for c in self._known.values()}
        self._of_step = [(c, c.of_step) for c in self._known.values() if c.of_step]
        self._at_decision = [(c, c.at_decision) for c in self._known.values() if c.at_decision]
        self._at_end = [(c, c.at_end) for c in self._known.values() if c.at_end]
        self._frame = wire.text(2, schemas.WORLD_FRAME)
        self._frames = self._frame + wire.text(3, schemas.ROBOT_FRAME)
        if self._mesh_every:
            self._rows, faces = self._files.mesh
            self._mesh = wire.TriangleMesh("robot", schemas.ROBOT_FRAME, faces, _MESH_COLOUR)

    def _write_state(self, now: int, stamp: bytes, x: np.ndarray) -> None:
        """Write the state and what is drawn of it: frame, centre of mass, surface, moving obstacles."""
        pose = x[:7].tolist()
        self._numbers(channels.STATE, now, stamp, x)
        self._write(channels.TF, now, wire.frame_transform(stamp, self._frames, pose))
        self._write(channels.COM, now, wire.pose_in_frame(stamp, self._frame, pose))
        if not self._drawn:
            return
        points = (self._surface(x)[self._rows] - x[:3]) @ rotations.matrix(x[3:7])
        points = np.rint(points * (1 / _MESH_GRID)) * _MESH_GRID
        self._write(channels.MESH, now, self._mesh.encode(stamp, points))
        if self._moving and self._steps:
            self._write(channels.SCENE, now, scene_update(self._scene, now))

    @property
    def _drawn(self) -> bool:
        """Whether what is made for looking is logged at this step."""
        return self._mesh_every > 0 and self._steps % self._mesh_every == 0

    def _numbers(self, topic: str, now: int, stamp: bytes, values: np.ndarray) -> None:
        message = wire.labelled_numbers(stamp, self._labels[topic], values)
        self._write(topic, now, message)

    def _write(self, topic: str, now: int, message: bytes) -> None:
        assert self._writer is not None, "begin was not called, or the log is closed already"
        if topic not in self._channels:
            kind = self._known[topic].message
            if kind not in self._kinds:
                self._kinds[kind] = register_schema(self._writer, kind)
            self._channels[topic] = self._writer.register_channel(
                topic, "protobuf", self._kinds[kind]
            )
        # `sequence` counts physics steps: it joins messages of one step whatever their times say
        self._writer.add_message(self._channels[topic], now, message, now, self._steps)

    def _flush(self, time: float) -> None:
        """End the chunk: what was written until now survives whatever comes."""
        assert self._writer is not None
        self._chunk_time = time
        try:
            self._writer.flush()
        except OSError as error:
            raise self._failure(error) from error

    def _failure(self, error: OSError) -> DefplanError:
        return DefplanError(f"cannot write log {self.partial}: {error.strerror or error}")


@lru_cache
def versions() -> dict[str, str]:
    """Return what a bit-identical rerun may depend on: packages, Python, system, processor."""
    packages = {"defplan": defplan_mj.__version__, "python": platform.python_version()}
    for package in _PACKAGES:
        try:
            packages[package] = importlib.metadata.version(package)
        except importlib.metadata.PackageNotFoundError:
            continue
    return {**packages, "system": platform.system(), "machine": platform.machine()}


def _pair(contacts: Contacts) -> tuple[np.ndarray, np.ndarray]:
    return contacts.points, contacts.forces


def _navigation(context: Mapping[str, Any], scene: Scene) -> Navigation:
    """Return what a context's navigation (a dataclass or its dict) says of the sensor."""
    navigation = context.get("navigation", {})
    if dataclasses.is_dataclass(navigation) and not isinstance(navigation, type):
        navigation = dataclasses.asdict(navigation)
    return Navigation(
        laser_range=float(navigation.get("laser_range", np.inf)),
        space=scene.space,
        sensor=navigation.get("sensor", ""),
    )


def _ns(time: float) -> int:
    return round(time * 1e9)


def _named(value: Any) -> Any:
    """Return a path's name, as a log is read elsewhere; of other values what JSON can hold."""
    return value.name if isinstance(value, Path) else files.plain(value)
