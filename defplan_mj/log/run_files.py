"""What every log of a run holds besides its episode: body, gait, surrogate, policy, terrain."""

from __future__ import annotations

import dataclasses
import json
import tempfile
from collections.abc import Mapping
from functools import cached_property
from pathlib import Path

import numpy as np

from defplan_mj.base.errors import DefplanError
from defplan_mj.body.model import Body
from defplan_mj.dynamics.terrain import Terrain
from defplan_mj.dynamics.world import World
from defplan_mj.gait.gait import Gait
from defplan_mj.log.decimate import decimate
from defplan_mj.planning.robot import Robot
from defplan_mj.planning.surrogate import Surrogate


@dataclasses.dataclass(frozen=True)
class RunFiles:
    """What every log of a run holds besides the episode, encoded once.

    Attributes:
        body, gait, surrogate: as loaded.
        terrain: what the body walks on; None: it swims.
        attachments: file name -> bytes, as they go into the log.
    """

    body: Body
    gait: Gait | None = None
    surrogate: Surrogate | None = None
    terrain: Terrain | None = None
    attachments: Mapping[str, bytes] = dataclasses.field(default_factory=dict)

    @classmethod
    def of(
        cls,
        body: Body,
        gait: Gait | None = None,
        surrogate: Surrogate | None = None,
        policy: str | Path | None = None,
        terrain: Terrain | None = None,
    ) -> RunFiles:
        """Encode the run's parts; `policy` is the planner's file, if it has one."""
        attachments = {}
        with tempfile.TemporaryDirectory() as folder:
            for name, part in (("body", body), ("gait", gait), ("surrogate", surrogate)):
                if part is not None:
                    path = Path(folder) / f"{name}.npz"
                    part.save(path)
                    attachments[path.name] = path.read_bytes()
        if policy is not None:
            attachments[f"policy{Path(policy).suffix}"] = _read(policy)
        world = World(body.medium, terrain)
        if world.walks:
            attachments["terrain.json"] = json.dumps(world.terrain_data).encode()
        return cls(body, gait, surrogate, terrain, attachments)

    @classmethod
    def of_robot(
        cls, robot: Robot, surrogate: Surrogate | None = None, policy: str | Path | None = None
    ) -> RunFiles:
        """Encode the parts of a robot, see `of`."""
        return cls.of(robot.body, robot.gait, surrogate, policy, robot.world.terrain)

    @cached_property
    def mesh(self) -> tuple[np.ndarray, np.ndarray]:
        """Rows of the body's surface points to draw, and their faces (at most 600)."""
        vertices, faces = decimate(self.body.vertices, self.body.faces, 600)
        return np.searchsorted(self.body.surface, vertices), faces


def _read(path: str | Path) -> bytes:
    try:
        return Path(path).read_bytes()
    except OSError as error:
        raise DefplanError(f"cannot read {path}: {error.strerror}") from error
