"""A task for any mesh: which way it looks, its time step and period, its gaits; each guess is said."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from defplan_mj.base.errors import DefplanError
from defplan_mj.base.progress import Progress, no_progress
from defplan_mj.body.build import build_body
from defplan_mj.body.convergence import stiffness_correction
from defplan_mj.body.elasticity import moving_modes
from defplan_mj.body.fidelity import MOST_DISTANCE
from defplan_mj.body.loading import fill_file, read_view
from defplan_mj.body.look import View
from defplan_mj.body.model import Material, Medium
from defplan_mj.body.options import BodyOptions
from defplan_mj.body.orientation import direction, turned
from defplan_mj.body.surface import Surface
from defplan_mj.body.tetmesh import TetMesh, boundary, lumped_mass
from defplan_mj.dynamics.world import GROUND
from defplan_mj.gait.problem import GaitProblem
from defplan_mj.gait.style import lateral_share
from defplan_mj.gait.trials import (
    ADVANCE,
    BENT_ADVANCE,
    BENT_STEP,
    STEP,
    STEP_TURN,
    TILT,
    TURN,
    try_tasks,
)
from defplan_mj.task import GaitTask, Navigation, TaskSpec, Weights
from defplan_mj.taskfile.find import EFFORT, MEDIA, mesh_task_name, mesh_task_solvers
from defplan_mj.taskfile.rhythm import rhythm, stiffened

_ROUND = 0.1  # by how much the two extents across the axis of a round body may differ


_MOST_MODES = 12
_BENDING = 1.2  # summed share of the modes that is sideways bending: the fish's first four have 1.9
_MOVED = 0.01  # a fish's tail fin moves 1.4% of it, a cow's ears, horns and tail .2 to .6%
_LEAST_ADVANCE, _LEAST_TURN = 0.05, 0.05  # of the length; rad: less is not worth a gait
_MORE = {"planar": 2.0, "spatial": 2.0, "ground": 1.0}
"""Times what a short trial reached is wanted; of a walker no more, or it falls."""
_WAYS = 6  # a time-out allows so many times the way


@dataclass(frozen=True)
class Guess:
    """A task guessed for a mesh.

    Attributes:
        spec: the task.
        sentence: what was guessed, for people.
        shape: the mesh's surface as it was taken, x ahead and z up.
    """

    spec: TaskSpec
    sentence: str
    shape: Surface


def guess_task(
    mesh: str | Path,
    medium: str,
    length: float | None = None,
    up: str | None = None,
    forward: str | None = None,
    name: str | None = None,
    progress: Progress = no_progress,
) -> Guess:
    """Return a task for a mesh that swims in water, or walks on the ground.

    Args:
        medium: 'water' or 'ground'.
        length: of the body, m; None: 1 m.
        up, forward: axes of the mesh file, e.g. 'z' and '-x'; None: guessed, see `look`.
        name: of the task; None: the mesh's, with '-swim' or '-walk'.

    Raises:
        DefplanError: the mesh cannot be used, or an option cannot be.
    """
    if medium not in MEDIA:
        raise DefplanError(f"there is no medium {medium}: it is water or ground")
    path = Path(os.path.abspath(mesh))
    size = 1.0 if length is None else length
    progress("task: reading the mesh", 0.0)
    with threadpool_limits(limits=1):
        loaded, view = read_view(path, medium, size, up, forward)
        body = turned(loaded, view.up, view.forward)
        axis = _own_axis(body, view) if medium == "water" else None
        kind = "ground" if medium == "ground" else "planar" if axis is None else "spatial"
        chosen = dataclasses.replace(BODIES[kind], length=size, up=view.up, forward=view.forward)
        progress("task: finding its natural frequencies", 0.3)
        chosen, hertz = _with_modes(path, chosen)
    height = float(np.ptp(body.vertices[:, 2]))
    chosen, hertz = stiffened(kind, chosen, hertz, size, height)
    timestep, steps = rhythm(kind, hertz, height)
    solvers = mesh_task_solvers(medium)
    spec = TaskSpec(
        name=name or mesh_task_name(path, medium),
        description=f"{path.stem}, guessed from its mesh: it {_DOES[kind]}",
        mesh=path,
        body=chosen,
        timestep=timestep,
        steps_per_cycle=steps,
        gait_tasks=gait_tasks(kind, size, axis),
        gait_steps=_GAIT_CYCLES[kind] * steps,
        weights=_weights(kind, size),
        axis=(1.0, 0.0, 0.0) if axis is None else axis,
        terrain=GROUND.terrain if kind == "ground" else None,
        gait_solver=solvers["gait_solver"],
        planner=solvers["planner"],
        feedback=solvers["feedback"],
        effort=EFFORT,
        navigation=_navigation(kind, size),
    )
    spec = _as_tried(spec, _MORE[kind], progress)
    progress("task: guessed", 1.0)
    surface = (
        body if isinstance(body, Surface) else Surface(body.vertices, boundary(body.tetrahedra)[0])
    )
    return Guess(spec, _sentence(spec, view, kind, hertz, path), surface)


def _own_axis(body: Surface | TetMesh, view: View) -> tuple[float, float, float] | None:
    """Return the own axis of a body that is alike all around it, mirrored across two planes; else None.

    It swims in space, like a jellyfish; with a third plane, or longer than three times its width, in the plane,
    like a fish.
    """
    if len(view.mirrors) != 2:
        return None
    across = [axis for axis in range(3) if axis in view.mirrors]
    along = ({0, 1, 2} - set(across)).pop()
    frame = np.array([direction(view.forward), np.zeros(3), direction(view.up)])
    frame[1] = np.cross(frame[2], frame[0])
    extent = abs(frame.T) @ np.ptp(body.vertices, axis=0)  # along the file's axes
    wide = extent[across]
    if abs(wide[0] - wide[1]) > _ROUND * wide.max() or extent[along] > 3 * wide.max():
        return None
    own = frame @ np.eye(3)[along]
    own = np.abs(np.round(own)) + 0.0
    return float(own[0]), float(own[1]), float(own[2])


def _with_modes(path: Path, options: BodyOptions) -> tuple[BodyOptions, np.ndarray]:
    """Return the options with as many modes as a body needs, and their frequencies, Hz.

    Frequencies are with the control stiffness. What swims like a fish needs modes that bend it sideways as a
    whole; legs are slower and come first. All up to the last one are taken that move some of the body.
    """
    mesh, material = fill_file(path, options).mesh, options.material
    mass = lumped_mass(mesh.vertices, mesh.tetrahedra, material.density)
    bends = options.modes == BODIES["planar"].modes
    count = _MOST_MODES if bends else options.modes
    values, modes, place = moving_modes(mesh, material, mass, count, options.moved)
    if bends:
        share = np.cumsum(lateral_share(mesh.vertices, modes, mass))
        enough = int(np.searchsorted(share, _BENDING)) + 1
        options = dataclasses.replace(
            options, modes=int(np.clip(enough, options.modes, _MOST_MODES))
        )
        values, modes = values[: options.modes], modes[..., : options.modes]
    # of the body's first modes: all modes are corrected alike, by what these are too stiff
    correction = stiffness_correction(mesh, material, mass, modes[..., :3], values[:3], place[2])
    hertz = np.sqrt(values * correction.young) / (2 * np.pi)
    return options, hertz * np.sqrt(1.0 + material.control_stiffness)


# ---- what it can do


def _as_tried(spec: TaskSpec, more: float, progress: Progress) -> TaskSpec:
    """Return a task that wants `more` times what short trials of its body reached: a third of it is asked for.

    At most what it wants already, and at least a twentieth of its length and of a radian a cycle. The slower
    it is, the later an episode times out.
    """
    body = build_body(spec.mesh, spec.body, progress)
    problem = GaitProblem.of(spec, spec.dynamics(body))
    size = spec.body.length or 1.0
    tasks = []
    tried = try_tasks(problem, progress=lambda message, done: progress(f"task: {message}", done))
    for task, done in zip(spec.gait_tasks, tried.trials, strict=True):
        turn, move = np.array(task.turn), np.array(task.move)
        if task.angle:
            turn *= _wanted(more * done.turn, _LEAST_TURN, task.angle) / task.angle
        if task.advance:
            move *= _wanted(more * done.advance, _LEAST_ADVANCE * size, task.advance) / task.advance
        tasks.append(dataclasses.replace(task, turn=_triple(turn), move=_triple(move)))
    slowest = min(d.advance for d, t in zip(tried.trials, tasks, strict=True) if not t.angle)
    usual = spec.navigation
    ways = np.ceil(_WAYS * usual.distance / max(slowest, _LEAST_ADVANCE * size))
    cycles = int(np.clip(ways, usual.max_cycles, 3 * usual.max_cycles))
    navigation = dataclasses.replace(usual, max_cycles=cycles)
    return dataclasses.replace(spec, gait_tasks=tuple(tasks), navigation=navigation)


def _wanted(done: float, least: float, most: float) -> float:
    return float(f"{np.clip(done, min(least, most), most):.2g}")


# ---- what it is to do

_DOES = {
    "planar": "swims in the plane",
    "spatial": "swims in space",
    "ground": "walks",
}
_GAIT_CYCLES = {"planar": 8, "spatial": 8, "ground": 8}  # half of what the shipped swimmers have


def gait_tasks(
    kind: str, length: float, axis: Sequence[float] | None = None
) -> tuple[GaitTask, ...]:
    """Return what the gaits should do, in body lengths.

    In water in the plane, and on the ground: forward, left, right; in space: tilts of the own axis to four
    sides, and forward along it.
    """
    if kind == "ground":
        return _straight_and_bent(STEP * length, STEP_TURN, BENT_STEP * length)
    if kind == "planar":
        return _straight_and_bent(ADVANCE * length, TURN, BENT_ADVANCE * length)
    own = np.array((0.0, 0.0, 1.0) if axis is None else axis)
    first = np.array([1.0, 0.0, 0.0]) if abs(own[0]) < 0.5 else np.array([0.0, 0.0, -1.0])
    names = {
        "front": first,
        "back": -first,
        "left": np.cross(own, first),
        "right": np.cross(first, own),
    }
    still = (0.0, 0.0, 0.0)
    tilts = [GaitTask(n, _triple(TILT * np.cross(own, to)), still) for n, to in names.items()]
    return (*tilts, GaitTask("forward", move=_triple(ADVANCE * length * own)))


def _straight_and_bent(ahead: float, turn: float, bent: float) -> tuple[GaitTask, ...]:
    """Return forward, and left and right with a turn (rad), by how far (m)."""
    sides = {"left": turn, "right": -turn}
    turns = (GaitTask(n, turn=(0.0, 0.0, t), move=(bent, 0.0, 0.0)) for n, t in sides.items())
    return (GaitTask("forward", move=(ahead, 0.0, 0.0)), *turns)


def _triple(vector: np.ndarray) -> tuple[float, float, float]:
    x, y, z = (float(value) + 0.0 for value in np.round(vector, 9))
    return x, y, z


BODIES = {
    "planar": BodyOptions(
        modes=5,
        basis=31,
        samples=16,
        drag_error=0.06,
        amplitude=2.0,
        shape_error=MOST_DISTANCE,
        moved=_MOVED,
    ),
    "spatial": BodyOptions(
        vertices=1500,
        modes=10,
        basis=60,
        samples=24,
        drag_error=0.06,
        medium=Medium(righting_height=0.0),
        shape_error=MOST_DISTANCE,
        moved=_MOVED,
    ),
    "ground": BodyOptions(
        vertices=1500,
        modes=10,
        basis=31,
        drag_error=0.3,
        amplitude=1.0,
        material=Material(damping=0.15),
        medium=GROUND.medium,
        shape_error=MOST_DISTANCE,
        moved=_MOVED,
    ),
}
"""How bodies are built: about as those of the shipped tasks."""


def _weights(kind: str, length: float) -> Weights:
    """Return the weights of the shipped task of its kind; those of lengths are per body length."""
    usual = {
        "planar": Weights(effort=0.15, style="sideways"),
        "spatial": Weights(turn=6.0, move=6.0, drift=6.0, roll=1.0, effort=0.15, style="pulse"),
        "ground": Weights(turn=3.0, move=8.0, drift=8.0, tilt=3.0, slip=0.8),
    }[kind]
    per_square = {n: getattr(usual, n) / length**2 for n in ("move", "drift", "sink")}
    return dataclasses.replace(usual, slip=usual.slip / length, **per_square)


def _navigation(kind: str, length: float) -> Navigation:
    """Return the navigation problem of the shipped tasks, half as far and in body lengths.

    Most of a run's time goes into its evaluation, and that into the way. There are half as many obstacles,
    so that they stand as close together. A walker's targets are at 6 lengths: a stranger's steps are short.
    """
    near = Navigation(distance=10.0, k2_obstacles=1, novel_obstacles=5)
    if kind == "ground":
        near = dataclasses.replace(near, distance=6.0, novel_obstacles=3)
    usual = dataclasses.replace(near, beams=128, space="spatial") if kind == "spatial" else near
    names = ("distance", "goal_radius", "laser_range")
    return dataclasses.replace(usual, **{n: length * getattr(usual, n) for n in names})


# ---- how it is said


def _sentence(spec: TaskSpec, view: View, kind: str, hertz: np.ndarray, path: Path) -> str:
    """Return what was guessed, in one sentence."""
    stands = "stands on" if kind == "ground" else "is down on"
    down = view.up[1:] if view.up.startswith("-") else f"-{view.up}"
    young = spec.body.material.youngs_modulus
    names = ", ".join(task.name for task in spec.gait_tasks)
    because = f" ({view.why})" if view.why else ""
    rate = f"{hertz.min():.3g} to {hertz.max():.3g} Hz"
    return (
        f"{path.name}: ahead is {view.forward}, it {stands} its {down} side{because} and is"
        f" {spec.body.length:g} m long (--forward, --up and --length overrule that); it {_DOES[kind]},"
        f" {spec.steps_per_cycle} steps of {spec.timestep:g} s a cycle, from natural frequencies of {rate}"
        f" with the control stiffness and a Young's modulus of {young:g} Pa; gaits: {names}"
    )
