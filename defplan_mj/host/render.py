"""Pictures and videos of states in their scene, without a screen (EGL or OSMesa)."""

from __future__ import annotations

import dataclasses
import difflib
import importlib
import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import imageio.v2 as imageio
import mujoco
import numpy as np
from PIL import Image

from defplan_mj.base import files, rotations
from defplan_mj.base.errors import DefplanError
from defplan_mj.base.progress import Progress, no_progress
from defplan_mj.base.space import PLANE
from defplan_mj.body.model import Body
from defplan_mj.dynamics.terrain import Terrain
from defplan_mj.host.ground import height_above
from defplan_mj.host.looks import LOOKS
from defplan_mj.host.obstacles import set_scene
from defplan_mj.host.scene import FLOOR_DEPTH, SUN, build_spec, compile_model, view_length
from defplan_mj.planning.scene import Scene

MAP = "map"  # sees the whole way from straight above, to scale
OVERVIEW = "overview"  # sees the whole way from behind and above
CHASE, SIDE, TOP = "chase", "side", "top"  # of the model: near the robot
CAMERAS = (CHASE, SIDE, TOP, MAP, OVERVIEW)
FORMATS = (".mp4", ".webp", ".gif", ".png")

TRAIL_RGBA = np.array([0.95, 0.98, 1.0, 1.0], np.float32)
_TRAIL_RADIUS = {MAP: 0.06, OVERVIEW: 0.03}  # m
_TRAIL_PIECES = 240  # a longer way is drawn in longer pieces
_TARGET_RGBA = np.array([0.90, 0.16, 0.10, 1.0], np.float32)
_SHADOW_RGBA = np.array([0.05, 0.08, 0.10, 0.22], np.float32)
_GROUND = 120.0  # m to each side, of ground that is not infinite
_SQUARE = 10.0  # m, of what that ground is made of
_TURNING_SECONDS = 0.8  # over which the heading is averaged that the camera at the side turns with
_BACKENDS = ("egl", "osmesa", "glfw")
_MOTE_RGBA = np.array([0.85, 0.95, 0.95, 0.55], np.float32)
_MOTE_CELL, _MOTE_SIZE, _MOTE_REACH = 1.25, 0.006, 5  # m; m; cells to each side


@dataclass(frozen=True)
class Quality:
    """How much work a picture is.

    Attributes:
        size: width, height in pixels.
        samples: of each pixel, against stairs along edges.
        shadows: whether the sun casts any.
        fine: whether the ground reaches the horizon and round things are very round.
    """

    size: tuple[int, int]
    samples: int
    shadows: bool
    fine: bool


STILL = Quality((960, 540), 8, True, True)
MOVING = Quality((480, 270), 0, False, False)
"""A picture may take its time; in a video, edges move, and a machine without a GPU draws each pixel."""


def check_video(path: str | Path, camera: str = CHASE) -> None:
    """Raise DefplanError if no video can be drawn at `path` by that camera; to be asked before long work."""
    if Path(path).is_dir():
        raise DefplanError(
            f"{path} is a folder: name a video in it, for example {Path(path) / 'fish.mp4'}"
        )
    if Path(path).suffix.lower() not in FORMATS:
        raise DefplanError(
            f"cannot write a video as {path}: end its name in .mp4, .webp, .gif or .png"
        )
    if camera not in CAMERAS:
        close = difflib.get_close_matches(camera, CAMERAS, n=1)
        guess = f", did you mean {close[0]}?" if close else ":"
        raise DefplanError(f"there is no camera {camera}{guess} there are {', '.join(CAMERAS)}")
    files.check_writable(path)


