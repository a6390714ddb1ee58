"""A log as a Rerun recording: body, scene, laser and named plots, and a blueprint that lays them out.

`rerun-sdk` is an optional extra ('defplan[rerun]') that is imported here only.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from defplan_mj.base import files, rotations
from defplan_mj.base.errors import DefplanError
from defplan_mj.base.progress import Progress, no_progress
from defplan_mj.base.space import SPACES
from defplan_mj.log import columns, schemas
from defplan_mj.log.reader import EpisodeLog, read_log
from defplan_mj.log.run_files import RunFiles
from defplan_mj.planning.sensors.laser import Laser
from defplan_mj.planning.sensors.sensor import sensor_of
from defplan_mj.task import Navigation

MESH_EVERY = 2
"""Steps from one drawn surface to the next, as in the log's own `/robot/mesh`."""

BODY, OBSTACLE, TARGET = (41, 140, 158), (64, 107, 191), (217, 51, 43)
BEAM, PATH, PREDICTION = (217, 138, 31, 90), (46, 139, 87), (138, 79, 158)
_TALL = 2.0  # m; obstacles are endless, this is what is drawn of them
_TIMELINE = "time"


def check_rerun(path: str | Path) -> None:
    """Raise DefplanError if no recording can be written at `path`; to be asked before long work."""
    if Path(path).suffix.lower() != ".rrd":
        raise DefplanError(f"cannot write a Rerun recording as {path}: end its name in .rrd")
    rerun()
    files.check_writable(path)


def rerun() -> Any:
    """Return the module `rerun`.

    Raises:
        DefplanError: it is not installed.
    """
    try:
        import rerun
    except ImportError as error:
        raise DefplanError("Rerun is not installed: pip install 'defplan[rerun]'") from error
    return rerun


def write_rerun(
    log: str | Path | EpisodeLog, path: str | Path, progress: Progress = no_progress
) -> None:
    """Write a log as a Rerun recording (.rrd), atomically.

    Entities: `world/robot` (surface), `world/path`, `world/target`, `world/obstacles`, `world/laser`,
    `world/surrogate` (where the surrogate expected the body), and `plots/...` in SI units.

    Raises:
        DefplanError: the log cannot be read, or Rerun is not installed.
    """
    check_rerun(path)
    log = log if isinstance(log, EpisodeLog) else read_log(log)
    rr = rerun()
    name = f"{log.path.name} {hashlib.sha256(log.states.tobytes()).hexdigest()[:12]}"
    with files.atomic_path(path) as temporary:
        recording = rr.RecordingStream("defplan", recording_id=name)
        recording.save(temporary, default_blueprint=blueprint())
        progress("writing for Rerun", 0.0)
        _write_scene(rr, recording, log)
        _write_plots(rr, recording, log)
        progress("writing for Rerun", 0.3)
        _write_laser(rr, recording, log)
        _write_body(rr, recording, log)
        recording.flush()
        recording.disconnect()
    progress("writing for Rerun", 1.0)


def blueprint() -> Any:
    """Return how the viewer lays a recording out: the scene to the left, plots to the right."""
    import rerun.blueprint as rrb

    titles = {
        "plots/target_distance": "distance to the target, m",
        "plots/clearance": "clearance, m",
        "plots/shape": "shape q",
        "plots/target_shape": "target shape u",
        "plots/gait": "gait",
        "plots/values": "planner's values",
        "plots/reward": "reward, m^2",
        "plots/position_error": "surrogate's error, m",
    }
    plots = [rrb.TimeSeriesView(origin=origin, name=name) for origin, name in titles.items()]
    half = len(plots) // 2
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Spatial3DView(origin="world", name="scene"),
            rrb.Tabs(rrb.Vertical(*plots[:half], name="body"), rrb.Vertical(*plots[half:], name="planner")),
            column_shares=[3, 2],
        ),
        collapse_panels=True,
    )  # fmt: skip


