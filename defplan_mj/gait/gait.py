"""A gait as plain data: the rhythmic multitask DMP of the paper (section IV-A) and its table of target shapes."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from defplan_mj.base import files
from defplan_mj.base.errors import DefplanError
from defplan_mj.base.printable import MOST_LETTERS, is_name
from defplan_mj.kernel.pack import INTEGRATORS, MAX_SUBSTEPS

FORMAT_VERSION = 2
MOST_STEPS = 100_000  # in a cycle: a table of them is made
MOST_TERMS = 10_000_000  # of all sums in that table
_HASH = re.compile("[0-9a-f]{64}")


def dmp(
    alpha: np.ndarray, beta: np.ndarray, mu: np.ndarray, tau: float, time: np.ndarray
) -> np.ndarray:
    """Return sum_k alpha_k exp(beta_k cos(tau t - mu_k)), the paper's rhythmic DMP.

    Args:
        alpha, beta: (..., D, r).
        mu: (D, r).
        tau: angular frequency, rad/s.
        time: (n,) s.

    Returns:
        (..., n, r) target shapes.
    """
    phase = tau * np.asarray(time)[:, None, None] - mu
    return (alpha[..., None, :, :] * np.exp(beta[..., None, :, :] * np.cos(phase))).sum(-2)


@dataclass(frozen=True)
class Gait:
    """One multitask gait: K tasks that share period and phase shifts.

    Attributes:
        body_hash: the body it was optimised for.
        task_names: (K,) names, e.g. ('forward', 'left', 'right').
        timestep: of a control step, s; a gait belongs to its time step.
        steps_per_cycle: 2 pi / (tau timestep), an integer.
        alpha, beta: (K, D, r) activation magnitude and sharpness.
        mu: (D, r) phase shifts.
        amplitude: (r,) bound of the target shape: it is clipped to [-amplitude, amplitude].
        substeps, integrator: of the dynamics it was optimised for, see `ReducedDynamics`.
        meta: solver, seed, seconds, objective history: what the report shows.
    """

    body_hash: str
    task_names: tuple[str, ...]
    timestep: float
    steps_per_cycle: int
    alpha: np.ndarray
    beta: np.ndarray
    mu: np.ndarray
    amplitude: np.ndarray
    substeps: int = 2
    integrator: str = "variational"
    meta: dict = field(default_factory=dict)

    @property
    def stepping(self) -> dict[str, Any]:
        """'substeps' and 'integrator', as `ReducedDynamics` and `build_spec` take them."""
        return {"substeps": self.substeps, "integrator": self.integrator}

    @property
    def tau(self) -> float:
        """Angular frequency, rad/s."""
        return 2 * np.pi / (self.steps_per_cycle * self.timestep)

    @property
    def cycle_seconds(self) -> float:
        """Duration of one cycle, s."""
        return self.steps_per_cycle * self.timestep

    def of_tasks(self, names: Sequence[str]) -> Gait:
        """Return the gaits of some of the tasks."""
        chosen = [self.task_names.index(name) for name in names]
        return replace(
            self, task_names=tuple(names), alpha=self.alpha[chosen], beta=self.beta[chosen]
        )

    def table(self) -> np.ndarray:
        """Return the (K, steps_per_cycle, r) target shapes; entry i is DMP((i + 1) timestep), clipped."""
        time = self.timestep * np.arange(1, self.steps_per_cycle + 1)
        shapes = dmp(self.alpha, self.beta, self.mu, self.tau, time)
        return np.clip(shapes, -self.amplitude, self.amplitude)

    @property
    def hash(self) -> str:
        """Content hash (64 hex digits), the same as the file's."""
        return files.content_hash(self._arrays(), self._meta())

    def _arrays(self) -> dict[str, np.ndarray]:
        names = ("alpha", "beta", "mu", "amplitude")
        return {name: getattr(self, name) for name in names}

    def _meta(self) -> dict:
        return {
            "body_hash": self.body_hash,
            "task_names": list(self.task_names),
            "timestep": self.timestep,
            "steps_per_cycle": self.steps_per_cycle,
            **self.stepping,
            "meta": self.meta,
        }

    def save(self, path: str | Path) -> None:
        """Write the gait to `path` (npz), atomically."""
        files.save_archive(path, "gait", FORMAT_VERSION, self._arrays(), self._meta())

    @classmethod
    def load(cls, path: files.Source) -> Gait:
        """Read a gait of `save`.

        Raises:
            DefplanError: the file is missing, damaged or of another version, or its content is no gait.
        """
        arrays, meta, _ = files.load_archive(path, "gait", FORMAT_VERSION)
        with files.fields_of(path, "gait"):
            gait = cls(
                body_hash=meta["body_hash"],
                task_names=tuple(meta["task_names"]),
                timestep=meta["timestep"],
                steps_per_cycle=meta["steps_per_cycle"],
                substeps=meta["substeps"],
                integrator=meta["integrator"],
                meta=meta["meta"],
                **arrays,
            )
            validate_gait(gait, str(path))
        return gait


