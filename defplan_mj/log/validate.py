"""What a log's content has to be: numbers that belong together, a world that can be, parts of one robot."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any, NoReturn

import numpy as np

from defplan_mj.base.errors import DefplanError
from defplan_mj.base.space import OF_OBSTACLE
from defplan_mj.kernel.pack import INTEGRATORS
from defplan_mj.log import channels
from defplan_mj.planning.outcome import ENDINGS
from defplan_mj.planning.scene import Scene

if TYPE_CHECKING:
    from defplan_mj.gait.gait import Gait
    from defplan_mj.log.reader import EpisodeLog

MOST_MODES = 16  # kernel.h
MOST_STEPS = 10**9  # of an episode; those that are there are counted
MOST_OBSTACLES, MOST_CYCLES, MOST_BEAMS = 10_000, 1_000_000, 100_000
_FARTHEST = 1e9  # m
_UNIT = 1e-6
_HASH = re.compile("[0-9a-f]{64}")


def refuse(log: EpisodeLog, field: str, why: str) -> NoReturn:
    """Raise the sentence on a field of a log."""
    raise DefplanError(f"log {log.path} cannot be used: its {field} {why}; record it anew")


def whole_number(entries: dict[str, str], name: str, least: int, most: int) -> int:
    """Return a whole number of a metadata record.

    Raises:
        ValueError: it is none, or out of its bounds.
    """
    text = entries[name]
    if not re.fullmatch(r"-?[0-9]{1,18}", text) or not least <= int(text) <= most:
        raise ValueError(
            f"{name} is {text[:40]!r}, a whole number from {least} to {most} is wanted"
        )
    return int(text)


def positive(entries: dict[str, str], name: str) -> float:
    """Return a positive number of a metadata record. Raises ValueError: it is none."""
    try:
        value = float(entries[name])
    except ValueError:
        value = -1.0
    if not 0.0 < value < np.inf:
        raise ValueError(f"{name} is {entries[name][:40]!r}, a positive number is wanted")
    return value


def scene_of(data: Any) -> Scene:
    """Return the scene of a log's configuration.

    Raises:
        ValueError, TypeError, KeyError: it is none.
    """
    if not isinstance(data, dict):
        raise ValueError("the scene is no object")
    arrays = {
        name: _numbers(data[name], name, columns)
        for name, columns in (("target", 0), ("centres", 3), ("radii", 0), ("velocities", 3))
    }
    arrays["orientation"] = _numbers(data["orientation"], "orientation", 0)
    count = arrays["radii"].size
    if count > MOST_OBSTACLES:
        raise ValueError(f"the scene has {count} obstacles, at most {MOST_OBSTACLES} can be")
    for name, shape in (
        ("target", (3,)),
        ("radii", (count,)),
        ("centres", (count, 3)),
        ("velocities", (count, 3)),
        ("orientation", (4,)),
    ):
        if arrays[name].shape != shape:
            raise ValueError(f"the scene's {name} has shape {arrays[name].shape}, wanted {shape}")
    if not (arrays["radii"] > 0.0).all():
        raise ValueError("the scene's radii must be positive")
    if abs(np.linalg.norm(arrays["orientation"]) - 1.0) > _UNIT:
        raise ValueError("the scene's orientation is no unit quaternion")
    scene = Scene(**{**data, **arrays})
    if scene.shape not in OF_OBSTACLE:
        raise ValueError(f"the scene's shape can be {' or '.join(OF_OBSTACLE)}")
    if not _is_number(scene.goal_radius) or not 0.0 < scene.goal_radius < _FARTHEST:
        raise ValueError("the scene's goal_radius must be a positive number")
    cycles = scene.max_cycles
    if not isinstance(cycles, int) or isinstance(cycles, bool) or not 1 <= cycles <= MOST_CYCLES:
        raise ValueError(f"the scene's max_cycles must be a whole number from 1 to {MOST_CYCLES}")
    if not isinstance(scene.meta, dict):
        raise ValueError("the scene's meta is no object")
    return scene


def check_navigation(configuration: dict[str, Any]) -> None:
    """Raise ValueError if what a configuration says of the sensor cannot be."""
    said = configuration.get("navigation")
    if said is None:
        return
    if not isinstance(said, dict):
        raise ValueError("navigation is no object")
    beams, reach = said.get("beams"), said.get("laser_range", 1.0)
    if beams is not None and (
        not isinstance(beams, int) or isinstance(beams, bool) or not 0 <= beams <= MOST_BEAMS
    ):
        raise ValueError(f"navigation's beams must be a whole number up to {MOST_BEAMS}")
    if not _is_number(reach) or not 0.0 < reach < _FARTHEST:
        raise ValueError("navigation's laser_range must be a positive number")
    if not isinstance(said.get("sensor", ""), str):
        raise ValueError("navigation's sensor must be a name")


def validate_log(log: EpisodeLog, modes: int) -> None:
    """Raise a DefplanError that names the field if something of a log cannot be.

    Args:
        modes: that the log says its body has.
    """
    if log.stepping["integrator"] not in INTEGRATORS:
        refuse(log, "integrator", f"can be {' or '.join(INTEGRATORS)}")
    if not _HASH.fullmatch(log.body_hash):
        refuse(log, "body_hash", "must be 64 hexadecimal digits")
    if log.outcome and log.outcome not in tuple(ENDINGS):
        refuse(log, "outcome", f"can be {', '.join(ENDINGS)}")
    n, m = len(log.target_shapes), len(log.gait_index)
    for name, array, shape in (
        (channels.STATE, log.states, (n + 1, 13 + 3 * modes)),
        (channels.TARGET_SHAPE, log.target_shapes, (n, modes)),
        (channels.CONTACTS, log.clearance, (n,)),
        (channels.REWARD, log.reward, (m,)),
    ):
        if array.shape != shape and name not in log.missing:
            refuse(log, name, f"has numbers of shape {array.shape}, wanted {shape}")
    for name, array in (
        (channels.STATE, log.states),
        (channels.TARGET_SHAPE, log.target_shapes),
        (channels.REWARD, log.reward),
    ):
        if name not in log.missing and not np.isfinite(array).all():
            row = int(np.argwhere(~np.isfinite(array))[0, 0])
            refuse(log, name, f"has a number that is not finite in its message {row}")
    for name, array in ((channels.CONTACTS, log.clearance), (channels.RANGES, log.laser)):
        if name not in log.missing and np.isnan(array).any():
            refuse(log, name, "has numbers that are not a number")
    if (np.abs(np.linalg.norm(log.states[:, 3:7], axis=1) - 1.0) > _UNIT).any():
        refuse(log, channels.STATE, "has an attitude that is no unit quaternion")
    if not np.isfinite(log.time).all() or (np.diff(log.time) <= 0.0).any():
        refuse(log, "time", "does not grow from step to step")
    gaits = np.inf if channels.VALUES in log.missing else log.values.shape[1]
    if m and not ((log.gait_index >= 0) & (log.gait_index < gaits)).all():
        refuse(log, channels.GAIT, f"chooses a gait that is none of the {log.values.shape[1]}")
    for contact in log.contacts:
        if not np.isfinite(contact.points).all() or not np.isfinite(contact.forces).all():
            refuse(log, channels.FORCES, "has numbers that are not finite")


def gait_numbers(numbers: list[float]) -> list[int]:
    """Return the gaits' indices. Raises ValueError: one is no whole number."""
    if not all(number == int(number) for number in numbers if np.isfinite(number)) or not all(
        np.isfinite(number) and abs(number) < 2**31 for number in numbers
    ):
        raise ValueError(f"{channels.GAIT} has a gait that is no whole number")
    return [int(number) for number in numbers]