class Offscreen:
    """An OpenGL context without a window, and the pictures of one model; a context manager."""

    def __init__(self, model: mujoco.MjModel, width: int, height: int):
        """Open the first of EGL, OSMesa and GLFW that works (MUJOCO_GL comes first).

        Raises:
            DefplanError: none works.
        """
        model.vis.global_.offwidth = max(width, model.vis.global_.offwidth)
        model.vis.global_.offheight = max(height, model.vis.global_.offheight)
        self._context = _open_context(width, height)
        self._model = model
        scale = mujoco.mjtFontScale  # of what is written into pictures
        font = scale.mjFONTSCALE_150 if width >= 600 else scale.mjFONTSCALE_100
        self._mjr = mujoco.MjrContext(model, font)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._mjr)
        self._rect = mujoco.MjrRect(0, 0, width, height)
        self._option = mujoco.MjvOption()
        self.scene = mujoco.MjvScene(model, maxgeom=20000)
        self._trail = 0, 0  # where in the scene its pieces begin, and how many are there

    def __enter__(self) -> Offscreen:
        return self

    def __exit__(self, *_: object) -> None:
        self._mjr.free()
        self._context.free()

    def picture(
        self,
        data: mujoco.MjData,
        camera: mujoco.MjvCamera,
        trail: np.ndarray | None = None,
        trail_radius: float = 0.012,
        trail_every: int = 1,
        motes: np.ndarray | None = None,
        target: np.ndarray | None = None,
        shadow: np.ndarray | None = None,
        shadow_radius: float = 0.24,
        caption: tuple[str, str] = ("", ""),
    ) -> np.ndarray:
        """Return the (height, width, 3) uint8 picture of `data`.

        Args:
            trail: (n, 3) points to join by a line, m, a piece to `trail_every` of them; of radius
                `trail_radius`, m (0: a thin line). The next picture's must begin with the same points.
            motes: (n, 3) places of specks floating in the water, m; see `motes_around`.
            target: (3,) place of a ball with a pole on it, m.
            shadow: (3,) place of a soft spot of shadow on level ground, m, of radius `shadow_radius`, m.
            caption: names and values, line by line, written into the upper left corner.
        """
        perturb, everything = mujoco.MjvPerturb(), mujoco.mjtCatBit.mjCAT_ALL
        mujoco.mjv_updateScene(
            self._model, data, self._option, perturb, camera, everything, self.scene
        )
        if trail is not None:
            self._add_trail(trail, trail_radius, trail_every)
        if motes is not None:
            self._add_motes(motes)
        if target is not None:
            self._add_target(target)
        if shadow is not None:
            size = np.array([shadow_radius, shadow_radius, 0.004])
            self._add(mujoco.mjtGeom.mjGEOM_ELLIPSOID, size, shadow, _SHADOW_RGBA)
        pixels = np.empty((self._rect.height, self._rect.width, 3), np.uint8)
        mujoco.mjr_render(self._rect, self.scene, self._mjr)
        if any(caption):
            font, corner = mujoco.mjtFont.mjFONT_NORMAL, mujoco.mjtGridPos.mjGRID_TOPLEFT
            mujoco.mjr_overlay(font, corner, self._rect, *caption, self._mjr)
        mujoco.mjr_readPixels(pixels, None, self._rect, self._mjr)
        return np.ascontiguousarray(pixels[::-1])

    def _add_trail(self, points: np.ndarray, radius: float, every: int) -> None:
        # the pieces of the picture before are still in their places in the scene
        first, there = self._trail
        whole = (len(points) - 1) // every
        if first != self.scene.ngeom or there > whole:
            first, there = self.scene.ngeom, 0
        self.scene.ngeom += there
        corners = np.concatenate([points[there * every :: every], points[-1:]])
        # a line casts no shadow, and costs a tenth of a capsule
        kind = mujoco.mjtGeom.mjGEOM_CAPSULE if radius else mujoco.mjtGeom.mjGEOM_LINE
        for start, end in zip(corners, corners[1:], strict=False):
            if self.scene.ngeom == self.scene.maxgeom:
                break
            geom = self.scene.geoms[self.scene.ngeom]
            mujoco.mjv_initGeom(geom, kind, np.zeros(3), np.zeros(3), np.zeros(9), TRAIL_RGBA)
            mujoco.mjv_connector(geom, kind, radius or 2.0, start, end)
            self.scene.ngeom += 1
        self._trail = first, min(whole, self.scene.ngeom - first)

    def _add_target(self, place: np.ndarray) -> None:
        """Add what shows a target from afar: its radius is drawn by the model."""
        self._add(mujoco.mjtGeom.mjGEOM_SPHERE, np.full(3, 0.12), place, _TARGET_RGBA)
        pole = np.array([0.035, 0.035, 1.5])
        self._add(mujoco.mjtGeom.mjGEOM_CYLINDER, pole, place + [0, 0, 1.5], _TARGET_RGBA)

    def _add(
        self, kind: mujoco.mjtGeom, size: np.ndarray, place: np.ndarray, rgba: np.ndarray
    ) -> None:
        if self.scene.ngeom == self.scene.maxgeom:
            return
        geom = self.scene.geoms[self.scene.ngeom]
        mujoco.mjv_initGeom(geom, kind, size, place, np.eye(3).ravel(), rgba)
        geom.transparent = int(rgba[3] < 1)
        self.scene.ngeom += 1

    def _add_motes(self, places: np.ndarray) -> None:
        size, upright = np.full(3, _MOTE_SIZE), np.eye(3).ravel()
        places = places[self._in_view(places)]
        for place in places[: self.scene.maxgeom - self.scene.ngeom]:
            geom = self.scene.geoms[self.scene.ngeom]
            mujoco.mjv_initGeom(geom, mujoco.mjtGeom.mjGEOM_BOX, size, place, upright, _MOTE_RGBA)
            geom.transparent = 1
            self.scene.ngeom += 1

    def _in_view(self, places: np.ndarray) -> np.ndarray:
        """Return which places (n, 3) the scene's camera, one with perspective, has in its picture, (n,)."""
        camera = self.scene.camera[0]  # one eye and the other are closer than a mote is large
        ahead, up = np.array(camera.forward), np.array(camera.up)
        axes = np.stack([np.cross(ahead, up), up, ahead], axis=1)
        across, high, along = ((places - np.array(camera.pos)) @ axes).T
        rise = camera.frustum_top / camera.frustum_near * along
        wide = rise * self._rect.width / self._rect.height
        return (along > 0) & (np.abs(high) < rise) & (np.abs(across) < wide)


