"""Build the MuJoCo model of one deformable robot in its world, with MjSpec: self-contained, nothing on disk."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

import mujoco
import numpy as np

from defplan_mj.base.errors import DefplanError
from defplan_mj.base.space import PLANE, SPACES
from defplan_mj.body.model import Body
from defplan_mj.dynamics.terrain import Terrain, pack_terrain
from defplan_mj.host import skin
from defplan_mj.host.ground import add_terrain
from defplan_mj.host.looks import (
    DRAWN_HALF_HEIGHT,
    DRAWN_HEIGHT,
    LOOKS,
    MEADOW,
    SEA,
    Look,
    Surroundings,
)
from defplan_mj.host.plugin import NAME as PLUGIN
from defplan_mj.host.plugin import load_plugin
from defplan_mj.kernel.pack import StepOptions, pack_body, pack_options

ROBOT = "robot"
ROOT = "root"
TARGET = "target"
TERRAIN = "defplan_terrain"
FLOOR_DEPTH = 4.0  # m below the start
SUN = np.array([0.18, 0.12, -0.975])  # where its light goes
SOLID_HALF_HEIGHT = (
    20.0  # m, of upright cylinders: swimmers drift up and down, the problem is planar
)
PARKED = (0.0, 0.0, -100.0)  # m, where unused obstacles wait
# Geom groups, as is usual in MuJoCo: what is drawn, and what is touched and seen by the laser.
DECOR_GROUP, SOLID_GROUP = 2, 3


class LaserNumbers(NamedTuple):
    """What the model's numeric 'laser' holds: beams, range in m, dimension of the space."""

    beams: float
    range: float
    dimension: float


def build_spec(
    body: Body,
    timestep: float,
    *,
    normalised_controls: bool = True,
    max_obstacles: int = 0,
    beams: int = 64,
    laser_range: float = 10.0,
    space: str = PLANE.name,
    sensor: str = "",
    terrain: Terrain | None = None,
    texture: np.ndarray | None = None,
    stepping: Mapping[str, Any] = MappingProxyType({}),
) -> mujoco.MjSpec:
    """Describe a robot with `body` that floats at the origin, a target, parked obstacles and cameras.

    The spec may be added to (geoms, bodies, sensors) before it is compiled. Names: body 'robot', its
    free joint 'root', slide joints 'mode_0'..., actuators 'target_0'..., sensor 'clearance', site
    'target', mocap bodies and geoms 'obstacle_0'... (and geoms 'obstacle_0_drawn'...), cameras
    'chase', 'side', 'top', numeric 'laser' (number of beams, range in m,
    dimension of its space), text 'body_hash', and text 'sensor' if it is not the laser of the space.

    Args:
        timestep: of the reduced step, s.
        normalised_controls: ctrl in [-1, 1] is the target shape divided by `body.amplitude`; if
            false, ctrl is the target shape itself, within the amplitude.
        max_obstacles: how many obstacles a planning.scene.Scene may have here.
        beams, laser_range: of the laser scanner; range in m.
        space: 'planar' or 'spatial', see task.Navigation.
        sensor: by name; '': the laser of the space.
        terrain: what the robot stands on, in the air; without it it swims.
        texture: of the skin, see `skin.add_skin`.
        stepping: 'substeps' and 'integrator' of `ReducedDynamics`, if not the default ones.
    """
    load_plugin()
    spec = mujoco.MjSpec()
    spec.modelname = body.name
    spec.option.timestep = timestep
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_EULER
    spec.nuser_body = 3  # velocity of a mocap obstacle
    around = SEA if terrain is None else MEADOW
    _add_looks(spec, around)
    _add_chequer(spec, around)
    if terrain is not None:
        spec.add_numeric(name=TERRAIN, data=pack_terrain(terrain, body))
        add_terrain(spec, terrain, "grid")
    elif LOOKS[space].sea_bed:
        _add_sea_bed(spec)
    _add_robot(spec, body, timestep, normalised_controls, LOOKS[space], stepping)
    skin.add_skin(spec, body, ROBOT, "self", texture)
    dimension = float(SPACES[space].dimension)
    spec.add_numeric(name="laser", data=LaserNumbers(float(beams), laser_range, dimension))
    if sensor:
        spec.add_text(name="sensor", data=sensor)
    # a site away from its body's origin: one compiled at the origin could not be moved
    spec.worldbody.add_site(
        name=TARGET, pos=[5, 0, 0], size=[0.5, 0.5, 0.5], material=TARGET, group=0
    )
    for index in range(max_obstacles):
        _add_obstacle(spec, index)
    return spec


