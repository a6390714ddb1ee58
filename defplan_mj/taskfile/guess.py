"""A task for any mesh: which way it looks, its time step and period, its gaits; each guess is said."""

from __future__ import annotations

import dataclasses
import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from defplan_mj.base.errors import DefplanError
from defplan_mj.base.progress import Progress, no_progress
from defplan_mj.body.build import build_body
from defplan_mj.body.convergence import stiffness_correction
from defplan_mj.body.elasticity import moving_modes
from defplan_mj.body.loading import fill_file, read_view
from defplan_mj.body.look import View
from defplan_mj.body.options import BodyOptions
from defplan_mj.body.orientation import direction, turned
from defplan_mj.body.surface import Surface
from defplan_mj.body.tetmesh import TetMesh, boundary, lumped_mass
from defplan_mj.dynamics.world import GROUND
from defplan_mj.gait.problem import GaitProblem
from defplan_mj.gait.style import lateral_share
from defplan_mj.gait.trials import (
    try_tasks,
)
from defplan_mj.task import TaskSpec
from defplan_mj.taskfile.find import EFFORT, MEDIA, mesh_task_name, mesh_task_solvers
from defplan_mj.taskfile.kinds import GAIT_CYCLES, KINDS, Kind, triple
from defplan_mj.taskfile.rhythm import rhythm, stiffened

_ROUND = 0.1  # by how much the two extents across the axis of a round body may differ


_MOST_MODES = 12
_BENDING = 1.2  # summed share of the modes that is sideways bending: the fish's first four have 1.9
_LEAST_ADVANCE, _LEAST_TURN = 0.05, 0.05  # of the length; rad: less is not worth a gait
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
        kind = KINDS["ground" if medium == "ground" else "planar" if axis is None else "spatial"]
        chosen = dataclasses.replace(kind.body, length=size, up=view.up, forward=view.forward)
        progress("task: finding its natural frequencies", 0.3)
        chosen, hertz = _with_modes(path, chosen, kind.bends)
    height = float(np.ptp(body.vertices[:, 2]))
    chosen, hertz = stiffened(kind.rhythm, chosen, hertz, size, height)
    own = (1.0, 0.0, 0.0) if axis is None else axis
    timestep, steps = rhythm(kind.rhythm, hertz, height)
    solvers = mesh_task_solvers(medium)
    spec = TaskSpec(
        name=name or mesh_task_name(path, medium),
        description=f"{path.stem}, guessed from its mesh: it {kind.does}",
        mesh=path,
        body=chosen,
        timestep=timestep,
        steps_per_cycle=steps,
        gait_tasks=kind.gaits(size, own),
        gait_steps=GAIT_CYCLES * steps,
        weights=kind.weights_of(size),
        axis=own,
        terrain=GROUND.terrain if kind.walks else None,
        gait_solver=solvers["gait_solver"],
        planner=solvers["planner"],
        feedback=solvers["feedback"],
        effort=EFFORT,
        navigation=kind.navigation_of(size),
    )
    spec = _as_tried(spec, kind.more, progress)
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


def _with_modes(path: Path, options: BodyOptions, bends: bool) -> tuple[BodyOptions, np.ndarray]:
    """Return the options with as many modes as a body needs, and their frequencies, Hz.

    Frequencies are with the control stiffness. What swims like a fish (it `bends`) needs modes that bend it
    sideways as a whole; legs are slower and come first. All up to the last one are taken that move some of
    the body.
    """
    mesh, material = fill_file(path, options).mesh, options.material
    mass = lumped_mass(mesh.vertices, mesh.tetrahedra, material.density)
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
        tasks.append(dataclasses.replace(task, turn=triple(turn), move=triple(move)))
    slowest = min(d.advance for d, t in zip(tried.trials, tasks, strict=True) if not t.angle)
    usual = spec.navigation
    ways = np.ceil(_WAYS * usual.distance / max(slowest, _LEAST_ADVANCE * size))
    cycles = int(np.clip(ways, usual.max_cycles, 3 * usual.max_cycles))
    navigation = dataclasses.replace(usual, max_cycles=cycles)
    return dataclasses.replace(spec, gait_tasks=tuple(tasks), navigation=navigation)


def _wanted(done: float, least: float, most: float) -> float:
    return float(f"{np.clip(done, min(least, most), most):.2g}")


# ---- how it is said


def _sentence(spec: TaskSpec, view: View, kind: Kind, hertz: np.ndarray, path: Path) -> str:
    """Return what was guessed, in one sentence."""
    stands = "stands on" if kind.walks else "is down on"
    down = view.up[1:] if view.up.startswith("-") else f"-{view.up}"
    young = spec.body.material.youngs_modulus
    names = ", ".join(task.name for task in spec.gait_tasks)
    because = f" ({view.why})" if view.why else ""
    rate = f"{hertz.min():.3g} to {hertz.max():.3g} Hz"
    return (
        f"{path.name}: ahead is {view.forward}, it {stands} its {down} side{because} and is"
        f" {spec.body.length:g} m long (--forward, --up and --length overrule that); it {kind.does},"
        f" {spec.steps_per_cycle} steps of {spec.timestep:g} s a cycle, from natural frequencies of {rate}"
        f" with the control stiffness and a Young's modulus of {young:g} Pa; gaits: {names}"
    )