def _at(rr: Any, seconds: np.ndarray) -> list[Any]:
    return [rr.TimeColumn(_TIMELINE, duration=seconds)]


def _write_scene(rr: Any, recording: Any, log: EpisodeLog) -> None:
    """Write what does not belong to the body: path, target, obstacles."""
    recording.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    way = rr.LineStrips3D([log.states[:, :3]], colors=PATH)
    recording.log("world/path", way, static=True)
    scene = log.scene
    target = rr.Points3D([scene.target], radii=0.1, colors=TARGET, labels="target")
    recording.log("world/target", target, static=True)
    goal = rr.Ellipsoids3D(centers=[scene.target], radii=[scene.goal_radius], colors=TARGET)
    recording.log("world/target/goal", goal, static=True)
    if not len(scene.radii):
        return
    moving = bool(np.any(scene.velocities))
    times = log.time[::MESH_EVERY] if moving else log.time[:1]
    for i, radius in enumerate(scene.radii):
        name = f"world/obstacles/{i}"
        if scene.shape == "sphere":
            recording.log(name, rr.Ellipsoids3D(radii=[radius], centers=[[0, 0, 0]],
                          colors=OBSTACLE, fill_mode="solid"), static=True)  # fmt: skip
        else:
            recording.log(name, rr.Cylinders3D(lengths=[_TALL], radii=[radius], centers=[[0, 0, 0]],
                          colors=OBSTACLE, fill_mode="solid"), static=True)  # fmt: skip
        places = scene.centres[i] + times[:, None] * scene.velocities[i]
        if moving:
            recording.send_columns(name, _at(rr, times), rr.Transform3D.columns(translation=places))
        else:
            recording.log(name, rr.Transform3D(translation=places[0]), static=True)


def _write_plots(rr: Any, recording: Any, log: EpisodeLog) -> None:
    """Write numbers over time, each under its name."""
    steps = _table(columns.STEPS, log)
    r = log.target_shapes.shape[1]
    of_state = {
        "target_distance": (steps["target_distance_m"], ["target_distance_m"]),
        "shape": (log.states[:, 7 : 7 + r], schemas.shape_labels(r)),
        "target_shape": (log.states[:, 13 + 2 * r :], [f"u{i + 1}" for i in range(r)]),
    }
    for name, (values, labels) in of_state.items():
        _plot(rr, recording, name, log.time, values, labels)
    if np.isfinite(log.clearance).any():
        _plot(rr, recording, "clearance", log.time[1:], log.clearance, ["clearance_m"])
    if not len(log.gait_index):
        return
    begin, end = log.time[log.cycle_steps[:-1]], log.time[log.cycle_steps[1:]]
    names = list(log.task_names) or [f"gait {k}" for k in range(log.values.shape[1])]
    _plot(rr, recording, "gait", begin, log.gait_index, ["gait"])
    done = [names[k] if k < len(names) else f"gait {k}" for k in log.gait_index]
    recording.send_columns("gaits", _at(rr, begin), rr.TextLog.columns(text=done))
    if log.values.shape[1] == len(names) and np.isfinite(log.values).all():
        _plot(rr, recording, "values", begin, log.values, names)
    if np.isfinite(log.reward).all():
        _plot(rr, recording, "reward", end, log.reward, ["reward_m2"])
    known = np.isfinite(log.surrogate_pose).all(1)
    if known.any():
        error = _table(columns.CYCLES, log)["position_error_m"]
        _plot(rr, recording, "position_error", end[known], error[known], ["position_error_m"])
        places = rr.Points3D.columns(
            positions=log.surrogate_pose[known, :3],
            radii=np.full(known.sum(), 0.06),
            colors=np.tile(PREDICTION, (known.sum(), 1)),
        )
        recording.send_columns("world/surrogate", _at(rr, end[known]), places)


