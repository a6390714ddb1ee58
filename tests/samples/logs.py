"""A small made-up body, gait, surrogate and episode for the tests of logs and reports."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from defplan_mj.base import rotations
from defplan_mj.body.model import Body, Material, Medium
from defplan_mj.dynamics.reduced import ReducedDynamics
from defplan_mj.dynamics.rigid import RigidDynamics
from defplan_mj.feedback import FeedbackSolver
from defplan_mj.gait.gait import Gait
from defplan_mj.log.recorder import Recorder
from defplan_mj.log.run_files import RunFiles
from defplan_mj.planning.scene import Scene
from defplan_mj.planning.surrogate import Surrogate

MODES = 2
TIMESTEP = 0.04
STEPS_PER_CYCLE = 11


def sample_body() -> Body:
    """Return a body of eight vertices with the right shapes of arrays; it draws, it does not swim."""
    corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.1, 0.1) for z in (-0.1, 0.1)])
    tetrahedra = np.array([[0, 4, 6, 7], [0, 6, 2, 7], [0, 2, 3, 7], [0, 3, 1, 7], [0, 1, 5, 7]])
    tetrahedra = np.vstack([tetrahedra, [[0, 5, 4, 7]]])
    quads = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    faces = np.array([t for q in quads for t in (q[:3], [q[0], *q[2:]])])
    rng = np.random.default_rng(0)
    modes = np.zeros((8, 3, MODES))
    modes[:, 1, 0] = corners[:, 0] ** 2
    modes[:, 2, 1] = corners[:, 0] ** 2
    mass = np.full(8, 5.0)
    basis = np.linalg.qr(modes.reshape(24, MODES))[0].reshape(8, 3, MODES) / np.sqrt(5.0)
    shapes = np.concatenate([corners[:, :, None], basis], axis=2)
    points = np.zeros((4, 3, MODES + 1))
    return Body(
        name="bar",
        material=Material(),
        medium=Medium(),
        vertices=corners,
        tetrahedra=tetrahedra,
        faces=faces,
        vertex_mass=mass,
        modes=modes,
        frequencies=np.array([1.5, 2.5]),
        stiffness=np.array([2.0, 3.0]),
        amplitude=np.array([1.5, 1.5]),
        basis=basis,
        sampled=np.array([0, 3]),
        feature_map=rng.normal(size=(2, 9, MODES)),
        feature_weights=rng.normal(size=(MODES, 18)),
        moments=np.einsum("v,via,vjb->abij", mass, shapes, shapes),
        drag_points=points,
        drag_tangents=np.stack([points, points]),
        drag_areas=np.ones(4),
        surface=np.arange(8),
        source={"mesh": "bar.stl", "vertices": 8, "quality_min": 0.31, "quality_mean": 0.88},
    )


def sample_gait(body: Body) -> Gait:
    """Return three tasks of two wavelets each."""
    rng = np.random.default_rng(1)
    return Gait(
        body_hash=body.hash,
        task_names=("forward", "left", "right"),
        timestep=TIMESTEP,
        steps_per_cycle=STEPS_PER_CYCLE,
        alpha=rng.normal(size=(3, 5, MODES)) * 0.3,
        beta=rng.uniform(0, 1, (3, 5, MODES)),
        mu=rng.uniform(0, 6, (5, MODES)),
        amplitude=body.amplitude,
        meta={"solver": "shooting", "seed": 0, "seconds": 12.5, "objective": [3.0, 1.0, -2.0]},
    )


def turn(angle: float) -> np.ndarray:
    """Return the rotation by an angle about z."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])


def sample_surrogate(body: Body) -> Surrogate:
    """Return a surrogate: forward 0.7 m, and two turns of 0.6 rad."""
    return Surrogate(
        body_hash=body.hash,
        gait_hash="0" * 64,
        task_names=("forward", "left", "right"),
        rotations=np.array([turn(0.0), turn(0.6), turn(-0.6)]),
        translations=np.array([[0.7, 0, 0], [0.4, 0.1, 0], [0.4, -0.1, 0]]),
        cycle_seconds=STEPS_PER_CYCLE * TIMESTEP,
        pairs=1000,
        rotation_mean=np.array([0.02, 0.6, 0.6]),
        rotation_sd=np.array([0.01, 0.03, 0.03]),
        translation_mean=np.array([0.7, 0.41, 0.41]),
        translation_sd=np.array([0.02, 0.02, 0.02]),
        radius=0.7,
    )


SPATIAL_TASKS = ("front", "back", "left", "right", "forward")


