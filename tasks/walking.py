"""What the walkers share: the air, the ground, four gaits without turning, the suite's walk task."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from dm_control.rl import control

from defplan_mj.base.rotations import level_attitude, product
from defplan_mj.base.space import Space
from defplan_mj.body.model import Body, Material
from defplan_mj.dynamics.reduced import ReducedDynamics
from defplan_mj.dynamics.world import GROUND
from defplan_mj.task import BodyOptions, GaitTask, TaskSpec, Weights
from defplan_tasks import environments, swimming

WEIGHTS = Weights(turn=3.0, move=8.0, drift=8.0, tilt=3.0, slip=0.8)
ADVANCE = 0.4  # wanted of a cycle, m

_SPEED = 0.5  # m/s towards the target that earn the full reward
_STANDING = 0.7  # share of the standing height from which on it is no fall


def walking_tasks(advance: float = ADVANCE) -> tuple[GaitTask, ...]:
    """Return forward, back, left and right, by `advance` (m) a cycle, the heading kept."""
    sides = {"forward": (1.0, 0.0), "back": (-1.0, 0.0), "left": (0.0, 1.0), "right": (0.0, -1.0)}
    return tuple(
        GaitTask(name, move=(advance * x, advance * y, 0.0)) for name, (x, y) in sides.items()
    )


def walk_spec(
    name: str,
    description: str,
    mesh: str,
    vertices: int,
    shipped: tuple[Path, Path],
    skin: Callable[[], np.ndarray],
    gait_solver: str,
    paper: dict,
) -> TaskSpec:
    """Return the task of a walker: all but its body's shape and the paper's figures is shared.

    Args:
        mesh: file among the assets.
        vertices: wanted number of tetrahedral mesh vertices.
        shipped: files of its body and gaits.
        skin: makes the picture it wears.
        gait_solver: the default one.
        paper: Tables I to III; hours are the paper's own.
    """
    return TaskSpec(
        name=name,
        description=description,
        mesh=environments.ASSETS / mesh,
        body=BodyOptions(
            vertices=vertices,
            modes=10,
            basis=31,
            samples=16,
            drag_error=0.3,  # of the air's
            amplitude=1.0,
            length=1.0,
            # as much as implicit Euler at 0.03 s used to add, (1 + k_c) h: with less a walker wobbles
            material=Material(youngs_modulus=1e6, damping=0.15),
            medium=GROUND.medium,
        ),
        timestep=0.015,
        steps_per_cycle=46,
        gait_tasks=walking_tasks(),
        gait_steps=400,
        weights=WEIGHTS,
        terrain=GROUND.terrain,
        shipped=shipped,
        skin=skin,
        gait_solver=gait_solver,
        planner="dql",
        feedback="none",
        rivals=("cio", "cio-alternating"),  # what the paper walks by, all at once and by turns
        paper={
            "dof": 16,
            "gait_steps": 200,
            "wavelets": 5,
            "k2": 10,
            "n2_cycles": 400,
            "memory": 40_000,
            "steps_per_cycle": 23,
            "k2_success": 1.0,
            "tasks": ("forward", "back", "left", "right"),
            "vertices": vertices,
            **paper,
        },
    )


def walk_environment(
    spec: TaskSpec,
    body: Body,
    time_limit: float = 40.0,
    random: np.random.RandomState | int | None = None,
    environment_kwargs: dict | None = None,
) -> control.Environment:
    """Return the task `Walk`: the action is the target shape, in [-1, 1] of the body's amplitude."""
    dynamics = spec.dynamics(body)
    return environments.shape_environment(
        spec, Walk(dynamics, time_limit, random), environment_kwargs
    )


class Walk(swimming.Swim):
    """Walk to a target at half a metre a second, upright and without sinking down."""

    speed = _SPEED

    def __init__(
        self,
        dynamics: ReducedDynamics,
        time_limit: float = 40.0,
        random: np.random.RandomState | int | None = None,
    ) -> None:
        """Take what walks, on level ground at height 0; the rest as for `Swim`."""
        super().__init__(dynamics, time_limit, random)
        self._rest = dynamics.rest_state()

    def draw(
        self, random: np.random.RandomState, place: Space, modes: int
    ) -> tuple[np.ndarray, np.ndarray]:
        """Draw target, heading and a slightly bent shape; the robot stands on the ground."""
        target, state = super().draw(random, place, modes)
        bend = state[7 : 7 + modes].copy()
        state[: 7 + modes] = self._rest[: 7 + modes]
        target[2] = state[2]
        sole = self._sole(state)
        yaw = random.uniform(-np.pi, np.pi)
        state[3:7] = product(level_attitude(yaw), state[3:7])
        state[7 : 7 + modes] += bend
        state[2] += sole - self._sole(state)  # on the ground, bent as it is
        return target, state

    def rewards(self, states: np.ndarray, targets: np.ndarray, place: Space) -> np.ndarray:
        """Return (n,) in [0, 1]: as for a swimmer in the plane, times how high it stands."""
        standing = np.clip(states[:, 2] / (_STANDING * self._rest[2]), 0.0, 1.0)
        return standing * super().rewards(states, targets, place)

    def _sole(self, state: np.ndarray) -> float:
        return float(self.dynamics.surface(state)[:, 2].min())
