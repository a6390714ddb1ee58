"""What a task file can say: its tables and fields, from the dataclasses of a task and their docstrings."""

from __future__ import annotations

import dataclasses
import math
import re
import types
import typing
from collections.abc import Callable
from dataclasses import MISSING, dataclass
from functools import cache
from typing import Any

from defplan_mj.base.places import PLACES
from defplan_mj.base.space import SPACES
from defplan_mj.body.model import LIMITS, Material, Medium
from defplan_mj.body.options import AXES, SHAPES, BodyOptions
from defplan_mj.dynamics.terrain import TYPES, Heightfield, Terrain, TerrainGeom
from defplan_mj.gait.gait import MOST_STEPS
from defplan_mj.gait.style import STYLES
from defplan_mj.kernel.pack import INTEGRATORS, MAX_SUBSTEPS
from defplan_mj.task import Effort, GaitTask, Navigation, TaskSpec, Weights

NOT_IN_A_FILE = ("file",)
"""Of a task: where it comes from is not for the file to say."""
NONE = "none"
"""What an optional field says that has no value; TOML has no word for it."""
LEFT_OUT = {"name": "the file's name", "description": "", "body": "its defaults"}
"""What may be left out of a file though a `TaskSpec` needs it, and what it is then."""
OTHER_WORDS = {
    "substeps": "of the dynamics in a control step",
    "integrator": "of the dynamics: 'variational' or 'implicit-euler'",
    "gait_solver": "solves the gaits, see `defplan list`; '': the default one",
    "planner": "steers, see `defplan list`; '': the default one",
    "feedback": "plays the gaits, see `defplan list`; '': the default one",
    "body.length": "longest extent, m; none: as the mesh file says",
    "body.drag_points": "as many drag points at most",
    "body.up": "axis of the mesh file that is up: x, -x, y, -y, z or -z",
    "body.forward": "axis of the mesh file that is ahead, the body's x",
    "terrain.friction": "coefficient of friction mu",
    "terrain.thickness": "d, of the layer in which contact acts, m; none: 1% of the body's length",
    "terrain.stiffness": "k, N/m^2; none: one point carries the body's weight at distance 0",
    "mesh": "path of the mesh file, from this file's folder on",
    "skin": "of which installed task the picture is that the body wears; none: a plain one",
    "shipped": "files of a body and of gaits made before, from this file's folder on; or none",
    "body": "how the mesh becomes a body",
    "gait_tasks": "what the gaits should do, a [[gait_tasks]] each",
    "weights": "of the gaits' objective, per cycle",
    "terrain": "what the robot walks on; without it, it swims",
    "navigation": "the second stage: targets among obstacles",
    "effort": "how much a run does where its command does not say",
    "paper": "figures that the report sets beside the run's own",
    "body.material": "isotropic and elastic",
    "body.medium": "what surrounds the body",
    "terrain.geoms": "static solids, as in MuJoCo, a [[terrain.geoms]] each; none given: the ground z = 0",
    "terrain.heightfield": "heights on a grid with a cubic spline through them",
}
"""What a file says in other words than the docstrings do."""


@dataclass(frozen=True)
class Field:
    """A field of a task file.

    Attributes:
        table: its table, e.g. 'body.material'; '' at the top.
        name: in the file and in Python.
        kind: its type.
        default: its value if the file does not say; MISSING: it has to.
        text: what it is, with its unit.
    """

    table: str
    name: str
    kind: Any
    default: Any
    text: str

    @property
    def path(self) -> str:
        """Table and name."""
        return f"{self.table}.{self.name}" if self.table else self.name


@dataclass(frozen=True)
class Bound:
    """What a number has to be.

    Attributes:
        fits: tells.
        words: the same in words.
    """

    fits: Callable[[Any], bool]
    words: str


def _between(least: float, most: float) -> Bound:
    return Bound(lambda x: least <= x <= most, f"between {least:g} and {most:g}")


def _from(least: float) -> Bound:
    return Bound(lambda x: x >= least, f"{least:g} or more")


def _one_of(*names: str) -> Bound:
    return Bound(lambda x: x in names, " or ".join(names))


_POSITIVE = Bound(lambda x: x > 0, "above 0")
_PLAIN = Bound(
    lambda x: re.fullmatch(r"[\w][\w.+-]*", x) is not None and len(x) < 100,
    "letters, digits, - and _: it names the run's folder",
)
_CALLED = Bound(lambda x: bool(x.strip()), "a name")
_UNIT = Bound(lambda x: abs(math.hypot(*x) - 1) < 1e-6, "a vector of length 1")

