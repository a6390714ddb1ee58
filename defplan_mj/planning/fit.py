"""Fitting the rigid surrogate f_fit to the reduced dynamics (paper, Algorithm 1 and Table III)."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np

from defplan_mj.base import rotations, threads
from defplan_mj.base.errors import DefplanError
from defplan_mj.base.progress import Progress, no_progress
from defplan_mj.body.model import Body
from defplan_mj.body.rotation_strain import affine_coordinates
from defplan_mj.dynamics.reduced import ReducedDynamics
from defplan_mj.gait.gait import Gait
from defplan_mj.gait.switching import roll_cycles, since_rest
from defplan_mj.planning.surrogate import Surrogate

CHAINS = 20  # independent runs of random switching; a fixed number, so that threads do not matter
WARM_UP = 3  # first cycles of a chain, from rest, that are not counted
RADIUS_CYCLES = 5  # cycles of each chain whose surface is measured


def fit_surrogate(
    dynamics: ReducedDynamics,
    gait: Gait,
    pairs: int = 1000,
    seed: int = 0,
    progress: Progress = no_progress,
) -> Surrogate:
    """Fit one rigid motion to the cycles of each task, while tasks are switched at random.

    Args:
        dynamics: the body's reduced dynamics, at the gait's time step.
        pairs: (before, after) pairs of states for each task.
        seed: of the switching.

    Raises:
        DefplanError: there are no pairs, the gait is of another body or time step, or the
            simulation failed.
    """
    if pairs < 1:
        raise DefplanError(f"the surrogate needs at least 1 pair a task, not {pairs}")
    if gait.body_hash != dynamics.body.hash:
        raise DefplanError(
            f"the gait belongs to another body than {dynamics.body.name}: solve it for this body"
        )
    if not np.isclose(gait.timestep, dynamics.timestep):
        raise DefplanError(
            f"the gait belongs to the time step {gait.timestep} s, the dynamics has"
            f" {dynamics.timestep} s: solve the gait for this time step"
        )
    task, before, after, radius = _switch(dynamics, gait, pairs, seed, progress)
    covariance, translation = pair_moments(dynamics.body, before, after)
    own_angle = rotations.angle(rotations.kabsch(covariance))
    own_length = np.linalg.norm(translation, axis=1)
    mine = [task == j for j in range(len(gait.task_names))]
    for name, of_task in zip(gait.task_names, mine, strict=True):
        if not of_task.any():
            raise DefplanError(
                f"{dynamics.body.name} falls in every cycle of the gait {name}: solve the gaits with"
                " another seed or solver"
            )
    return Surrogate(
        body_hash=dynamics.body.hash,
        gait_hash=gait.hash,
        task_names=gait.task_names,
        rotations=rotations.kabsch(np.array([covariance[i].sum(0) for i in mine])),
        translations=np.array([translation[i].mean(0) for i in mine]),
        cycle_seconds=gait.cycle_seconds,
        pairs=pairs,
        rotation_mean=np.array([own_angle[i].mean() for i in mine]),
        rotation_sd=np.array([own_angle[i].std() for i in mine]),
        translation_mean=np.array([own_length[i].mean() for i in mine]),
        translation_sd=np.array([own_length[i].std() for i in mine]),
        radius=radius,
    )


def pair_moments(
    body: Body, before: np.ndarray, after: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return what the rigid fit of pairs of states needs, in the body frame before.

    With y the vertices' positions relative to the centre of mass before, the covariance
    sum_v m_v y_after y_before^T comes from the body's moments; vertices are not touched.

    Args:
        before, after: (n, nx) reduced states.

    Returns:
        (n, 3, 3) covariances, kg m^2, and (n, 3) displacements of the centre of mass, m.
    """
    r = body.n_modes
    frame = rotations.rotation(before[:, 3:7])
    turned = frame.inv() * rotations.rotation(after[:, 3:7])
    old, new = (affine_coordinates(body, x[:, 7 : 7 + r]) for x in (before, after))
    moments = np.einsum("abij,na,nb->nij", body.moments, new, old, optimize=True)
    return turned.as_matrix() @ moments, frame.inv().apply(after[:, :3] - before[:, :3])


def _switch(
    dynamics: ReducedDynamics, gait: Gait, pairs: int, seed: int, progress: Progress
) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Switch tasks at random, each equally often; return tasks (n,), states before, after, radius.

    Cycles in which a walker comes down are left out: planning ends there.
    """
    generator = np.random.default_rng(seed)
    tasks = generator.permutation(np.repeat(np.arange(len(gait.task_names)), pairs))
    chains = [
        np.concatenate([generator.integers(0, len(gait.task_names), WARM_UP), chain])
        for chain in np.array_split(tasks, CHAINS)
        if len(chain)
    ]
    table = gait.table()

    def run(chain: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        states, down = roll_cycles(dynamics, table[chain])
        counted = (since_rest(down) >= WARM_UP) & ~down
        measured = states[counted][:RADIUS_CYCLES, :-1].reshape(-1, dynamics.nx)
        far = [np.linalg.norm(dynamics.surface(x) - x[:3], axis=1).max() for x in measured]
        return chain[counted], states[counted][:, [0, -1]], float(max(far, default=0.0))

    gaits, starts, ends, radius = [], [], [], 0.0
    pool = ThreadPoolExecutor(min(threads.available_cores(), 2))
    try:
        for done, (counted, states, farthest) in enumerate(pool.map(run, chains)):
            gaits.append(counted)
            starts.append(states[:, 0])
            ends.append(states[:, 1])
            radius = max(radius, farthest)
            progress("switching tasks at random", (done + 1) / len(chains))
    finally:
        pool.shutdown(cancel_futures=True)
    return np.concatenate(gaits), np.concatenate(starts), np.concatenate(ends), radius
