"""Mesh files that mean harm: one sentence with the file, within memory and time, whatever is in them."""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from defplan_mj.base.bounded import TooLong, bounded
from defplan_mj.base.errors import DefplanError
from tests.samples.hostile_meshes import BY_MESHIO, BY_TRIMESH, bombs, whole
from tests.samples.meshes import load_mesh
from tests.samples.paths import ROOT

MOST_MEMORY = 1 << 30
MOST_SECONDS, LARGE_SECONDS = 10.0, 60.0
"""Of CPU time, for a small file and for one of 45 MB: bounds of the work, no speeds."""
QUICK = (
    "ply, binary_little_endian, of 1000000000.ply",
    "mesh of 1000000000.mesh",
    "vtk STRUCTURED_POINTS of 1000000000 1 1.vtk",
    "vtk, BINARY, of 4294967295.vtk",
    "msh 2.2 of 1000000000.msh",
    "msh 4.1 of 4294967295.msh",
    "xml of 1000000000.xml",
    "gltf of 1000000000.gltf",
    "stl of 1000000000.stl",
    "off of 1000000000.off",
    "obj naming 1000000000.obj",
    "3mf of 10^11 parts.3mf",
    "3mf in a circle.3mf",
    "gltf in a circle.gltf",
)


def check(*names: str) -> None:
    """Read bombs in a process of their own; each has to be a sentence, in time and memory."""
    done = subprocess.run(
        [sys.executable, "-m", "tests.samples.hostile_meshes", *names],
        cwd=ROOT,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    found = [json.loads(line) for line in done.stdout.splitlines()]
    assert [bomb["name"] for bomb in found] == list(names)
    for bomb in found:
        assert bomb["size"] < 50e6 and bomb["peak"] < MOST_MEMORY, bomb
        assert bomb["seconds"] < (LARGE_SECONDS if bomb["size"] > 1e6 else MOST_SECONDS), bomb
        assert "bomb." in bomb["said"] and "\n" not in bomb["said"], bomb
        assert len(bomb["said"]) < 500, bomb


def test_bombs_are_a_sentence_within_memory_and_time():
    check(*QUICK)


@pytest.mark.slow
def test_all_bombs_are_a_sentence_within_memory_and_time():
    check(*bombs())


@st.composite
def damaged(draw) -> tuple[str, bytes]:
    """Return the ending of a mesh file's name and its bytes: cut, changed, or parts doubled."""
    suffix, data = whole(draw(st.sampled_from([*BY_TRIMESH, *BY_MESHIO])))
    content = bytearray(data)
    place = st.integers(0, len(content) - 1)
    kind = draw(st.sampled_from(["cut", "flip", "number", "drop", "double", "word"]))
    at = draw(place)
    if kind == "cut":
        del content[at:]
    elif kind == "flip":
        for spot in draw(st.lists(place, min_size=1, max_size=8)):
            content[spot] ^= draw(st.integers(1, 255))
    elif kind == "number":  # of text
        digits = [i for i, byte in enumerate(content) if chr(byte).isdigit()] or [at]
        spot = digits[at % len(digits)]
        told = draw(
            st.sampled_from(["-1", "0", "nan", "1e400", "999999999", str(2**31), str(2**63), ""])
        )
        content[spot : spot + 1] = told.encode()
    elif kind == "drop":
        del content[at : at + draw(st.integers(1, 64))]
    elif kind == "double":
        content[at:at] = content[at : at + draw(st.integers(1, 64))]
    else:  # of a binary file
        content[at : at + 4] = draw(st.sampled_from([b"\xff" * 4, bytes(4), b"\0\0\0\x80"]))
    return suffix, bytes(content)


def read(suffix: str, data: bytes) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"bad.{suffix}"
        path.write_bytes(data)
        try:
            load_mesh(path)
        except DefplanError as error:
            assert str(path) in str(error) and "\n" not in str(error) and len(str(error)) < 600
            assert str(error).isprintable()


@settings(
    max_examples=120, deadline=None, suppress_health_check=list(HealthCheck), derandomize=True
)
@given(damaged())
@example(("stl", b"solid"))
def test_a_damaged_mesh_is_read_or_a_sentence(made):
    read(*made)


@pytest.mark.slow
@settings(max_examples=3000, deadline=None, suppress_health_check=list(HealthCheck))
@given(damaged())
def test_many_damaged_meshes_are_read_or_a_sentence(made):
    read(*made)


def test_work_beyond_its_bounds_ends_though_its_errors_are_dropped():
    with pytest.raises(MemoryError), bounded(64 << 20, 60.0):
        bytearray(1 << 30)  # a long process may give back some hundred megabytes meanwhile
    bytearray(128 << 20)
    with pytest.raises(TooLong), bounded(1 << 30, 0.2):
        while True:
            try:
                while True:
                    pass
            except BaseException as error:
                dropped = error
                del dropped
                break
        while True:
            pass
