"""Builds all packaged bodies anew from their meshes: `python -m defplan_tasks.package bodies [FOLDER]`.

Gaits name their body by its hash: those that are packaged have to be trained anew afterwards.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from defplan_mj.body.build import build_body
from defplan_mj.body.model import Body
from defplan_mj.task import TaskSpec
from defplan_tasks import environments, fish, quadruped, tee

BODIES: dict[str, TaskSpec] = {
    "fish_body": fish.SWIM,
    "quadruped_body": quadruped.SWIM,
    "quadruped_walker_body": quadruped.WALK,
    "tee_body": tee.WALK,
}
"""Files among the assets, and the task that each is built for."""


def build_packaged(name: str) -> Body:
    """Return the body of assets/NAME.npz as its task's options build it from its mesh."""
    spec = BODIES[name]
    return build_body(spec.mesh, spec.body, name=spec.mesh.stem)


def main(arguments: list[str] | None = None) -> None:
    """Write the bodies and say how good their drag points are."""
    parser = argparse.ArgumentParser(prog="python -m defplan_tasks.package", description=__doc__)
    parser.add_argument("what", choices=["bodies"])
    parser.add_argument("folder", nargs="?", type=Path, default=environments.ASSETS)
    folder = parser.parse_args(arguments).folder
    for name in BODIES:
        body = build_packaged(name)
        body.save(folder / f"{name}.npz")
        drag = body.source["drag"]
        print(
            f"{name}: {drag['points']} drag points for {drag['triangles']} triangles, force within"
            f" {drag['error']:.2%}, areas within {drag['area_error']:.2%}; hash {body.hash[:12]}"
        )


if __name__ == "__main__":
    main()
