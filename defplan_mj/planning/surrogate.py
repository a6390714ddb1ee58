"""The rigid surrogate f_fit: a gait cycle is one rigid motion (paper, section IV-B)."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from defplan_mj.base import files
from defplan_mj.base.space import SPACES
from defplan_mj.planning.frames import frames_of

FORMAT_VERSION = 1


class Motions(NamedTuple):
    """What a cycle of each gait does, in the frame at its start (see `planning.frames`).

    Attributes:
        rotations: (K, d, d).
        translations: (K, d) m.
    """

    rotations: np.ndarray
    translations: np.ndarray

    def of(self, gaits: np.ndarray) -> Motions:
        """Return the motions of some gaits (n,), one after the other."""
        return Motions(self.rotations[gaits], self.translations[gaits])

    def after(self, position: np.ndarray, frames: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return poses (n, d), (n, d, d) one motion later: (c + R t, R R_j) (paper, section IV-B)."""
        end = position + np.einsum("nij,nj->ni", frames, self.translations)
        return end, frames @ self.rotations


@dataclass(frozen=True)
class Surrogate:
    """f_fit: task j maps the body frame (c, R) to (c + R t_j, R R_j).

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

    def motions(self, space: str) -> Motions:
        """Return the tasks' motions in a space: all of them in 'spatial', in 'planar' the level part."""
        d = SPACES[space].dimension
        return Motions(frames_of(self.rotations, d), self.translations[:, :d])

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
        files.save_archive(
            path, "surrogate", FORMAT_VERSION, {n: getattr(self, n) for n in names}, meta
        )

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
            contents: dict[str, Any] = {**meta, **arrays, "task_names": tuple(meta["task_names"])}
            surrogate = cls(**contents)
            validate_surrogate(surrogate, str(path))
        return surrogate
