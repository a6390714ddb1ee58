"""Makes what is packaged anew: `python -m defplan_tasks.package bodies|gaits [FOLDER] [--task NAME]`.

Bodies are built from their meshes, gaits trained for the packaged bodies (10 to 15 minutes a task). Gaits
name their body by its hash: after a body has changed, its gaits have to be trained anew.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from defplan_mj import registry
from defplan_mj.base.errors import DefplanError
from defplan_mj.body.build import build_body
from defplan_mj.body.model import Body
from defplan_mj.gait.gait import Gait
from defplan_mj.gait.problem import GaitProblem
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


def train_packaged(spec: TaskSpec, body: Body, seed: int = 0) -> Gait:
    """Return the gaits of a task by its own solver, for its packaged body."""
    solver = registry.get_solver(spec.gait_solver, "gait")
    return solver.solve(GaitProblem.of(spec, spec.dynamics(body)), seed)


def write_bodies(folder: Path, tasks: set[str]) -> None:
    """Build and write the bodies of `tasks` and say how good their drag points are."""
    for name, spec in BODIES.items():
        if spec.name not in tasks:
            continue
        body = build_packaged(name)
        body.save(folder / f"{name}.npz")
        drag = body.source["drag"]
        print(
            f"{name}: {drag['points']} drag points for {drag['triangles']} triangles, force within"
            f" {drag['error']:.2%}, areas within {drag['area_error']:.2%}; hash {body.hash[:12]}"
        )


def write_gaits(folder: Path, tasks: set[str]) -> None:
    """Train and write the gaits of `tasks`."""
    for name in sorted(tasks):
        spec = registry.get_task(name)
        if spec.shipped is None:
            raise DefplanError(f"nothing is packaged for {name}")
        gait = train_packaged(spec, Body.load(spec.shipped[0]))
        path = folder / spec.shipped[1].name
        gait.save(path)
        print(f"{path.name}: {', '.join(gait.task_names)}; hash {gait.hash[:12]}")


def main(arguments: list[str] | None = None) -> None:
    """Make what is asked for."""
    names = sorted({spec.name for spec in BODIES.values()} | {quadruped.RUN.name})
    parser = argparse.ArgumentParser(prog="python -m defplan_tasks.package", description=__doc__)
    parser.add_argument("what", choices=["bodies", "gaits"])
    parser.add_argument("folder", nargs="?", type=Path, default=environments.ASSETS)
    parser.add_argument("--task", choices=names, action="append", help="(default: all)")
    options = parser.parse_args(arguments)
    write = {"bodies": write_bodies, "gaits": write_gaits}[options.what]
    write(options.folder, set(options.task or names))


if __name__ == "__main__":
    main()
