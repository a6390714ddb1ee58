"""Gait solvers `cio`, `cio-alternating` and `cio-shooting`: contact-invariant optimisation of a walker's gaits.

The paper's Eq. 1 with E_cio: the forces on the feet are unknowns beside states and target shapes, and
a cost makes contact and force agree (terms.py), so that a gradient can move a foot to another place
in another step. Weights are raised stage by stage, from gliding to walking (docs/gaits.md).
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from defplan_mj.base.progress import Progress, no_progress
from defplan_mj.gait.gait import Gait
from defplan_mj.gait.problem import GaitProblem
from defplan_solvers.cio import start
from defplan_solvers.cio.model import Walker, walker_of
from defplan_solvers.cio.newton import ContactInvariant, Iterate
from defplan_solvers.cio.terms import Weights
from defplan_solvers.gait import shooting
from defplan_solvers.gait.alternating import Fit
from defplan_solvers.gait.shooting_walk import Walking

_DAMPING = 1e-2
_GENTLE = 0.4  # wanted of a cycle at first if it is polished, lengths of the body


@dataclass(frozen=True)
class Stage:
    """One stage: weights of E_phys, E_cio and E_dmp, and how long.

    Attributes:
        physics, contact, dmp: see terms.Weights; `dmp` is for the alternating scheme.
        iterations: of Gauss-Newton; by turns, in each round.
        rounds: of the alternating scheme.
    """

    physics: float
    contact: float
    iterations: int
    dmp: float = 0.0
    rounds: int = 1


@dataclass(frozen=True)
class Trial:
    """Walks of all tasks from one kind of start, or the best of several.

    Attributes:
        w: (n_w,) of the whole problem.
        believed, simulated: (K,) E_obj of each task: by the optimiser's states, and re-simulated from
            rest (inf if a step does not converge).
        stage: what the report shows.
    """

    w: np.ndarray
    believed: np.ndarray
    simulated: np.ndarray
    stage: dict


@dataclass(frozen=True)
class Cio:
    """Contact-invariant optimisation.

    Attributes:
        joint: 'joint' has states, forces and w as unknowns at once (target shapes are the DMP's);
            the paper's alternation has states, forces and target shapes for fixed w, and w for fixed
            target shapes, by turns.
        patterns: which feet are down when, at the starts (start.PATTERNS, or 'random'); each task
            keeps the start that does best.
        cycles: of each task's trajectory; the first one, from rest, is not judged.
        stages: weights, stage by stage.
        judged: cycles of the simulation that chooses among the starts.
        fit_iterations: quasi-Newton iterations on w, a round of the alternation.
        bound: of alpha and beta.
        polish: goes on from the result through the implicit contact, or nothing.
        threads: for the steps.
    """

    name: str
    summary: str
    stages: tuple[Stage, ...]
    joint: bool = True
    kind: str = "gait"
    patterns: tuple[str, ...] = ("trot",)
    cycles: int = 3
    judged: int = 6
    fit_iterations: int = 60
    bound: float = 4.0
    polish: shooting.Shooting | None = None
    threads: int = 2

    def solve(self, problem: GaitProblem, seed: int = 0, progress: Progress = no_progress) -> Gait:
        """Return the gait of `problem`; a seed gives one result.

        The meta data hold `seconds`, `objective` (what the optimiser's states claim), `resimulated`
        (what each task alone gives, from rest) and `stages`.

        Raises:
            DefplanError: the body does not walk on level ground.
        """
        began = time.perf_counter()
        rng = np.random.default_rng(seed)
        share = 0.5 if self.polish else 1.0
        # a fast gait is polished from a slow one: fast ones that are found alone do not go together
        first = problem.at_most(_GENTLE * problem.dynamics.body.length) if self.polish else problem
        walker = walker_of(first)
        if self.joint:
            trial = self._joint(walker, first, self.patterns, rng, progress, share)
        else:
            trial = self._by_turns(walker, first, self.patterns, rng, progress)
        w = trial.w
        meta = {
            "solver": self.name,
            "seed": seed,
            "seconds": time.perf_counter() - began,
            "objective": float(trial.believed.mean()),
            "resimulated": _finite(trial.simulated.mean()),
            "patterns": list(self.patterns),
            "history": trial.stage.pop("history"),
            "stages": [trial.stage],
        }
        if self.polish is None:
            return problem.gait(w, meta)

        def tell(message: str, fraction: float) -> None:
            progress(message, share + (1 - share) * fraction)

        gait = self.polish.solve(problem, seed, tell, start=w)
        meta |= {
            "seconds": time.perf_counter() - began,
            "objective": gait.meta["objective"],
            "history": gait.meta["history"],
            "stages": [*meta["stages"], *gait.meta["stages"]],
        }
        return problem.gait(problem.w_of(gait), meta)

    def _joint(
        self,
        walker: Walker,
        problem: GaitProblem,
        patterns: tuple[str, ...],
        rng: np.random.Generator,
        progress: Progress,
        share: float,
    ) -> Trial:
        """Take all tasks from all patterns side by side; each task keeps its best."""
        began, k = time.perf_counter(), problem.n_tasks
        tasks = list(range(k)) * len(patterns)
        walk = start.starts(walker, problem, tasks, list(np.repeat(patterns, k)), self.cycles, rng)
        problem_of_all = self._contact_invariant(walker, problem, tasks)
        history: list[float] = []
        for number, stage in enumerate(self.stages):
            weights = Weights(stage.physics, stage.contact)
            damping = np.full(len(tasks), _DAMPING)
            walk, _ = problem_of_all.minimise(walk, weights, stage.iterations, damping)
            history.append(float(problem_of_all.cost(walk, weights).min()))
            progress("gait: contact-invariant", share * (number + 1) / len(self.stages))
        trial = self._judge(problem, problem_of_all, walk, Weights(*_last(self.stages)))
        seconds = time.perf_counter() - began
        return _with_stage(trial, f"joint, from {', '.join(patterns)}", seconds, history)

    def _by_turns(
        self,
        walker: Walker,
        problem: GaitProblem,
        patterns: tuple[str, ...],
        rng: np.random.Generator,
        progress: Progress,
    ) -> Trial:
        """The paper's alternation, from one pattern after the other; the best one is kept whole."""
        k, trials = problem.n_tasks, []
        by_turns = self._contact_invariant(walker, problem, list(range(k)))
        fit = Fit(problem, [[j] * self.cycles for j in range(k)], self.bound, self.fit_iterations)
        for done, pattern in enumerate(patterns):
            began, history = time.perf_counter(), []
            walk = start.starts(walker, problem, list(range(k)), [pattern] * k, self.cycles, rng)
            w = _together(problem, walk.w)
            walk = Iterate(walk.states, walk.forces, by_turns.dmp(walk.w), walk.w)
            for number, stage in enumerate(self.stages):
                weights = Weights(stage.physics, stage.contact, dmp=stage.dmp)
                damping = np.full(k, _DAMPING)
                for _ in range(stage.rounds):
                    walk, damping = by_turns.minimise(walk, weights, stage.iterations, damping)
                    damping = np.minimum(3 * damping, _DAMPING)
                    w = fit(
                        w, walk.shapes.reshape(-1, walker.nu), stage.dmp**2 * len(walk.shapes[0])
                    )
                    walk = Iterate(walk.states, walk.forces, walk.shapes, apart(problem, w))
                history.append(float(by_turns.cost(walk, weights).mean()))
                part = (number + 1) / len(self.stages)
                progress("gait: contact-invariant, by turns", (done + part) / len(patterns))
            trial = self._judge(problem, by_turns, walk, weights)
            trial = Trial(w, trial.believed, trial.simulated, trial.stage)
            seconds = time.perf_counter() - began
            trials.append(_with_stage(trial, f"by turns, from {pattern}", seconds, history))
        return min(trials, key=lambda trial: trial.simulated.mean())

    def _contact_invariant(
        self, walker: Walker, problem: GaitProblem, tasks: list[int]
    ) -> ContactInvariant:
        return ContactInvariant(
            walker,
            problem,
            tasks,
            self.cycles,
            joint=self.joint,
            bound=self.bound,
            threads=self.threads,
        )

    def _judge(
        self, problem: GaitProblem, optimised: ContactInvariant, walk: Iterate, weights: Weights
    ) -> Trial:
        """Simulate every walk's gait; each task keeps the one that does best."""
        believed, simulated = np.empty(len(walk.w)), np.empty(len(walk.w))
        for b, task in enumerate(optimised.tasks):
            alone = problem.alone(task)
            states = walk.states[b].T
            sequence = [0] * self.cycles
            cost = alone.trajectory_cost(sequence, optimised.settle)(states[:, 0], states[:, 1:])
            believed[b] = float(cost) + float(optimised.regular(walk.w[b]))
            try:
                simulated[b] = float(alone.objective([[0] * self.judged], settle=2)(walk.w[b]))
            except RuntimeError:  # a step of this gait does not converge
                simulated[b] = np.inf
        tasks = np.array(optimised.tasks)
        best = [
            min(np.flatnonzero(tasks == j), key=lambda b: simulated[b])
            for j in range(problem.n_tasks)
        ]
        parts = optimised.parts(walk, weights)
        stage = {f"rms_{name}": float(np.sqrt(value[best].mean())) for name, value in parts.items()}
        w = _together(problem, walk.w[best])
        return Trial(w, believed[best], simulated[best], stage)


def _together(problem: GaitProblem, w: np.ndarray) -> np.ndarray:
    """Return w of the whole problem of those of each task alone (K, .), which share mu."""
    n = problem.n_phases
    return np.concatenate([w[0, :n], w[:, n : 2 * n].ravel(), w[:, 2 * n :].ravel()])


def apart(problem: GaitProblem, w: np.ndarray) -> np.ndarray:
    """Return w of each task alone (K, .)."""
    mu, alpha, beta = problem.split(w)
    parts = zip(alpha, beta, strict=True)
    return np.array([np.concatenate([mu.ravel(), a.ravel(), b.ravel()]) for a, b in parts])


def _last(stages: tuple[Stage, ...]) -> tuple[float, float]:
    return stages[-1].physics, stages[-1].contact


def _with_stage(trial: Trial, name: str, seconds: float, history: list[float]) -> Trial:
    stage = {
        "stage": name,
        "objective": float(trial.believed.mean()),
        "resimulated": _finite(trial.simulated.mean()),
        "seconds": seconds,
        "history": history,
    }
    return Trial(trial.w, trial.believed, trial.simulated, trial.stage | stage)


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


JOINT_STAGES = (
    Stage(0.1, 0.3, 15),
    Stage(0.3, 1.0, 15),
    Stage(1.0, 3.0, 20),
    Stage(3.0, 10.0, 20),
    Stage(10.0, 30.0, 20),
)
TURNS_STAGES = (
    Stage(0.1, 0.3, 5, dmp=0.5, rounds=3),
    Stage(0.3, 1.0, 5, dmp=1.0, rounds=3),
    Stage(1.0, 3.0, 5, dmp=2.0, rounds=4),
    Stage(3.0, 10.0, 5, dmp=5.0, rounds=4),
    Stage(10.0, 30.0, 5, dmp=15.0, rounds=4),
)
_POLISH = Walking(rounds=((3, 8, 40), (6, 8, 40), (8, 8, 40)))  # it walks already
JOINT = Cio(
    "cio",
    "contact-invariant optimisation: states, foot forces and DMP at once",
    JOINT_STAGES,
)
ALTERNATING = Cio(
    "cio-alternating",
    "contact-invariant optimisation as in the paper: states and forces, then the DMP, by turns",
    TURNS_STAGES,
    joint=False,
)
POLISHED = Cio(
    "cio-shooting",
    "cio, then single shooting from there through the implicit contact",
    JOINT_STAGES,
    polish=shooting.Shooting(name="cio-shooting", walking=_POLISH),
)
