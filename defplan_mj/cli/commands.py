"""The commands: each takes the parsed arguments and the console, and returns the exit code.

What is heavy to import is imported where it is used, so that `defplan --help` answers at once.
"""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

from defplan_mj.cli.console import Console, table
from defplan_mj.errors import DefplanError

if TYPE_CHECKING:
    from defplan_mj.task import Progress, TaskSpec


def list_installed(arguments: argparse.Namespace, console: Console) -> int:
    """Name the tasks, solvers and suite domains that are installed, broken ones with the reason."""
    from defplan_mj import registry

    tasks, solvers, domains = registry.tasks(), registry.solvers(), registry.domains()
    data = {
        "tasks": [_entry(e, "description") for e in tasks],
        "solvers": [_entry(e, "summary", "kind") for e in solvers],
        "domains": [_entry(e) for e in domains],
    }
    rows = [
        ["task", d["name"], d.get("description", "")] for d in data["tasks"] if "error" not in d
    ]
    rows += [
        [f"{d['kind']} solver" if d["kind"] != "planner" else "planner", d["name"], d["summary"]]
        for d in sorted(
            (d for d in data["solvers"] if "error" not in d), key=lambda d: (d["kind"], d["name"])
        )
    ]
    rows += [["suite domain", d["name"], ""] for d in data["domains"] if "error" not in d]
    console.result(data, _left(rows))
    for entry in [*tasks, *solvers, *domains]:
        if entry.error:
            console.say(f"{entry.name} of package {entry.package} is broken: {entry.error}")
    return 0


def _entry(entry: Any, *attributes: str) -> dict[str, str]:
    """Return a registry entry as JSON."""
    data = {"name": entry.name, "package": entry.package}
    if entry.error:
        return {**data, "error": entry.error}
    return {**data, **{name: str(getattr(entry.value, name, "")) for name in attributes}}


def _left(rows: list[list[str]]) -> str:
    """Return rows of text in columns, all to the left."""
    if not rows:
        return "nothing is installed"
    width = [max(len(row[i]) for row in rows) for i in range(len(rows[0]) - 1)]
    return "\n".join(
        "  ".join([*(c.ljust(w) for c, w in zip(row, width, strict=False)), row[-1]]).rstrip()
        for row in rows
    )


def run(arguments: argparse.Namespace, console: Console) -> int:
    """Not yet."""
    raise DefplanError("not yet")


def gait(arguments: argparse.Namespace, console: Console) -> int:
    """Not yet."""
    raise DefplanError("not yet")


def surrogate(arguments: argparse.Namespace, console: Console) -> int:
    """Not yet."""
    raise DefplanError("not yet")


def planner(arguments: argparse.Namespace, console: Console) -> int:
    """Not yet."""
    raise DefplanError("not yet")


def evaluate(arguments: argparse.Namespace, console: Console) -> int:
    """Not yet."""
    raise DefplanError("not yet")


def bench(arguments: argparse.Namespace, console: Console) -> int:
    """Time the reduced step and its peers on the task's body, which is built if it is not there."""
    from defplan_mj import registry
    from defplan_mj.bench import bench as measure

    spec = registry.get_task(arguments.task)
    with console.progress() as progress, _open(arguments, spec, progress) as run:
        data = measure(spec, run.body, progress, arguments.quick)
    console.result(data, _bench_text(data))
    return 0


def _bench_text(data: dict[str, Any]) -> str:
    """Return the figures as a table."""
    step = next(iter(data["reduced_step_us"].values()))
    flex, is_of, adjoint = data["mujoco_flex_step_ms"], data["conditions"], data["adjoint_step_us"]
    cycle = data["environment_step_us"]
    rows = [
        ["reduced step", f"{step['median']:.1f} µs", f"{step['p99']:.1f} µs"],
        ["  in a rollout, per step", f"{data['rollout_step_us']:.1f} µs", ""],
        ["  its adjoint", f"{adjoint['median']:.1f} µs", f"{adjoint['p99']:.1f} µs"],
        ["full FEM step (f)", f"{data['full_fem_step_ms']:.0f} ms", ""],
        ["MuJoCo flex step, full", f"{flex['full']:.2f} ms", ""],
        ["MuJoCo flex step, trilinear", f"{flex['trilinear']:.2f} ms", ""],
        ["surrogate transition, with laser", f"{1e6 / data['surrogate_transitions_per_s']:.2f} µs", ""],
        [f"laser scan, {is_of['beams']} beams", f"{data['laser_scan_us']:.1f} µs", ""],
        ["clearance", f"{data['clearance_us']:.1f} µs", ""],
        ["environment, per physics step", f"{cycle['median']:.1f} µs", f"{cycle['p99']:.1f} µs"],
    ]
    lines = [
        table(["one call", "median", "99%"], rows),
        f"two threads do rollouts {data['rollout_two_thread_speed_up']:.2f} times as fast as one;"
        f" the environment runs {data['environment_real_time_factor']:.0f} times real time",
        f"{is_of['task']}: {is_of['vertices']} vertices, r = {is_of['modes']}, k = {is_of['basis']},"
        f" time step {is_of['timestep_s']} s; an empty call takes {data['empty_call_us']:.2f} µs",
    ]
    if is_of["quick"]:
        lines.append("few repeats (--quick): not to be quoted")
    return "\n".join(lines)


def _open(arguments: argparse.Namespace, spec: TaskSpec, progress: Progress, **options: Any) -> Any:
    """Return the run (a context manager) that the arguments name."""
    from defplan_mj.run import RunOptions, open_run

    chosen = RunOptions(seed=arguments.seed, **options)
    return open_run(spec, arguments.logs, chosen, progress)


def view(arguments: argparse.Namespace, console: Console) -> int:
    """Not yet."""
    raise DefplanError("not yet")
