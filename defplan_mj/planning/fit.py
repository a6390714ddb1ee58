"""Fitting the rigid surrogate f_fit to the reduced dynamics (paper, Algorithm 1 and Table III)."""

from __future__ import annotations

import itertools
from collections.abc import Callable
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
from defplan_mj.planning.past import Past, past_of
from defplan_mj.planning.surrogate import Surrogate, Switched
from defplan_mj.task import steps_of_decision

CHAINS = 20  # independent runs of random switching; a fixed number, so that threads do not matter
WARM_UP = 3  # first cycles of a chain, from rest, that are not counted
RADIUS_CYCLES = 5  # cycles of each chain whose surface is measured
FEWEST = 3  # decisions that a motion is fitted to; for fewer, less of the past tells it


def fit_surrogate(
    dynamics: ReducedDynamics,
    gait: Gait,
    pairs: int = 1000,
    seed: int = 0,
    progress: Progress = no_progress,
    decisions: int = 1,
) -> Surrogate:
    """Fit rigid motions to the cycles of each task, while tasks are switched at random.

    One motion a task is Table III's; beside it stands one for each task after each other one, and for
    each from rest. With more decisions a cycle these are of parts of it, and tasks are switched at each
    for them: as many cycles again.

    Args:
        dynamics: the body's reduced dynamics, at the gait's time step.
        pairs: (before, after) pairs of states for each task.
        seed: of the switching.
        decisions: in a cycle.

    Raises:
        DefplanError: there are no pairs, the gait is of another body or time step or has no so many equal
            parts, or the simulation failed.
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
    steps_of_decision(gait.steps_per_cycle, decisions)
    k = len(gait.task_names)
    cycles, radius = _switch(dynamics, gait, past_of(k), pairs, seed, progress)
    own_angle = rotations.angle(rotations.kabsch(cycles.covariance))
    own_length = np.linalg.norm(cycles.translation, axis=1)
    mine = [cycles.task == j for j in range(k)]
    for name, of_task in zip(gait.task_names, mine, strict=True):
        if not of_task.any():
            raise DefplanError(
                f"{dynamics.body.name} falls in every cycle of the gait {name}: solve the gaits with"
                " another seed or solver"
            )
    past, parts = past_of(k, decisions), cycles
    if decisions > 1:
        parts, farthest = _switch(dynamics, gait, past, pairs * decisions, seed, progress)
        radius = max(radius, farthest)
    if not _is_whole(parts, past):
        raise DefplanError(
            f"{dynamics.body.name} was not seen to play every gait in every part of a cycle: fit the"
            " surrogate to more pairs, or solve the gaits with another seed or solver"
        )
    turns, ways = (part[0] for part in _plain(cycles, past_of(k)))
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
        switching=fit_switched(parts, _from_rest(dynamics, gait, past), past),
        decisions_per_cycle=decisions,
    )


class Cycles(NamedTuple):
    """What n decisions did, each a cycle or a part of it, in the body frame at the start of each.

    Attributes:
        chain: (n,) of which run of random switching.
        before, task: (n,) the past (`planning.past`) and the gait.
        covariance: (n, 3, 3) see `pair_moments`, kg m^2; of parts of cycles see `frame_turns`.
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


def fit_switched(cycles: Cycles, from_rest: Cycles, past: Past) -> Switched:
    """Return the rigid motion of each gait after each past, rest among them.

    What is said of single decisions is measured on every fifth chain by motions that were fitted to the
    others; the motions themselves are fitted to all. A past that a gait never (or hardly) followed has
    the motion of those with the same gait before, or else of its phase.
    """
    held = cycles.chain % 5 == 4
    fitted, judged = cycles.some(~held), cycles.some(held)
    held_out: dict[str, float] = {}
    if len(judged.task) and _is_whole(fitted, past):
        for name, motions, index in (
            ("", _by_past(fitted, from_rest, past), (judged.before, judged.task)),
            ("plain_", _plain(fitted, past), (past.phase[judged.before], judged.task)),
        ):
            turn, way = _errors(judged, *motions, index)
            held_out[f"{name}place_m"] = float(np.sqrt((way**2).sum(1).mean()))
            held_out[f"{name}turn_rad"] = float(np.sqrt((turn**2).mean()))
        held_out["cycles"] = len(judged.task)
    turns, ways = _by_past(cycles, from_rest, past)
    turn, way = _errors(cycles, turns, ways, (cycles.before, cycles.task))
    turn_sd, way_sd = (np.zeros((past.rest + 1, past.gaits)) for _ in range(2))
    phase, segment = past.phase[cycles.before], past.segment[cycles.before]
    for j in range(past.gaits):
        for i in np.unique(past.segment):
            rows = past.segment == i
            own = (cycles.task == j) & (phase == past.phase[rows][0])
            after = own & (segment == i)
            which = after if after.any() else own
            # a turn has one axis that counts in the plane and three in space; each has this share
            turn_sd[rows, j] = np.sqrt((turn[which] ** 2).mean() / 3)
            way_sd[rows, j] = np.sqrt((way[which] ** 2).mean())
    return Switched(turns, ways, turn_sd, way_sd, held_out)


