"""What the report draws is what was computed: outlines, cut meshes, views, intervals."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from defplan_mj.body.tetmesh import boundary
from defplan_mj.log.plotting import view
from defplan_mj.report.content import duration, mean_sd, number, percent
from defplan_mj.report.figures.drawing import outlines
from defplan_mj.report.figures.planning import rates_figure
from defplan_mj.report.figures.preview import preview_figure
from defplan_mj.report.figures.views import episode_views


def winding(point: np.ndarray, loops: list[np.ndarray]) -> int:
    """Return how often closed curves wind around a point."""
    total = 0.0
    for loop in loops:
        a = np.unwrap(np.arctan2(*(np.vstack([loop, loop[:1]]) - point).T[::-1]))
        total += a[-1] - a[0]
    return round(total / (2 * np.pi))


def test_a_silhouette_covers_what_the_surface_covers():
    ball = trimesh.creation.icosphere(subdivisions=3)
    loops = outlines(ball.vertices, ball.faces)
    area = sum(
        0.5 * np.sum(l[:, 0] * np.roll(l[:, 1], -1) - l[:, 1] * np.roll(l[:, 0], -1)) for l in loops
    )
    assert area == pytest.approx(np.pi, rel=0.01)


def test_a_silhouette_of_a_surface_with_a_hole_keeps_the_hole():
    ring = trimesh.creation.torus(major_radius=1.0, minor_radius=0.25)
    loops = outlines(ring.vertices, ring.faces)
    assert winding(np.array([0.0, 0.0]), loops) == 0
    assert winding(np.array([1.0, 0.01]), loops) == 1
    assert winding(np.array([1.5, 0.0]), loops) == 0


def test_parts_above_each_other_are_covered():
    low = trimesh.creation.icosphere(subdivisions=2)
    high = low.copy().apply_translation([0.5, 0, 3.0])
    both = trimesh.util.concatenate([low, high])
    assert isinstance(both, trimesh.Trimesh)
    loops = outlines(both.vertices, both.faces)
    assert winding(np.array([0.25, 0.013]), loops) == 2  # filled: not zero
    assert winding(np.array([1.3, 0.013]), loops) == 1
    assert winding(np.array([2.0, 0.013]), loops) == 0


def test_the_boundary_of_two_tetrahedra_has_six_outward_faces():
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1.0]])
    tetrahedra = np.array([[0, 1, 2, 3], [1, 4, 2, 3]])
    for corners in tetrahedra:
        edges = points[corners[1:]] - points[corners[0]]
        assert np.linalg.det(edges) > 0
    faces, _ = boundary(tetrahedra)
    assert len(faces) == 6
    mesh = trimesh.Trimesh(points, faces, process=False)
    assert mesh.is_watertight
    assert mesh.volume == pytest.approx(1 / 6 + 1 / 3)  # positive: faces point outward


def test_a_view_is_a_rotation_that_sees_the_side_it_says():
    rotation = view(azimuth=-90, elevation=0)  # from the right: front to the right, up is up
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-15)
    np.testing.assert_allclose(rotation @ [1, 0, 0], [1, 0, 0], atol=1e-15)
    np.testing.assert_allclose(rotation @ [0, 0, 1], [0, 1, 0], atol=1e-15)
    assert np.linalg.det(view(20, 40)) == pytest.approx(1)


@pytest.mark.parametrize("space", ["planar", "spatial"])
@pytest.mark.parametrize("target", [[3.0, -4.0, 2.0], [0.1, 0.2, 9.0], [0.0, 0.0, -5.0]])
def test_views_of_an_episode_are_rotations_that_lead_to_the_right(space, target):
    if space == "planar" and not any(target[:2]):
        pytest.skip("a planar way is not vertical")
    start = np.array([1.0, 2.0, 3.0])
    goal = start + target
    views = episode_views(start, goal, space)
    assert len(views) == (1 if space == "planar" else 4)
    for seen in views:
        np.testing.assert_allclose(seen.rotation @ seen.rotation.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(seen.rotation) == pytest.approx(1)  # nothing is mirrored
        np.testing.assert_allclose(seen.place(start), 0, atol=1e-12)
    way = np.linalg.norm(target[: 2 if space == "planar" else 3])
    for seen in views if space == "planar" else views[1:3]:
        np.testing.assert_allclose(seen.place(goal), np.array([way, 0.0]), atol=1e-12)
    if space == "spatial":
        np.testing.assert_allclose(views[3].place(goal), 0, atol=1e-12)  # straight ahead
        assert views[3].depth(goal) == pytest.approx(-way)


def test_numbers_are_written_for_people():
    assert [duration(s) for s in (8.6e-5, 0.012, 12.34, 601, 6120)] == [
        "86 µs",
        "12 ms",
        "12.3 s",
        "10 min",
        "1.7 h",
    ]
    assert (percent(1.0), percent(0.975), percent(0.0)) == ("100%", "97.5%", "0%")
    assert (number(None), number(float("nan")), mean_sd(1, 0.5, 1)) == ("–", "–", "1.0 ± 0.5")


def test_the_dot_of_a_rate_of_100_percent_is_whole():
    axes = rates_figure([("unseen scenes", 1.0, (0.98, 1.0)), ("novel", 0.9, (0.8, 0.95))]).axes[0]
    assert [np.array(dot.get_offsets()).tolist() for dot in axes.collections] == [
        [[100, 0]],
        [[90, 1]],
    ]
    assert not any(dot.get_clip_on() for dot in axes.collections)


def test_a_preview_shows_which_way_a_mesh_looks():
    figure = preview_figure(*_long_box())
    words = [[text.get_text() for text in axes.texts] for axes in figure.axes]
    assert words == [["ahead", "up"], ["ahead"], ["up"], ["ahead", "up"]]
    ahead, up = figure.axes[0].texts
    assert ahead.get_position()[0] > 0.5 and up.get_position()[1] > 0.5  # to the right; upwards


def _long_box() -> tuple[np.ndarray, np.ndarray]:
    box = trimesh.creation.box((1.0, 0.3, 0.4))
    return np.asarray(box.vertices), np.asarray(box.faces)
