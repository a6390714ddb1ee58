"""dm_control's Physics for a deformable robot: its reduced state, measurements, laser, and gait following."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np
from dm_control.mujoco import engine, wrapper

from defplan_mj.base import rotations
from defplan_mj.base.space import OF_DIMENSION, Space
from defplan_mj.host import contact
from defplan_mj.host.ground import height_above
from defplan_mj.host.laser import SceneView
from defplan_mj.host.obstacles import set_scene
from defplan_mj.host.plugin import load_plugin
from defplan_mj.host.scene import ROBOT, TARGET, TERRAIN, LaserNumbers, text_of
from defplan_mj.kernel.library import kernel
from defplan_mj.kernel.pack import unpack_options
from defplan_mj.planning.scene import Scene
from defplan_mj.planning.sensors.sensor import sensor_of
from defplan_mj.task import Navigation

load_plugin()  # on import, since a pickled Physics needs it before any of its code runs

# indices into plugin_state (plugin.c)
_ITERATIONS, _RESIDUAL, _FAILED, _DIVISION = 1, 2, 3, 4


class Physics(engine.Physics):
    """A model of `scene.build_spec` under way.

    The robot is the model's first body, so its state is the first 7 + r of qpos, 6 + r of qvel, r of act.
    """

    _shape_of: Callable[[np.ndarray], np.ndarray] | None = None
    _after: Callable[[Physics, np.ndarray], bool] | None = None

    @classmethod
    def from_mjmodel(cls, model: mujoco.MjModel) -> Physics:
        """Return a Physics at rest of a compiled model."""
        return cls.from_model(wrapper.MjModel(model))

    @property
    def stepping(self) -> dict[str, Any]:
        """'substeps' and 'integrator' of the reduced dynamics."""
        return unpack_options(self._numeric("defplan_options")).stepping

    # ---- the reduced state

    @property
    def space(self) -> str:
        """'planar' or 'spatial': where the robot navigates."""
        return self.place.name

    @property
    def place(self) -> Space:
        """The space itself."""
        return OF_DIMENSION[int(self._laser_numbers().dimension)]

    @property
    def n_modes(self) -> int:
        """r, the number of modal coordinates."""
        return self._numeric("defplan_scale").size

    def reduced_state(self) -> np.ndarray:
        """Return a copy of the state (13 + 3r,) as kernel.h lays it out."""
        r = self.n_modes
        return np.concatenate([self.data.qpos[: 7 + r], self.data.qvel[: 6 + r], self.data.act[:r]])

    def set_reduced_state(self, state: np.ndarray) -> None:
        """Set the state (13 + 3r,); use within `reset_context`, or call `forward` afterwards."""
        r = self.n_modes
        self.data.qpos[: 7 + r] = state[: 7 + r]
        self.data.qvel[: 6 + r] = state[7 + r : 13 + 2 * r]
        self.data.act[:r] = state[13 + 2 * r :]

    def target_shape(self) -> np.ndarray:
        """Return the target shape (r,) that the present controls ask for."""
        r = self.n_modes
        low, high = self.model.actuator_ctrlrange[:r].T
        return self._numeric("defplan_scale") * np.clip(self.data.ctrl[:r], low, high)

    def solver(self) -> dict[str, float]:
        """Return 'iterations', 'residual' and 'division' of the last step, 'failed' solves since the reset."""
        state = self.data.plugin_state
        return {
            "iterations": float(state[_ITERATIONS]),
            "residual": float(state[_RESIDUAL]),
            "failed": float(state[_FAILED]),
            "division": float(state[_DIVISION]),
        }

    # ---- measurements

    def shape(self) -> np.ndarray:
        """Return a copy of the modal coordinates (r,)."""
        return self.data.qpos[7 : 7 + self.n_modes].copy()

    def shape_velocity(self) -> np.ndarray:
        """Return a copy of the modal velocities (r,), 1/s."""
        return self.data.qvel[6 : 6 + self.n_modes].copy()

    def com(self) -> np.ndarray:
        """Return a copy of the centre of mass (3,), m."""
        return self.data.qpos[:3].copy()

    def target(self) -> np.ndarray:
        """Return a copy of the target's position (3,), m."""
        return self.named.data.site_xpos[TARGET].copy()

    def orientation(self) -> np.ndarray:
        """Return the (3, 3) rotation of the body frame: columns forward, left, up."""
        matrix = np.empty(9)
        mujoco.mju_quat2Mat(matrix, self.data.qpos[3:7])
        return matrix.reshape(3, 3)

    def yaw(self) -> float:
        """Return the heading, rad, in (-pi, pi]."""
        return float(rotations.heading(self.orientation()))

    def yaw_frame(self) -> np.ndarray:
        """Return the (3, 3) rotation by the heading about the vertical."""
        return rotations.level_matrix(self.yaw())

    def planning_frame(self) -> np.ndarray:
        """Return the (3, 3) rotation that planning turns with: by the heading, or the body's own."""
        return self.place.frame(self.orientation())

    def frame(self) -> np.ndarray:
        """Return its axes (3, d), as columns in the world, along which planning goes.

        In the plane the heading and what lies to its left (d = 2), in space the body's own axes (d = 3).
        """
        return self.planning_frame()[:, : self.place.dimension]

    @property
    def walks(self) -> bool:
        """Whether there is a terrain."""
        return mujoco.mj_name2id(self.model.ptr, mujoco.mjtObj.mjOBJ_NUMERIC, TERRAIN) >= 0

    def height(self) -> float:
        """Return the height of the centre of mass above the terrain straight below, m; -1 if none."""
        return height_above(self.model.ptr, self.data.ptr, self.com())

    def upright(self) -> float:
        """Return the cosine of the angle between the body's up and the vertical."""
        return float(self.orientation()[2, 2])

    def surface(self) -> np.ndarray:
        """Return the world positions (n_s, 3) of the deformed surface vertices, m."""
        blob, sizes = self._blob(), (ctypes.c_int * 5)()
        kernel().dp_sizes(blob, sizes)
        points = np.empty((sizes[3], 3))
        qpos = self.data.qpos[: 7 + self.n_modes].copy()
        kernel().dp_surface(blob, qpos, points)
        return points

    def clearance(self) -> float:
        """Return the signed distance of the surface to the nearest obstacle, m, at most 1."""
        return float(self.named.data.sensordata["clearance"][0])

    def nearest(self, cutoff: float = 1.0) -> contact.Nearest:
        """Return the closest pair of surface point and geom within `cutoff` (m)."""
        qpos = self.data.qpos[: 7 + self.n_modes].copy()
        robot = self.model.name2id(ROBOT, "body")
        return contact.nearest(self.model.ptr, self.data.ptr, self._blob(), qpos, robot, cutoff)

    def laser_range(self) -> float:
        """Return the range of the laser, m."""
        return float(self._laser_numbers().range)

    def laser(self) -> np.ndarray:
        """Return what the robot's sensor measures (size,): the distances along a laser's beams, m."""
        there = self._sensing()
        robot = self.model.name2id(ROBOT, "body")
        view = SceneView(self.model.ptr, self.data.ptr, self.com(), self.frame(), robot)
        return sensor_of(there).measure(view, there)

    def _sensing(self) -> Navigation:
        """Return what the model says of the sensor."""
        numbers = self._laser_numbers()
        return Navigation(
            beams=int(numbers.beams),
            laser_range=float(numbers.range),
            space=self.space,
            sensor=text_of(self.model.ptr, "sensor"),
        )

    # ---- acting

    def set_scene(self, scene: Scene) -> None:
        """Place target and obstacles; use within `reset_context`, see `obstacles.set_scene`."""
        set_scene(self.model.ptr, self.data.ptr, scene)

    def follow(
        self,
        shape_of: Callable[[np.ndarray], np.ndarray],
        after: Callable[[Physics, np.ndarray], bool],
    ) -> None:
        """Make the next `step(n)` ask for a control before each of its physics steps.

        Args:
            shape_of: called with the reduced state, returns the control (r,).
            after: called after each physics step with the control; true ends the `step` early.
        """
        self._shape_of, self._after = shape_of, after

    def step(self, nstep: int = 1) -> None:
        """Advance by `nstep` physics steps, with the controls of `follow` if there are."""
        shape_of, after = self._shape_of, self._after
        self._shape_of = self._after = None
        if shape_of is None or after is None:
            super().step(nstep)
            return
        for _ in range(nstep):
            shape = shape_of(self.reduced_state())
            self.set_control(shape)
            super().step()
            if after(self, shape):
                break

    def _numeric(self, name: str) -> np.ndarray:
        model = self.model.ptr
        return model.numeric(name).data

    def _laser_numbers(self) -> LaserNumbers:
        return LaserNumbers(*self._numeric("laser"))

    def _blob(self) -> np.ndarray:
        return self._numeric("defplan_body")
