"""What a gait solver plugin has to offer."""

from __future__ import annotations

from typing import Protocol

from defplan_mj.base.progress import Progress, no_progress
from defplan_mj.gait.gait import Gait
from defplan_mj.gait.problem import GaitProblem


class GaitSolver(Protocol):
    """A gait solver plugin (entry point group `defplan_mj.solvers`).

    Its repr tells it from one with other options. One whose gaits belong to packaged bodies has an attribute
    `body_as_packaged = True`: a run then takes its task's packaged body.
    """

    @property
    def kind(self) -> str:
        """'gait'."""

    @property
    def name(self) -> str:
        """What it is asked for by."""

    @property
    def summary(self) -> str:
        """One line."""

    def solve(self, problem: GaitProblem, seed: int = 0, progress: Progress = no_progress) -> Gait:
        """Return the gaits of a problem: `problem.gait(w, meta)` of the best w (n_w,) that it found.

        `problem.random_gait(rng)` is a w to start from, `problem.objective(sequences)` w -> E_obj
        with its exact gradient, `problem.switching_sequences(rng)` sequences to judge by.

        What report and comparison read of `meta`, if it is there: 'solver' (its name), 'seconds',
        'objective' (its own, of the result), 'history' (the objective of each iteration) and
        'stages' (dicts). All of `meta` has to be JSON-able.

        Args:
            seed: the same one gives the same gaits to the bit.
            progress: to be called every few seconds with what is done and the fraction done, at
                most 1; it is where Ctrl-C is heard.

        Raises:
            DefplanError: the problem is not of a kind that this solver can solve.
        """
