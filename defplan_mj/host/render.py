"""Pictures and videos of states in their scene, without a screen (EGL or OSMesa)."""

from __future__ import annotations

import importlib
import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import imageio.v2 as imageio
import mujoco
import numpy as np

from defplan_mj.base import files
from defplan_mj.base.errors import DefplanError
from defplan_mj.base.space import PLANE
from defplan_mj.body.model import Body
from defplan_mj.dynamics.terrain import Terrain
from defplan_mj.host.looks import LOOKS
from defplan_mj.host.obstacles import set_scene
from defplan_mj.host.scene import build_spec, compile_model
from defplan_mj.planning.scenes import Scene

MAP = "map"  # sees the whole way from straight above, to scale
OVERVIEW = "overview"  # sees the whole way from behind and above
TRAIL_RGBA = np.array([0.95, 0.98, 1.0, 1.0], np.float32)
_TRAIL_RADIUS = {MAP: 0.06, OVERVIEW: 0.03}  # m
_BACKENDS = ("egl", "osmesa", "glfw")
_MOTE_RGBA = np.array([0.85, 0.95, 0.95, 0.55], np.float32)
_MOTE_CELL, _MOTE_SIZE, _MOTE_REACH = 1.25, 0.006, 5  # m; m; cells to each side


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
        self._mjr = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_150)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._mjr)
        self._rect = mujoco.MjrRect(0, 0, width, height)
        self._option = mujoco.MjvOption()
        self.scene = mujoco.MjvScene(model, maxgeom=20000)

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
        motes: np.ndarray | None = None,
    ) -> np.ndarray:
        """Return the (height, width, 3) uint8 picture of `data`.

        Args:
            trail: (n, 3) points to join by a line, m; of radius `trail_radius`, m.
            motes: (n, 3) places of specks floating in the water, m; see `motes_around`.
        """
        perturb, everything = mujoco.MjvPerturb(), mujoco.mjtCatBit.mjCAT_ALL
        mujoco.mjv_updateScene(
            self._model, data, self._option, perturb, camera, everything, self.scene
        )
        if trail is not None:
            self._add_trail(trail, trail_radius)
        if motes is not None:
            self._add_motes(motes)
        pixels = np.empty((self._rect.height, self._rect.width, 3), np.uint8)
        mujoco.mjr_render(self._rect, self.scene, self._mjr)
        mujoco.mjr_readPixels(pixels, None, self._rect, self._mjr)
        return np.ascontiguousarray(pixels[::-1])

    def _add_trail(self, points: np.ndarray, radius: float) -> None:
        capsule = mujoco.mjtGeom.mjGEOM_CAPSULE
        for start, end in zip(points, points[1:], strict=False):
            if self.scene.ngeom == self.scene.maxgeom:
                return
            geom = self.scene.geoms[self.scene.ngeom]
            mujoco.mjv_initGeom(geom, capsule, np.zeros(3), np.zeros(3), np.zeros(9), TRAIL_RGBA)
            mujoco.mjv_connector(geom, capsule, radius, start, end)
            self.scene.ngeom += 1

    def _add_motes(self, places: np.ndarray) -> None:
        size, upright = np.full(3, _MOTE_SIZE), np.eye(3).ravel()
        for place in places[: self.scene.maxgeom - self.scene.ngeom]:
            geom = self.scene.geoms[self.scene.ngeom]
            mujoco.mjv_initGeom(geom, mujoco.mjtGeom.mjGEOM_BOX, size, place, upright, _MOTE_RGBA)
            geom.transparent = 1
            self.scene.ngeom += 1


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


def render_states(
    body: Body,
    states: np.ndarray,
    scene: Scene | None = None,
    path: str | Path | None = None,
    size: tuple[int, int] = (960, 540),
    fps: float = 25.0,
    camera: str = "chase",
    *,
    timestep: float = 0.04,
    trail: bool = True,
    terrain: Terrain | None = None,
    texture: np.ndarray | None = None,
) -> list[np.ndarray]:
    """Draw states in their scene: a video, a picture, or frames.

    Args:
        states: (n, 13 + 3r), `timestep` apart, the first at time 0.
        path: an .mp4 or .gif file takes all frames in real time; a .png takes the last state, with
            the way to it; None returns the frames.
        size: width, height in pixels.
        fps: frames a second of simulated time.
        camera: 'chase', 'side', 'top' follow the body, without turning with it; 'map' sees the whole
            way from straight above, to scale; 'overview' from behind and above.
        timestep: s.
        trail: draw the way of the centre of mass.
        terrain: what the robot walks on.
        texture: of the skin, see `skin.add_skin`.

    Returns:
        The frames, (height, width, 3) uint8, if `path` is None, else an empty list.

    Raises:
        DefplanError: no way to draw without a screen, or the file cannot be written.
    """
    states = np.atleast_2d(states)
    still = path is not None and Path(path).suffix.lower() == ".png"
    times = timestep * np.arange(len(states))
    instants = times[-1:] if still else np.arange(0.0, times[-1] + 0.5 * timestep, 1 / fps)
    indices = np.minimum(np.round(instants / timestep).astype(int), len(states) - 1)
    frames = _frames(body, states, scene, size, camera, timestep, indices, trail, terrain, texture)
    if path is None:
        return list(frames)
    _write(frames, Path(path), fps, still)
    return []


def _frames(
    body: Body,
    states: np.ndarray,
    scene: Scene | None,
    size: tuple[int, int],
    camera: str,
    timestep: float,
    indices: Sequence[int],
    trail: bool,
    terrain: Terrain | None,
    texture: np.ndarray | None,
) -> Iterator[np.ndarray]:
    room = 0 if scene is None else len(scene.radii)
    space = PLANE.name if scene is None else scene.space
    spec = build_spec(
        body, timestep, max_obstacles=room, space=space, terrain=terrain, texture=texture
    )
    model = compile_model(spec)
    data = mujoco.MjData(model)
    if scene is None:
        model.site_rgba[:, 3] = 0
        model.site_matid[:] = -1
    if camera == OVERVIEW:
        model.vis.map.shadowclip *= 3  # at the rim of its map the shadow of the sea bed is grainy
    r = body.n_modes
    view = _camera(model, camera, states[:, :3], scene, size[1] / size[0])
    with Offscreen(model, *size) as offscreen:
        offscreen.scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = camera != MAP  # to scale
        for index in indices:
            data.time = index * timestep
            data.qpos[:], data.qvel[:] = states[index, : 7 + r], states[index, 7 + r : 13 + 2 * r]
            if scene is not None:
                set_scene(model, data, scene)
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            mujoco.mj_camlight(model, data)
            way = states[: index + 1, :3] if trail else None
            motes = None
            if LOOKS[space].motes and camera not in (MAP, OVERVIEW):
                motes = motes_around(states[index, :3])
            yield offscreen.picture(data, view, way, _TRAIL_RADIUS.get(camera, 0.012), motes)


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
            return
        options: dict[str, Any] = {"fps": fps}
        if path.suffix.lower() != ".gif":
            options |= {"quality": 8, "macro_block_size": 2}
        writer: Any
        with imageio.get_writer(temporary, **options) as writer:
            for frame in frames:
                writer.append_data(frame)


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