def _is_whole(cycles: Cycles, past: Past) -> bool:
    """Return whether every gait occurs at every phase."""
    there = past.phase[cycles.before] * past.gaits + cycles.task
    return len(np.unique(there)) == past.decisions * past.gaits


def _plain(cycles: Cycles, past: Past) -> tuple[np.ndarray, np.ndarray]:
    """Return the motions (m, K, 3, 3), (m, K, 3) that fit all decisions for a gait at a phase best."""
    m, k, phase = past.decisions, past.gaits, past.phase[cycles.before]
    mine = [(phase == p) & (cycles.task == j) for p in range(m) for j in range(k)]
    turns = rotations.kabsch(np.array([cycles.covariance[i].sum(0) for i in mine]))
    ways = np.array([cycles.translation[i].mean(0) for i in mine])
    return turns.reshape(m, k, 3, 3), ways.reshape(m, k, 3)


def _by_past(cycles: Cycles, from_rest: Cycles, past: Past) -> tuple[np.ndarray, np.ndarray]:
    """Return the motions (P, K, 3, 3), (P, K, 3) that fit the decisions after each past best."""
    turns, ways = (part[past.phase] for part in _plain(cycles, past))
    every = np.arange(past.rest + 1)
    for part, same, least in (
        (cycles, past.segment, 1),
        (cycles, every, FEWEST),
        (from_rest, every, 1),
    ):
        group = same[part.before]
        for i, j in {(int(i), int(j)) for i, j in zip(group, part.task, strict=True)}:
            which = (group == i) & (part.task == j)
            if which.sum() >= least:
                turns[same == i, j] = rotations.kabsch(part.covariance[which].sum(0))
                ways[same == i, j] = part.translation[which].mean(0)
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


def frame_turns(body: Body, before: np.ndarray, after: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the turns (n, 3, 3) of the body frame and displacements (n, 3), m, in the body frame before.

    In place of `pair_moments` for parts of a cycle, at whose ends the body has not the shape that it began
    with: the rigid fits of its vertices do not make up that of the cycle, the turns of the frame do.

    Args:
        before, after: (n, nx) reduced states.
    """
    frame = rotations.rotation(before[:, 3:7])
    turned = frame.inv() * rotations.rotation(after[:, 3:7])
    return turned.as_matrix(), frame.inv().apply(after[:, :3] - before[:, :3])


def _moments(past: Past) -> Callable[..., tuple[np.ndarray, np.ndarray]]:
    """Return what tells the motions of cycles, or of their parts."""
    return pair_moments if past.decisions == 1 else frame_turns


def _segments(gait: Gait, decisions: int, chain: np.ndarray) -> np.ndarray:
    """Return the target shapes (n, steps, r) of a chain (n,) of gaits, each for a part of a cycle."""
    table = gait.table()
    parts = table.reshape(len(table), decisions, -1, table.shape[2])
    return parts[chain, np.arange(len(chain)) % decisions]


def _switch(
    dynamics: ReducedDynamics, gait: Gait, past: Past, pairs: int, seed: int, progress: Progress
) -> tuple[Cycles, float]:
    """Switch tasks at random, each equally often; return the decisions that count and the radius.

    Those in which a walker comes down are left out: planning ends there.
    """
    generator = np.random.default_rng(seed)
    m, memory, warm_up = past.decisions, past.memory, WARM_UP * past.decisions
    tasks = generator.permutation(np.repeat(np.arange(len(gait.task_names)), pairs))
    chains = [
        np.concatenate([generator.integers(0, len(gait.task_names), warm_up), chain])
        for chain in np.array_split(tasks, CHAINS)
        if len(chain)
    ]

    def run(chain: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
        states, down = roll_cycles(dynamics, _segments(gait, m, chain))
        since = since_rest(down)
        counted = np.flatnonzero((since >= warm_up) & ~down)
        measured = states[counted][: RADIUS_CYCLES * m, :-1].reshape(-1, dynamics.nx)
        far = [np.linalg.norm(dynamics.surface(x) - x[:3], axis=1).max() for x in measured]
        ends = states[counted][:, [0, -1]]
        recent = chain[counted[:, None] + np.arange(-memory, 0)]
        before = past.row(counted % m, recent, since[counted])
        return before, chain[counted], ends, float(max(far, default=0.0))

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
    return Cycles(number, before, task, *_moments(past)(dynamics.body, start, end)), radius


def _from_rest(dynamics: ReducedDynamics, gait: Gait, past: Past) -> Cycles:
    """Return what every sequence of gaits does first from rest, as far as it is told apart or comes down."""
    before, task, ends = [], [], []
    for chain in itertools.product(range(past.gaits), repeat=past.memory):
        states, down = roll_cycles(dynamics, _segments(gait, past.decisions, np.array(chain)))
        row = past.rest
        for j, states_of, falls in zip(chain, states, down, strict=True):
            if falls:
                break
            before.append(row)
            task.append(j)
            ends.append(states_of[[0, -1]])
            row = past.then[row, j]
    start, end = np.moveaxis(np.array(ends).reshape(-1, 2, dynamics.nx), 1, 0)
    rows = np.array(before, int)
    moments = _moments(past)(dynamics.body, start, end)
    return Cycles(np.zeros_like(rows), rows, np.array(task, int), *moments)