def _table(fields: list[columns.Field], log: EpisodeLog) -> Mapping[str, np.ndarray]:
    return {name: part for field in fields for name, part in field.columns(log).items()}


def _plot(
    rr: Any, recording: Any, name: str, seconds: np.ndarray, values: np.ndarray, labels: list[str]
) -> None:
    """Write numbers (n,) or (n, k) as a plot with k named lines."""
    values = np.asarray(values, float).reshape(len(seconds), -1)
    recording.log(f"plots/{name}", rr.SeriesLines(names=labels), static=True)
    batch = rr.Scalars.columns(scalars=values.ravel())
    lengths = np.full(len(seconds), values.shape[1])
    recording.send_columns(f"plots/{name}", _at(rr, seconds), batch.partition(lengths))


def _write_laser(rr: Any, recording: Any, log: EpisodeLog) -> None:
    """Write where the sensor saw something, at each decision; nothing if its plugin is not here."""
    settings = log.configuration.get("navigation") or {}
    navigation = Navigation(
        laser_range=float(settings.get("laser_range", Navigation().laser_range)),
        space=log.space,
        sensor=settings.get("sensor", ""),
    )
    try:
        sensor = sensor_of(navigation)
    except DefplanError:
        return
    if not len(log.laser) or not np.isfinite(log.laser).all():
        return
    space = SPACES[log.space]
    strips: list[np.ndarray] = []
    counts = []
    for start, reading in zip(log.cycle_steps[:-1], log.laser, strict=True):
        x = log.states[start]
        seen, there = sensor.points(reading, navigation)
        local = np.pad(seen[there], ((0, 0), (0, 3 - space.dimension)))
        frame = space.frame(rotations.matrix(x[3:7]))
        hits = x[:3] + local @ frame.T
        strips += [np.stack([x[:3], hit]) for hit in hits]
        counts.append(len(hits))
    if not strips:
        return
    begin = log.time[log.cycle_steps[:-1]]
    ends = np.array([strip[1] for strip in strips])
    colours = np.tile(BEAM[:3], (len(strips), 1))
    points = rr.Points3D.columns(
        positions=ends, radii=np.full(len(ends), 0.04), colors=colours
    ).partition(counts)
    recording.send_columns("world/laser/hits", _at(rr, begin), points)
    if isinstance(sensor, Laser):
        beams = rr.LineStrips3D.columns(strips=strips, colors=colours).partition(counts)
        recording.send_columns("world/laser/beams", _at(rr, begin), beams)


def _write_body(rr: Any, recording: Any, log: EpisodeLog) -> None:
    """Write the deformed surface; nothing if the body was filtered out."""
    if "body.npz" not in log.attachments:
        return
    from defplan_mj.dynamics.reduced import ReducedDynamics

    dynamics = ReducedDynamics(log.body, log.timestep, log.terrain, **log.stepping)
    rows, faces = RunFiles(log.body).mesh
    moments = np.arange(0, len(log.states), MESH_EVERY)
    points = np.stack([dynamics.surface(x)[rows] for x in log.states[moments]]).astype(np.float32)
    # what does not change is static; static numbers would hide those over time
    still = rr.Mesh3D.from_fields(triangle_indices=faces, albedo_factor=BODY)
    recording.log("world/robot", still, static=True)
    moving = rr.Mesh3D.columns(
        vertex_positions=points.reshape(-1, 3),
        vertex_normals=np.stack([_normals(p, faces) for p in points]).reshape(-1, 3),
    ).partition(np.full(len(points), len(rows)))
    recording.send_columns("world/robot", _at(rr, log.time[moments]), moving)


def _normals(points: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Return the unit normals (p, 3) of a surface at its points."""
    a, b, c = points[faces].swapaxes(0, 1)
    across = np.cross(b - a, c - a)
    normals = np.zeros_like(points)
    for k in range(3):
        np.add.at(normals, faces[:, k], across)
    return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
