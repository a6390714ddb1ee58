"""The benchmark: the reduced step beside f, MuJoCo's flex and f_fit, and what a cycle is made of.

All in one process and one run, on one core unless a name says otherwise, after warm-up. Times of single
calls are taken around the compiled function itself (arguments are laid out before), and the time of an
empty call of the same kind is stated beside them.
"""

from __future__ import annotations

import ctypes
import dataclasses
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np

from defplan_mj import registry, suite
from defplan_mj.base import threads
from defplan_mj.base.progress import Progress, no_progress
from defplan_mj.base.space import PLANE, SPACE
from defplan_mj.body.model import Body
from defplan_mj.dynamics.full_fem import FullFem
from defplan_mj.dynamics.reduced import ReducedDynamics
from defplan_mj.gait.gait import Gait
from defplan_mj.host.navigation import robot_environment
from defplan_mj.kernel import library
from defplan_mj.planning.outcome import Outcome
from defplan_mj.planning.robot import Robot
from defplan_mj.planning.scene import Scene
from defplan_mj.planning.scenes import novel_scenes, training_scenes
from defplan_mj.planning.surrogate import Surrogate
from defplan_mj.planning.surrogate_env import SurrogateEnv
from defplan_mj.rl.many import KernelVectorEnv
from defplan_mj.studies.bench_integrators import error_against_time, integrators
from defplan_mj.studies.timing import Timing, measure
from defplan_mj.task import Navigation, TaskSpec

OBSTACLES = 10
ENVIRONMENTS = 256
VECTOR_ENVIRONMENTS = 512
_GEOM_TYPES = {"sphere": 2, "cylinder": 5}  # MuJoCo's
VIGOUR = 0.9  # of the largest amplitude a gait may ask for


def vigorous_gait(body: Body, timestep: float, steps_per_cycle: int) -> Gait:
    """Return a gait that swings every mode through 90% of its amplitude, each at its own phase.

    2 sinh(b cos) from two DMP elements; harder on the solver than an optimised gait.
    """
    r, sharpness = body.n_modes, 1.0
    size = VIGOUR * body.amplitude / (2 * np.sinh(sharpness))
    alpha = np.stack([size, -size])[None]
    beta = np.stack([np.full(r, sharpness), np.full(r, -sharpness)])[None]
    mu = np.tile(2 * np.pi * np.arange(r) / r, (2, 1))
    return Gait(
        body_hash=body.hash,
        task_names=("vigorous",),
        timestep=timestep,
        steps_per_cycle=steps_per_cycle,
        alpha=alpha,
        beta=beta,
        mu=mu,
        amplitude=body.amplitude,
    )


class Kernel:
    """The compiled functions, called with addresses: nothing is checked or copied on the way."""

    def __init__(self, dynamics: ReducedDynamics) -> None:
        self.dynamics = dynamics
        self._lib = library.kernel()
        self._blob, self._model = dynamics.blob.ctypes.data, ctypes.addressof(dynamics.model)
        self._sizes = (ctypes.c_int * 5)()

    def function(self, name: str, result: Any, *kinds: Any) -> Any:
        """Return a function of the library with plain argument types."""
        return ctypes.CFUNCTYPE(result, *kinds)((name, self._lib))

    def empty(self) -> Callable[[], Any]:
        """Return a call that does next to nothing: what a call costs by itself."""
        call = self.function("dp_sizes", None, ctypes.c_void_p, ctypes.c_void_p)
        sizes = ctypes.addressof(self._sizes)
        return lambda: call(self._blob, sizes)

    def steps(self, states: np.ndarray, shapes: np.ndarray) -> Timing:
        """Time each single step along a trajectory (N + 1, nx) under `shapes` (N, r)."""
        call = self.function("dp_step", ctypes.c_int, *[ctypes.c_void_p] * 5)
        out = np.empty(states.shape[1])
        return self._along(call, (states, shapes, out, None), len(shapes))

    def adjoints(self, states: np.ndarray, shapes: np.ndarray) -> Timing:
        """Time the adjoint of each step of a trajectory."""
        call = self.function("dp_step_adj", ctypes.c_int, *[ctypes.c_void_p] * 7)
        nx = states.shape[1]
        seed, gx, gu = np.ones(nx), np.empty(nx), np.empty(shapes.shape[1])
        return self._along(call, (states, shapes, states[1:], seed, gx, gu), len(shapes))

    def _along(self, call: Any, arrays: tuple[np.ndarray | None, ...], n: int) -> Timing:
        """Time `call(model, row i of each 2D array...)` for i < n."""
        addresses = [
            [
                None if a is None else a[i].ctypes.data if a.ndim == 2 else a.ctypes.data
                for i in range(n)
            ]
            for a in arrays
        ]
        rows = list(zip(*addresses, strict=True))
        for row in rows[: min(n, 200)]:
            call(self._model, *row)
        samples = np.empty(n)
        clock = time.perf_counter_ns
        model = self._model
        for i, row in enumerate(rows):
            start = clock()
            call(model, *row)
            samples[i] = clock() - start
        return Timing(1e-9 * samples)

    def clearance(self, qpos: np.ndarray, scene: Scene) -> Callable[[], Any]:
        """Return a call that finds the clearance to the scene's obstacles."""
        call = self.function(
            "dp_clearance", ctypes.c_double, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_int,
            ctypes.c_void_p, ctypes.c_double, ctypes.c_void_p, ctypes.c_void_p,
        )  # fmt: skip
        geoms = (library.Geom * len(scene.radii))()
        for geom, centre, radius in zip(geoms, scene.centres, scene.radii, strict=True):
            geom.type = _GEOM_TYPES[scene.shape]
            geom.size[:] = (radius, 3.0, 0.0)
            geom.pos[:] = tuple(centre)
            geom.mat[:] = tuple(np.eye(3).ravel())
        state = np.ascontiguousarray(qpos)
        address, count = ctypes.addressof(geoms), len(geoms)
        return lambda: call(self._blob, state.ctypes.data, count, address, 1e3, None, None)


