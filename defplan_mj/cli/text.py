"""What the commands print for people: the same figures as their JSON, as tables."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from defplan_mj.cli.console import table
from defplan_mj.planning.outcome import ENDINGS, SCENES, Outcome

_FAILURES = [str(ending) for ending in ENDINGS if ending is not Outcome.SUCCESS]


def run_text(data: dict[str, Any]) -> str:
    """Return the figures of a whole run."""
    seconds = data["seconds"]
    stages = ", ".join(f"{name} {value:.1f}" for name, value in seconds.items() if name != "total")
    texts = [text(data[name]) for name, text in STAGE_TEXTS.items() if data.get(name)]
    return "\n\n".join(
        [
            f"{data['task']}, seed {data['seed']}: {seconds['total']:.1f} s ({stages})",
            *(text for text in texts if text),
            *filter(None, [skills_text(data.get("skills", []))]),
            f"report  {data['files']['report']}\nlog     {data['files']['log']}",
        ]
    )


CUT_SHORT = (
    "the planner's training was cut short by its limit of wall time: another machine gives another"
)


def training_text(data: dict[str, Any]) -> str:
    """Return what is to be known of a training that was not whole; nothing if it was."""
    return CUT_SHORT if data["cut_short"] else ""


def planner_text(data: dict[str, Any]) -> str:
    """Return how long the training took, and whether it came to its end."""
    line = f"{data['file']}: {data['planner']}, trained in {data['seconds']:.1f} s"
    return "\n".join(filter(None, [line, training_text(data)]))


def episodes_text(data: dict[str, Any]) -> str:
    """Return how the episodes of training targets and unseen scenes end, with and without the shield."""
    rows = []
    for scenes, result in data.items():
        label = SCENES.get(scenes, scenes)
        rows.append([f"{label}, with shield", *_evaluation_row(result)])
        rows.append([f"{label}, without", *_evaluation_row(result["without_shield"])])
    return table(["scenes", *_EVALUATION_COLUMNS], rows, "Episodes on the reduced dynamics")


def moving_text(rows: list[dict[str, Any]]) -> str:
    """Return the episodes among moving obstacles."""
    columns = ["obstacles, m/s", *_EVALUATION_COLUMNS]
    text = [[f"{row['speed']:g}", *_evaluation_row(row)] for row in rows]
    return table(columns, text, "Training targets with shield, among moving obstacles")


def gait_text(data: dict[str, Any]) -> str:
    """Return what the gaits do while they are switched."""
    rows = [
        [
            t["name"],
            _pair(t["advance_m"], t["advance_sd"]),
            _pair(t["drift_m"], t["drift_sd"]),
            _pair(t["turn_rad"], t["turn_sd"]),
        ]
        for t in data["tasks"]
    ]
    switching = data["switching"]
    title = f"Gaits, switched at random: {switching['falls']} falls in {switching['cycles']} cycles"
    columns = ["gait", "advance, m (sd)", "drift, m (sd)", "turn, rad (sd)"]
    return table(columns, rows, title)


def skills_text(skills: list[dict[str, Any]]) -> str:
    """Return what was wanted of each gait, what it does, and which were dropped; nothing if not judged."""
    rows = []
    for skill in skills:
        goal, got = skill["wanted"], skill["got"]
        kept = "kept" if skill["kept"] else "dropped"
        rows.append([skill["name"], *(f"{goal[k]:.2f}" for k in ("advance_m", "turn_rad"))])
        rows[-1] += ["-" if got[k] is None else f"{got[k]:.2f}" for k in ("advance_m", "turn_rad")]
        rows[-1] += [f"{got['falls']} of {got['cycles']}", kept]
    if not rows:
        return ""
    columns = ["gait", "wanted, m", "wanted, rad", "does, m", "does, rad", "falls", ""]
    failed = [f"{skill['name']} {skill['fault']}" for skill in skills if not skill["kept"]]
    return "\n".join([table(columns, rows, "Gaits, judged"), *failed])


def surrogate_text(data: dict[str, Any]) -> str:
    """Return the surrogate's row of the paper's Table III."""
    rows = [
        [
            t["name"],
            _pair(t["rotation_mean"], t["rotation_sd"]),
            _pair(t["translation_mean"], t["translation_sd"]),
        ]
        for t in data["tasks"]
    ]
    columns = ["gait", "rotation, rad (sd)", "translation, m (sd)"]
    text = table(columns, rows, f"Surrogate, {data['pairs']} pairs a gait")
    if not (held_out := data.get("held_out")):
        return text
    errors = [
        f"{held_out[f'{key}place_m']:.3f} m, {held_out[f'{key}turn_rad']:.3f} rad"
        for key in ("plain_", "")
    ]
    m = data.get("decisions_per_cycle", 1)
    part, gaits = ("a cycle", "gait") if m == 1 else (f"1 / {m} of a cycle", "gaits")
    return (
        f"{text}\n{part} that was not fitted is off by {errors[0]}; by the {gaits} before, too,"
        f" {errors[1]}"
    )


_EVALUATION_COLUMNS = ["episodes", "success", "95%", *_FAILURES, "x real time"]


def evaluation_text(data: dict[str, Any]) -> str:
    """Return one evaluation."""
    return table(_EVALUATION_COLUMNS, [_evaluation_row(data)])


def _evaluation_row(data: dict[str, Any]) -> list[str]:
    low, high = data["interval"]["success"]
    return [
        str(data["episodes"]),
        f"{100 * data['success']:.1f}%",
        f"{100 * low:.1f}-{100 * high:.1f}%",
        *(f"{100 * data.get(name, 0.0):.1f}%" for name in _FAILURES),
        f"{data['real_time_factor']:.0f}",
    ]


def bound_text(data: dict[str, Any]) -> str:
    """Return a row for each kind of scenes and planner."""
    rows = []
    for row in data["rows"]:
        low, high = row["interval"]
        share = "-" if row["of_bound"] is None else f"{100 * row['of_bound']:.1f}%"
        rows.append(
            [
                row["scenes"],
                f"{row['speed']:g}",
                row["planner"],
                str(row["episodes"]),
                f"{100 * row['success']:.1f}%",
                f"{100 * low:.1f}-{100 * high:.1f}%",
                share,
                *(f"{100 * row[name]:.1f}%" for name in _FAILURES),
                f"{row['decision_ms']:.2f}",
            ]
        )
    columns = ["scenes", "m/s", "planner", "episodes", "success", "95%", "of the bound"]
    columns += [*_FAILURES, "ms a decision"]
    return table(columns, rows, f"{data['task']}: planners against one that knows everything")


def noise_text(data: dict[str, Any]) -> str:
    """Return a row for each disturbance and strength."""
    rows = []
    for row in data["rows"]:
        low, high = row["interval"]
        rows.append(
            [
                row["disturbance"],
                f"{row['strength']:g} {row['unit']}".strip(),
                str(row["episodes"]),
                f"{100 * row['success']:.1f}%",
                f"{100 * low:.1f}-{100 * high:.1f}%",
                *(f"{100 * row[name]:.1f}%" for name in _FAILURES),
            ]
        )
    columns = ["disturbance", "strength", "episodes", "success", "95%", *_FAILURES]
    return table(columns, rows, f"{data['task']}: {data['planner']}, unseen scenes, disturbed")


def robustness_text(data: dict[str, Any]) -> str:
    """Return falls and drift, a row for each condition and feedback."""
    rows = []
    for row in data["rows"]:
        low, high = row["interval"]
        figures = [row["place_m"], row["turn_rad"], row["way_m"]]
        rows.append(
            [
                row["condition"],
                row["feedback"],
                f"{row['falls']} of {row['cycles']}",
                f"{100 * low:.1f}-{100 * high:.1f}%",
                *("-" if value is None else f"{value:.3f}" for value in figures),
                f"{row['decision_ms']:.2f}",
            ]
        )
    columns = [
        "condition",
        "feedback",
        "falls",
        "95%",
        "drift, m",
        "drift, rad",
        "m a cycle",
        "ms a step",
    ]
    return table(columns, rows, f"{data['task']}, gaits switched at random")


STAGE_TEXTS: dict[str, Callable[[Any], str]] = {
    "gait": gait_text,
    "surrogate": surrogate_text,
    "planner": training_text,
    "evaluation": episodes_text,
    "moving": moving_text,
    "robustness": robustness_text,
}
"""What a stage's figures in the JSON are for people; in the order of the stages."""


