"""The report's section on how true the gaits are: `defplan check --run DIR` leaves its figures in the folder."""

from __future__ import annotations

from defplan_mj.report.content import Missing, Section, Table, Text, percent
from defplan_mj.report.material import Material

_KINDS = {
    "reduced": "as it is",
    "refined": "steps / 4",
    "substeps": "substeps x 4",
    "full": "full FEM",
    "modes": "more modes",
    "basis": "larger basis",
    "drag_points": "more drag points",
}


def check_section(material: Material) -> Section:
    """Return what finer steps and the full FEM change about each gait."""
    section = Section("check", "How true the gaits are")
    data = material.documents.get("check")
    if not data:
        command = f"defplan check {material.task} --run {material.folder.name}"
        section.blocks.append(Missing(f"Not checked yet: {command} does it, in minutes."))
        return section
    if material.is_outdated(data):
        section.blocks.append(Missing("Checked with other gaits than these: check them again."))
    gaits = data["gaits"]
    kinds = [kind for kind in _KINDS if kind in gaits[0]["turn_rad"]]
    for what, unit in (("advance_m", "m"), ("turn_rad", "rad")):
        rows = [[gait["name"], *(f"{gait[what][kind]:.3f}" for kind in kinds)] for gait in gaits]
        name = "advance" if unit == "m" else "turn"
        caption = f"The {name} of a cycle of each gait, played over and over from rest, {unit}."
        section.blocks.append(Table(["gait", *(_KINDS[kind] for kind in kinds)], rows, caption))
    if "shifted" in gaits[0]:
        rows = [
            [
                gait["name"],
                *(f"{gait['shifted'][of]:.3f}" for of in ("advance_sd_m", "turn_sd_rad")),
            ]
            for gait in gaits
        ]
        caption = (
            "How much a cycle scatters (standard deviation) when all target shapes are moved by normal "
            f"shifts of {percent(data['shift'])} of the amplitude: no gait is truer than its body's shapes."
        )
        section.blocks.append(Table(["gait", "advance, m", "turn, rad"], rows, caption))
    if "full" in kinds:
        rows = [
            [gait["name"], percent(gait["shape_error"]), f"{gait['attitude_rad']:.3f}"]
            for gait in gaits
        ]
        caption = "The reduced body beside the full one at the end, after the same gait from rest."
        section.blocks.append(Table(["gait", "shape", "attitude, rad"], rows, caption))
    notes = []
    if data["drag_force_error"] is not None:
        notes.append(f"The drag points' force is within {percent(data['drag_force_error'])}.")
    if data["frequency_error"] is not None:
        notes.append(f"The first frequencies are within {percent(data['frequency_error'])}.")
    if material.spec is not None and material.spec.world.walks:
        notes.append(f"Falls with every step divided by four: {data['falls_refined']}.")
    section.blocks.append(Text(" ".join(notes)))
    return section