def motes_around(centre: np.ndarray) -> np.ndarray:
    """Return the places (n, 3) of specks in the water around a point, m: one in every cell of a grid.

    A mote stays where it is, whatever point is asked for, so that motion shows in open water.
    """
    reach = np.arange(-_MOTE_REACH, _MOTE_REACH + 1)
    grid = np.stack(np.meshgrid(reach, reach, reach, indexing="ij"), -1).reshape(-1, 3)
    cells = grid + np.round(centre / _MOTE_CELL).astype(int)
    # a place within the cell that looks random but is the cell's own
    number = cells @ np.array([[73, 179, 283], [419, 29, 211], [157, 347, 61]])
    return _MOTE_CELL * (cells + number * (number + 11) % 997 / 997 - 0.5)


Caption = Callable[[int], tuple[str, str]]
"""Index of a state -> names and values to be written into its picture, line by line."""


def render_states(
    body: Body,
    states: np.ndarray,
    scene: Scene | None = None,
    path: str | Path | None = None,
    size: tuple[int, int] | None = None,
    fps: float = 25.0,
    camera: str = CHASE,
    *,
    timestep: float = 0.04,
    trail: bool = True,
    terrain: Terrain | None = None,
    texture: np.ndarray | None = None,
    caption: Caption | None = None,
    quality: Quality | None = None,
    progress: Progress = no_progress,
) -> list[np.ndarray]:
    """Draw states in their scene: a video, a picture, or frames.

    Args:
        states: (n, 13 + 3r), `timestep` apart, the first at time 0.
        path: an .mp4, .webp or .gif file takes all frames in real time; a .png takes the last state, with
            the way to it; None returns the frames.
        size: width, height in pixels; None: that of the quality.
        fps: frames a second of simulated time.
        camera: 'chase', 'top' follow the body, without turning with it; 'side' turns with the heading of
            one that stays upright; 'map' sees the whole way from straight above, to scale; 'overview'
            from behind and above.
        timestep: s.
        trail: draw the way of the centre of mass.
        terrain: what the robot walks on.
        texture: of the skin, see `skin.add_skin`.
        caption: what is written into a picture.
        quality: None: `STILL` for a picture, `MOVING` for a video.

    Returns:
        The frames, (height, width, 3) uint8, if `path` is None, else an empty list.

    Raises:
        DefplanError: no way to draw without a screen, or the file cannot be written.
    """
    states = np.atleast_2d(states)
    if path is not None:
        check_video(path, camera)
    still = path is not None and Path(path).suffix.lower() == ".png"
    quality = quality or (STILL if still else MOVING)
    if size is not None:
        quality = dataclasses.replace(quality, size=size)
    times = timestep * np.arange(len(states))
    instants = times[-1:] if still else np.arange(0.0, times[-1] + 0.5 * timestep, 1 / fps)
    indices = np.minimum(np.round(instants / timestep).astype(int), len(states) - 1)
    space = PLANE.name if scene is None else scene.space
    spec = build_spec(
        body,
        timestep,
        max_obstacles=0 if scene is None else len(scene.radii),
        space=space,
        terrain=terrain,
        texture=texture,
    )
    film = _Film(
        compile_model(spec),
        states,
        scene,
        timestep,
        camera,
        quality,
        trail,
        length=view_length(body),
        walks=terrain is not None,
    )
    frames = film.frames(indices, caption, progress)
    if path is None:
        return list(frames)
    _write(frames, Path(path), fps, still)
    return []