def check_text(data: dict[str, Any]) -> str:
    """Return a row for each gait: what finer steps and the full FEM change."""
    kinds = list(data["gaits"][0]["turn_rad"])
    rows = []
    for gait in data["gaits"]:
        row = [gait["name"]]
        for what in ("advance_m", "turn_rad"):
            row += [f"{gait[what][kind]:.3f}" for kind in kinds]
        row += [f"{gait['shifted'][name]:.3f}" for name in ("advance_sd_m", "turn_sd_rad")]
        if "full" in kinds:
            row += [f"{100 * gait['shape_error']:.1f}%", f"{gait['attitude_rad']:.3f}"]
        rows.append(row)
    columns = ["gait", *(f"m {k}" for k in kinds), *(f"rad {k}" for k in kinds)]
    columns += ["± m", "± rad"]
    columns += ["shape", "attitude"] if "full" in kinds else []
    text = table(columns, rows, f"{data['task']}: a cycle of each gait")
    drag, frequency = data["drag_force_error"], data["frequency_error"]
    notes = [
        "refined: every step divided by four; substeps: only those; full: the full FEM",
        "modes, basis, drag_points: bodies with more of them" if "modes" in kinds else "",
        f"±: what shifts of all target shapes by {data['shift']:.0%} of the amplitude change (sd)",
        f"drag force within {100 * drag:.1f}%" if drag is not None else "",
        f"frequencies within {100 * frequency:.1f}%" if frequency is not None else "",
        f"falls with finer steps: {data['falls_refined']}",
    ]
    return "\n".join([text, *(note for note in notes if note)])