BOUNDS: dict[type, dict[str, Bound]] = {
    TaskSpec: {
        "name": _PLAIN,
        "timestep": _POSITIVE,
        "steps_per_cycle": _between(1, MOST_STEPS),
        "gait_steps": _from(1),
        "substeps": _between(1, MAX_SUBSTEPS),
        "integrator": _one_of(*INTEGRATORS),
        "axis": _UNIT,
        "gait_tasks": Bound(bool, "one or more"),
    },
    BodyOptions: {
        "vertices": _between(20, 1_000_000),
        "modes": _between(1, LIMITS["modes"]),
        "basis": _between(1, LIMITS["basis"]),
        "samples": _between(1, LIMITS["samples"]),
        "drag_error": _POSITIVE,
        "drag_points": _between(4, LIMITS["drag points"]),
        "length": _POSITIVE,
        "amplitude": _POSITIVE,
        "up": _one_of(*AXES),
        "forward": _one_of(*AXES),
        "shapes": _one_of(*SHAPES),
        "moved": Bound(lambda x: 0 <= x < 1, "between 0 and 1"),
    },
    Material: {
        "density": _POSITIVE,
        "youngs_modulus": _POSITIVE,
        "poissons_ratio": Bound(lambda x: -1 < x < 0.5, "between -1 and 0.5"),
        "damping": _from(0),
        "control_stiffness": _from(0),
    },
    Medium: {
        "name": _CALLED,
        "density": _from(0),
        "drag_normal": _from(0),
        "drag_tangential": _from(0),
    },
    GaitTask: {"name": _CALLED},
    Weights: {
        **{f.name: _from(0) for f in dataclasses.fields(Weights) if f.name != "style"},
        "style": _one_of("any", *STYLES),
    },
    Terrain: {
        "friction": _from(0),
        "slip_speed": _POSITIVE,
        "thickness": _POSITIVE,
        "stiffness": _POSITIVE,
        "damping": _from(0),
    },
    TerrainGeom: {
        "shape": _one_of(*TYPES),
        "size": Bound(lambda sizes: all(s > 0 for s in sizes), "all above 0"),
        "quaternion": Bound(any, "other than zeros"),
    },
    Heightfield: {
        "half_size": Bound(lambda sizes: all(s > 0 for s in sizes), "all above 0"),
        "heights": Bound(lambda h: h.ndim == 2 and min(h.shape) > 1, "a grid of 2 x 2 or more"),
    },
    Effort: {
        "pairs": _from(1),
        "episodes": _from(1),
        "moving": _from(0),
        "unchecked": Bound(lambda x: 0 < x <= 1, "above 0, and 1 at most"),
    },
    Navigation: {
        "distance": _POSITIVE,
        "goal_radius": _POSITIVE,
        "max_cycles": _from(1),
        "decisions_per_cycle": _from(1),
        "k2": _from(1),
        "k2_obstacles": _from(0),
        "novel_obstacles": _from(0),
        "beams": _from(1),
        "laser_range": _POSITIVE,
        "space": _one_of(*SPACES),
        "scenes": _one_of("", *PLACES),
        "room": _POSITIVE,
    },
}
"""What the values of a class' fields have to be, besides being of their type and finite."""


def optional(kind: Any) -> tuple[Any, bool]:
    """Return a type without None, and whether None was in it."""
    if isinstance(kind, types.UnionType) or typing.get_origin(kind) is typing.Union:
        parts = [part for part in typing.get_args(kind) if part is not type(None)]
        return parts[0], len(parts) < len(typing.get_args(kind))
    return kind, False


def table_of(kind: Any) -> type | None:
    """Return the dataclass that a type is, or is a tuple of; None: it is neither."""
    kind, _ = optional(kind)
    if typing.get_origin(kind) is tuple:
        kind = typing.get_args(kind)[0]
    return kind if dataclasses.is_dataclass(kind) and isinstance(kind, type) else None


@cache
def fields_of(cls: type, table: str = "") -> tuple[Field, ...]:
    """Return the fields of a dataclass, in its order."""
    hints, texts = typing.get_type_hints(cls), attribute_texts(cls)
    fields = []
    for field in dataclasses.fields(cls):
        if cls is TaskSpec and field.name in NOT_IN_A_FILE:
            continue
        default = field.default
        if field.default_factory is not MISSING:
            default = field.default_factory()
        if cls is TaskSpec and default is MISSING and field.name in LEFT_OUT:
            default = LEFT_OUT[field.name]
        path = f"{table}.{field.name}" if table else field.name
        text = OTHER_WORDS.get(path) or texts.get(field.name, "")
        fields.append(Field(table, field.name, hints[field.name], default, text))
    return tuple(fields)


@cache
def all_fields(cls: type = TaskSpec, table: str = "") -> tuple[Field, ...]:
    """Return every field of a task file, a table's after the table that holds it."""
    own = fields_of(cls, table)
    inner = [all_fields(kind, f.path) for f in own if (kind := table_of(f.kind)) is not None]
    return (*own, *(field for fields in inner for field in fields))


def attribute_texts(cls: type) -> dict[str, str]:
    """Return what the 'Attributes' of a docstring say of each name."""
    block = (cls.__doc__ or "").partition("Attributes:\n")[2]
    entries = re.findall(r"^ {8}(\S[^:\n]*): (.*(?:\n {9,}.*)*)", block, re.MULTILINE)
    texts = {}
    for names, text in entries:
        for name in names.split(","):
            texts[name.strip()] = " ".join(text.split()).rstrip(".")
    return texts