def compile_model(spec: mujoco.MjSpec) -> mujoco.MjModel:
    """Compile `spec`.

    Raises:
        DefplanError: MuJoCo refuses it.
    """
    try:
        return spec.compile()
    except (ValueError, mujoco.FatalError) as error:
        raise DefplanError(f"MuJoCo cannot build the model {spec.modelname}: {error}") from error


def view_length(body: Body) -> float:
    """Return how long a slender body would be that fills a picture as this one does, m."""
    return float(np.linalg.norm(np.ptp(body.vertices, axis=0))) / 1.06


def text_of(model: mujoco.MjModel, name: str) -> str:
    """Return a text of the model, or '' if it has none of that name."""
    index = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_TEXT, name)
    if index < 0:
        return ""
    start, size = model.text_adr[index], model.text_size[index]
    return bytes(model.text_data[start : start + size]).rstrip(b"\0").decode()


def _add_robot(
    spec: mujoco.MjSpec,
    body: Body,
    timestep: float,
    normalised: bool,
    look: Look,
    stepping: Mapping[str, Any],
) -> None:
    """Add the free joint, the modal slide joints, their actuators, the plugin and its data."""
    amplitude = np.asarray(body.amplitude, float)
    scale = amplitude if normalised else np.ones(body.n_modes)
    plugin = _add_plugin(spec, body, StepOptions(timestep, **stepping), scale)

    masses, points = body.vertex_mass, body.vertices
    second = np.einsum("v,vi,vj->ij", masses, points, points)
    inertia = np.trace(second) * np.eye(3) - second
    robot = spec.worldbody.add_body(
        name=ROBOT,
        gravcomp=1,
        explicitinertial=True,
        mass=body.mass,
        ipos=[0, 0, 0],
        fullinertia=inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]],
    )
    robot.add_freejoint(name=ROOT)
    for mode in range(body.n_modes):
        limit = 1.0 if normalised else amplitude[mode]
        _add_mode(spec, robot, mode, 1e-9 * body.mass, limit, plugin)
    spec.add_sensor(name="clearance", type=mujoco.mjtSensor.mjSENS_PLUGIN).plugin = plugin
    _add_cameras(robot, view_length(body), look)


def _add_plugin(
    spec: mujoco.MjSpec, body: Body, options: StepOptions, scale: np.ndarray
) -> mujoco.MjsPlugin:
    """Add the plugin that moves the robot, and the numbers that it reads: body, options, units of controls."""
    spec.add_numeric(name="defplan_body", data=pack_body(body))
    spec.add_numeric(name="defplan_options", data=pack_options(body, options))
    spec.add_numeric(name="defplan_scale", data=scale)
    spec.add_text(name="body_hash", data=body.hash)

    spec.activate_plugin(PLUGIN)
    plugin = spec.add_plugin(name="reduced_fem", plugin_name=PLUGIN, active=True)
    plugin.config = {
        "body": "defplan_body",
        "options": "defplan_options",
        "scale": "defplan_scale",
        "terrain": TERRAIN,
    }
    return plugin


def _add_mode(
    spec: mujoco.MjSpec,
    robot: mujoco.MjsBody,
    mode: int,
    mass: float,
    limit: float,
    plugin: mujoco.MjsPlugin,
) -> None:
    """Add a dummy of almost no mass (kg), which carries q as a joint position, and its actuator up to `limit`.

    The plugin moves it.
    """
    dummy = robot.add_body(
        name=f"mode_{mode}",
        gravcomp=1,
        explicitinertial=True,
        mass=mass,
        ipos=[0, 0, 0],
        inertia=[1e-9, 1e-9, 1e-9],
    )
    dummy.add_joint(
        name=f"mode_{mode}", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=[1, 0, 0], armature=1
    )
    spec.add_actuator(
        name=f"target_{mode}",
        trntype=mujoco.mjtTrn.mjTRN_JOINT,
        target=f"mode_{mode}",
        ctrllimited=True,
        ctrlrange=[-limit, limit],
        # the activation holds the last target; nothing but the plugin changes it
        dyntype=mujoco.mjtDyn.mjDYN_USER,
        actdim=1,
    ).plugin = plugin