def _pair(mean: float, deviation: float) -> str:
    return f"{mean:.3f} ({deviation:.3f})"


def bench_text(data: dict[str, Any]) -> str:
    """Return the figures as a table."""
    step = next(iter(data["reduced_step_us"].values()))
    flex, is_of, adjoint = data["mujoco_flex_step_ms"], data["conditions"], data["adjoint_step_us"]
    cycle = data["environment_step_us"]
    rows = [
        ["reduced step", f"{step['median']:.1f} µs", f"{step['p99']:.1f} µs"],
        ["  in a rollout, per step", f"{data['rollout_step_us']:.1f} µs", ""],
        ["  its adjoint", f"{adjoint['median']:.1f} µs", f"{adjoint['p99']:.1f} µs"],
        *(
            [f"feedback {name}, per step", f"{time['median']:.0f} µs", f"{time['p99']:.0f} µs"]
            for name, time in data["feedback_decision_us"].items()
        ),
        ["full FEM step (f)", f"{data['full_fem_step_ms']:.0f} ms", ""],
        ["MuJoCo flex step, full", f"{flex['full']:.2f} ms", ""],
        ["MuJoCo flex step, trilinear", f"{flex['trilinear']:.2f} ms", ""],
        [
            "surrogate transition, with laser",
            f"{1e6 / data['surrogate_transitions_per_s']:.2f} µs",
            "",
        ],
        [f"laser scan, {is_of['beams']} beams", f"{data['laser_scan_us']:.1f} µs", ""],
        ["  spherical", f"{data['spherical_laser_scan_us']:.1f} µs", ""],
        ["observation, planar", f"{data['observation_us']:.1f} µs", ""],
        ["  spatial", f"{data['spatial_observation_us']:.1f} µs", ""],
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
    if vector := data["vector_environment_steps_per_s"]:
        lines.insert(
            2,
            f"{is_of['vector_environments']} robots on {is_of['cores']} cores take {vector['smooth']} control"
            f" steps a second under smooth actions, {vector['random']} under random ones",
        )
    errors = [
        [
            row["name"],
            f"{row['step_us']:.1f} µs",
            f"{100 * row['advance_error']:.2f}%",
            f"{row['turn_error_rad']:.4f}",
        ]
        for row in data["error_against_time"]
    ]
    lines.append(table(["integrator", "a step", "off in place", "attitude, rad"], errors))
    if is_of["quick"]:
        lines.append("few repeats (--quick): not to be quoted")
    return "\n".join(lines)
