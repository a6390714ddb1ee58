"""A task for any mesh: which way it looks, its time step and period, its gaits; each guess is said."""

from __future__ import annotations

import dataclasses
import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree
from threadpoolctl import threadpool_limits

from defplan_mj.base.errors import DefplanError
from defplan_mj.base.progress import Progress, no_progress
from defplan_mj.body.convergence import stiffness_correction
from defplan_mj.body.elasticity import linear_modes
from defplan_mj.body.meshing import fill
from defplan_mj.body.model import Material, Medium
from defplan_mj.body.options import BodyOptions
from defplan_mj.body.orientation import direction, turned
from defplan_mj.body.surface import Surface, load_mesh
from defplan_mj.body.tetmesh import TetMesh, boundary, lumped_mass, volumes
from defplan_mj.dynamics.terrain import STANDARD_GRAVITY
from defplan_mj.dynamics.world import GROUND
from defplan_mj.task import GaitTask, Navigation, TaskSpec, Weights

MEDIA = ("water", "ground")
_SAMPLES = 4000  # points of the surface that are mirrored
_MIRRORED = 0.01  # rms distance of the mirrored surface beyond that of chance, in body lengths
_ROUND = 0.1  # by how much the two extents across the axis of a round body may differ
_LEVEL = 0.02  # of the length: a centre of mass this near the middle says nothing
_COARSE = 800  # vertices
_Y_UP = (".gltf", ".glb")  # the format says so


@dataclass(frozen=True)
class Rhythm:
    """How long a gait cycle is, in units of the slowest natural period; see `rhythm`.

    Attributes:
        periods: a cycle, in periods of the first mode with the control stiffness.
        steps: control steps in a cycle, at least.
        finest: longest time step, in periods of the last mode with the control stiffness.
        falling: a cycle lasts this many sqrt(height / g) at least, on the ground.
    """

    periods: float
    steps: int
    finest: float
    falling: float = 0.0


RHYTHMS = {
    "planar": Rhythm(2.5, 32, 0.56),
    "spatial": Rhythm(1.4, 18, 0.56),
    "ground": Rhythm(2.1, 46, 0.56, 2.6),
}
"""What the shipped tasks have: the fish, the jellyfish-like swimmer, the 4-legged and the T-shaped walker."""
_MOST_STEPS = 200


@dataclass(frozen=True)
class Guess:
    """A task guessed for a mesh.

    Attributes:
        spec: the task.
        sentence: what was guessed, for people.
    """

    spec: TaskSpec
    sentence: str


@dataclass(frozen=True)
class View:
    """Which way a mesh looks.

    Attributes:
        up, forward: axes of the file.
        mirrors: indices of the file's axes across which it is its own mirror image.
        why: how that was found, as a clause.
    """

    up: str
    forward: str
    mirrors: tuple[int, ...]
    why: str


def guess_task(
    mesh: str | Path,
    medium: str,
    length: float | None = None,
    up: str | None = None,
    forward: str | None = None,
    name: str | None = None,
    progress: Progress = no_progress,
    options: BodyOptions | None = None,
) -> Guess:
    """Return a task for a mesh that swims in water, or walks on the ground.

    Args:
        medium: 'water' or 'ground'.
        length: of the body, m; None: 1 m.
        up, forward: axes of the mesh file, e.g. 'z' and '-x'; None: guessed, see `look`.
        name: of the task; None: the mesh's, with '-swim' or '-walk'.
        options: of the body, apart from these; None: defaults of the medium.

    Raises:
        DefplanError: the mesh cannot be used, or an option cannot be.
    """
    if medium not in MEDIA:
        raise DefplanError(f"there is no medium {medium}: it is water or ground")
    path = Path(os.path.abspath(mesh))
    size = 1.0 if length is None else length
    progress("task: reading the mesh", 0.0)
    with threadpool_limits(limits=1):
        loaded = load_mesh(path, size)
        view = look(loaded, path.suffix.lower(), medium, up, forward)
        body = turned(loaded, view.up, view.forward)
        axis = _own_axis(body, view) if medium == "water" else None
        kind = "ground" if medium == "ground" else "planar" if axis is None else "spatial"
        chosen = _body_options(kind, options, size, view)
        progress("task: finding its natural frequencies", 0.3)
        hertz = _frequencies(body, chosen, str(path))
    height = float(np.ptp(body.vertices[:, 2]))
    timestep, steps = rhythm(kind, hertz, height)
    progress("task: guessed", 1.0)
    spec = TaskSpec(
        name=name or f"{plain_name(path.stem)}-{'walk' if kind == 'ground' else 'swim'}",
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
        navigation=_navigation(kind, size),
    )
    return Guess(spec, _sentence(spec, view, kind, hertz, path))


