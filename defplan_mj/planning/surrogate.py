"""The rigid surrogate f_fit: a decision is one rigid motion, that of its gait and of the gaits before it."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from defplan_mj.base import files
from defplan_mj.base.errors import DefplanError
from defplan_mj.base.space import SPACES
from defplan_mj.planning.frames import frames_of
from defplan_mj.planning.past import Past, past_of
from defplan_mj.task import Navigation

FORMAT_VERSION = 2


class Motions(NamedTuple):
    """What a cycle of each gait does, in the frame at its start (see `planning.frames`).

    Attributes:
        rotations: (K, d, d).
        translations: (K, d) m.
    """

    rotations: np.ndarray
    translations: np.ndarray

    def of(self, gaits: Any) -> Motions:
        """Return the motions of some gaits (n,); of switched motions, those of (pasts (n,), gaits (n,))."""
        return Motions(self.rotations[gaits], self.translations[gaits])

    def switched(self) -> Motions:
        """Return motions (K + 1, K, ...) that do not depend on the gait before; switched ones as they are."""
        if self.translations.ndim == 3:
            return self
        return Motions(*(np.repeat(part[None], len(part) + 1, 0) for part in self))

    def after(self, position: np.ndarray, frames: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return poses (n, d), (n, d, d) one motion later: (c + R t, R R_j) (paper, section IV-B)."""
        end = position + np.einsum("nij,nj->ni", frames, self.translations)
        return end, frames @ self.rotations


@dataclass(frozen=True)
class Switched:
    """What a decision does after others: rows are the pasts (`planning.past`), the last one is rest.

    With one decision a cycle these are the gait before, P = K + 1.

    Attributes:
        rotations: (P, K, 3, 3), in the body frame at the decision.
        translations: (P, K, 3) m, likewise.
        rotation_sd, translation_sd: (P, K) root mean square of what is left, along one axis, rad and m.
        held_out: errors of a decision of chains that were not fitted, root mean square: 'place_m' and
            'turn_rad' of these motions, 'plain_place_m' and 'plain_turn_rad' of one motion a gait (and
            phase), and 'cycles', how many decisions; empty if there was too little to hold some out.
    """

    rotations: np.ndarray
    translations: np.ndarray
    rotation_sd: np.ndarray
    translation_sd: np.ndarray
    held_out: dict[str, float]


def check_decisions(surrogate: Surrogate, navigation: Navigation) -> None:
    """Raise a DefplanError unless a surrogate is of as many decisions a cycle as the task."""
    own, asked = surrogate.decisions_per_cycle, navigation.decisions_per_cycle
    if own != asked:
        raise DefplanError(
            f"the surrogate is of {own} decisions a gait cycle and the task of {asked}: fit the surrogate"
            " for this task"
        )


def check_whole_cycles(planner: str, navigation: Navigation) -> None:
    """Raise a DefplanError if a planner that decides once a cycle is to decide more often."""
    if navigation.decisions_per_cycle != 1:
        raise DefplanError(
            f"the planner {planner} decides once a gait cycle: take another one, or set"
            " navigation.decisions_per_cycle to 1"
        )


_SWITCHED = tuple(field.name for field in fields(Switched) if field.name != "held_out")