def bench(
    spec: TaskSpec, body: Body, progress: Progress = no_progress, quick: bool = False
) -> dict[str, Any]:
    """Measure everything for one task's body.

    Args:
        spec: the task: time step, cycle, navigation problem.
        body: built from its mesh.
        quick: a tenth of the repeats.

    Returns:
        JSON-able figures; a name ends in its unit.
    """
    threads.limit_threads(1)
    few = 10 if quick else 1
    name = spec.name.split("-")[0]
    gait = vigorous_gait(body, spec.timestep, spec.steps_per_cycle)
    dynamics = spec.dynamics(body)
    kernel = Kernel(dynamics)

    progress("bench: reduced step", 0.0)
    cycles = 1000 // few
    shapes = np.tile(gait.table()[0], (cycles, 1))
    states = dynamics.rollout(dynamics.rest_state(), shapes)
    empty = measure(kernel.empty(), 2000)
    step = kernel.steps(states, shapes)
    rollout = measure(lambda: dynamics.rollout(states[0], shapes[:1100]), 20 // few + 1, 1)
    adjoint = kernel.adjoints(states, shapes)
    iterations = np.mean([dynamics.step_info(x, u)[1].iterations
                          for x, u in zip(states[:500], shapes[:500], strict=False)])  # fmt: skip

    progress("bench: feedback", 0.08)
    decision = _decisions(dynamics, gait, spec.navigation.space, 40 // few + 2)

    progress("bench: two threads", 0.1)
    speed_up = two_thread_speed_up(dynamics, states[0], shapes[:1100], 20 // few + 2)

    progress("bench: clearance and laser", 0.2)
    scene = novel_scenes(spec.navigation, 1, 0, OBSTACLES)[0]
    clearance = measure(kernel.clearance(states[-1][: 7 + body.n_modes], scene), 5000 // few)
    robot = Robot(body, gait, spec.world)
    planar = _sensing(robot, spec.navigation, PLANE.name, 5000 // few)
    spatial = _sensing(robot, spec.navigation, SPACE.name, 5000 // few)

    progress("bench: environment", 0.3)
    environment = _environment(robot, spec.navigation, scene)
    cycle = _environment_cycles(environment, 200 // few)
    vector = vector_steps_per_s(spec.name, 200 // few)

    progress("bench: surrogate", 0.4)
    surrogate = _transition(spec, body, gait, dynamics, 100 // few + 5)

    progress("bench: MuJoCo's flex", 0.5)
    flex = _flex(body, spec.timestep, 20 // few + 3)

    progress("bench: full FEM", 0.7)
    full = _full_fem(body, spec.timestep, gait, 20 // few + 2, progress)
    progress("bench: full FEM", 1.0)
    rows = error_against_time(integrators(body, spec), gait.table()[0], 3 if quick else 6)

    per_cycle = spec.steps_per_cycle
    return {
        "reduced_step_us": {name: step.scaled(1e-6)},
        "full_fem_step_ms": round(full.median * 1e3, 1),
        "mujoco_flex_step_ms": {key: round(value, 2) for key, value in flex.items()},
        "surrogate_transitions_per_s": round(ENVIRONMENTS / surrogate.median),
        "laser_scan_us": planar["laser"],
        "spherical_laser_scan_us": spatial["laser"],
        "observation_us": planar["observation"],
        "spatial_observation_us": spatial["observation"],
        "rollout_step_us": round(rollout.median * 1e6 / min(len(shapes), 1100), 2),
        "newton_iterations": round(float(iterations), 2),
        "rollout_two_thread_speed_up": round(speed_up, 2),
        "adjoint_step_us": adjoint.scaled(1e-6),
        "feedback_decision_us": {key: times.scaled(1e-6, 0) for key, times in decision.items()},
        "feedback_real_time_factor": {
            key: round(spec.timestep / (times.median + step.median), 1)
            for key, times in decision.items()
        },
        "clearance_us": round(clearance.median * 1e6, 1),
        "environment_step_us": cycle.scaled(1e-6 * per_cycle, 1),
        "vector_environment_steps_per_s": vector,
        "environment_real_time_factor": round(gait.cycle_seconds / cycle.median, 1),
        "empty_call_us": round(empty.median * 1e6, 2),
        "error_against_time": [dataclasses.asdict(row) for row in rows],
        "conditions": {
            "task": spec.name,
            "vertices": len(body.vertices),
            "modes": body.n_modes,
            "basis": body.n_basis,
            "timestep_s": spec.timestep,
            "surface_points": len(body.surface),
            "obstacles": OBSTACLES,
            "beams": spec.navigation.beams,
            "surrogate_environments": ENVIRONMENTS,
            "vector_environments": VECTOR_ENVIRONMENTS,
            "cores": threads.available_cores(),
            "quick": quick,
        },
    }


def two_thread_speed_up(
    dynamics: ReducedDynamics, x: np.ndarray, shapes: np.ndarray, repeats: int
) -> float:
    """Return how much faster two threads do a batch of rollouts than one; the median of pairs."""
    if threads.available_cores() < 2:
        return float("nan")

    def batch(pool: ThreadPoolExecutor) -> float:
        start = time.perf_counter()
        list(pool.map(lambda _: dynamics.rollout(x, shapes), range(4)))
        return time.perf_counter() - start

    with ThreadPoolExecutor(1) as one, ThreadPoolExecutor(2) as two:
        batch(one), batch(two)
        return float(np.median([batch(one) / batch(two) for _ in range(repeats)]))


def _decisions(dynamics: ReducedDynamics, gait: Gait, space: str, cycles: int) -> dict[str, Timing]:
    """Time what each installed feedback takes to choose a target shape, along cycles from rest."""
    timings = {}
    for entry in registry.solvers("feedback"):
        if entry.error or entry.name == "none":
            continue
        feedback, x = entry.value.prepare(dynamics, gait, space), dynamics.rest_state()
        samples = np.empty(cycles * gait.steps_per_cycle)
        for i in range(len(samples)):
            if i % gait.steps_per_cycle == 0:
                feedback.begin(0, x)
            start = time.perf_counter()
            shape = feedback.shape(x)
            samples[i] = time.perf_counter() - start
            x = dynamics.step(x, shape)
        timings[entry.name] = Timing(samples)
    return timings


def _environment(robot: Robot, navigation: Navigation, scene: Scene) -> Any:
    """Return the navigation environment in `scene`."""
    environment = robot_environment(robot, navigation, lambda random: scene, scene=scene)
    environment.reset()
    return environment


def _sensing(robot: Robot, navigation: Navigation, space: str, repeats: int) -> dict[str, float]:
    """Time laser scans and whole observations, laser included, in a scene of `space`; medians, us."""
    navigation = dataclasses.replace(navigation, space=space)
    scene = novel_scenes(navigation, 1, 0, OBSTACLES)[0]
    environment = _environment(robot, navigation, scene)
    physics, task = environment.physics, environment.task
    calls = {"laser": physics.laser, "observation": lambda: task.get_observation(physics)}
    return {name: round(measure(call, repeats).median * 1e6, 1) for name, call in calls.items()}


def _environment_cycles(environment: Any, repeats: int) -> Timing:
    """Time whole gait cycles of `env.step`, laser and contact queries included.

    A gait that fells a walker has few whole cycles, or none: then those that an end cut short count,
    too, scaled to a whole cycle. Twice `repeats` cycles are the most that are played.
    """
    whole, physics_step = environment.task.gait.cycle_seconds, environment.physics.timestep()
    for _ in range(5):
        _cycle(environment)
    complete, scaled = [], []
    for _ in range(2 * repeats):
        seconds, simulated = _cycle(environment)
        if simulated > whole - 0.5 * physics_step:
            complete.append(seconds)
        elif simulated > 0.5 * physics_step:
            scaled.append(seconds * whole / simulated)
        if len(complete) == repeats:
            break
    enough = len(complete) >= max(1, repeats // 10)
    return Timing(np.array(complete if enough else complete + scaled))


def _cycle(environment: Any) -> tuple[float, float]:
    """Play a cycle, after a reset if the last episode is over; wall and simulated seconds."""
    if environment.task.outcome != Outcome.RUNNING:
        environment.reset()
    before, start = environment.physics.time(), time.perf_counter()
    environment.step(0)
    return time.perf_counter() - start, environment.physics.time() - before


def vector_steps_per_s(name: str, repeats: int) -> dict[str, int] | None:
    """Return control steps a second of the suite's vector environment, on all cores; None if it has none.

    Args:
        name: of a task; the suite's is the one whose domain and task it names, such as 'fish-swim'.
        repeats: steps of all robots.

    Returns:
        Of 'smooth' actions, sines of half the amplitude, and of 'random' ones, drawn anew each step, on
        which the solver has more to do.
    """
    domain, _, task = name.partition("-")
    if (domain, task) not in suite.ALL_TASKS:
        return None
    env = KernelVectorEnv(domain, task, VECTOR_ENVIRONMENTS)
    rng, size = np.random.default_rng(0), env.action_space.shape
    start, turns = rng.uniform(0, 2 * np.pi, size), 0.3 * np.arange(repeats)
    actions = {
        "smooth": [0.5 * np.sin(start + turn) for turn in turns],
        "random": [rng.uniform(-1, 1, size) for _ in turns],
    }
    rates = {}
    for kind, each in actions.items():
        env.reset(seed=0)
        env.step(each[0])
        begin = time.perf_counter()
        for action in each:
            env.step(action)
        rates[kind] = round(repeats * VECTOR_ENVIRONMENTS / (time.perf_counter() - begin))
    env.close()
    return rates


def _transition(
    spec: TaskSpec, body: Body, gait: Gait, dynamics: ReducedDynamics, repeats: int
) -> Timing:
    """Time one step of the training environment: all its robots, laser scans included."""
    x = dynamics.rollout(dynamics.rest_state(), np.tile(gait.table()[0], (3, 1)))[-1]
    moved = np.linalg.norm(x[:3]) / 3
    surrogate = Surrogate(
        body_hash=body.hash,
        gait_hash="",
        task_names=("forward", "left", "right"),
        rotations=np.stack([_turn(a) for a in (0.0, 0.6, -0.6)]),
        translations=np.tile([max(moved, 0.5), 0.0, 0.0], (3, 1)),
        cycle_seconds=gait.cycle_seconds,
        pairs=0,
        rotation_mean=np.zeros(3),
        rotation_sd=np.zeros(3),
        translation_mean=np.zeros(3),
        translation_sd=np.zeros(3),
        radius=0.5 * body.length,
    )
    scenes = training_scenes(spec.navigation, 512, 0)
    generator = np.random.default_rng(0)
    environment = SurrogateEnv(surrogate, spec.navigation, scenes, ENVIRONMENTS, generator)
    actions = generator.integers(0, 3, (64, ENVIRONMENTS))
    count = iter(range(10**9))
    return measure(lambda: environment.step(actions[next(count) % 64]), repeats, 5)


def _turn(angle: float) -> np.ndarray:
    cos, sin = np.cos(angle), np.sin(angle)
    return np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])


def _flex(body: Body, timestep: float, steps: int) -> dict[str, float]:
    from defplan_mj.host.flex_peer import flex_step_ms

    return flex_step_ms(body, timestep, steps)


def _full_fem(body: Body, timestep: float, gait: Gait, repeats: int, progress: Progress) -> Timing:
    """Time f along the same gait, from rest; it swells over a cycle, since f has no way to clip it."""
    fem = FullFem(body, timestep)
    state = fem.rest()
    table = gait.table()[0]
    table = table * np.minimum(np.arange(1, len(table) + 1) / len(table), 1.0)[:, None]
    samples = []
    for i in range(repeats):
        progress("bench: full FEM", 0.7 + 0.3 * i / repeats)
        start = time.perf_counter()
        state = fem.step(state, table[i % len(table)])
        samples.append(time.perf_counter() - start)
    return Timing(np.array(samples[2:]))