def validate_gait(gait: Gait, where: str) -> None:
    """Raise a DefplanError that names the field if something of the gait cannot be.

    Args:
        where: what is wrong, for the error: a file.
    """

    def refuse(name: str, why: str) -> None:
        raise DefplanError(f"{where} is no gait that can be used: its {name} {why}; train it again")

    names, steps = gait.task_names, gait.steps_per_cycle
    if not isinstance(gait.body_hash, str) or not _HASH.fullmatch(gait.body_hash):
        refuse("body_hash", "must be 64 hexadecimal digits")
    if (
        not names
        or not all(isinstance(n, str) and is_name(n) for n in names)
        or len(set(names)) < len(names)
    ):
        refuse(
            "task_names", f"must be different names of at most {MOST_LETTERS} letters, one or more"
        )
    if not isinstance(gait.timestep, (int, float)) or not 0.0 < gait.timestep < np.inf:
        refuse("timestep", f"is {gait.timestep!r:.40}, it must be positive")
    if isinstance(steps, bool) or not isinstance(steps, int) or not 1 <= steps <= MOST_STEPS:
        refuse(
            "steps_per_cycle", f"is {steps!r:.40}, a whole number from 1 to {MOST_STEPS} is wanted"
        )
    if gait.integrator not in INTEGRATORS:
        refuse("integrator", f"is {gait.integrator!r:.40}, it can be {' or '.join(INTEGRATORS)}")
    substeps = gait.substeps
    if isinstance(substeps, bool) or not isinstance(substeps, int):
        refuse("substeps", f"is {substeps!r:.40}, a whole number is wanted")
    if not 1 <= substeps <= MAX_SUBSTEPS:
        refuse("substeps", f"is {substeps}, it must lie between 1 and {MAX_SUBSTEPS}")
    for name in ("alpha", "beta", "mu", "amplitude"):
        array = getattr(gait, name)
        if not isinstance(array, np.ndarray) or array.dtype.kind != "f":
            refuse(name, "must be floating numbers")
        if not np.isfinite(array).all():
            refuse(name, "has numbers that are not finite")
    if gait.mu.ndim != 2 or 0 in gait.mu.shape:
        refuse("mu", f"has shape {gait.mu.shape}, wanted (wavelets, modes)")
    expected = (len(names), *gait.mu.shape)
    for name in ("alpha", "beta"):
        if getattr(gait, name).shape != expected:
            refuse(name, f"has shape {getattr(gait, name).shape}, wanted {expected}")
    if steps * gait.alpha.size > MOST_TERMS:
        refuse("alpha", f"and steps_per_cycle make {steps * gait.alpha.size} terms, at most"
               f" {MOST_TERMS} can be")  # fmt: skip
    if gait.amplitude.shape != expected[2:]:
        refuse("amplitude", f"has shape {gait.amplitude.shape}, wanted {expected[2:]}")
    if not (gait.amplitude > 0.0).all():
        refuse("amplitude", "must be positive")
