"""Meshing: closed surfaces filled with well-shaped tetrahedra, to the wanted count."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from defplan_mj.base.errors import DefplanError
from defplan_mj.body import lattice
from defplan_mj.body.fitting import closest_on_triangles, spread_points
from defplan_mj.body.meshing import fill, stuff
from defplan_mj.body.surface import Surface
from defplan_mj.body.tetmesh import (
    TetMesh,
    boundary,
    face_pieces,
    lumped_mass,
    quality,
    split_longest_edges,
    volumes,
)
from tests.samples.meshes import FISH, bar, load_mesh, pill, surface_of


def _check_sound(mesh: TetMesh) -> trimesh.Trimesh:
    assert volumes(mesh.vertices, mesh.tetrahedra).min() > 0.0
    label, most = face_pieces(mesh.tetrahedra)
    assert label.max() == 0 and most == 2
    faces, _ = boundary(mesh.tetrahedra)
    return trimesh.Trimesh(mesh.vertices, faces, process=False)


@pytest.mark.parametrize("wanted", [150, 401])
def test_count_is_met_within_two_and_no_tetrahedron_is_flat(wanted):
    mesh, _ = fill(surface_of(pill(3)), wanted)
    assert abs(len(mesh.vertices) - wanted) <= 2
    assert volumes(mesh.vertices, mesh.tetrahedra).min() > 0.0
    assert quality(mesh.vertices, mesh.tetrahedra).min() > 0.1
    assert face_pieces(mesh.tetrahedra)[1] == 2


def test_fish_has_2118_vertices_and_keeps_its_thin_fins():
    surface = load_mesh(FISH, 1.0)
    assert isinstance(surface, Surface)
    mesh, _ = fill(surface, 2118)
    assert abs(len(mesh.vertices) - 2118) <= 2
    shape = quality(mesh.vertices, mesh.tetrahedra)
    assert shape.min() > 0.15 and shape.mean() > 0.7
    tets = volumes(mesh.vertices, mesh.tetrahedra)
    assert tets.sum() == pytest.approx(surface.volume, rel=0.01)
    # volume of the tail fin alone, thinner than a lattice cell: exact by cutting the surface
    x = mesh.vertices[mesh.tetrahedra].mean(1)[:, 0]
    whole = trimesh.Trimesh(surface.vertices, surface.faces, process=False)
    assert mesh.vertices[:, 0].min() == pytest.approx(-0.5, abs=0.015)
    tail = _volume_behind(whole, -0.4)
    assert tets[x < -0.4].sum() == pytest.approx(tail, rel=0.05)


def _volume_behind(mesh: trimesh.Trimesh, place: float) -> float:
    """Integrate the area of cross-sections behind x = place."""
    heights = np.linspace(mesh.bounds[0, 0] + 1e-4, place, 30)
    areas = []
    for x in heights:
        section = mesh.section([1, 0, 0], [x, 0, 0])
        assert section is not None
        # each closed loop's area by the shoelace formula; loops here do not nest
        areas.append(
            sum(
                abs(0.5 * np.sum(p[:-1, 1] * p[1:, 2] - p[1:, 1] * p[:-1, 2]))
                for p in section.discrete
            )
        )
    return float(np.trapezoid(areas, heights))


def test_volume_error_shrinks_with_the_cell_on_an_ellipsoid():
    surface = surface_of(pill(4))
    errors = []
    for cell in (0.1, 0.05):
        mesh = stuff(surface.vertices, surface.faces, np.full(3, cell), np.zeros(3))
        errors.append(abs(volumes(mesh.vertices, mesh.tetrahedra).sum() / surface.volume - 1.0))
    assert errors[1] < 0.4 * errors[0] < 0.05


def test_box_aligned_with_the_lattice_is_filled_exactly():
    box = surface_of(trimesh.creation.box([1.0, 0.6, 0.4]))
    mesh = stuff(box.vertices, box.faces, np.full(3, 0.1), np.zeros(3))
    _check_sound(mesh)
    assert volumes(mesh.vertices, mesh.tetrahedra).sum() == pytest.approx(0.24, rel=0.02)


def test_splitting_edges_adds_exactly_what_is_asked_and_keeps_the_mesh_whole():
    box = bar((4, 3, 2), (1.0, 0.6, 0.3))
    for count in (1, 7, 100):
        finer = split_longest_edges(box, count)
        assert len(finer.vertices) == len(box.vertices) + count
        assert len(np.unique(finer.tetrahedra)) == len(finer.vertices)
        sound = _check_sound(finer)
        assert sound.is_watertight and sound.volume == pytest.approx(0.18)
        assert volumes(finer.vertices, finer.tetrahedra).sum() == pytest.approx(0.18)
    lengths = [trimesh.Trimesh(m.vertices, boundary(m.tetrahedra)[0]).edges_unique_length.max()
               for m in (box, finer)]  # fmt: skip
    assert lengths[1] < 0.8 * lengths[0]


def test_a_plate_that_lies_askew_is_filled_as_well_as_one_along_the_axes():
    plate = trimesh.creation.box([1.0, 0.6, 0.08])
    plate.apply_transform(trimesh.transformations.rotation_matrix(0.7, [1, 2, 3]))
    mesh, _ = fill(surface_of(plate), 400)
    assert volumes(mesh.vertices, mesh.tetrahedra).sum() == pytest.approx(0.048, rel=0.05)
    assert quality(mesh.vertices, mesh.tetrahedra).min() > 0.1
    np.testing.assert_allclose(np.ptp(mesh.vertices, 0), np.ptp(plate.vertices, 0), rtol=0.08)


def test_count_is_met_on_a_box_along_the_axes_where_whole_layers_come_and_go():
    box = surface_of(trimesh.creation.box([1.0, 0.4, 0.3]))
    mesh, _ = fill(box, 350)
    assert abs(len(mesh.vertices) - 350) <= 2
    assert quality(mesh.vertices, mesh.tetrahedra).min() > 0.1


def test_a_ring_stays_a_ring():
    ring = surface_of(trimesh.creation.torus(0.4, 0.12))
    mesh, _ = fill(ring, 500)
    assert _check_sound(mesh).euler_number == 0


def test_inside_agrees_with_the_analytic_ball():
    ball = trimesh.creation.icosphere(subdivisions=4, radius=6.0)
    for direction in (*lattice.AXES, *lattice.DIAGONALS):
        lines = lattice.crossings(np.array(ball.vertices), np.array(ball.faces), direction)
        grid = np.stack(np.meshgrid(*[np.arange(-8, 9)] * 3, indexing="ij"), -1).reshape(-1, 3)
        grid = grid[(grid[:, 0] % 2 == grid[:, 1] % 2) & (grid[:, 0] % 2 == grid[:, 2] % 2)]
        radius = np.linalg.norm(grid, axis=1)
        clear = np.abs(radius - 6.0) > 0.1
        np.testing.assert_array_equal(lines.inside(grid)[clear], (radius < 6.0)[clear])


def test_lines_through_vertices_and_edges_are_counted_once():
    # every vertex and many edges of this octahedron lie on lattice lines
    octahedron = np.array([[4, 0, 0], [-4, 0, 0], [0, 4, 0], [0, -4, 0], [0, 0, 4], [0, 0, -4]])
    faces = trimesh.convex.convex_hull(octahedron.astype(float))
    grid = np.stack(np.meshgrid(*[np.arange(-6, 7)] * 3, indexing="ij"), -1).reshape(-1, 3)
    grid = grid[(grid[:, 0] % 2 == grid[:, 1] % 2) & (grid[:, 0] % 2 == grid[:, 2] % 2)]
    size = np.abs(grid).sum(1)
    for direction in (*lattice.AXES, *lattice.DIAGONALS):
        lines = lattice.crossings(np.array(faces.vertices), np.array(faces.faces), direction)
        inside = lines.inside(grid)
        assert inside[size < 4].all() and not inside[size > 4].any()


def test_too_few_vertices_for_a_thin_body_is_said():
    plate = surface_of(trimesh.creation.box([1.0, 1.0, 0.01]))
    with pytest.raises(DefplanError, match="ask for"):
        fill(plate, 60, "plate.stl")


def test_closest_points_agree_with_dense_sampling():
    rng = np.random.default_rng(3)
    p, a, b, c = rng.normal(size=(4, 40, 3))
    weights = closest_on_triangles(p, a, b, c)
    assert weights.min() >= -1e-12 and np.allclose(weights.sum(-1), 1.0)
    near = weights[:, :1] * a + weights[:, 1:2] * b + weights[:, 2:] * c
    u, v = (g.ravel() for g in np.meshgrid(np.linspace(0, 1, 201), np.linspace(0, 1, 201)))
    u, v = u[u + v <= 1.0], v[u + v <= 1.0]
    dense = a[:, None] + u[:, None] * (b - a)[:, None] + v[:, None] * (c - a)[:, None]
    least = np.linalg.norm(dense - p[:, None], axis=-1).min(1)
    distance = np.linalg.norm(near - p, axis=1)
    assert (distance <= least + 1e-12).all()
    np.testing.assert_allclose(distance, least, atol=0.02)


def test_spread_points_lie_on_the_surface_and_give_every_part_its_share():
    box = surface_of(trimesh.creation.box([1.0, 0.5, 0.02]))  # two long thin triangles a side
    points, normals = spread_points(box, 4000)
    half = np.array([0.5, 0.25, 0.01])
    side = np.abs(normals).argmax(1)
    rows = np.arange(4000)
    np.testing.assert_allclose(points[rows, side], (normals * half)[rows, side], atol=1e-12)
    assert (np.abs(points) <= half + 1e-12).all()
    for axis in range(3):
        share = 2.0 * np.delete(2.0 * half, axis).prod() / box.area
        assert (side == axis).mean() == pytest.approx(share, abs=0.002)
    top = points[(side == 2) & (normals[:, 2] > 0)]
    cells = np.histogram2d(top[:, 0], top[:, 1], bins=8)[0]
    assert cells.min() > 0.6 * cells.mean()  # no holes: at random it would be 0.4


def test_masses_and_quality_of_known_meshes():
    box = bar((3, 2, 2), (1.0, 0.5, 0.4))
    mass = lumped_mass(box.vertices, box.tetrahedra, 700.0)
    assert mass.sum() == pytest.approx(700.0 * 0.2)
    np.testing.assert_allclose(mass @ box.vertices, 0.0, atol=1e-12)
    regular = np.array([[1.0, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]])
    assert quality(regular, np.array([[0, 2, 1, 3]])) == pytest.approx(1.0)
    faces, _ = boundary(box.tetrahedra)
    assert trimesh.Trimesh(box.vertices, faces).volume == pytest.approx(0.2)
