"""Fitting the rigid surrogate f_fit to the reduced dynamics (paper, Algorithm 1 and Table III)."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np

from defplan_mj.base import rotations, threads
from defplan_mj.base.errors import DefplanError
from defplan_mj.base.progress import Progress, no_progress
from defplan_mj.body.model import Body
from defplan_mj.body.rotation_strain import affine_coordinates
from defplan_mj.dynamics.reduced import ReducedDynamics
from defplan_mj.gait.gait import Gait
from defplan_mj.gait.switching import roll_cycles, since_rest
from defplan_mj.planning.surrogate import Surrogate, Switched

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
    """Fit rigid motions to the cycles of each task, while tasks are switched at random.

    One motion a task is Table III's; beside it stands one for each task after each other one, and for
    each from rest.

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
    cycles, radius = _switch(dynamics, gait, pairs, seed, progress)
    k = len(gait.task_names)
    own_angle = rotations.angle(rotations.kabsch(cycles.covariance))
    own_length = np.linalg.norm(cycles.translation, axis=1)
    mine = [cycles.task == j for j in range(k)]
    for name, of_task in zip(gait.task_names, mine, strict=True):
        if not of_task.any():
            raise DefplanError(
                f"{dynamics.body.name} falls in every cycle of the gait {name}: solve the gaits with"
                " another seed or solver"
            )
    turns, ways = _plain(cycles, k)
    return Surrogate(
        body_hash=dynamics.body.hash,
        gait_hash=gait.hash,
        task_names=gait.task_names,
        rotations=turns,
        translations=ways,
        cycle_seconds=gait.cycle_seconds,
        pairs=pairs,
        rotation_mean=np.array([own_angle[i].mean() for i in mine]),
        rotation_sd=np.array([own_angle[i].std() for i in mine]),
        translation_mean=np.array([own_length[i].mean() for i in mine]),
        translation_sd=np.array([own_length[i].std() for i in mine]),
        radius=radius,
        switching=fit_switched(cycles, _from_rest(dynamics, gait), k),
    )


class Cycles(NamedTuple):
    """What n cycles did, in the body frame at the start of each.

    Attributes:
        chain: (n,) of which run of random switching.
        before, task: (n,) the gait before and the gait.
        covariance: (n, 3, 3) see `pair_moments`, kg m^2.
        translation: (n, 3) m.
    """

    chain: np.ndarray
    before: np.ndarray
    task: np.ndarray
    covariance: np.ndarray
    translation: np.ndarray

    def some(self, which: np.ndarray) -> Cycles:
        """Return some of the cycles."""
        return Cycles(*(part[which] for part in self))


def fit_switched(cycles: Cycles, from_rest: Cycles, k: int) -> Switched:
    """Return the rigid motion of each of k gaits after each other one and from rest.

    What is said of single cycles is measured on every fifth chain by motions that were fitted to the
    others; the motions themselves are fitted to all. A pair of gaits that never occurred has its gait's
    plain motion and scatter.
    """
    held = cycles.chain % 5 == 4
    fitted, judged = cycles.some(~held), cycles.some(held)
    held_out: dict[str, float] = {}
    if len(judged.task) and len(np.unique(fitted.task)) == k:
        plain = _plain(fitted, k)
        for name, motions, index in (
            ("", _by_pair(fitted, from_rest, k), (judged.before, judged.task)),
            ("plain_", plain, (judged.task,)),
        ):
            turn, way = _errors(judged, *motions, index)
            held_out[f"{name}place_m"] = float(np.sqrt((way**2).sum(1).mean()))
            held_out[f"{name}turn_rad"] = float(np.sqrt((turn**2).mean()))
        held_out["cycles"] = len(judged.task)
    turns, ways = _by_pair(cycles, from_rest, k)
    turn, way = _errors(cycles, turns, ways, (cycles.before, cycles.task))
    turn_sd, way_sd = (np.zeros((k + 1, k)) for _ in range(2))
    for j in range(k):
        own = cycles.task == j
        for i in range(k + 1):
            after = own & (cycles.before == i)
            which = after if after.any() else own
            # a turn has one axis that counts in the plane and three in space; each has this share
            turn_sd[i, j] = np.sqrt((turn[which] ** 2).mean() / 3)
            way_sd[i, j] = np.sqrt((way[which] ** 2).mean())
    return Switched(turns, ways, turn_sd, way_sd, held_out)


