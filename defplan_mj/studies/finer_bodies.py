"""Bodies of the same mesh that are reduced less: what a task's gaits owe to modes, basis and drag points."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from defplan_mj.base.progress import Progress, no_progress
from defplan_mj.body.build import build_body
from defplan_mj.body.model import LIMITS, Body
from defplan_mj.body.options import BodyOptions
from defplan_mj.task import TaskSpec

MORE_MODES, LARGER = 4, 1.5  # added; factor of the basis and of its samples


def finer_options(options: BodyOptions) -> dict[str, BodyOptions]:
    """Return the options of finer bodies by what is finer: 'modes', 'basis', 'drag_points'.

    More modes need a larger basis, too: that has what 'basis' has.
    """
    basis = min(round(LARGER * options.basis), LIMITS["basis"])
    larger = replace(
        options, basis=basis, samples=min(round(LARGER * options.samples), LIMITS["samples"])
    )
    return {
        "modes": replace(larger, modes=min(options.modes + MORE_MODES, LIMITS["modes"])),
        "basis": larger,
        "drag_points": replace(
            options, drag_error=options.drag_error / 3, drag_points=LIMITS["drag points"]
        ),
    }


def finer_bodies(
    spec: TaskSpec, progress: Progress = no_progress
) -> Iterator[tuple[str, BodyOptions, Body]]:
    """Build the finer bodies of a task's mesh, one after the other: name, options, body."""
    for name, options in finer_options(spec.body).items():
        yield name, options, build_body(spec.mesh, options, progress=progress)


def same_shapes(coarse: Body, fine: Body, shapes: np.ndarray) -> np.ndarray:
    """Return shapes (n, r) of `coarse` in the modes of `fine`, of the same mesh: (n, r').

    A mode may come with the other sign, or mixed with one of nearly the same frequency.
    """
    mass = fine.vertex_mass
    overlap = np.einsum("n,nik,nil->kl", mass, fine.modes, coarse.modes, optimize=True)
    size = np.einsum("n,nik,nik->k", mass, fine.modes, fine.modes, optimize=True)
    return shapes @ (overlap / size[:, None]).T
