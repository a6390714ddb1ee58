"""The report's section on the body: its mesh, its modes and what the reduction keeps."""

from __future__ import annotations

from defplan_mj.report.content import Figures, Section, Table, Text, drawing, number
from defplan_mj.report.figures.body import mesh_figures, mode_figure
from defplan_mj.report.material import Material, missing


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


def _pair(values: dict[str, float], *names: str) -> str:
    return " / ".join(number(values.get(name), 2) for name in names)
