"""The navigation task (paper, section IV-B): an action is a gait, a step one gait cycle, or a part of it."""

from __future__ import annotations

import collections
from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np
from dm_control.rl import control
from dm_control.suite import base
from dm_env import specs

from defplan_mj.base import rotations
from defplan_mj.base.errors import DefplanError
from defplan_mj.base.space import PLANE, SPACE, SPACES
from defplan_mj.body.model import Body
from defplan_mj.dynamics.reduced import ReducedDynamics
from defplan_mj.dynamics.terrain import Terrain
from defplan_mj.feedback import Feedback, OpenLoop
from defplan_mj.gait.gait import Gait
from defplan_mj.host.physics import Physics
from defplan_mj.host.scene import build_spec, compile_model
from defplan_mj.planning.outcome import Outcome
from defplan_mj.planning.robot import Robot
from defplan_mj.planning.scene import Scene
from defplan_mj.task import Navigation, steps_of_decision

COLLISION_PENALTY = 1000.0  # Eq. 2
USUAL, IN_PLACES = 32, 160  # obstacles of a drawn scene, at most: beside the way, of a place
_LEAN, _SUNK = 0.5, 0.5  # a fall: cosine of the up axis' tilt, and share of the standing height

SceneSampler = Callable[[np.random.RandomState], Scene]
StepHook = Callable[[Physics, np.ndarray], None]