def check_body(log: EpisodeLog, said: str) -> None:
    """Raise a DefplanError unless a part of a log is of the body that moved in it.

    Args:
        said: hash of the body that the part is, or is for.
    """
    if said != log.body_hash:
        raise DefplanError(
            f"log {log.path} holds parts of another body than the one that moved in it:"
            f" {said[:12]} instead of {log.body_hash[:12]}; record it anew"
        )


def check_cycles(log: EpisodeLog, gait: Gait) -> None:
    """Raise a DefplanError unless a log's cycles are (parts of) cycles of its gait, the last one cut or not."""
    if len(log.gait_index) and log.gait_index.max() >= len(gait.task_names):
        refuse(log, channels.GAIT, f"chooses a gait that gait.npz has not ({len(gait.task_names)})")
    if (gait.timestep, gait.stepping) != (log.timestep, log.stepping):
        refuse(log, "timestep, substeps and integrator", "are not those of its gait.npz")
    if gait.amplitude.shape != log.target_shapes.shape[1:]:
        refuse(log, "gait.npz", f"is of {gait.amplitude.size} modes, not of those of the log")
    lengths = np.diff(log.cycle_steps)
    steps, cut = divmod(gait.steps_per_cycle, log.decisions_per_cycle)
    if cut or (lengths[:-1] != steps).any() or (lengths > steps).any():
        refuse(log, "cycles", f"have not the {steps} steps of its gait.npz")


def _numbers(value: Any, name: str, columns: int) -> np.ndarray:
    """Return an array of finite numbers within reach; `columns`: of a table that may be empty."""
    array = np.array(value, float)
    if columns and array.size == 0:
        array = array.reshape(-1, columns)
    if not (np.abs(array) < _FARTHEST).all():
        raise ValueError(f"the scene's {name} has numbers that are not finite or too large")
    return array


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)
