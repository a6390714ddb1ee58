"""The commands: each takes the parsed arguments and the console, and returns the exit code.

What is heavy to import is imported where it is used, so that `defplan --help` answers at once.
"""

from __future__ import annotations

import argparse
import contextlib
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from defplan_mj.base.errors import DefplanError
from defplan_mj.cli.console import Console
from defplan_mj.cli.text import (
    bench_text,
    bound_text,
    check_text,
    evaluation_text,
    gait_text,
    noise_text,
    planner_text,
    robustness_text,
    run_text,
    skills_text,
    surrogate_text,
)
from defplan_mj.cli.workers import workers

if TYPE_CHECKING:
    from defplan_mj.base.progress import Progress
    from defplan_mj.pipeline.run import Run


def list_installed(arguments: argparse.Namespace, console: Console) -> int:
    """Name the tasks, solvers, sensors, studies and the suite that are installed, broken ones with the reason."""
    from defplan_mj import registry, suite
    from defplan_mj.rl.register import registered

    tasks, solvers, domains = registry.tasks(), registry.solvers(), registry.domains()
    sensors, ids, studies = registry.sensors(), registered(), registry.studies()
    data: dict[str, list[dict[str, Any]]] = {
        "tasks": [_entry(e, "description") for e in tasks],
        "solvers": [_entry(e, "summary", "kind") for e in solvers],
        "sensors": [_entry(e) for e in sensors],
        "domains": [_entry(e) for e in domains],
        "studies": [_entry(e) for e in studies],
        "suite": [
            {"domain": domain, "task": task, "gymnasium": ids.get((domain, task))}
            for domain, task in suite.ALL_TASKS
        ],
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
    rows += [["sensor", d["name"], ""] for d in data["sensors"] if "error" not in d]
    rows += [["study", d["name"], ""] for d in data["studies"] if "error" not in d]
    rows += [
        ["suite task", f"{d['domain']} {d['task']}", d["gymnasium"] or ""] for d in data["suite"]
    ]
    console.result(data, _left(rows))
    for entry in [*tasks, *solvers, *sensors, *domains, *studies]:
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
    """Do everything from the mesh to the report; of a mesh, write its task file first."""
    from defplan_mj.cli.new import refuse_guessing, task_of_mesh
    from defplan_mj.pipeline.results import run_results
    from defplan_mj.taskfile.find import is_mesh

    if Path(arguments.task).is_dir():
        raise DefplanError(
            f"{arguments.task} is a folder: name a task, or a mesh or task file in it"
        )
    if is_mesh(arguments.task):
        arguments.task = str(task_of_mesh(arguments, console))
    else:
        refuse_guessing(arguments)

    chosen = {
        "gait_solver": arguments.gait_solver,
        "planner": arguments.planner,
        "feedback": arguments.feedback,
        "rivals": arguments.compare_with,
        "solver_seeds": arguments.solver_seeds,
        "moving": arguments.moving,
        "pairs": arguments.pairs,
        "training_seconds": arguments.training_seconds,
        "episodes": arguments.episodes,
    }
    with (
        console.progress() as progress,
        _open(arguments, console, progress, whole=True, **chosen) as run,
    ):
        data = run_results(run)
    console.result(data, run_text(data))
    return 0


def gait(arguments: argparse.Namespace, console: Console) -> int:
    """Optimise the task's gaits, and say what they do."""
    data = _make(arguments, console, "gait", "gait.npz", gait_solver=arguments.gait_solver)
    text = "\n\n".join(filter(None, [gait_text(data), skills_text(data.get("skills", []))]))
    console.result(data, f"{data['file']}, {data['seconds']:.1f} s\n{text}")
    return 0


def surrogate(arguments: argparse.Namespace, console: Console) -> int:
    """Fit the rigid surrogate, and print its row of the paper's Table III."""
    data = _make(arguments, console, "surrogate", "surrogate.npz", pairs=arguments.pairs)
    console.result(data, f"{data['file']}, {data['seconds']:.1f} s\n{surrogate_text(data)}")
    return 0


def _make(
    arguments: argparse.Namespace, console: Console, stage: str, file: str, **chosen: Any
) -> dict[str, Any]:
    """Make one stage; return its figures, seconds and file."""
    from defplan_mj.pipeline.making import skills

    with _stage(arguments, console, stage, **chosen) as run:
        run.do(stage)
        verdicts = {"skills": skills(run)} if stage == "gait" and skills(run) else {}
        return {
            **run.figures(stage),
            **verdicts,
            "seconds": run.seconds(stage),
            "file": run.file(file),
        }


def planner(arguments: argparse.Namespace, console: Console) -> int:
    """Train a planner on the surrogate."""
    from defplan_mj.pipeline.making import policy_file, training_file

    chosen = {"planner": arguments.planner, "training_seconds": arguments.training_seconds}
    with _stage(arguments, console, "planner", **chosen) as run:
        run.do("planner")
        data = {
            **run.figures("planner"),
            "seconds": run.seconds("planner"),
            "file": policy_file(run),
            "training": training_file(run),
        }
    console.result(data, planner_text(data))
    return 0


def evaluate(arguments: argparse.Namespace, console: Console) -> int:
    """Let a planner steer the reduced dynamics through scenes, and count how the episodes end."""
    from defplan_mj.pipeline.evaluation import without_rows
    from defplan_mj.pipeline.trial import Recorders
    from defplan_mj.pipeline.trial import evaluate as try_planner

    log = None
    if arguments.log is not None:
        log = Recorders(arguments.log, arguments.scenes, 10**9)
    chosen = {"planner": arguments.planner, "feedback": arguments.feedback}
    with _stage(arguments, console, "evaluation", **chosen) as run:
        run.do("planner")
        result = try_planner(
            run,
            arguments.scenes,
            arguments.shield,
            episodes=arguments.episodes,
            obstacles=arguments.obstacles,
            obstacle_speed=arguments.obstacle_speed,
            log=log,
        )
    data = {
        "task": run.plan.spec.name,
        "seed": arguments.seed,
        "planner": run.plan.planner.name,
        "feedback": run.plan.feedback.name,
        "shield": arguments.shield,
        "scenes": arguments.scenes,
        **without_rows(result),
    }
    console.result(data, evaluation_text(data))
    return 0


def bound(arguments: argparse.Namespace, console: Console) -> int:
    """Judge planners, in the collision check, against one that is told all obstacles and how they move."""
    from defplan_mj import registry
    from defplan_mj.base.errors import DefplanError
    from defplan_mj.base.places import PLACES
    from defplan_mj.pipeline.trial import robot
    from defplan_mj.studies.bound import judge, settings

    where = settings(arguments.scenes or list(PLACES), arguments.obstacle_speed or ())
    with _stage(arguments, console, "planner") as run:
        run.do("planner")
        own, spec = run.plan.planner.name, run.plan.spec
        surrogate = run.result("surrogate")
        planners = {}
        for name in arguments.planner or [own]:
            solver = registry.get_solver(name, "planner")
            if name != own and solver.needs_training:
                raise DefplanError(
                    f"the run has no trained {name}: run with --planner {name} first"
                )
            planners[name] = (
                run.result("planner")
                if name == own
                else solver.train(surrogate, spec.navigation, arguments.seed).planner
            )
        rows = judge(
            robot(run),
            surrogate,
            spec.navigation,
            planners,
            where,
            arguments.episodes,
            arguments.seed,
            run.progress_of("bound"),
        )
    data = {"task": spec.name, "seed": arguments.seed, "rows": rows}
    console.result(data, bound_text(data))
    return 0


def noise(arguments: argparse.Namespace, console: Console) -> int:
    """Count successes in unseen scenes where sensing is bad, or the robot not as it was."""
    from defplan_mj.pipeline.trial import robot
    from defplan_mj.planning.scenes import novel_scenes
    from defplan_mj.studies.noise import measure_noise

    with _stage(arguments, console, "planner") as run:
        run.do("planner")
        navigation = run.plan.spec.navigation
        rows = measure_noise(
            robot(run),
            run.result("surrogate"),
            navigation,
            run.result("planner"),
            novel_scenes(navigation, arguments.episodes, arguments.seed),
            seed=arguments.seed,
            progress=run.progress_of("noise"),
        )
        data = {"task": run.plan.spec.name, "seed": arguments.seed}
        data |= {"planner": run.plan.planner.name, "rows": rows}
    console.result(data, noise_text(data))
    return 0


def robustness(arguments: argparse.Namespace, console: Console) -> int:
    """Switch a task's gaits at random in worlds that are not the model's, with each feedback."""
    from defplan_mj.pipeline.robustness import robustness as stage_of
    from defplan_mj.taskfile.find import find_task

    spec = find_task(arguments.task)
    stage = stage_of(spec, arguments.feedback or (), arguments.cycles, arguments.push)
    with _stage(arguments, console, "robustness") as run:
        run.do(stage)
        data = run.figures("robustness")
        run.renew_report()
    console.result(data, robustness_text(data))
    return 0


def check(arguments: argparse.Namespace, console: Console) -> int:
    """Play a task's gaits with finer steps and through the full FEM, and say what changes."""
    from defplan_mj.studies.check import check_gaits, packaged_robot, robot_of_run
    from defplan_mj.taskfile.find import find_task

    spec = find_task(arguments.task)
    folder = arguments.run
    robot = packaged_robot(spec) if folder is None else robot_of_run(spec, folder)
    with console.progress() as progress:
        options = arguments.full, arguments.cycles, arguments.seed
        data = check_gaits(spec, robot, *options, progress, arguments.bodies)
        if folder is not None:
            _keep_check(folder, {**data, "gait": robot.gait.hash}, progress)
    console.result(data, check_text(data))
    return 0


def _keep_check(folder: Path, data: dict[str, Any], progress: Progress) -> None:
    """Write a check's figures into a run's folder, and into its report if there is one."""
    from defplan_mj.pipeline.stages import REPORT_FILE
    from defplan_mj.pipeline.store import write_json
    from defplan_mj.studies.check import CHECK_FILE

    write_json(folder / CHECK_FILE, data)
    if (folder / REPORT_FILE).is_file():
        from defplan_mj.report.report import write_report

        write_report(folder, progress)


def bench(arguments: argparse.Namespace, console: Console) -> int:
    """Time the reduced step and its peers on the task's body, which is built if it is not there."""
    from defplan_mj.studies.bench import bench as measure

    with console.progress() as progress, _open(arguments, console, progress) as run:
        run.do("body")
        data = measure(run.plan.spec, run.result("body"), progress, arguments.quick)
    console.result(data, bench_text(data))
    return 0


@contextlib.contextmanager
def _open(
    arguments: argparse.Namespace,
    console: Console,
    progress: Progress,
    whole: bool = False,
    anew: Iterable[str] = (),
    **chosen: Any,
) -> Iterator[Run]:
    """Yield the run that the arguments name.

    Args:
        whole: this is `defplan run`: --fresh means everything, not one stage.
        anew: stages that are made even if they could be used again.
        chosen: fields of `RunOptions`; None: as the run in the folder was asked for.
    """
    from defplan_mj.pipeline.outlook import Consent
    from defplan_mj.pipeline.run import open_run
    from defplan_mj.taskfile.find import find_task

    spec = find_task(arguments.task)
    fresh = whole and arguments.fresh
    consent = Consent(arguments.remake, console.say, console.asker())
    with (
        workers(arguments, console),  # before the folder is touched: options may not go together
        open_run(
            spec,
            arguments.logs,
            arguments.seed,
            chosen,
            progress,
            whole=whole,
            fresh=fresh,
            consent=consent,
            anew=anew,
        ) as run,
    ):
        yield run


@contextlib.contextmanager
def _stage(
    arguments: argparse.Namespace, console: Console, stage: str, **chosen: Any
) -> Iterator[Run]:
    """Yield the run for a command that makes one stage; --fresh makes that one anew."""
    anew = (stage,) if arguments.fresh else ()
    with (
        console.progress() as progress,
        _open(arguments, console, progress, anew=anew, **chosen) as run,
    ):
        yield run


def view(arguments: argparse.Namespace, console: Console) -> int:
    """Watch the planner steer through unseen scenes, in real time, until the window is closed."""
    from defplan_mj.host.viewer import require_display, view
    from defplan_mj.pipeline import trial
    from defplan_mj.planning.planner import needs_obstacles

    if arguments.live:
        return _stream(arguments, console)
    require_display()  # before any work
    chosen = {"planner": arguments.planner, "feedback": arguments.feedback}
    with _stage(arguments, console, "view", **chosen) as run:
        run.do("planner")
        environment = trial.environment(run, arguments.obstacles)
        planner = trial.steering(run, arguments.shield)
    environment.task.tells_obstacles = needs_obstacles(planner)
    outcomes = view(environment, lambda step: int(planner.values(step.observation).argmax()))
    console.result({"outcomes": outcomes}, "\n".join(outcomes))
    return 0


def _stream(arguments: argparse.Namespace, console: Console) -> int:
    """Stream unseen scenes to Foxglove or Lichtblick until Ctrl-C, or for --episodes."""
    from defplan_mj.log.live import Server
    from defplan_mj.pipeline import trial

    chosen = {"planner": arguments.planner, "feedback": arguments.feedback}
    with (
        Server(arguments.port) as server,  # before any work
        _stage(arguments, console, "view", **chosen) as run,
    ):
        run.do("planner")
        console.say(
            f"streaming to {server.address}: open it in Foxglove or Lichtblick; Ctrl-C ends"
        )
        options = arguments.shield, arguments.obstacles, arguments.episodes
        outcomes = trial.stream(run, server, *options)
    console.result({"outcomes": outcomes}, "\n".join(outcomes))
    return 0