class Navigate(base.Task):
    """Reach the target of a scene, cycle by cycle, without touching an obstacle.

    The surface is checked against all obstacles after every physics step; the episode ends within
    the cycle, at the physics step where the target is reached or an obstacle touched.

    In the plane obstacles are upright cylinders, as in the paper, and the distance from the target
    is the horizontal one, so that drifting up or down is neither a way out nor held against the
    robot. In space obstacles are spheres and the distance is that in space.

    With more than one decision a cycle a step plays that part of the chosen gait's cycle that comes next:
    all gaits share their phases.

    On a terrain the episode also ends at the physics step where the robot falls: where its up axis
    leans by more than 60 degrees, or its centre of mass is below half of its standing height.

    Attributes:
        scene: of this episode; setting it takes effect at the next reset.
        outcome: of the episode, RUNNING until it is over.
        decisions: steps begun in this episode.
        closest: smallest clearance of this episode, m, at most 1.
        step_hook: called with the physics and the target shape (r,) after every physics step.
        tells_obstacles: observations have 'obstacles', for planners that need them
            (`planning.planner.needs_obstacles`).
    """

    def __init__(
        self,
        gait: Gait,
        sampler: SceneSampler,
        rest: np.ndarray,
        *,
        scene: Scene | None = None,
        feedback: Feedback | None = None,
        time_limit: float = float("inf"),
        random: np.random.RandomState | int | None = None,
        decisions_per_cycle: int = 1,
    ):
        """Take what drives the robot and where scenes come from.

        Args:
            gait: its tasks are the actions.
            sampler: draws the scene of an episode; not used once `scene` is set.
            rest: (13 + 3r,) the state at rest, where the robot starts.
            scene: keep to this one.
            feedback: plays the gaits; None: as they are, in open loop.
            time_limit: s, ends the episode as a timeout.
            random: generator or seed of the sampler.
            decisions_per_cycle: how often in a cycle the gait is chosen.
        """
        super().__init__(random=random)
        self.gait = gait
        self.outcome = Outcome.RUNNING
        self.decisions_per_cycle = decisions_per_cycle
        self._steps = steps_of_decision(gait.steps_per_cycle, decisions_per_cycle)
        self.decisions = 0
        self.closest = 1.0
        self.step_hook: StepHook | None = None
        self.tells_obstacles = False
        self._feedback = OpenLoop(gait) if feedback is None else feedback
        self._sampler = sampler
        self._fixed = scene
        self._scene = scene
        self._time_limit = time_limit
        self._before = np.zeros(3)
        self._rest = rest
        self._standing = 0.0

    @property
    def cycles(self) -> int:
        """Gait cycles begun in this episode."""
        return -(-self.decisions // self.decisions_per_cycle)

    @property
    def scene(self) -> Scene | None:
        """The scene of this episode; None before the first reset."""
        return self._scene

    @scene.setter
    def scene(self, scene: Scene) -> None:
        self._fixed = scene

    def initialize_episode(self, physics: Physics) -> None:
        """Place the robot at rest at the origin, or standing on its terrain there, in its scene.

        Raises:
            DefplanError: the scene is of another space than the robot navigates in.
        """
        self._scene = self._fixed if self._fixed is not None else self._sampler(self.random)
        _check_space(physics.space, self._scene)
        physics.set_scene(self._scene)
        state, attitude = self._rest.copy(), self._scene.orientation
        mujoco.mju_rotVecQuat(state[:3], self._rest[:3], attitude)
        mujoco.mju_mulQuat(state[3:7], attitude, self._rest[3:7])
        physics.set_reduced_state(state)
        self._feedback.reset()
        self.outcome = Outcome.RUNNING
        self.decisions = 0
        self.closest = 1.0
        self._before = physics.com()

    def action_spec(self, physics: Physics) -> specs.DiscreteArray:
        """Return the choice among the gait's tasks."""
        return specs.DiscreteArray(len(self.gait.task_names), name="gait")

    def before_step(self, action: int, physics: Physics) -> None:
        """Make the coming physics steps one cycle of gait `action`, or the part of it that comes next.

        Raises:
            DefplanError: there is no such gait.
        """
        index = self._gait_of(action)
        if self.decisions == 0:
            self._standing = physics.height()
        first = self.decisions % self.decisions_per_cycle * self._steps
        self.decisions += 1
        self._before = physics.com()
        if first:
            self._feedback.begin(index, physics.reduced_state(), first)
        else:  # a feedback that knows whole cycles only has no third argument
            self._feedback.begin(index, physics.reduced_state())
        physics.follow(self._feedback.shape, self._after_physics_step)

    def _gait_of(self, action: Any) -> int:
        """Return the number of the gait that an action, one whole number in whatever array, chooses."""
        array = np.asarray(action)
        whole = array.size == 1 and array.dtype.kind in "iu"
        if not whole or not 0 <= array.item() < len(self.gait.task_names):
            raise DefplanError(
                f"there is no gait {action}: the actions are 0 to {len(self.gait.task_names) - 1}"
                f" ({', '.join(self.gait.task_names)})"
            )
        return int(array.item())

    def _after_physics_step(self, physics: Physics, target_shape: np.ndarray) -> bool:
        """Check for collision and success; true ends the cycle here."""
        clearance = physics.clearance()
        self.closest = min(self.closest, clearance)
        if clearance < 0:
            self.outcome = Outcome.COLLISION
        elif self.distance(physics) <= self._here().goal_radius:
            self.outcome = Outcome.SUCCESS
        elif physics.walks and self._fallen(physics):
            self.outcome = Outcome.FALL
        if self.step_hook is not None:
            self.step_hook(physics, target_shape)
        return self.outcome != Outcome.RUNNING

    def _fallen(self, physics: Physics) -> bool:
        return physics.upright() < _LEAN or physics.height() < _SUNK * self._standing

    def after_step(self, physics: Physics) -> None:
        """Time out after the scene's number of cycles."""
        most = self._here().max_cycles * self.decisions_per_cycle
        late = self.decisions >= most or physics.time() >= self._time_limit
        if self.outcome == Outcome.RUNNING and late:
            self.outcome = Outcome.TIMEOUT

    def distance(self, physics: Physics) -> float:
        """Return the distance of the centre of mass from the target, m; see `Navigate`."""
        return float(np.linalg.norm(self._offset(physics.com())))

    def _offset(self, centre: np.ndarray) -> np.ndarray:
        """Return `centre` minus the target; level in the plane."""
        scene = self._here()
        offset = centre - scene.target
        offset[scene.place.dimension :] = 0.0
        return offset

    def get_reward(self, physics: Physics) -> float:
        """Return Eq. 2: |c_i - T|^2 - |c_{i+1} - T|^2 - 1000 coll, of the step just done."""
        before, after = self._offset(self._before), self._offset(physics.com())
        collision = COLLISION_PENALTY if self.outcome == Outcome.COLLISION else 0.0
        return float(before @ before - after @ after - collision)

    def get_termination(self, physics: Physics) -> float | None:
        """Return the last discount: 1 at a timeout, 0 at another end; None if not over."""
        if self.outcome == Outcome.RUNNING:
            return None
        return 1.0 if self.outcome == Outcome.TIMEOUT else 0.0

    def get_observation(self, physics: Physics) -> collections.OrderedDict[str, np.ndarray]:
        """Return 'state', 'target' and 'laser', see `reduced_observation`; 'obstacles' if it tells them."""
        observation = reduced_observation(physics, physics.target())
        if self.tells_obstacles:
            seconds = self.gait.cycle_seconds / self.decisions_per_cycle
            observation["obstacles"] = true_obstacles(physics, self._here(), seconds)
        return observation

    def _here(self) -> Scene:
        if self._scene is None:
            raise DefplanError("the episode has no scene yet: reset the environment first")
        return self._scene


def reduced_observation(
    physics: Physics, target: np.ndarray
) -> collections.OrderedDict[str, np.ndarray]:
    """Return what a planner sees, float64, in the frame that it turns with: see `Physics.frame`.

    In the plane that is the yaw frame (x forward, y left, z up), in space the body's.

    'state': height (m); attitude; modal coordinates; velocity in the frame (m/s); angular velocity
    in the body frame (rad/s); modal velocities. The attitude is, in the plane, the orientation
    without yaw as a quaternion w x y z, so (11 + 2r,) in all; in space it is the whole rotation
    matrix, row by row, which has no jumps at any attitude, so (16 + 2r,). 'target' (3,): its
    position in the frame relative to the centre of mass, m. 'laser' (beams,): what the
    task's sensor measures, see `planning.sensors`.
    """
    frame = physics.planning_frame()
    centre = physics.com()
    state = np.concatenate(
        [
            centre[2:],
            _ATTITUDES[physics.space](physics),
            physics.shape(),
            physics.data.qvel[:3] @ frame,
            physics.data.qvel[3:6],
            physics.shape_velocity(),
        ]
    )
    observation = collections.OrderedDict()
    observation["state"] = state
    observation["target"] = (np.asarray(target) - centre) @ frame
    observation["laser"] = physics.laser()
    return observation


def true_obstacles(physics: Physics, scene: Scene, seconds: float) -> np.ndarray:
    """Return the obstacles (n, 2 d + 1) of a scene now, in the robot's frame.

    Each row is a centre (d), m, a radius, m, and how far it moves in a decision of `seconds` (d), m.
    """
    d, frame = scene.place.dimension, physics.planning_frame()
    centres = scene.centres + physics.time() * scene.velocities - physics.com()
    drift = seconds * scene.velocities
    return np.hstack([(centres @ frame)[:, :d], scene.radii[:, None], (drift @ frame)[:, :d]])


def _tilt(physics: Physics) -> np.ndarray:
    """Return the orientation without yaw as a quaternion (4,) w x y z, w not negative."""
    tilt = rotations.product(rotations.level_attitude(-physics.yaw()), physics.data.qpos[3:7])
    return tilt if tilt[0] >= 0 else -tilt


_ATTITUDES: dict[str, Callable[[Physics], np.ndarray]] = {
    PLANE.name: _tilt,
    SPACE.name: lambda physics: physics.orientation().ravel(),
}
"""What is told of the attitude in each space."""


def _check_space(space: str, scene: Scene) -> None:
    if scene.space != space:
        raise DefplanError(
            f"a {space} task cannot use a scene of {scene.shape}s: hand in a scene of"
            f" {SPACES[space].obstacle}s, or set navigation.space to {scene.space!r}"
        )


def navigation_environment(
    body: Body,
    gait: Gait,
    navigation: Navigation,
    sampler: SceneSampler,
    *,
    terrain: Terrain | None = None,
    scene: Scene | None = None,
    feedback: Feedback | None = None,
    time_limit: float = float("inf"),
    random: np.random.RandomState | int | None = None,
    max_obstacles: int | None = None,
    texture: np.ndarray | None = None,
    environment_kwargs: dict | None = None,
) -> control.Environment:
    """Return the navigation task of `body` with `gait` as a dm_control environment.

    Args:
        navigation: the space, beams and range of the laser, decisions a cycle, goal and limits of sampled
            scenes.
        sampler: draws scenes with the task's generator.
        terrain: what the robot walks on; without it it swims.
        scene: keep to this one; later ones are set as `env.task.scene`.
        feedback: prepared for this gait; None: open loop.
        time_limit: s; a scene's own max_cycles holds anyway.
        max_obstacles: room for the obstacles of a scene; None: as many as drawn scenes may have.
        texture: of the skin, see `skin.add_skin`.

    Raises:
        DefplanError: the gait is of another body, asks for larger shapes than the body has, or its cycle
            has not as many equal parts as there are decisions in it.
    """
    if gait.body_hash != body.hash:
        raise DefplanError(
            f"the gait belongs to another body ({gait.body_hash[:8]}) than {body.name}"
            f" ({body.hash[:8]}): solve the gait for this body"
        )
    if np.any(np.abs(gait.table()) > body.amplitude):
        raise DefplanError(
            f"the gait asks for larger target shapes than the body {body.name} is made for"
            f" ({np.array2string(body.amplitude)})"
        )
    if max_obstacles is None:
        max_obstacles = IN_PLACES if navigation.scenes else USUAL
    spec = build_spec(
        body,
        gait.timestep,
        normalised_controls=False,
        max_obstacles=max_obstacles,
        beams=navigation.beams,
        laser_range=navigation.laser_range,
        space=navigation.space,
        sensor=navigation.sensor,
        terrain=terrain,
        texture=texture,
        stepping=gait.stepping,
    )
    rest = ReducedDynamics(body, gait.timestep, terrain, **gait.stepping).rest_state()
    task = Navigate(
        gait,
        sampler,
        rest,
        scene=scene,
        feedback=feedback,
        time_limit=time_limit,
        random=random,
        decisions_per_cycle=navigation.decisions_per_cycle,
    )
    return control.Environment(
        Physics.from_mjmodel(compile_model(spec)),
        task,
        n_sub_steps=steps_of_decision(gait.steps_per_cycle, navigation.decisions_per_cycle),
        time_limit=time_limit,
        **(environment_kwargs or {}),
    )


def robot_environment(
    robot: Robot, navigation: Navigation, sampler: SceneSampler, **options: Any
) -> control.Environment:
    """Return a robot's navigation environment; `options` are those of `navigation_environment`."""
    return navigation_environment(
        robot.body,
        robot.gait,
        navigation,
        sampler,
        terrain=robot.world.terrain,
        feedback=robot.prepared(navigation.space),
        **options,
    )