@dataclass(frozen=True, eq=False)
class _Film:
    """Pictures of states by one camera."""

    model: mujoco.MjModel
    states: np.ndarray
    scene: Scene | None
    timestep: float
    camera: str
    quality: Quality
    trail: bool
    length: float
    walks: bool

    def frames(
        self, indices: Sequence[int], caption: Caption | None, progress: Progress
    ) -> Iterator[np.ndarray]:
        """Yield the pictures of some of the states."""
        model, states, scene = self.model, self.states, self.scene
        data = mujoco.MjData(model)
        near = self.camera not in (MAP, OVERVIEW)
        look = LOOKS[PLANE.name if scene is None else scene.space]
        width, height = self.quality.size
        if scene is None:
            model.site_rgba[:, 3] = 0
            model.site_matid[:] = -1
        model.vis.quality.offsamples = self.quality.samples
        if not self.quality.fine:
            _simplify(model)
        self._aim_shadows(near)
        nq = model.nq
        view = _camera(model, self.camera, states[:, :3], scene, height / width)
        headings = self._headings() if self.camera == SIDE and look.side_turns else None
        with Offscreen(model, width, height) as offscreen:
            # near swimmers cast theirs far below, and specks on themselves: a soft spot does, as it
            # does in videos, where the sun's shadows cost more than all the rest
            shadows = self.quality.shadows and (self.walks if near else self.camera != MAP)
            spot = look.sea_bed and near and not shadows
            offscreen.scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = shadows
            for number, index in enumerate(indices):
                progress("drawing", number / len(indices))
                x = states[index]
                data.time = index * self.timestep
                data.qpos[:], data.qvel[:] = x[:nq], x[nq : nq + model.nv]
                if scene is not None:
                    set_scene(model, data, scene)
                mujoco.mj_kinematics(model, data)
                mujoco.mj_comPos(model, data)
                mujoco.mj_camlight(model, data)
                if headings is not None:
                    _beside(view, x[:3], headings[index], 1.93 * self.length)
                below = x[2] + FLOOR_DEPTH
                if self.walks:
                    below = height_above(model, data, x[:3])
                ground = x[:3] + below * SUN / -SUN[2] + [0, 0, 0.01]
                yield offscreen.picture(
                    data,
                    view,
                    trail=states[: index + 1, :3] if self.trail else None,
                    trail_radius=_TRAIL_RADIUS.get(self.camera, 0.0),
                    trail_every=-(-len(states) // _TRAIL_PIECES),
                    motes=motes_around(x[:3]) if look.motes and near else None,
                    target=None if scene is None else scene.target,
                    shadow=ground if spot and below > 0 else None,
                    shadow_radius=(0.32 if self.walks else 0.24) * self.length,
                    caption=("", "") if caption is None else caption(int(index)),
                )
        progress("drawing", 1.0)

    def _aim_shadows(self, near: bool) -> None:
        """Let the map of shadows cover what is seen, and no more: where it is coarse, shadows are torn."""
        model, reach = self.model, 9.0  # its rim is grainy on the floor
        if not near:
            seen = [self.states[:, :3]] + ([] if self.scene is None else [self.scene.centres])
            reach = 60.0 + max(
                float(np.linalg.norm(p - self.states[-1, :3], axis=1).max(initial=0)) for p in seen
            )
        model.vis.map.shadowclip = reach / model.stat.extent

    def _headings(self) -> np.ndarray:
        """Return the headings (n,) of the states, rad, without what a stroke turns the body to and fro."""
        heading = np.unwrap(rotations.heading(rotations.matrix(self.states[:, 3:7])))
        half = round(0.5 * _TURNING_SECONDS / self.timestep)
        padded = np.pad(heading, half, mode="edge")
        return np.convolve(padded, np.full(2 * half + 1, 1 / (2 * half + 1)), mode="valid")


def _simplify(model: mujoco.MjModel) -> None:
    """Take out of the pictures what costs much without a GPU and is hardly seen.

    MuJoCo draws an infinite plane as many squares, twice with shadows: 4 and 17 ms a picture.
    """
    for geom in np.flatnonzero(model.geom_type == int(mujoco.mjtGeom.mjGEOM_PLANE)):
        model.geom_size[geom] = [_GROUND, _GROUND, _SQUARE]
    model.vis.quality.numslices, model.vis.quality.numstacks = 24, 8


def _beside(camera: mujoco.MjvCamera, place: np.ndarray, heading: float, distance: float) -> None:
    """Aim a free camera at a place from the right of a heading (rad), that far away (m)."""
    camera.type = mujoco.mjtCamera.mjCAMERA_FREE
    camera.lookat = place
    camera.azimuth, camera.elevation = 90.0 + np.degrees(heading), -10.0
    camera.distance = distance


def _camera(
    model: mujoco.MjModel, name: str, way: np.ndarray, scene: Scene | None, height_to_width: float
) -> mujoco.MjvCamera:
    """Return a camera of the model, or one above that sees the way, the target, the obstacles."""
    camera = mujoco.MjvCamera()
    if name not in (MAP, OVERVIEW):
        identity = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_CAMERA, name)
        if identity < 0:
            names = ", ".join([*(model.camera(i).name for i in range(model.ncam)), MAP, OVERVIEW])
            raise DefplanError(f"there is no camera {name}: there are {names}")
        camera.type = mujoco.mjtCamera.mjCAMERA_FIXED
        camera.fixedcamid = identity
        return camera
    offset = np.zeros(3) if scene is None else scene.target - way[0]
    bearing = float(np.degrees(np.arctan2(offset[1], offset[0])))
    points, margins = [way], [np.full(len(way), 1.0)]
    if scene is not None:
        points += [scene.target[None], scene.centres]
        margins += [np.array([scene.goal_radius + 0.5]), scene.radii + 0.5]
    camera.type = mujoco.mjtCamera.mjCAMERA_FREE
    if name == OVERVIEW:
        aside, down = LOOKS[PLANE.name if scene is None else scene.space].overview
        camera.azimuth, camera.elevation = bearing + aside, down
    else:  # the way from start to target lies from left to right
        camera.azimuth, camera.elevation = 90 + bearing, -90.0
        camera.orthographic = model.vis.global_.orthographic = 1
    _fit(camera, model, np.concatenate(points), np.concatenate(margins), height_to_width)
    return camera


