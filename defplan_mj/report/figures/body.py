"""Pictures of a body: its mesh, whole and cut open, and each mode at both amplitudes."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from defplan_mj.body.model import Body
from defplan_mj.body.tetmesh import boundary
from defplan_mj.dynamics.reduced import ReducedDynamics
from defplan_mj.log.plotting import SERIES, new_figure, styled, view
from defplan_mj.report.figures.drawing import draw_surface, fit

_OUTER, _INNER = "#1f7a8c", "#e0b25b"


@styled
def mesh_figures(body: Body) -> tuple[Figure, Figure]:
    """Return the tetrahedral mesh, whole and with the half nearer to the viewer taken away."""
    rotation = view(-60, 22)
    whole, grid = new_figure(4.6, 2.4)
    draw_surface(grid[0, 0], body.vertices, body.faces, rotation, _OUTER, edges=0.2)
    grid[0, 0].set_title(f"{len(body.vertices)} vertices")
    # seen from the right (azimuth < 0): what lies to the right is on the viewer's side
    centre = body.vertices[body.tetrahedra].mean(1)
    faces, _ = boundary(body.tetrahedra[centre[:, 1] > 0])
    outside = {tuple(face) for face in np.sort(body.faces, axis=1).tolist()}
    inner = [tuple(face) not in outside for face in np.sort(faces, axis=1).tolist()]
    opened, grid = new_figure(4.6, 2.4)
    colours = [_INNER if cut else _OUTER for cut in inner]
    draw_surface(grid[0, 0], body.vertices, faces, rotation, colours, edges=0.2)
    grid[0, 0].set_title(f"{len(body.tetrahedra)} tetrahedra")
    return whole, opened


@styled
def mode_figure(body: Body, dynamics: ReducedDynamics, mode: int) -> Figure:
    """Return a mode at minus and plus its amplitude, by the reduced rotation-strain map."""
    shapes = []
    for sign in (-1, 1):
        x = dynamics.rest_state()
        x[7 + mode] = sign * body.amplitude[mode]
        shapes.append(dynamics.surface(x))
    rotation = _seen_best(body, shapes[1])
    figure, axes = new_figure(4.6, 1.7, 1, 2)
    colour = SERIES[mode % len(SERIES)]
    for column, points in enumerate(shapes):
        draw_surface(axes[0, column], points, body.surface_faces, rotation, colour)
    seen = np.concatenate([points @ rotation.T for points in shapes])[:, :2]
    for column, mark in enumerate("−+"):
        fit(axes[0, column], seen)  # both at one scale
        axes[0, column].set_title(f"$q_{{{mode + 1}}}$ = {mark}{body.amplitude[mode]:.1f}")
    figure.suptitle(
        f"mode {mode + 1}, {body.frequencies[mode]:.1f} Hz", x=0.02, ha="left", fontweight="bold"
    )
    return figure


def _seen_best(body: Body, points: np.ndarray) -> np.ndarray:
    """Return the view from above or from the side, whichever shows more of a deformation."""
    move = np.abs(points - body.vertices[body.surface])
    sideways, upward = move[:, 1].mean(), move[:, 2].mean()
    return view(-90, 60) if sideways > upward else view(-75, 12)
