"""Bodies, gaits and terrains that cannot be are refused in one sentence that names the field."""

from __future__ import annotations

import io
import json
import zipfile
from dataclasses import replace

import numpy as np
import pytest

from defplan_mj.base import files
from defplan_mj.base.errors import DefplanError
from defplan_mj.body.model import FORMAT_VERSION, Body, Material, Medium
from defplan_mj.dynamics.terrain import Heightfield, Terrain, TerrainGeom, pack_terrain
from defplan_mj.gait.gait import Gait
from defplan_mj.kernel.pack import pack_body
from tests.samples.logs import sample_body, sample_gait


def with_value(array, value):
    changed = array.copy()
    changed.flat[0] = value
    return changed


FLOATS = [
    *("vertices", "vertex_mass", "modes", "frequencies", "stiffness", "amplitude", "basis"),
    *("feature_map", "feature_weights", "moments", "drag_points", "drag_tangents", "drag_areas"),
]
INDICES = ["tetrahedra", "faces", "surface", "sampled"]


def refused(thing, kind, path, name):
    thing.save(path)
    with pytest.raises(DefplanError, match=name) as caught:
        kind.load(path)
    assert str(path) in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize("name", [*FLOATS, *INDICES])
def test_a_body_with_an_array_of_another_shape_is_refused(tmp_path, name):
    body = sample_body()
    array = getattr(body, name)
    refused(replace(body, **{name: array[None]}), Body, tmp_path / "b.npz", f"its {name}")
    shorter = array[..., :-1]
    with pytest.raises(DefplanError, match=r"no body that can be used: its \w+"):
        replace(body, **{name: shorter}).save(tmp_path / "c.npz")
        Body.load(tmp_path / "c.npz")


@pytest.mark.parametrize("bad", [np.nan, np.inf])
@pytest.mark.parametrize("name", FLOATS)
def test_a_body_with_numbers_that_are_none_is_refused(tmp_path, name, bad):
    body = sample_body()
    broken = replace(body, **{name: with_value(getattr(body, name), bad)})
    refused(broken, Body, tmp_path / "b.npz", f"its {name}")
    with pytest.raises(DefplanError, match=f"its {name}"):
        pack_body(broken)


@pytest.mark.parametrize("bad", [-1, 10_000])
@pytest.mark.parametrize("name", INDICES)
def test_a_body_with_an_index_out_of_range_is_refused(tmp_path, name, bad):
    body = sample_body()
    broken = replace(body, **{name: with_value(getattr(body, name), bad)})
    refused(broken, Body, tmp_path / "b.npz", f"its {name}")


@pytest.mark.parametrize(
    "name", ["vertex_mass", "frequencies", "stiffness", "amplitude", "drag_areas"]
)
def test_a_body_with_a_size_that_is_not_positive_is_refused(tmp_path, name):
    body = sample_body()
    broken = replace(body, **{name: with_value(getattr(body, name), 0.0)})
    refused(broken, Body, tmp_path / "b.npz", f"its {name} must be positive")


@pytest.mark.parametrize("name", FLOATS)
def test_a_body_of_integers_where_numbers_belong_is_refused(tmp_path, name):
    body = sample_body()
    broken = replace(body, **{name: getattr(body, name).astype(int)})
    refused(broken, Body, tmp_path / "b.npz", f"its {name} must be floating")


def test_a_body_whose_basis_or_moments_are_not_its_masss_is_refused(tmp_path):
    body = sample_body()
    refused(
        replace(body, basis=1.01 * body.basis), Body, tmp_path / "b.npz", "not mass-orthonormal"
    )
    refused(replace(body, moments=2.0 * body.moments), Body, tmp_path / "b.npz", "its moments")


@pytest.mark.parametrize(
    ("change", "name"),
    [
        ({"material": Material(density=0.0)}, "material's density"),
        ({"material": Material(youngs_modulus=-1.0)}, "material's youngs_modulus"),
        ({"material": Material(poissons_ratio=0.5)}, "material's poissons_ratio"),
        ({"material": Material(damping=float("nan"))}, "material's damping"),
        ({"medium": Medium(density=-1.0)}, "medium's density"),
        ({"medium": Medium(gravity=float("inf"))}, "medium's gravity"),
    ],
)
def test_a_body_of_constants_that_cannot_be_is_refused(tmp_path, change, name):
    refused(replace(sample_body(), **change), Body, tmp_path / "b.npz", name)


def test_a_body_of_the_old_format_says_how_to_make_it_anew(tmp_path):
    body = sample_body()
    path = tmp_path / "old.npz"
    files.save_archive(path, "body", FORMAT_VERSION - 1, body._arrays(), body._meta())
    with pytest.raises(DefplanError, match="body format 1, this version reads 2: build it again"):
        Body.load(path)