def spatial_parts(body: Body) -> tuple[Gait, Surrogate]:
    """Return five tasks in space: four turns of 0.5 rad about horizontal axes, and 0.5 m along +z."""
    rng = np.random.default_rng(2)
    axes = [[0, 0.5, 0], [0, -0.5, 0], [-0.5, 0, 0], [0.5, 0, 0], [0, 0, 0]]
    plain = sample_gait(body)
    gait = replace(
        plain,
        task_names=SPATIAL_TASKS,
        alpha=rng.normal(size=(5, 5, body.n_modes)) * 0.3,
        beta=rng.uniform(0, 1, (5, 5, body.n_modes)),
        mu=rng.uniform(0, 6, (5, body.n_modes)),
    )
    surrogate = replace(
        sample_surrogate(body),
        task_names=SPATIAL_TASKS,
        rotations=Rotation.from_rotvec(axes).as_matrix(),
        translations=np.array([[0.02, 0, 0.05]] * 4 + [[0, 0, 0.5]]),
        rotation_mean=np.array([0.5, 0.5, 0.5, 0.5, 0.05]),
        rotation_sd=np.full(5, 0.03),
        translation_mean=np.array([0.05, 0.05, 0.05, 0.05, 0.5]),
        translation_sd=np.full(5, 0.01),
    )
    return gait, surrogate


def spatial_scene(obstacles: int = 3, target=(4.0, 3.0, -7.0)) -> Scene:
    """Return a target somewhere in space, spheres on the way, and a start that lies on its side."""
    rng = np.random.default_rng(3)
    share = np.linspace(0.4, 0.8, obstacles)[:, None]
    return Scene(
        target=np.array(target),
        centres=share * np.array(target) + rng.normal(size=(obstacles, 3)),
        radii=rng.uniform(0.5, 0.9, obstacles),
        velocities=np.zeros((obstacles, 3)),
        shape="sphere",
        orientation=np.array([0.5, 0.5, -0.5, 0.5]),
    )


def sample_scene(speed: float = 0.0, obstacles: int = 3) -> Scene:
    """Return a target ahead and obstacles beside the way."""
    centres = np.array([[2.0 + 2 * i, (-1) ** i * 1.5, 0.0] for i in range(obstacles)])
    return Scene(
        target=np.array([9.0, 0.5, 0.0]),
        centres=centres.reshape(-1, 3),
        radii=np.full(obstacles, 0.5),
        velocities=np.full((obstacles, 3), [0.0, speed, 0.0]),
    )


def surface_of(body: Body):
    """Return x -> world points of the surface, bent by the linear modes."""

    def surface(x: np.ndarray) -> np.ndarray:
        q = x[7 : 7 + MODES]
        local = body.vertices + body.modes @ q
        return x[:3] + local[body.surface] @ rotations.matrix(x[3:7]).T

    return surface


