"""`defplan body`: what it writes and prints, and one sentence for each mesh that cannot be used."""

from __future__ import annotations

import json

import numpy as np
import pytest
import trimesh

from defplan_mj import cli
from defplan_mj.body.model import Body

SMALL = ["--vertices", "300", "--modes", "3", "--quiet"]


def sphere() -> trimesh.Trimesh:
    """Return a closed ellipsoid."""
    mesh = trimesh.creation.icosphere(subdivisions=2)
    mesh.apply_scale([0.5, 0.2, 0.3])
    return mesh


def run(argv: list[str], capfd) -> tuple[int, str, str]:
    """Run the command line; return exit code, stdout, stderr."""
    code = cli.main(argv)
    captured = capfd.readouterr()
    return code, captured.out, captured.err


def test_the_body_is_as_the_options_say(tmp_path, capfd):
    mesh, output = tmp_path / "egg.ply", tmp_path / "egg.npz"
    sphere().export(mesh)
    options = "--length 2 --density 900 --youngs-modulus 2e5 --poissons-ratio 0.3 --medium air"
    argv = ["body", str(mesh), "-o", str(output), *SMALL, *options.split(), "--json"]
    code, out, _ = run(argv, capfd)
    data = json.loads(out)
    body = Body.load(output)
    assert code == 0
    assert abs(len(body.vertices) - 300) <= 2
    assert body.n_modes == 3
    assert body.length == pytest.approx(2.0, rel=0.03)
    assert (body.material.density, body.material.youngs_modulus) == (900.0, 2e5)
    assert body.material.poissons_ratio == 0.3
    assert body.medium.name == "air" and body.medium.gravity < 0
    assert data["hash"] == body.hash
    assert data["vertices"] == len(body.vertices)
    assert 0 < data["quality"]["min"] <= data["quality"]["mean"] <= 1


def open_mesh(path):
    mesh = sphere()
    mesh.update_faces(np.arange(len(mesh.faces)) > 3)
    mesh.export(path)


def inside_out(path):
    mesh = sphere()
    mesh.invert()
    mesh.export(path)


def in_pieces(path):
    other = sphere()
    other.apply_translation([3, 0, 0])
    trimesh.util.concatenate([sphere(), other]).export(path)


def self_intersecting(path):
    mesh = sphere()
    mesh.vertices[mesh.vertices[:, 2].argmax()] = [0.07, 0.03, -0.6]  # through the other side
    mesh.export(path)


def empty(path):
    path.write_bytes(b"")


def without_faces(path):
    path.write_text("solid empty\nendsolid empty\n")


def with_nan(path):
    mesh = sphere()
    mesh.vertices[5] = np.nan
    mesh.export(path)


def of_zero_size(path):
    mesh = sphere()
    mesh.vertices[:] = 1.0
    mesh.export(path)


def flat(path):
    mesh = sphere()
    mesh.vertices[:, 2] = 0.0
    mesh.export(path)


def cut_short(path):
    sphere().export(path)
    path.write_bytes(path.read_bytes()[:2000])


def no_mesh(path):
    path.write_text("this is a letter to a friend\n")


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (in_pieces, "pieces|parts"),
        (empty, "empty"),
        (without_faces, "empty"),
        (with_nan, "finite"),
        (of_zero_size, "volume|size"),
        (flat, "flat|volume"),
        (cut_short, "cut short"),
        (no_mesh, "read|empty"),
    ],
)
def test_a_bad_mesh_is_one_sentence_that_names_the_file(make, says, tmp_path, capfd):
    mesh, output = tmp_path / "bad.stl", tmp_path / "bad.npz"
    make(mesh)
    code, out, err = run(["body", str(mesh), "-o", str(output), *SMALL], capfd)
    assert code == 1
    assert out == ""
    assert err.startswith("defplan body: ") and err.count("\n") == 1
    assert "bad.stl" in err and "mistake in defplan" not in err
    assert any(word in err for word in says.split("|")), err
    assert not output.exists()


@pytest.mark.parametrize(
    ("make", "says"),
    [(open_mesh, "open"), (inside_out, "inside out"), (self_intersecting, "intersects itself")],
)
def test_strict_refuses_what_would_be_mended(make, says, tmp_path, capfd):
    make(tmp_path / "bad.stl")
    argv = ["body", str(tmp_path / "bad.stl"), "-o", str(tmp_path / "bad.npz"), "--strict", *SMALL]
    code, _, err = run(argv, capfd)
    assert code == 1 and says in err and "--strict" in err and err.count("\n") == 1
    assert not (tmp_path / "bad.npz").exists()


def test_a_missing_mesh_and_an_unknown_kind_are_named(tmp_path, capfd):
    code, _, err = run(["body", str(tmp_path / "none.stl"), *SMALL], capfd)
    assert code == 1 and "none.stl does not exist" in err
    code, _, err = run(["body", "fish-swm", *SMALL], capfd)
    assert code == 1 and "did you mean fish-swim?" in err
    (tmp_path / "a.docx").write_text("x")
    code, _, err = run(["body", str(tmp_path / "a.docx"), *SMALL], capfd)
    assert code == 1 and ".stl" in err and err.count("\n") == 1


def test_a_folder_that_cannot_be_written_is_one_sentence(tmp_path, capfd):
    sphere().export(tmp_path / "egg.stl")
    (tmp_path / "file").write_text("in the way")
    output = tmp_path / "file" / "egg.npz"
    code, _, err = run(["body", str(tmp_path / "egg.stl"), "-o", str(output), *SMALL], capfd)
    assert code == 1 and "cannot write" in err and err.count("\n") == 1
