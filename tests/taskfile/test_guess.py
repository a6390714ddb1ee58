"""What is guessed of a mesh: which way it looks, and the time steps that the shipped tasks have."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from defplan_mj import registry
from defplan_mj.base.errors import DefplanError
from defplan_mj.body.look import look
from defplan_mj.body.model import Body
from defplan_mj.body.options import AXES, BodyOptions
from defplan_mj.body.orientation import direction, frame_of, turned
from defplan_mj.body.surface import Surface
from defplan_mj.gait.skills import can_steer
from defplan_mj.taskfile.guess import guess_task
from defplan_mj.taskfile.kinds import KINDS
from defplan_mj.taskfile.rhythm import rhythm, stiffened
from tests.samples.meshes import finned


def legged() -> trimesh.Trimesh:
    """Return a box on four legs, 1 m long, 0.5 m wide, 0.5 m high, with neck and head in front: z up."""
    return _boxes(
        ((0.0, 0.0, 0.35), (1.0, 0.5, 0.3)), ((0.45, 0.0, 0.6), (0.1, 0.2, 0.2)),
        ((0.55, 0.0, 0.65), (0.2, 0.2, 0.2)),
        *(((0.4 * x, 0.2 * y, 0.1), (0.1, 0.1, 0.2)) for x in (-1, 1) for y in (-1, 1)),
    )  # fmt: skip


def _boxes(*boxes):
    parts = []
    for middle, size in boxes:
        part = trimesh.creation.box(size)
        part.apply_translation(middle)
        parts.append(part)
    return trimesh.util.concatenate(parts)


def surface(mesh: trimesh.Trimesh, frame: np.ndarray | None = None) -> Surface:
    """Return a mesh whose body's axes are the rows of `frame` in the file."""
    frame = np.eye(3) if frame is None else frame
    return Surface(np.asarray(mesh.vertices) @ frame, np.asarray(mesh.faces))


def test_axes_are_turned_to_x_ahead_and_z_up():
    for up in AXES:
        for forward in AXES:
            if up[-1] == forward[-1]:
                with pytest.raises(DefplanError, match="two different axes"):
                    frame_of(up, forward)
                continue
            frame = frame_of(up, forward)
            assert np.linalg.det(frame) == pytest.approx(1.0)
            assert np.allclose(frame @ direction(up), [0, 0, 1])
            assert np.allclose(frame @ direction(forward), [1, 0, 0])
    mesh = surface(finned())
    assert turned(mesh) is mesh
    assert turned(turned(mesh, "y", "-z"), "z", "x").volume == pytest.approx(mesh.volume)


@pytest.mark.parametrize(("up", "forward"), [("z", "x"), ("y", "z"), ("y", "-x"), ("x", "y")])
@pytest.mark.parametrize("backed", [True, False])
def test_a_fish_is_seen_whichever_way_its_file_has_it(up, forward, backed):
    view = look(surface(finned(backed), frame_of(up, forward)))
    assert (view.up, view.forward) == (up, forward)
    assert ("left and right are alike" if backed else "flat sideways") in view.why
    assert "heavier in front" in view.why


@pytest.mark.parametrize("medium", ["water", "ground"])
@pytest.mark.parametrize(("up", "forward"), [("z", "x"), ("y", "z"), ("z", "-y"), ("y", "-x")])
def test_what_has_legs_is_upright_and_looks_where_its_head_is(up, forward, medium):
    view = look(surface(legged(), frame_of(up, forward)), medium=medium)
    assert (view.up, view.forward) == (up, forward)
    assert "stands on 4 feet" in view.why and "its head is beyond its feet" in view.why


def test_legs_that_are_not_quite_alike_are_legs_too():
    mesh = surface(legged(), frame_of("y", "z"))
    moved = mesh.vertices.copy()
    moved[:, 0] += 0.3 * moved[:, 2] ** 2  # the file's x is the body's left: it bends to one side
    view = look(Surface(moved, mesh.faces), medium="ground")
    assert (view.up, view.forward, view.mirrors) == ("y", "z", ())
    assert "nearly alike across x" in view.why


def test_what_has_no_legs_stands_on_its_base():
    cone = trimesh.creation.cone(0.4, 1.0, sections=40)
    cone.apply_translation((0.1, 0, 0))
    cone.vertices[:, 0] += 0.6 * cone.vertices[:, 2] ** 2  # it leans
    cone.vertices[:, 1] *= 0.8
    view = look(surface(cone, frame_of("y", "z")), medium="ground")
    assert view.up == "y" and "stands firmest on -y" in view.why


def test_what_is_given_is_taken_and_the_rest_guessed():
    mesh = surface(finned())
    assert look(mesh, forward="-x").forward == "-x"
    view = look(mesh, up="-z")
    assert (view.up, view.forward) == ("-z", "x")
    assert look(mesh, up="y", forward="z").why == ""