# ---- which way it looks


def look(
    mesh: Surface | TetMesh,
    suffix: str = "",
    medium: str = "water",
    up: str | None = None,
    forward: str | None = None,
) -> View:
    """Return which axes of a mesh are up and ahead, as given, or else as follows.

    Left and right are alike: if there is one mirror plane (of the three through the file's axes), up and
    ahead lie in it. Ahead is the longer of the two, on the side of the centre of mass (tails are thin);
    the other is up, on its positive side. A walker that would then lie on its side with no wider stand
    is not found out: say `up`. Without one mirror plane, z is up (in glTF y), and ahead is the longest of
    the other two.
    """
    points, faces, centre = _solid(mesh)
    extent = np.ptp(points, axis=0)
    mirrors = tuple(
        axis for axis in range(3) if _is_mirror(points, faces, centre, axis, extent.max())
    )
    given = {name[-1] for name in (up, forward) if name}
    free = [axis for axis in range(3) if "xyz"[axis] not in given]
    usual = 1 if suffix in _Y_UP else 2
    why = []
    if len(mirrors) == 1 and mirrors[0] in free:
        free.remove(mirrors[0])
        why.append(f"it is mirrored across {'xyz'[mirrors[0]]}")
        usual = min(free, key=lambda axis: extent[axis]) if len(free) == 2 else usual
        if len(free) == 2 and extent[free[0]] > 0.9 * extent[free[1]] > 0.81 * extent[free[0]]:
            usual = 2 if 2 in free else 1  # about as high as long: as files have it
    if up is None:
        axis = usual if usual in free else max(free)
        free.remove(axis)
        up = "xyz"[axis]
    if forward is None:
        axis = max(free, key=lambda axis: extent[axis])
        low, high = points[:, axis].min(), points[:, axis].max()
        behind = centre[axis] - (low + high) / 2 < -_LEVEL * extent.max()
        forward = ("-" if behind else "") + "xyz"[axis]
        why.append(f"longest along {forward[-1]}" if extent[axis] >= extent.max() else "")
        why.append(
            "heavier in front"
            if abs(centre[axis] - (low + high) / 2) > _LEVEL * extent.max()
            else ""
        )
    told = ", ".join(filter(None, why)) or "as given"
    return View(up, forward, mirrors, told)