def test_a_body_without_a_field_or_with_another_is_refused(tmp_path):
    body = sample_body()
    for arrays in (
        {k: v for k, v in body._arrays().items() if k != "drag_areas"},
        {**body._arrays(), "patch_areas": np.ones(4)},
    ):
        files.save_archive(tmp_path / "b.npz", "body", FORMAT_VERSION, arrays, body._meta())
        with pytest.raises(DefplanError, match="has not the fields of a body"):
            Body.load(tmp_path / "b.npz")


def test_an_array_that_claims_more_than_its_bytes_takes_no_memory(tmp_path):
    path = tmp_path / "b.npz"
    sample_body().save(path)
    with zipfile.ZipFile(path) as archive:
        contents = {name: archive.read(name) for name in archive.namelist()}
    stream = io.BytesIO()
    np.lib.format.write_array_header_1_0(
        stream, {"descr": "<f8", "fortran_order": False, "shape": (1 << 40,)}
    )
    contents["drag_areas.npy"] = stream.getvalue()
    with zipfile.ZipFile(path, "w") as archive:
        for name, data in contents.items():
            archive.writestr(name, data)
    with pytest.raises(DefplanError, match="not a whole body file"):
        Body.load(path)


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("body_hash", lambda g: "none"),
        ("task_names", lambda g: ()),
        ("task_names", lambda g: ("left", "left", "right")),
        ("timestep", lambda g: 0.0),
        ("timestep", lambda g: float("nan")),
        ("steps_per_cycle", lambda g: 0),
        ("steps_per_cycle", lambda g: 10**9),
        ("steps_per_cycle", lambda g: 10.5),
        ("alpha", lambda g: g.alpha[:2]),
        ("alpha", lambda g: with_value(g.alpha, np.nan)),
        ("beta", lambda g: g.beta[:, :-1]),
        ("beta", lambda g: with_value(g.beta, np.inf)),
        ("mu", lambda g: g.mu[0]),
        ("mu", lambda g: with_value(g.mu, np.nan)),
        ("amplitude", lambda g: g.amplitude[:1]),
        ("amplitude", lambda g: with_value(g.amplitude, -1.0)),
        ("amplitude", lambda g: g.amplitude.astype(int)),
    ],
)
def test_a_gait_with_a_field_that_cannot_be_is_refused(tmp_path, name, change):
    gait = sample_gait(sample_body())
    broken = replace(gait, **{name: change(gait)})
    refused(broken, Gait, tmp_path / "g.npz", f"its {name}")


@pytest.mark.parametrize(
    ("terrain", "says"),
    [
        (Terrain(friction=float("nan")), "friction"),
        (Terrain(slip_speed=float("inf")), "slip_speed"),
        (Terrain(thickness=-1.0), "thickness"),
        (Terrain(stiffness=float("nan")), "stiffness"),
        (Terrain(geoms=()), "neither geoms nor a heightfield"),
        (Terrain(geoms=(TerrainGeom("plane"),) * 10_001), "10001 geoms"),
        (Terrain((TerrainGeom("sphere", (float("inf"),)),)), "size"),
        (Terrain((TerrainGeom("sphere", (1.0,), (0.0, 0.0, float("nan"))),)), "position"),
        (Terrain((TerrainGeom("sphere", (1.0,), (0.0, 0.0)),)), "position"),  # type: ignore[arg-type]
        (Terrain((TerrainGeom("plane", (), quaternion=(float("nan"),) * 4),)), "quaternion"),
        (Terrain(heightfield=Heightfield(np.zeros((1, 4)), (1.0, 1.0))), "2 x 2"),
        (Terrain(heightfield=Heightfield(np.full((4, 4), np.nan), (1.0, 1.0))), "heights"),
        (Terrain(heightfield=Heightfield(np.zeros((4, 4)), (1.0, np.inf))), "half_size"),
        (Terrain(heightfield=Heightfield(np.zeros((4, 4)), (1.0,))), "half_size"),  # type: ignore[arg-type]
        (
            Terrain(heightfield=Heightfield(np.zeros((4, 4)), (1.0, 1.0), (0, 0, np.inf))),
            "position",
        ),
        (Terrain(heightfield=Heightfield(np.zeros((4000, 4000)), (1.0, 1.0))), "16000000 heights"),
    ],
)
def test_a_terrain_that_cannot_be_is_refused(terrain, says):
    with pytest.raises(DefplanError, match=says) as caught:
        pack_terrain(terrain, sample_body())
    assert "\n" not in str(caught.value)


def test_a_header_that_is_json_but_no_header_is_refused(tmp_path):
    header = np.frombuffer(json.dumps([1, 2]).encode(), np.uint8)
    np.savez(tmp_path / "b.npz", **{"header.json": header})  # type: ignore[arg-type]
    with pytest.raises(DefplanError, match="not a whole body file"):
        Body.load(tmp_path / "b.npz")
