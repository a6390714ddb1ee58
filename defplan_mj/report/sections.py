"""The report's sections on body, gaits and surrogate: the first stage."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from defplan_mj.base.statistics import wilson_interval
from defplan_mj.gait.footing import SOLE, TORSO
from defplan_mj.report.body_figures import mesh_figures, mode_figure
from defplan_mj.report.content import (
    Block,
    Figures,
    Missing,
    Section,
    Table,
    Text,
    drawing,
    duration,
    mean_sd,
    number,
)
from defplan_mj.report.gait_figures import (
    controls_figure,
    history_figure,
    path_figures,
    play,
    strip_figure,
)
from defplan_mj.report.material import Material
from defplan_mj.report.views import PICTURES


def missing(material: Material, *names: str) -> Missing:
    """Return the sentence on files that a section needs and does not have."""
    for name in names:
        if name in material.faults:
            return Missing(f"{material.faults[name]}.")
    what = " and ".join(names)
    return Missing(f"Not made yet ({what}): defplan run {material.task} makes it.")


def body_section(material: Material) -> Section:
    """Return mesh, modes and what the reduction keeps."""
    section = Section("body", "Body and modes")
    body, dynamics = material.body, material.dynamics
    if body is None or dynamics is None:
        section.blocks.append(missing(material, "body.npz"))
        return section
    quality = body.source.get("quality", {})
    paper = material.paper
    rows = [
        ["vertices", str(len(body.vertices)), str(paper.get("vertices", "–"))],
        ["tetrahedra", str(len(body.tetrahedra)), "–"],
        ["quality of tetrahedra, minimum / mean", _pair(quality, "min", "mean"), "–"],
        ["degrees of freedom, full / reduced", f"{body.vertices.size} / {6 + body.n_modes}",
         f"{3 * paper['vertices']} / {paper['dof']}" if "dof" in paper else "–"],
        ["displacement basis k / sampled tetrahedra", f"{body.n_basis} / {len(body.sampled)}", "–"],
        ["length / mass", f"{body.length:.2f} m / {body.mass:.2f} kg", "1 m / –"],
        ["Young's modulus / Poisson's ratio",
         f"{body.material.youngs_modulus:.3g} Pa / {body.material.poissons_ratio:g}", "–"],
    ]  # fmt: skip
    section.blocks += [
        Text(
            f"The body is built from {body.source.get('mesh', 'a mesh')}. A shape is a few modal "
            "coordinates q; the rotation-strain map turns them into a displacement that keeps its "
            "volume at large bends, and a second reduction makes it cheap enough for real time."
        ),
        Figures(
            [drawing(figure, shaded=True) for figure in mesh_figures(body)],
            "The tetrahedral mesh, whole, and without the half nearer to the viewer, so that the "
            "tetrahedra inside (yellow) show.",
        ),
        Figures(
            [drawing(mode_figure(body, dynamics, i), shaded=True) for i in range(body.n_modes)],
            "Every linear mode at minus and plus the largest amplitude that gaits may ask for, as "
            "the reduced body takes it. The frequency is that of small vibrations in vacuum.",
        ),
        Table(["", "here", "paper"], rows, "The body in figures."),
    ]
    return section


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


def surrogate_section(material: Material) -> Section:
    """Return Table III's row, here and in the paper."""
    section = Section("surrogate", "Rigid surrogate")
    surrogate = material.surrogate
    if surrogate is None:
        section.blocks.append(missing(material, "surrogate.npz"))
        return section
    paper = material.paper
    theirs = list(paper.get("tasks", ()))
    rows = []
    for k, name in enumerate(surrogate.task_names):
        row = [
            name,
            mean_sd(surrogate.rotation_mean[k], surrogate.rotation_sd[k]),
            mean_sd(surrogate.translation_mean[k], surrogate.translation_sd[k]),
        ]
        if name in theirs:
            i = theirs.index(name)
            row.append(mean_sd(paper["rotation_mean"][i], paper["rotation_sd"][i]))
            row.append(mean_sd(paper["translation_mean"][i], paper["translation_sd"][i]))
        else:
            row += ["–", "–"]
        rows.append(row)
    columns = ["gait", "rotation (rad)", "translation (m)", "paper: rotation", "paper: translation"]
    shares = surrogate.translation_sd / np.maximum(surrogate.translation_mean, 1e-12)
    section.blocks += [
        Text(
            f"For planning, a whole cycle of a gait is one rigid motion, fitted to {surrogate.pairs} "
            "pairs of states before and after a cycle while gaits are switched at random. The "
            "spread says how far a single cycle is from it: here the translation's standard "
            f"deviation is {100 * shares.min():.0f} to {100 * shares.max():.0f}% of its mean."
        ),
        Table(
            columns,
            rows,
            "Rotation and translation a cycle, mean ± standard deviation over the pairs, beside "
            "the paper's Table III.",
        ),
    ]
    return section


def time_section(material: Material) -> Section:
    """Return the seconds of each stage beside the paper's Table I."""
    section = Section("time", "Seconds per stage")
    seconds, paper = material.seconds, material.paper
    if not seconds:
        section.blocks.append(missing(material, "run.json"))
        return section
    theirs = {"gait": paper.get("gait_h")}
    if "planner_h" in paper:
        theirs["planner"] = paper["planner_h"] + paper.get("features_h", 0.0)
    rows = []
    for stage, spent in seconds.items():
        hours = theirs.get(stage)
        ratio = f"{3600 * hours / spent:.0f}×" if hours and spent else "–"
        rows.append(
            [stage.replace("_", " "), duration(spent), f"{hours:g} h" if hours else "–", ratio]
        )
    rows.append(["total", duration(sum(seconds.values())), "–", "–"])
    section.blocks.append(
        Table(
            ["stage", "here", "paper", "faster by"],
            rows,
            "Wall time of each stage in this run, beside the paper's Table I (an 8-core CPU; its "
            "planner's time is learning and the laser's features together). A stage that was reused counts with "
            "the time it took when it was made.",
        )
    )
    return section


def _pair(values: dict[str, float], *names: str) -> str:
    return " / ".join(number(values.get(name), 2) for name in names)