def _plain(cycles: Cycles, k: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the motions (k, 3, 3), (k, 3) that fit all cycles of each gait best."""
    mine = [cycles.task == j for j in range(k)]
    return (
        rotations.kabsch(np.array([cycles.covariance[i].sum(0) for i in mine])),
        np.array([cycles.translation[i].mean(0) for i in mine]),
    )


def _by_pair(cycles: Cycles, from_rest: Cycles, k: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the motions (k + 1, k, 3, 3), (k + 1, k, 3) that fit the cycles after each gait best."""
    turns, ways = (np.repeat(part[None], k + 1, 0) for part in _plain(cycles, k))
    for part in (cycles, from_rest):
        for i, j in {(int(i), int(j)) for i, j in zip(part.before, part.task, strict=True)}:
            which = (part.before == i) & (part.task == j)
            turns[i, j] = rotations.kabsch(part.covariance[which].sum(0))
            ways[i, j] = part.translation[which].mean(0)
    return turns, ways


def _errors(
    cycles: Cycles, turns: np.ndarray, ways: np.ndarray, index: tuple[np.ndarray, ...]
) -> tuple[np.ndarray, np.ndarray]:
    """Return the angles (n,) and offsets (n, 3) by which cycles miss the motions at `index`."""
    off = np.swapaxes(turns[index], 1, 2) @ rotations.kabsch(cycles.covariance)
    return rotations.angle(off), cycles.translation - ways[index]


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
) -> tuple[Cycles, float]:
    """Switch tasks at random, each equally often; return the cycles that count and the radius.

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

    def run(chain: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
        states, down = roll_cycles(dynamics, table[chain])
        counted = np.flatnonzero((since_rest(down) >= WARM_UP) & ~down)
        measured = states[counted][:RADIUS_CYCLES, :-1].reshape(-1, dynamics.nx)
        far = [np.linalg.norm(dynamics.surface(x) - x[:3], axis=1).max() for x in measured]
        ends = states[counted][:, [0, -1]]
        return chain[counted - 1], chain[counted], ends, float(max(far, default=0.0))

    numbers, befores, gaits, ends, radius = [], [], [], [], 0.0
    pool = ThreadPoolExecutor(min(threads.available_cores(), 2))
    try:
        for done, (before, task, states, farthest) in enumerate(pool.map(run, chains)):
            numbers.append(np.full(len(task), done))
            befores.append(before)
            gaits.append(task)
            ends.append(states)
            radius = max(radius, farthest)
            progress("switching tasks at random", (done + 1) / len(chains))
    finally:
        pool.shutdown(cancel_futures=True)
    start, end = np.moveaxis(np.concatenate(ends), 1, 0)
    number, before, task = (np.concatenate(part) for part in (numbers, befores, gaits))
    return Cycles(number, before, task, *pair_moments(dynamics.body, start, end)), radius


def _from_rest(dynamics: ReducedDynamics, gait: Gait) -> Cycles:
    """Return the first cycle of each gait from rest, unless it comes down."""
    k = len(gait.task_names)
    rolled = [roll_cycles(dynamics, cycle[None]) for cycle in gait.table()]
    stands = np.array([j for j, (_, down) in enumerate(rolled) if not down[0]], int)
    ends = np.array([rolled[j][0][0, [0, -1]] for j in stands]).reshape(-1, 2, dynamics.nx)
    rest = np.full(len(stands), k)
    moments = pair_moments(dynamics.body, ends[:, 0], ends[:, 1])
    return Cycles(np.zeros_like(rest), rest, stands, *moments)
