"""Small bodies, hand-made gaits and scenes for the tests of the MuJoCo host."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Sequence

import numpy as np

from defplan_mj.base.rotations import level_attitude
from defplan_mj.body.model import Body
from defplan_mj.dynamics.reduced import ReducedDynamics
from defplan_mj.gait.gait import Gait
from defplan_mj.host.physics import Physics
from defplan_mj.host.scene import build_spec, compile_model
from defplan_mj.planning.scene import Scene
from defplan_mj.task import TaskSpec
from defplan_tasks import quadruped as quadruped_domain
from defplan_tasks import tee as tee_domain
from tests.samples import bodies


def fish() -> Body:
    """Return a coarse fish."""
    return bodies.small_fish()


def quadruped() -> Body:
    """Return a coarse 4-legged body; on fewer vertices its legs would be lost."""
    return _coarse(quadruped_domain.SWIM)


def walker() -> Body:
    """Return the coarse 4-legged body in the air."""
    return _coarse(quadruped_domain.WALK)


def tee() -> Body:
    """Return the coarse T-shaped body."""
    return _coarse(tee_domain.WALK)


def _coarse(spec: TaskSpec) -> Body:
    return bodies.built(spec.mesh, dataclasses.replace(spec.body, vertices=450, drag_points=40))


@functools.cache
def dynamics(timestep: float = 0.04) -> ReducedDynamics:
    return ReducedDynamics(fish(), timestep)


@functools.cache
def gait() -> Gait:
    """Return three undulations, by hand: the tail beats, straight or bent to a side."""
    r = fish().n_modes
    alpha, beta = np.zeros((3, 5, r)), np.zeros((3, 5, r))
    mu = np.tile(2 * np.pi * np.arange(5)[:, None] / 5, (1, r))
    alpha[:, 0, 0], alpha[:, 2, 0] = 0.7, -0.7
    alpha[:, 1, 1], alpha[:, 3, 1] = 0.5, -0.5
    beta[:, :4, :2] = 1.0
    alpha[1, 4, 0], alpha[2, 4, 0] = 0.4, -0.4
    return Gait(
        fish().hash, ("forward", "left", "right"), 0.04, 11, alpha, beta, mu, fish().amplitude
    )


@functools.cache
def quadruped_gait() -> Gait:
    """Return five ways to beat the legs, by hand: one mode leads, another follows."""
    return _beats(quadruped(), quadruped_domain.SWIM, 0.8)


@functools.cache
def walker_gait() -> Gait:
    """Return four small ways to move the legs, on which the walker stays up."""
    return _beats(walker(), quadruped_domain.WALK, 0.1)


@functools.cache
def tee_gait() -> Gait:
    """Return four small ways to move the T-shaped body."""
    return _beats(tee(), tee_domain.WALK, 0.1)


def _beats(body: Body, spec: TaskSpec, size: float) -> Gait:
    names = tuple(task.name for task in spec.gait_tasks)
    alpha, beta = np.zeros((2, len(names), 2, body.n_modes))
    mu = np.tile(np.array([0.0, np.pi])[:, None], (1, body.n_modes))
    for task in range(len(names)):
        alpha[task, :, task], alpha[task, :, task + 1] = [size, -size], [-0.6 * size, 0.6 * size]
    beta[:] = 0.8
    return Gait(
        body.hash, names, spec.timestep, spec.steps_per_cycle, alpha, beta, mu, body.amplitude
    )


def scene(
    circles: list[tuple[float, float, float]],
    target: tuple[float, float, float] = (20.0, 0.0, 0.0),
    velocities: Sequence[tuple[float, ...]] | None = None,
    yaw: float = 0.0,
    **kwargs,
) -> Scene:
    """Return a scene with cylinders (x, y, radius) and a start heading, rad."""
    array = np.array(circles, float).reshape(-1, 3)
    centres = np.column_stack([array[:, :2], np.zeros(len(array))])
    moving = np.zeros_like(centres) if velocities is None else np.array(velocities, float)
    attitude = level_attitude(yaw)
    return Scene(
        np.array(target, float), centres, array[:, 2], moving, orientation=attitude, **kwargs
    )


def physics(max_obstacles: int = 4, **kwargs) -> Physics:
    """Return the fish in its world, at rest at the origin."""
    spec = build_spec(fish(), 0.04, max_obstacles=max_obstacles, **kwargs)
    return Physics.from_mjmodel(compile_model(spec))


def place(
    physics: Physics, position=(0.0, 0.0, 0.0), quaternion=(1.0, 0.0, 0.0, 0.0), q=None
) -> None:
    """Put the robot somewhere, at rest."""
    with physics.reset_context():
        state = np.zeros(13 + 3 * physics.n_modes)
        state[:3], state[3:7] = position, np.array(quaternion) / np.linalg.norm(quaternion)
        if q is not None:
            state[7 : 7 + physics.n_modes] = q
        physics.set_reduced_state(state)


def spheres(
    balls: Sequence[tuple[float, float, float, float]] | np.ndarray,
    target: tuple[float, float, float] | np.ndarray = (20.0, 0.0, 0.0),
    orientation=(1.0, 0.0, 0.0, 0.0),
    **kwargs,
) -> Scene:
    """Return a scene with spheres (x, y, z, radius) and a start attitude w x y z."""
    array = np.array(balls, float).reshape(-1, 4)
    attitude = np.array(orientation, float) / np.linalg.norm(orientation)
    return Scene(
        np.array(target, float),
        array[:, :3],
        array[:, 3],
        np.zeros((len(array), 3)),
        "sphere",
        attitude,
        **kwargs,
    )


def attitudes(n: int, seed: int = 0) -> np.ndarray:
    """Return n quaternions (n, 4), spread evenly over all attitudes, of both signs."""
    quaternions = np.random.default_rng(seed).normal(size=(n, 4))
    return quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)