@dataclass(frozen=True)
class Surrogate:
    """f_fit: task j after past i maps the body frame (c, R) to (c + R t_ij, R R_ij).

    Table III's plain surrogate, one motion a task and cycle, stands beside it; `plain` uses that one alone.

    Attributes:
        body_hash, gait_hash: what it was fitted to.
        task_names: (K,) names.
        rotations: (K, 3, 3) R_j, in the body frame at the start of the cycle.
        translations: (K, 3) t_j, m, in the body frame at the start of the cycle.
        cycle_seconds: duration of a cycle, s.
        pairs: number of (before, after) pairs behind each task.
        rotation_mean, rotation_sd: (K,) angle of the pairs' own rotations, rad (Table III).
        translation_mean, translation_sd: (K,) length of the pairs' own translations, m (Table III).
        radius: radius about the centre of mass that holds the body's surface over a cycle, m.
        switching: the motions by what was before; None: they do not depend on it.
        decisions_per_cycle: m, how often a cycle the gait may be switched: `switching` is of 1 / m of a
            cycle, all else of whole ones.
    """

    body_hash: str
    gait_hash: str
    task_names: tuple[str, ...]
    rotations: np.ndarray
    translations: np.ndarray
    cycle_seconds: float
    pairs: int
    rotation_mean: np.ndarray
    rotation_sd: np.ndarray
    translation_mean: np.ndarray
    translation_sd: np.ndarray
    radius: float
    switching: Switched | None = None
    decisions_per_cycle: int = 1

    @property
    def plain(self) -> Surrogate:
        """The surrogate with one motion a task and cycle, whatever was before."""
        return replace(self, switching=None, decisions_per_cycle=1)

    @property
    def gaits(self) -> int:
        """How many there are: K."""
        return len(self.task_names)

    @property
    def past(self) -> Past:
        """The pasts that are told apart."""
        return past_of(self.gaits, self.decisions_per_cycle)

    @property
    def rest(self) -> int:
        """The past of a robot at rest: K if it decides once a cycle."""
        return self.past.rest

    @property
    def decision_seconds(self) -> float:
        """Duration of what a decision plays, s."""
        return self.cycle_seconds / self.decisions_per_cycle

    def motions(self, space: str) -> Motions:
        """Return the tasks' plain motions a cycle in a space: all in 'spatial', in 'planar' the level part."""
        d = SPACES[space].dimension
        return Motions(frames_of(self.rotations, d), self.translations[..., :d])

    def switched_motions(self, space: str) -> Motions:
        """Return the motions (P, K, ...) of a decision by the past, in a space."""
        if self.switching is None:
            return self.motions(space).switched()
        d = SPACES[space].dimension
        switching = self.switching
        return Motions(frames_of(switching.rotations, d), switching.translations[..., :d])

    def cycle_motions(self, space: str) -> Motions:
        """Return the motions (m, K, ...) of a whole cycle of each task that begins at each phase."""
        if self.decisions_per_cycle == 1:
            return Motions(*(part[None] for part in self.motions(space)))
        kept = np.array([self.past.kept(phase) for phase in range(self.decisions_per_cycle)])
        return self.kept_motions(space).of((kept, np.arange(self.gaits)))

    def kept_motions(self, space: str) -> Motions:
        """Return the motions (P, K, ...) of a gait that is kept for as long as a cycle, by the past."""
        single = self.switched_motions(space)
        if self.decisions_per_cycle == 1:
            return single
        past, d = self.past, single.translations.shape[-1]
        shape = (past.rest + 1, self.gaits)
        before, gait = (index.ravel() for index in np.indices(shape))
        way, turn = np.zeros((len(gait), d)), np.tile(np.eye(d), (len(gait), 1, 1))
        for _ in range(self.decisions_per_cycle):
            way, turn = single.of((before, gait)).after(way, turn)
            before = past.then[before, gait]
        return Motions(turn.reshape(*shape, d, d), way.reshape(*shape, d))

    def scatter(self) -> tuple[np.ndarray, np.ndarray]:
        """Return (P, K) the standard deviations of single decisions: of the turn, rad; of the way, m."""
        if self.switching is None:
            shape = (self.rest + 1, self.gaits)
            return np.broadcast_to(self.rotation_sd, shape), np.broadcast_to(
                self.translation_sd, shape
            )
        return self.switching.rotation_sd, self.switching.translation_sd

    def save(self, path: str | Path) -> None:
        """Write the surrogate to `path` (npz), atomically."""
        names = ["rotations", "translations", "rotation_mean", "rotation_sd"]
        names += ["translation_mean", "translation_sd"]
        meta = {
            "body_hash": self.body_hash,
            "gait_hash": self.gait_hash,
            "task_names": list(self.task_names),
            "cycle_seconds": self.cycle_seconds,
            "pairs": self.pairs,
            "radius": self.radius,
        }
        arrays = {name: getattr(self, name) for name in names}
        if self.switching is not None:
            arrays |= {f"switched_{name}": getattr(self.switching, name) for name in _SWITCHED}
            meta["held_out"] = self.switching.held_out
        if self.decisions_per_cycle != 1:
            meta["decisions_per_cycle"] = self.decisions_per_cycle
        files.save_archive(path, "surrogate", FORMAT_VERSION, arrays, meta)

    @classmethod
    def load(cls, path: files.Source) -> Surrogate:
        """Read a surrogate of `save`.

        Raises:
            DefplanError: the file is missing, damaged or of another version, or its content is no surrogate.
        """
        from defplan_mj.planning.validate import (
            validate_surrogate,
        )  # here: it looks into surrogates

        arrays, meta, _ = files.load_archive(path, "surrogate", FORMAT_VERSION)
        with files.fields_of(path, "surrogate"):
            switching = None
            if "held_out" in meta:
                parts = {name: arrays.pop(f"switched_{name}") for name in _SWITCHED}
                switching = Switched(**parts, held_out=meta.pop("held_out"))
            contents: dict[str, Any] = {**meta, **arrays, "task_names": tuple(meta["task_names"])}
            surrogate = cls(**contents, switching=switching)
            validate_surrogate(surrogate, str(path))
        return surrogate