def _solid(mesh: Surface | TetMesh) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return vertices and triangles of the surface, and the centre of volume (3,)."""
    if isinstance(mesh, TetMesh):
        size = volumes(mesh.vertices, mesh.tetrahedra)
        middle = mesh.vertices[mesh.tetrahedra].mean(1)
        faces, _ = boundary(mesh.tetrahedra)
        return mesh.vertices[np.unique(faces)], _renumbered(faces), size @ middle / size.sum()
    corners = mesh.vertices[mesh.faces]
    size = np.einsum("ij,ij->i", np.cross(corners[:, 0], corners[:, 1]), corners[:, 2]) / 6
    return mesh.vertices, mesh.faces, size @ (corners.sum(1) / 4) / size.sum()


def _renumbered(faces: np.ndarray) -> np.ndarray:
    return np.unique(faces, return_inverse=True)[1].reshape(-1, 3)


def _is_mirror(
    vertices: np.ndarray, faces: np.ndarray, centre: np.ndarray, axis: int, length: float
) -> bool:
    """Return whether a surface is its own mirror image across the plane through its centre.

    Points drawn on it are mirrored; they have to lie about as near to others drawn on it as these do.
    """
    here, there = _drawn(vertices, faces, 0), _drawn(vertices, faces, 1)
    image = here.copy()
    image[:, axis] = 2 * centre[axis] - image[:, axis]
    tree = cKDTree(there)
    chance, found = tree.query(here)[0], tree.query(image)[0]
    return bool(np.sqrt((found**2).mean()) < np.sqrt((chance**2).mean()) + _MIRRORED * length)


def _drawn(vertices: np.ndarray, faces: np.ndarray, seed: int) -> np.ndarray:
    """Return points (n, 3) drawn evenly on a surface."""
    random = np.random.default_rng(seed)
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    chosen = random.choice(len(faces), _SAMPLES, p=area / area.sum())
    first, second = random.random((2, _SAMPLES, 1))
    over = first + second > 1
    first, second = np.where(over, 1 - first, first), np.where(over, 1 - second, second)
    return a[chosen] + first * (b - a)[chosen] + second * (c - a)[chosen]


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


# ---- how fast it moves


def rhythm(kind: str, hertz: Sequence[float] | np.ndarray, height: float) -> tuple[float, int]:
    """Return the time step, s, and the steps of a cycle.

    With f the natural frequencies with the control stiffness, which is what the target shape pulls with:
    a cycle is 2.5 / f_1 (a swimmer in the plane), 1.4 / f_1 (in space) or 2.1 / f_1 on the ground, there
    at least 2.6 sqrt(height / g), the time of falling over; 32, 18 and 46 steps a cycle, and more if
    the last mode would have fewer than 1.8 of them in a period. So have it the shipped tasks: the fish
    2.50, the swimmer 1.38, the walkers 2.11 and 2.6. The time step has three digits.

    Args:
        kind: 'planar', 'spatial' or 'ground'.
        hertz: of the modes that are used, with the control stiffness.
        height: of the body, m.
    """
    rule = RHYTHMS[kind]
    period = max(rule.periods / min(hertz), rule.falling * np.sqrt(height / STANDARD_GRAVITY))
    steps = max(rule.steps, int(np.ceil(period * max(hertz) / rule.finest)))
    steps = min(steps, _MOST_STEPS)
    return float(f"{period / steps:.3g}"), steps


def _frequencies(body: Surface | TetMesh, options: BodyOptions, name: str) -> np.ndarray:
    """Return the natural frequencies with the control stiffness, Hz."""
    mesh = body if isinstance(body, TetMesh) else _coarse(body, options.vertices, name)
    material = options.material
    mass = lumped_mass(mesh.vertices, mesh.tetrahedra, material.density)
    values, modes = linear_modes(mesh, material, mass, options.modes)
    correction = stiffness_correction(mesh, material, mass, modes)
    hertz = np.sqrt(values * correction.young) / (2 * np.pi)
    return hertz * np.sqrt(1.0 + material.control_stiffness)


def _coarse(surface: Surface, vertices: int, name: str) -> TetMesh:
    """Return a surface filled coarsely if that loses nothing: frequencies are corrected for it."""
    try:
        return fill(surface, min(vertices, _COARSE), name)[0]
    except DefplanError:
        if vertices <= _COARSE:
            raise
        return fill(surface, vertices, name)[0]


# ---- what it is to do

_DOES = {
    "planar": "swims in the plane",
    "spatial": "swims in space",
    "ground": "walks",
}
_GAIT_CYCLES = {"planar": 18, "spatial": 11, "ground": 8}  # as the shipped tasks have


def gait_tasks(
    kind: str, length: float, axis: Sequence[float] | None = None
) -> tuple[GaitTask, ...]:
    """Return what the gaits should do, in body lengths.

    In water in the plane: forward, left, right; in space: tilts of the own axis to four sides, and forward
    along it; on the ground forward, back, left and right without turning.
    """
    if kind == "ground":
        sides = {"forward": (1, 0), "back": (-1, 0), "left": (0, 1), "right": (0, -1)}
        return tuple(
            GaitTask(name, move=(0.4 * length * x, 0.4 * length * y, 0.0))
            for name, (x, y) in sides.items()
        )
    if kind == "planar":
        return (
            GaitTask("forward", move=(0.5 * length, 0.0, 0.0)),
            GaitTask("left", turn=(0.0, 0.0, 0.6), move=(0.3 * length, 0.0, 0.0)),
            GaitTask("right", turn=(0.0, 0.0, -0.6), move=(0.3 * length, 0.0, 0.0)),
        )
    own = np.array((0.0, 0.0, 1.0) if axis is None else axis)
    first = np.array([1.0, 0.0, 0.0]) if abs(own[0]) < 0.5 else np.array([0.0, 0.0, -1.0])
    names = {
        "front": first,
        "back": -first,
        "left": np.cross(own, first),
        "right": np.cross(first, own),
    }
    still = (0.0, 0.0, 0.0)
    tilts = [GaitTask(n, _triple(0.45 * np.cross(own, to)), still) for n, to in names.items()]
    return (*tilts, GaitTask("forward", move=_triple(0.5 * length * own)))


def _triple(vector: np.ndarray) -> tuple[float, float, float]:
    x, y, z = (float(value) + 0.0 for value in np.round(vector, 9))
    return x, y, z


def _body_options(kind: str, options: BodyOptions | None, length: float, view: View) -> BodyOptions:
    """Return how the body is built: as the shipped task of its kind is, or as asked for."""
    kept: dict[str, Any] = {"length": length, "up": view.up, "forward": view.forward}
    usual = {
        "planar": BodyOptions(modes=5, basis=31, samples=16, amplitude=2.0),
        "spatial": BodyOptions(
            vertices=1500, modes=10, basis=60, samples=24, medium=Medium(righting_height=0.0)
        ),
        "ground": BodyOptions(
            vertices=1500, modes=10, basis=31, drag_error=0.3, amplitude=1.0,
            material=Material(damping=0.15), medium=GROUND.medium,
        ),
    }[kind]  # fmt: skip
    if options is not None:
        kept |= {"medium": usual.medium}
    return dataclasses.replace(options or usual, **kept)


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
    """Return the navigation problem of the shipped tasks, in body lengths."""
    usual = Navigation(k2=30, beams=128, space="spatial") if kind == "spatial" else Navigation()
    names = ("distance", "goal_radius", "laser_range")
    return dataclasses.replace(usual, **{n: length * getattr(usual, n) for n in names})


# ---- how it is said


def plain_name(stem: str) -> str:
    """Return a file's stem as a task's name."""
    return re.sub(r"[^\w.+-]+", "-", stem).strip("-.+") or "body"


def _sentence(spec: TaskSpec, view: View, kind: str, hertz: np.ndarray, path: Path) -> str:
    """Return what was guessed, in one sentence."""
    stands = "stands on" if kind == "ground" else "is down on"
    down = view.up[1:] if view.up.startswith("-") else f"-{view.up}"
    rate = f"{hertz.min():.3g} to {hertz.max():.3g} Hz"
    return (
        f"{path.name}: ahead is {view.forward}, it {stands} its {down} side ({view.why}) and is"
        f" {spec.body.length:g} m long (--forward, --up and --length overrule that); it {_DOES[kind]},"
        f" {spec.steps_per_cycle} steps of {spec.timestep:g} s a cycle, from natural frequencies of {rate}"
        f" with the control stiffness; gaits: {', '.join(task.name for task in spec.gait_tasks)}"
    )