def _add_cameras(robot: mujoco.MjsBody, length: float, look: Look) -> None:
    """Add cameras that go along with the robot, as far away as a body of this `length` (m) asks, and the sun."""
    track = mujoco.mjtCamLight.mjCAMLIGHT_TRACKCOM
    # Cameras do not turn with the robot, so that it may turn over; the one at its side does where it
    # stays upright.
    turning = mujoco.mjtCamLight.mjCAMLIGHT_FIXED if look.side_turns else track
    views = {
        "chase": ([-0.84, -1.17, 0.67], [0.814, -0.581, 0, 0.246, 0.345, 0.906], 45, track),
        "side": ([0, -1.9, 0.35], [1, 0, 0, 0, 0.18, 0.98], 45, turning),
        "top": (look.top[0], [1, 0, 0, 0, 1, 0], look.top[1], track),
    }
    for name, (place, axes, angle, mode) in views.items():
        pos = length * np.array(place)
        robot.add_camera(name=name, mode=mode, pos=pos, xyaxes=axes, fovy=angle)
    # above the robot wherever it goes, so that the shadow map need not cover the whole world
    robot.add_light(
        name="sun",
        mode=track,
        type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
        pos=[0, 0, 8],
        dir=SUN,
        diffuse=[0.75, 0.75, 0.7],
        specular=[0.25, 0.25, 0.25],
        castshadow=look.shadows,
    )


def _add_obstacle(spec: mujoco.MjSpec, index: int) -> None:
    """Add a parked obstacle: a solid geom, which is not drawn, and its picture."""
    name = f"obstacle_{index}"
    holder = spec.worldbody.add_body(name=name, mocap=True, pos=PARKED)
    cylinder = mujoco.mjtGeom.mjGEOM_CYLINDER
    size = [1, SOLID_HALF_HEIGHT, 0]
    holder.add_geom(name=name, type=cylinder, size=size, rgba=[0, 0, 0, 0], group=SOLID_GROUP)
    holder.add_geom(
        name=f"{name}_drawn",
        type=cylinder,
        size=[1, DRAWN_HALF_HEIGHT, 0],
        pos=[0, 0, DRAWN_HEIGHT],
        rgba=[0, 0, 0, 0],
        group=DECOR_GROUP,
        contype=0,
        conaffinity=0,
        mass=0,  # bounding boxes are centred on the body's centre of mass
    )


def _add_looks(spec: mujoco.MjSpec, around: Surroundings) -> None:
    """Add light, water and the materials that dm_control's reward colours want."""
    spec.stat.extent = 3
    spec.stat.center = [0, 0, 0]
    visual = spec.visual
    visual.headlight.ambient = [0.35, 0.38, 0.42]
    visual.headlight.diffuse = [0.35, 0.36, 0.36]
    visual.headlight.specular = [0.1, 0.1, 0.1]
    visual.map.znear = 0.01
    visual.map.zfar = 60
    visual.map.shadowclip = 16
    visual.quality.shadowsize = 4096
    visual.quality.offsamples = 8
    visual.global_.offwidth = 1920
    visual.global_.offheight = 1080
    visual.rgba.haze = [*around.haze, 1]

    spec.add_texture(
        name="skybox",
        type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
        rgb1=around.sky[0],
        rgb2=around.sky[1],
        width=256,
        height=256,
    )
    colours = {
        "self": ([1, 1, 1, 1], [0.7, 1, 0.7, 1]),
        "effector": ([0.7, 0.4, 0.2, 1], [0, 0.5, 0.3, 1]),
        "target": ([0.90, 0.22, 0.17, 0.30], [1, 0.45, 0.35, 0.6]),
    }
    for name, (plain, highlight) in colours.items():
        if name != "self":  # the skin makes that one, with its picture
            spec.add_material(name=name, rgba=plain)
        spec.add_material(name=f"{name}_default", rgba=plain)
        spec.add_material(name=f"{name}_highlight", rgba=highlight)


def _add_chequer(spec: mujoco.MjSpec, around: Surroundings) -> None:
    """Add the material of the ground."""
    spec.add_texture(
        name="grid",
        type=mujoco.mjtTexture.mjTEXTURE_2D,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_CHECKER,
        rgb1=around.floor[0],
        rgb2=around.floor[1],
        width=256,
        height=256,
        mark=mujoco.mjtMark.mjMARK_EDGE,
        markrgb=around.floor[2],
    )
    textures = [""] * mujoco.mjtTextureRole.mjNTEXROLE.value
    textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "grid"
    spec.add_material(
        name="grid", textures=textures, texrepeat=[0.5, 0.5], texuniform=True, reflectance=0.0
    )


def _add_sea_bed(spec: mujoco.MjSpec) -> None:
    """Add a floor, which is a picture only."""
    spec.worldbody.add_geom(
        name="floor",
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        pos=[0, 0, -FLOOR_DEPTH],
        size=[0, 0, 1],
        material="grid",
        contype=0,
        conaffinity=0,
        group=DECOR_GROUP,
    )