def test_z_is_up_where_nothing_else_tells():
    assert look(surface(trimesh.creation.icosphere(subdivisions=3))).up == "z"


@pytest.mark.parametrize(
    ("name", "kind"),
    [("fish-swim", "planar"), ("quadruped-swim", "spatial"), ("quadruped-walk", "ground"), ("tee-walk", "ground")],
)  # fmt: skip
def test_the_rule_of_time_step_and_period_gives_what_the_shipped_tasks_have(name, kind):
    spec = registry.get_task(name)
    assert spec.shipped is not None
    body = Body.load(spec.shipped[0])
    hertz = body.frequencies * np.sqrt(1 + spec.body.material.control_stiffness)
    timestep, steps = rhythm(KINDS[kind].rhythm, hertz, float(np.ptp(body.vertices[:, 2])))
    assert steps == spec.steps_per_cycle
    assert timestep == pytest.approx(spec.timestep, rel=0.03)


def test_a_stiff_swimmer_is_softened_to_the_rhythm_of_the_shipped_one():
    body = BodyOptions()
    for length in (0.5, 1.0, 4.0):
        soft, hertz = stiffened(KINDS["planar"].rhythm, body, np.array([20.0, 50.0]), length, 0.3)
        assert hertz[0] == pytest.approx(5.75 / np.sqrt(length), rel=0.05)
        assert soft.material.youngs_modulus == pytest.approx(1e6 * (hertz[0] / 20) ** 2)
        assert soft.medium.righting_height == pytest.approx(0.03 * length)
    same, hertz = stiffened(KINDS["planar"].rhythm, body, np.array([5.7, 20.0]), 1.0, 0.3)
    assert same == body and hertz[0] == 5.7
    assert stiffened(KINDS["ground"].rhythm, body, np.array([20.0]), 1.0, 0.7)[0] == body


def test_a_walker_whose_legs_do_not_carry_it_is_stiffened_until_it_falls_slower_than_it_steps():
    body = BodyOptions()
    stiff, hertz = stiffened(KINDS["ground"].rhythm, body, np.array([1.2, 3.0]), 1.0, 0.83)
    factor = stiff.material.youngs_modulus / body.material.youngs_modulus
    assert factor > 4 and hertz == pytest.approx(np.array([1.2, 3.0]) * np.sqrt(factor))
    timestep, steps = rhythm(KINDS["ground"].rhythm, hertz, 0.83)
    assert timestep * steps == pytest.approx(2.6 * np.sqrt(0.83 / 9.81), rel=0.03)


def test_a_body_with_fast_modes_has_more_steps_and_never_too_many():
    assert rhythm(KINDS["planar"].rhythm, [5.0, 80.0], 0.3)[1] == int(np.ceil(0.5 * 80 / 0.58))
    assert rhythm(KINDS["planar"].rhythm, [5.0, 8000.0], 0.3)[1] == 200


@pytest.mark.parametrize(
    ("kind", "axis"),
    [("planar", None), ("ground", None), ("spatial", (0.0, 0.0, 1.0)), ("spatial", (1.0, 0.0, 0.0))],
)  # fmt: skip
def test_guessed_gaits_can_steer(kind, axis):
    tasks = KINDS[kind].gaits(2.0, axis or (1.0, 0.0, 0.0))
    space = "spatial" if kind == "spatial" else "planar"
    assert can_steer(tasks, space, axis or (1.0, 0.0, 0.0))
    assert not can_steer(tasks[:1], space, axis or (1.0, 0.0, 0.0))
    assert max(task.advance for task in tasks) <= 1.0  # half of the length
    if kind == "spatial":
        assert all(abs(np.dot(task.turn, axis)) < 1e-12 for task in tasks)


def test_the_jellyfish_like_body_swims_in_space_as_its_task_does(monkeypatch):
    monkeypatch.setattr(
        "defplan_mj.taskfile.guess._with_modes",
        lambda _, body, bends: (body, np.array([3.0, 16.0])),
    )
    monkeypatch.setattr("defplan_mj.taskfile.guess._as_tried", lambda spec, *_: spec)
    shipped = registry.get_task("quadruped-swim")
    spec = guess_task(shipped.mesh, "water").spec
    assert spec.navigation.space == "spatial" and spec.axis == shipped.axis and not spec.feedback
    for guessed, task in zip(spec.gait_tasks, shipped.gait_tasks, strict=True):
        assert guessed.name == task.name and guessed.turn == task.turn
        assert np.allclose(guessed.direction, task.direction)
    ground = guess_task(shipped.mesh, "ground", length=2.0)
    assert ground.spec.world.walks and ground.spec.body.length == 2.0
    assert ground.spec.navigation.distance == 12.0
    assert ground.spec.feedback == registry.quick_solver("feedback") != ""
    assert "--length" in ground.sentence and "\n" not in ground.sentence