def _fit(
    camera: mujoco.MjvCamera,
    model: mujoco.MjModel,
    points: np.ndarray,
    margins: np.ndarray,
    height_to_width: float,
) -> None:
    """Aim a free camera, whose angles are set, so that all balls (points, margins) are in the picture."""
    azimuth, elevation = np.radians([camera.azimuth, camera.elevation])
    right = np.array([np.sin(azimuth), -np.cos(azimuth), 0.0])
    ahead = np.array(
        [
            np.cos(elevation) * np.cos(azimuth),
            np.cos(elevation) * np.sin(azimuth),
            np.sin(elevation),
        ]
    )
    axes = np.stack([right, np.cross(right, ahead), ahead])
    seen, margin = points @ axes.T, margins[:, None]
    middle = 0.5 * ((seen - margin).min(0) + (seen + margin).max(0))
    camera.lookat = middle @ axes
    across, up, along = (seen - middle).T
    if camera.orthographic:
        height = np.maximum(np.abs(up) + margins, (np.abs(across) + margins) * height_to_width)
        model.vis.global_.fovy = 2 * float(height.max())
        camera.distance = 30.0 + float(np.ptp(along))
        return
    slope = np.tan(np.radians(model.vis.global_.fovy) / 2)
    reach = np.maximum(np.abs(up) + margins, (np.abs(across) + margins) * height_to_width) / slope
    camera.distance = float((reach - along).max())


def _write(frames: Iterator[np.ndarray], path: Path, fps: float, still: bool) -> None:
    with files.atomic_path(path) as temporary:
        if still:
            imageio.imwrite(temporary, next(frames))
        elif path.suffix.lower() == ".mp4":
            options: dict[str, Any] = {"quality": None, "macro_block_size": 2}
            # with slower presets, to compress a picture costs as much as to draw it
            options["output_params"] = ["-crf", "20", "-preset", "ultrafast"]
            writer: Any
            with imageio.get_writer(temporary, fps=fps, **options) as writer:
                for frame in frames:
                    writer.append_data(frame)
        else:  # all pictures at once: for some seconds, as on a page
            first, *others = map(Image.fromarray, frames)
            first.save(
                temporary,
                path.suffix[1:].lower(),
                save_all=True,
                append_images=others,
                duration=round(1000 / fps),
                loop=0,
                quality=60,
            )


def _open_context(width: int, height: int):
    """Return a current GL context of the first backend that works."""
    first = os.environ.get("MUJOCO_GL", "").lower().strip()
    order = [first] if first in _BACKENDS else []
    reasons = []
    for backend in order + [b for b in _BACKENDS if b not in order]:
        try:
            context = importlib.import_module(f"mujoco.{backend}").GLContext(width, height)
            context.make_current()
        except Exception as error:  # each backend fails in its own ways
            reasons.append(f"{backend}: {type(error).__name__}")
            continue
        return context
    raise DefplanError(
        "cannot draw without a screen: neither EGL nor OSMesa works here"
        f" ({'; '.join(reasons)}); install libegl1 or libosmesa6"
    )
