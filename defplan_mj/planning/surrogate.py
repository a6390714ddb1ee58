"""The rigid surrogate f_fit: a gait cycle is one rigid motion, that of its gait and of the gait before it."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from defplan_mj.base import files
from defplan_mj.base.space import SPACES
from defplan_mj.planning.frames import frames_of

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
        """Return the motions of some gaits (n,); of switched motions, those of (before (n,), gaits (n,))."""
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
    """What a cycle does after a cycle of another gait: rows are the gait before, the last one is rest.

    Attributes:
        rotations: (K + 1, K, 3, 3), in the body frame at the start of the cycle.
        translations: (K + 1, K, 3) m, likewise.
        rotation_sd, translation_sd: (K + 1, K) root mean square of what is left, along one axis, rad and m.
        held_out: errors of a cycle of chains that were not fitted, root mean square: 'place_m' and
            'turn_rad' of these motions, 'plain_place_m' and 'plain_turn_rad' of one motion a gait, and
            'cycles', how many; empty if there was too little to hold some of it out.
    """

    rotations: np.ndarray
    translations: np.ndarray
    rotation_sd: np.ndarray
    translation_sd: np.ndarray
    held_out: dict[str, float]


_SWITCHED = tuple(field.name for field in fields(Switched) if field.name != "held_out")


@dataclass(frozen=True)
class Surrogate:
    """f_fit: task j after task i maps the body frame (c, R) to (c + R t_ij, R R_ij).

    Table III's plain surrogate, one motion a task, stands beside it; `plain` uses that one alone.

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
        switching: the motions by the gait before; None: they do not depend on it.
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

    @property
    def plain(self) -> Surrogate:
        """The surrogate with one motion a task, whatever was before."""
        return replace(self, switching=None)

    @property
    def rest(self) -> int:
        """What stands for the gait before the first one: K."""
        return len(self.task_names)

    def motions(self, space: str) -> Motions:
        """Return the tasks' plain motions in a space: all in 'spatial', in 'planar' the level part."""
        d = SPACES[space].dimension
        return Motions(frames_of(self.rotations, d), self.translations[..., :d])

    def switched_motions(self, space: str) -> Motions:
        """Return the motions (K + 1, K, ...) by the gait before, in a space."""
        if self.switching is None:
            return self.motions(space).switched()
        d = SPACES[space].dimension
        switching = self.switching
        return Motions(frames_of(switching.rotations, d), switching.translations[..., :d])

    def scatter(self) -> tuple[np.ndarray, np.ndarray]:
        """Return (K + 1, K) the standard deviations of single cycles: of the turn, rad; of the way, m."""
        if self.switching is None:
            shape = (self.rest + 1, self.rest)
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