def state(pose: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return a state of that pose; what else it says is random, so every bit of it counts."""
    shape, velocity = rng.normal(size=MODES), rng.normal(size=6 + MODES)
    return np.concatenate([pose, shape, velocity, 0.7 * shape[::-1]])


def record_episode(
    path: Path,
    cycles: int = 8,
    error: tuple[float, float] = (0.0, 0.0),
    outcome: str | None = "success",
    scene: Scene | None = None,
    files: RunFiles | None = None,
    contacts: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]] | None = None,
) -> dict[str, np.ndarray]:
    """Log a made-up episode: every cycle is the surrogate's motion and then a known error.

    Args:
        error: metres the truth ends left of the prediction, and radians it heads more to the left.
        outcome: None leaves the log without an end.
        contacts: of `Recorder`.

    Returns:
        what was logged: time, states, target_shapes, clearance, gait_index, values, reward, laser.
    """
    if files is None:
        body = sample_body()
        files = RunFiles.of(body, sample_gait(body), sample_surrogate(body))
    assert files.gait is not None and files.surrogate is not None
    rng = np.random.default_rng(7)
    table = files.gait.table()
    scene = scene or sample_scene()
    pose = np.array([0, 0, 0, *scene.orientation])
    x = state(pose, rng)
    kept: dict[str, list] = {k: [] for k in ("time", "states", "target_shapes", "clearance")}
    kept |= {k: [] for k in ("gait_index", "values", "reward", "laser")}
    kept["time"].append(0.0)
    kept["states"].append(x)
    with Recorder(path, files, surface_of(files.body), contacts) as recorder:
        context = {"task": "bar-swim", "seed": 3, "planner": "greedy", "shield": True}
        context |= {
            "timestep": TIMESTEP,
            "substeps": 2,
            "integrator": "variational",
            "state": x,
            "episode": 4,
        }
        context |= {"navigation": {"laser_range": 8.0}}
        recorder.begin(context, scene)
        step = 0
        for cycle in range(cycles):
            start, time = x, step * TIMESTEP
            gait_index = int(rng.integers(len(table)))
            goal = RigidDynamics(files.surrogate).step(start[:7], gait_index)
            frame = rotations.matrix(goal[3:])
            goal[:3] += frame @ [0, error[0], 0]
            goal[3:] = rotations.quaternion(frame @ turn(error[1]))
            for i in range(STEPS_PER_CYCLE):
                step += 1
                part = (i + 1) / STEPS_PER_CYCLE
                middle = np.append(start[:3] + part * (goal[:3] - start[:3]), goal[3:])
                x = state(goal if part == 1 else middle, rng)
                shape, clearance = table[gait_index, i], rng.uniform(0.1, 2)
                recorder.step(step * TIMESTEP, x, shape, clearance)
                kept["time"].append(step * TIMESTEP)
                for name, value in (("states", x), ("target_shapes", shape)):
                    kept[name].append(value)
                kept["clearance"].append(clearance)
            values, reward = rng.normal(size=len(table)), rng.normal()
            laser = np.minimum(rng.uniform(1, 10, 64), 8.0)
            recorder.cycle(cycle, time, start, gait_index, values, reward, laser)
            for name, value in (("values", values), ("reward", reward), ("laser", laser)):
                kept[name].append(value)
            kept["gait_index"].append(gait_index)
        if outcome is not None:
            recorder.end(outcome, "the target was reached")
    return {name: np.array(value) for name, value in kept.items()}


def tumbling_gait(body: Body) -> Gait:
    """Return five tasks, as a spatial swimmer has them, that wave all modes each in its own way."""
    rng = np.random.default_rng(6)
    r = body.n_modes
    alpha = 0.4 * rng.normal(size=(5, 2, r))
    return replace(
        swimming_gait(body), task_names=SPATIAL_TASKS, alpha=alpha, beta=np.ones((5, 2, r))
    )


def swimming_gait(body: Body) -> Gait:
    """Return three tasks that wave the first mode, the last two with a bend."""
    r = body.n_modes
    alpha, beta = np.zeros((3, 2, r)), np.ones((3, 2, r))
    alpha[:, 0, 0], alpha[:, 1, 0] = 0.4, -0.4
    alpha[:, 0, 1], alpha[:, 1, 1] = 0.1, -0.1
    alpha[1, 0, 0], alpha[2, 0, 0] = 0.6, 0.2
    return Gait(
        body_hash=body.hash,
        task_names=("forward", "left", "right"),
        timestep=TIMESTEP,
        steps_per_cycle=STEPS_PER_CYCLE,
        alpha=alpha,
        beta=beta,
        mu=np.tile([[0.0], [np.pi]], (1, r)),
        amplitude=body.amplitude,
    )


def swimming_files(body: Body) -> RunFiles:
    """Return the body with its gait and a surrogate."""
    surrogate = replace(sample_surrogate(body), body_hash=body.hash)
    return RunFiles.of(body, swimming_gait(body), surrogate)


def record_swim(
    path: Path,
    files: RunFiles,
    cycles: int = 6,
    scene: Scene | None = None,
    feedback: FeedbackSolver | None = None,
) -> None:
    """Log an episode of the navigation environment, with gaits drawn at random."""
    from defplan_mj.host.navigation import navigation_environment
    from defplan_mj.task import Navigation

    assert files.gait is not None
    scene = scene or sample_scene(speed=0.1)
    navigation, gaits = Navigation(laser_range=8.0, space=scene.space), len(files.gait.alpha)
    plays, ground = None, files.terrain
    if feedback is not None:
        plays = feedback.prepare(ReducedDynamics(files.body, TIMESTEP, ground), files.gait)
    env = navigation_environment(
        files.body,
        files.gait,
        navigation,
        lambda random: scene,
        terrain=ground,
        feedback=plays,
    )
    rng = np.random.default_rng(5)
    with Recorder(path, files) as recorder:
        env.task.step_hook = lambda physics, shape: recorder.step(
            physics.time(), physics.reduced_state(), shape, physics.clearance()
        )
        timestep = env.reset()
        context = {
            "task": "pebble-swim",
            "seed": 5,
            "timestep": TIMESTEP,
            **files.gait.stepping,
            "navigation": navigation,
        }
        context["feedback"] = "none" if feedback is None else feedback.name
        recorder.begin({**context, "state": env.physics.reduced_state()}, scene)
        for cycle in range(cycles):
            time, x = env.physics.time(), env.physics.reduced_state()
            laser, gait_index = timestep.observation["laser"].copy(), int(rng.integers(gaits))
            timestep = env.step(gait_index)
            recorder.cycle(cycle, time, x, gait_index, np.zeros(gaits), timestep.reward, laser)
        recorder.end("timeout", f"{cycles} cycles are over")
    env.close()
