"""How true a task's gaits are: played through the reduced dynamics, with finer steps, and through the full FEM."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from defplan_mj.base import rotations
from defplan_mj.base.errors import DefplanError
from defplan_mj.base.progress import Progress, no_progress
from defplan_mj.body.check import placed_vertices
from defplan_mj.body.model import Body
from defplan_mj.dynamics.full_fem import FemState, FullFem
from defplan_mj.dynamics.world import MAX_TILT, tilt
from defplan_mj.gait.gait import Gait
from defplan_mj.gait.problem import GaitProblem
from defplan_mj.gait.switching import evaluate_switching, heading, wrap
from defplan_mj.planning.robot import Robot
from defplan_mj.studies.finer_bodies import finer_bodies, same_shapes
from defplan_mj.task import GaitTask, TaskSpec

CHECK_FILE = "check.json"
FINER = 4  # what every step is divided by
SETTLE, CYCLES = 2, 2  # cycles from rest that are not judged, and that are, in the full FEM
_POSES = 4  # of a judged cycle at which shapes are compared
SHIFT, SHIFTS = 0.03, 16  # of the amplitude, that target shapes are moved by; how often


@dataclass(frozen=True)
class Motion:
    """Mean motion of a gait's judged cycles, in the frame at their start.

    Attributes:
        advance: in the wanted direction (all of the way if none is wanted), m.
        turn: about the wanted axis (in the plane: up), rad.
    """

    advance: float
    turn: float


def packaged_robot(spec: TaskSpec) -> Robot:
    """Return the body and gaits that are packaged for a task, in its world.

    Raises:
        DefplanError: there are none.
    """
    if spec.shipped is None:
        raise DefplanError(
            f"no gaits are packaged for {spec.name}: name the folder of a run that has some"
            " (--run DIR)"
        )
    body, gait = spec.shipped
    return Robot(Body.load(body), Gait.load(gait), spec.world)


def robot_of_run(spec: TaskSpec, folder: Path) -> Robot:
    """Return the body and gaits of a run's folder, in the task's world."""
    return Robot(Body.load(folder / "body.npz"), Gait.load(folder / "gait.npz"), spec.world)


def refined(gait: Gait, factor: int = FINER) -> Gait:
    """Return the same DMP with every step divided by `factor`."""
    return replace(
        gait, timestep=gait.timestep / factor, steps_per_cycle=gait.steps_per_cycle * factor
    )


def check_gaits(
    spec: TaskSpec,
    robot: Robot,
    full: bool = True,
    switched: int = 50,
    seed: int = 0,
    progress: Progress = no_progress,
    finer: bool = False,
) -> dict[str, Any]:
    """Play each gait from rest in the reduced dynamics as it is, with finer steps, and in the full FEM.

    Args:
        full: whether the full FEM is asked, which takes minutes.
        switched: cycles, switched at random, in which a walker's falls with finer steps are counted.
        finer: whether bodies of the task's mesh that are reduced less are asked, which have to be built.

    Returns:
        'task'; 'gaits', for each 'name', 'advance_m' and 'turn_rad' ({'reduced', 'refined', 'substeps',
        'full'}: of the reduced dynamics; of the same DMP with every step divided by four; with the
        target's ramp as it is and four times as many substeps; of the full FEM, if it was asked; 'modes',
        'basis', 'drag_points': of bodies with more of these),
        'shifted' ('advance_sd_m', 'turn_sd_rad': how both scatter when all target shapes are moved by a
        constant, normal ones of 'shift' of the amplitude, seeded by `seed`: a gait that answers a little
        bend by much cannot be truer than its body's shapes); 'shape_error' (rms distance of reduced and
        full vertices after a rigid motion, of the rms displacement from rest) and 'attitude_rad' (between
        the two bodies at the end); 'drag_force_error', 'frequency_error' (largest of the first three),
        'falls_refined'.

    Raises:
        DefplanError: the gaits are not of this body, or a solve failed.
    """
    body, gait = robot.body, robot.gait
    if gait.body_hash != body.hash:
        raise DefplanError(
            f"the gaits belong to another body ({gait.body_hash[:8]}) than {body.name}"
            f" ({body.hash[:8]}): solve them for this body"
        )
    divided, more = refined(gait), replace(gait, substeps=FINER * gait.substeps)
    kinds = {
        "reduced": (robot.dynamics, gait),
        "refined": (replace(robot, gait=divided).dynamics, divided),
        "substeps": (replace(robot, gait=more).dynamics, gait),
    }
    rows = []
    tasks = [_task(spec, name) for name in gait.task_names]
    for j, task in enumerate(tasks):
        row: dict[str, Any] = {"name": task.name, "advance_m": {}, "turn_rad": {}}
        states = {}
        for kind, (dynamics, played) in kinds.items():
            progress(f"check: {task.name}, {kind}", j / len(tasks))
            shapes = np.tile(played.table()[j], (SETTLE + CYCLES, 1))
            states[kind] = dynamics.rollout(dynamics.rest_state(), shapes)
            _tell(row, kind, _judged(spec, task, states[kind], played))
        row["shifted"] = _shifted(spec, task, robot, gait.table()[j], seed)
        if full:
            _compare_full(spec, robot, j, states["reduced"], row, progress)
        rows.append(row)
    if finer:
        _compare_finer(spec, robot, rows, progress)
    errors = body.source.get("frequencies", {}).get("error", [])[:3]
    problem = GaitProblem.of(spec.of_gaits(gait.task_names), kinds["refined"][0])
    problem.steps_per_cycle = divided.steps_per_cycle
    progress("check: switching", 1.0)
    falls = evaluate_switching(problem, divided, switched, seed).falls if robot.world.walks else 0
    return {
        "task": spec.name,
        "gaits": rows,
        "shift": SHIFT,
        "drag_force_error": body.source.get("drag", {}).get("error"),
        "frequency_error": max((abs(e) for e in errors), default=None),
        "falls_refined": falls,
    }


def _shifted(
    spec: TaskSpec, task: GaitTask, robot: Robot, shapes: np.ndarray, seed: int
) -> dict[str, float]:
    """Return how much advance and turn of target shapes (n, r) scatter when these are moved a little."""
    dynamics, gait = robot.dynamics, robot.gait
    start = dynamics.rest_state()
    moves = np.random.default_rng(seed).normal(size=(SHIFTS, dynamics.nu)) * SHIFT * gait.amplitude
    motions = [
        _judged(
            spec,
            task,
            dynamics.rollout(start, np.tile(shapes + move, (SETTLE + CYCLES, 1))),
            gait,
        )
        for move in moves
    ]
    return {
        "advance_sd_m": float(np.std([motion.advance for motion in motions])),
        "turn_sd_rad": float(np.std([motion.turn for motion in motions])),
    }


def _judged(spec: TaskSpec, task: GaitTask, states: np.ndarray, gait: Gait) -> Motion:
    """Return the mean motion of the judged cycles of states (N + 1, nx) from rest."""
    return _motion(spec, task, states[SETTLE * gait.steps_per_cycle :: gait.steps_per_cycle])


def _compare_finer(
    spec: TaskSpec, robot: Robot, rows: list[dict[str, Any]], progress: Progress
) -> None:
    """Play the gaits on bodies that are reduced less, and fill in what they do."""
    gait = robot.gait
    for kind, _, fine in finer_bodies(spec, progress):
        dynamics = replace(robot, body=fine).dynamics
        for j, row in enumerate(rows):
            progress(f"check: {row['name']}, more {kind.replace('_', ' ')}", j / len(rows))
            shapes = np.tile(same_shapes(robot.body, fine, gait.table()[j]), (SETTLE + CYCLES, 1))
            states = dynamics.rollout(dynamics.rest_state(), shapes)
            _tell(row, kind, _judged(spec, _task(spec, row["name"]), states, gait))


def _tell(row: dict[str, Any], kind: str, motion: Motion) -> None:
    row["advance_m"][kind], row["turn_rad"][kind] = motion.advance, motion.turn


def _motion(spec: TaskSpec, task: GaitTask, ends: np.ndarray) -> Motion:
    """Return the mean motion between states (cycles + 1, >= 7)."""
    planar = spec.navigation.place.level
    attitude = rotations.rotation(ends[:, 3:7])
    yaw = heading(ends)
    frame = rotations.upright(yaw[:-1]) if planar else attitude[:-1]
    move = frame.inv().apply(np.diff(ends[:, :3], axis=0))
    if planar:
        move[:, 2] = 0.0
        turn = wrap(np.diff(yaw))
    else:
        turn = (frame.inv() * attitude[1:]).as_rotvec() @ np.array(task.turn_axis)
    along = move @ np.array(task.direction) if task.advance else np.linalg.norm(move, axis=1)
    return Motion(float(along.mean()), float(turn.mean()))


def _compare_full(
    spec: TaskSpec,
    robot: Robot,
    j: int,
    reduced: np.ndarray,
    row: dict[str, Any],
    progress: Progress,
) -> None:
    """Play gait j in the full FEM and fill in what differs."""
    body, gait, world = robot.body, robot.gait, robot.world
    n, r = gait.steps_per_cycle, body.n_modes
    fem = FullFem(body, gait.timestep, terrain=world.terrain, integrator=gait.integrator)
    start = reduced[0]
    turned = rotations.matrix(start[3:7])
    state = fem.at(start[7 : 7 + r], start[:3], turned, target=start[13 + 2 * r :])
    steps, shapes = n * (SETTLE + CYCLES), gait.table()[j]
    looked = {steps - n + (i + 1) * n // _POSES for i in range(_POSES)}
    ends, errors, sizes, share = [], [], [], body.vertex_mass / body.mass
    if SETTLE == 0:
        ends.append(_pose(body, state))
    for i in range(1, steps + 1):
        progress(f"check: {row['name']}, full FEM, step {i} of {steps}", i / steps)
        state = fem.step(state, shapes[(i - 1) % n])
        if i % n == 0 and i >= SETTLE * n:
            ends.append(_pose(body, state))
        if i in looked:
            here, there = placed_vertices(body, reduced[i]), state.now
            rotation, move = _fit(share, here, there)
            errors.append(share @ ((here @ rotation.T + move - there) ** 2).sum(1))
            rotation, move = _fit(share, body.vertices, there)
            sizes.append(share @ ((body.vertices @ rotation.T + move - there) ** 2).sum(1))
    _tell(row, "full", _motion(spec, _task(spec, row["name"]), np.array(ends)))
    row["shape_error"] = float(np.sqrt(np.sum(errors) / np.sum(sizes)))
    rotation, _ = _fit(share, placed_vertices(body, reduced[-1]), state.now)
    row["attitude_rad"] = float(rotations.angle(rotation))
    if world.walks:
        row["fell_full"] = bool(tilt(np.array(ends)).max() > MAX_TILT)


def _task(spec: TaskSpec, name: str) -> GaitTask:
    return next(task for task in spec.gait_tasks if task.name == name)


def _pose(body: Body, state: FemState) -> np.ndarray:
    """Return the place and quaternion (7,) of the full body, as the reduced one's that fits it best."""
    share = body.vertex_mass / body.mass
    rotation, _ = _fit(share, body.vertices, state.now)
    return np.concatenate([share @ state.now, rotations.quaternion(rotation)])


def _fit(share: np.ndarray, a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return rotation and move that bring vertices a (n, 3) closest to b (n, 3)."""
    centre_a, centre_b = share @ a, share @ b
    rotation = rotations.kabsch(((b - centre_b) * share[:, None]).T @ (a - centre_a))
    return rotation, centre_b - rotation @ centre_a
