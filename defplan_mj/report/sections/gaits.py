"""The report's section on the gaits: curves and paths, their switching, and the gait solvers compared."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from defplan_mj.base.statistics import wilson_interval
from defplan_mj.gait.footing import SOLE, TORSO
from defplan_mj.report.content import (
    Block,
    Figures,
    Missing,
    Section,
    Table,
    Text,
    drawing,
    mean_sd,
    number,
)
from defplan_mj.report.figures.gaits import (
    controls_figure,
    history_figure,
    path_figures,
    play,
    strip_figure,
)
from defplan_mj.report.figures.views import PICTURES
from defplan_mj.report.material import Material, missing


def gait_section(material: Material) -> Section:
    """Return control curves, paths, and what switching between the gaits gives."""
    section = Section("gaits", "Gaits")
    gait, dynamics = material.gait, material.dynamics
    if gait is None or dynamics is None:
        section.blocks.append(missing(material, "body.npz" if gait else "gait.npz"))
        return section
    if gait.body_hash != dynamics.body.hash:
        section.blocks.append(Missing("The gaits belong to another body than this folder's."))
        return section
    solver, pictures = gait.meta.get("solver", ""), PICTURES[material.space]
    section.blocks.append(
        Text(
            f"{len(gait.task_names)} gaits share one period of {gait.cycle_seconds:.2f} s "
            f"({gait.steps_per_cycle} steps of {gait.timestep:g} s) and their phase shifts; each has "
            "its own activations. A gait is a target shape that the body's muscles pull to: it is "
            "open loop, the same whatever the body does."
            + (f" Solver: {solver}." if solver else "")
        )
    )
    for task, name in enumerate(gait.task_names):
        states = play(gait, task, dynamics)
        drawn = [
            drawing(controls_figure(gait, task)),
            *(drawing(f) for f in path_figures(gait, task, dynamics, states, material.space)),
        ]
        caption = (
            f"Gait '{name}': the target shape of each modal coordinate over two cycles, and the "
            "path of the centre of mass (green, a black dot a cycle) when the gait is played "
            f"from rest, with the body's silhouette {pictures.path_sides}"
        )
        if material.legged:
            strip = strip_figure(gait, task, dynamics, states, material.space)
            drawn.append(drawing(strip, shaded=True))
            caption += "; the body within a cycle, numbered by steps"
            caption += ", and after each of the first cycles" * pictures.turning
        section.blocks.append(Figures(drawn, f"{caption}."))
    history = gait.meta.get("history", [])
    if isinstance(history, list) and len(history) > 1:
        section.blocks.append(
            drawing(
                history_figure(history),
                "The solver's objective (mean cost of a cycle) over its iterations, smaller is better; "
                "dotted: the best so far.",
            )
        )
    section.blocks += _gait_tables(material)
    return section


def _footing_table(footing: dict[str, float]) -> Table:
    """Return how a walker puts its feet."""
    rows = [
        ["slip of loaded feet, of the way walked", f"{100 * footing['slip_share']:.0f}%"],
        ["deepest penetration, of the body's height", f"{100 * footing['penetration_share']:.2f}%"],
        ["torso above the ground, at least", f"{footing['torso_clearance_m']:.3f} m"],
        ["load that is not on the soles", f"{100 * footing['belly_load']:.1f}%"],
    ]
    caption = (
        "How the feet are put while gaits are switched: slip is weighted with the share of the load; "
        f"the torso is all above the lowest {TORSO:.0%} of the undeformed body, the soles the lowest "
        f"{SOLE:.0%}."
    )
    return Table(["feet", ""], rows, caption)


def _gait_tables(material: Material) -> list[Block]:
    """Return the tables on advance and turn a cycle, on switching, and on the solvers."""
    blocks: list[Block] = []
    results = material.switching
    tasks = results.get("tasks", [])
    if tasks:
        goes = {t.name: t.advance > 0 for t in material.spec.gait_tasks} if material.spec else {}
        columns = {"advance (m)": "advance_m", "drift (m)": "drift_m", "turn (rad)": "turn_rad"}
        spatial = PICTURES[material.space].turning
        if spatial:
            columns["stray (rad)"] = "stray_rad"
        rows = []
        for task in tasks:
            row = [task["name"]]
            for key in columns.values():
                if key == "advance_m" and not goes.get(task["name"], True):
                    row.append("–")  # it is not to go anywhere
                else:
                    row.append(mean_sd(task.get(key), task.get(key.rsplit("_", 1)[0] + "_sd")))
            rows.append(row)
        switching = results.get("switching") or {}
        note = ""
        if switching:
            note = (
                f" {switching.get('falls')} of {switching.get('cycles')} cycles "
                + ("" if spatial else "tilt past 30 degrees or ")
                + ("sink below 60% of the standing height or " if "footing" in results else "")
                + "go or turn the wrong way."
            )
        caption = (
            "What a cycle does while gaits are switched at random (mean ± sd): displacement in the "
            "wanted direction and across it, rotation about the wanted axis"
            + (" and the rest of the rotation." if spatial else ".")
        ) + note
        blocks.append(Table(["gait", *columns], rows, caption))
        if results.get("footing"):
            blocks.append(_footing_table(results["footing"]))
    else:
        blocks.append(Missing("Advance and turn a cycle under switching were not measured yet."))
    solvers = solver_rows(material.solvers)
    if solvers:
        seeds = len({solver.get("seed") for solver in material.solvers})
        many = f", mean ± sd over {seeds} seeds" if seeds > 1 else ""
        caption = (
            f"The gait solvers on the same problem{many}. What a solver claims counts for nothing "
            "until its gaits are simulated again, step by step: the objective then; while gaits are "
            "switched at random, the advance a cycle of the gaits that are to go farthest, the turn "
            "a cycle of those that are to turn, what loaded feet slide per metre walked, and the "
            "cycles that fail as said above, with their 95% interval (Wilson's)."
        )
        blocks.append(Table(SOLVER_COLUMNS, solvers, caption))
        failed = [solver for solver in material.solvers if "error" in solver]
        blocks += [Missing(f"Solver {s['name']}{_seed(s)} failed: {s['error']}.") for s in failed]
    else:
        blocks.append(Missing("The gait solvers were not compared in this run."))
    return blocks


SOLVER_COLUMNS = (
    "solver",
    "its objective",
    "re-simulated",
    "seconds",
    "advance (m)",
    "turn (rad)",
    "slip (m/m)",
    "failed cycles",
)


def solver_rows(solvers: Sequence[dict[str, Any]]) -> list[list[str]]:
    """Return a row a solver, for `SOLVER_COLUMNS`, over all the seeds that it did not fail with."""
    rows = []
    for name in dict.fromkeys(str(solver.get("name", "")) for solver in solvers):
        mine = [s for s in solvers if s.get("name") == name and "error" not in s]
        if not mine:
            continue
        falls, cycles = (sum(s.get(key, 0) for s in mine) for key in ("falls", "cycles"))
        failed = f"{falls} of {cycles}"
        if cycles:
            low, high = wilson_interval(falls, cycles)
            failed += f" ({100 * low:.1f}–{100 * high:.1f}%)"
        rows.append(
            [
                name,
                _over_seeds(mine, "objective"),
                _over_seeds(mine, "resimulated"),
                _over_seeds(mine, "seconds", 1),
                _over_seeds(mine, "advance_m"),
                _over_seeds(mine, "turn_rad"),
                _over_seeds(mine, "slip_share", 2),
                failed,
            ]
        )
    return rows


def _over_seeds(solvers: Sequence[dict[str, Any]], name: str, digits: int = 3) -> str:
    """Return mean and standard deviation (n - 1) over seeds; of one seed its number."""
    values = [s[name] for s in solvers if s.get(name) is not None]
    if not values:
        return number(None)
    if len(values) == 1:
        return number(values[0], digits)
    return mean_sd(float(np.mean(values)), float(np.std(values, ddof=1)), digits)


def _seed(solver: dict[str, Any]) -> str:
    return f", seed {solver['seed']}," if "seed" in solver else ""
