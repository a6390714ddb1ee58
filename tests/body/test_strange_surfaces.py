"""Surfaces as strangers' programs make them: drawn from both sides, with crumbs, fins and many pieces."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import trimesh

from defplan_mj.base.errors import DefplanError
from defplan_mj.body import tetwild, touching
from defplan_mj.body.repair import Repaired, repair
from defplan_mj.body.surface import check_surface
from tests.samples.meshes import pill, surface_of

BOX = trimesh.creation.box([1.0, 0.4, 0.3])


def repaired(*parts: tuple[Any, Any]) -> Repaired:
    before = np.cumsum([0, *(len(vertices) for vertices, _ in parts)])
    faces = [np.array(faces) + n for (_, faces), n in zip(parts, before, strict=False)]
    return repair(np.vstack([vertices for vertices, _ in parts]), np.vstack(faces), "it")


def shifted(box, by):
    return np.array(box.vertices) + by, np.array(box.faces)


def test_a_surface_drawn_from_both_sides_keeps_one():
    whole = surface_of(pill(3))
    back = whole.faces[:, ::-1]
    done = repaired((whole.vertices, whole.faces), (whole.vertices, back))
    assert abs(done.surface.volume) == pytest.approx(whole.volume) and done.simple
    assert done.said[0] == f"dropped {len(back)} double triangles"
    done = repaired((whole.vertices, whole.faces), (whole.vertices, back[::2]))  # a part of it
    assert done.surface.volume == pytest.approx(whole.volume) and done.simple


def test_triangles_that_all_collapse_are_called_that():
    with pytest.raises(DefplanError, match="all its triangles collapse"):
        check_surface(np.array(BOX.vertices), np.repeat(BOX.faces[:, :1], 3, axis=1), "it")


def test_crumbs_beside_pieces_that_overlap_are_left_out():
    small = trimesh.creation.box([0.02] * 3)
    done = repaired(
        shifted(small, [-0.45, 0.23, 0.0]), shifted(BOX, 0.0), shifted(BOX, [0.3, 0.05, 0.05]),
        shifted(small, [-0.3, 0.23, 0.0]),
    )  # fmt: skip
    assert any(text.startswith("left out 2 crumbs") for text in done.said)
    assert "joined pieces that overlap" in done.said
    assert "what was left out reached 3.1% of the length out of the body" in done.said


def test_what_is_left_out_must_not_take_the_extents_along():
    fin = np.array([[0.0, 0.0, 0.2], [0.3, 0.0, 0.2], [0.0, 0.0, 0.6]])
    with pytest.raises(DefplanError, match="stick out by 45.0% of the length"):
        repaired(shifted(BOX, 0.0), (fin, [[0, 1, 2]]))


def test_many_pieces_apart_are_refused_after_few_looks(monkeypatch):
    looks = []
    distances = touching.distances_of

    def look(*arguments):
        looks.append(arguments)
        return distances(*arguments)

    monkeypatch.setattr(touching, "distances_of", look)
    with pytest.raises(DefplanError, match="12 pieces that lie apart, by 2.2%"):
        repaired(
            *(shifted(BOX, [0.0, 0.0, k * 0.5]) for k in range(11)), shifted(BOX, [0.0, 0.0, 9.0])
        )
    assert len(looks) <= 3


def test_a_busy_machine_is_not_called_a_thin_mesh():
    assert tetwild.WALL_SECONDS >= 10 * tetwild.CPU_SECONDS
    assert "the machine is busy" in tetwild._failure("it", -9, b"", tetwild.WALL_SECONDS + 1.0)
    assert "too thin" in tetwild._failure("it", -24, b"", 60.0)
