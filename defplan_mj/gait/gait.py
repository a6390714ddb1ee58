"""A gait as plain data: the rhythmic multitask DMP of the paper (section IV-A) and its table of target shapes."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from defplan_mj import files

FORMAT_VERSION = 2


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
    def load(cls, path: str | Path) -> Gait:
        """Read a gait of `save`.

        Raises:
            DefplanError: the file is missing, damaged or of another version.
        """
        arrays, meta, _ = files.load_archive(path, "gait", FORMAT_VERSION)
        return cls(
            body_hash=meta["body_hash"],
            task_names=tuple(meta["task_names"]),
            timestep=meta["timestep"],
            steps_per_cycle=meta["steps_per_cycle"],
            substeps=meta["substeps"],
            integrator=meta["integrator"],
            meta=meta["meta"],
            **arrays,
        )
