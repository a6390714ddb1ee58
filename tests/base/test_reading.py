"""What others may have written is read within bounds, or refused with the reason."""

from __future__ import annotations

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from defplan_mj.base import files, reading
from defplan_mj.base.errors import DefplanError
from tests.samples import hostile

ANY_JSON = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-(2**63), 2**63)
    | st.floats(allow_nan=False)
    | st.text(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(), inner, max_size=4),
    max_leaves=30,
)


@given(ANY_JSON)
def test_any_json_comes_back(value):
    assert reading.parse_json(json.dumps(value)) == value
    assert reading.parse_json(json.dumps(value).encode()) == value


@pytest.mark.parametrize(
    ("text", "why"),
    [
        (hostile.nested(100_000), "nested too deeply"),
        (hostile.nested(65), "nested more than 64 deep"),
        (b'{"a":' * 70 + b"1" + b"}" * 70, "nested more than 64 deep"),
        (b"[" + b"[]," * 300_000 + b"[]]", "too many values"),
        (b"[" + b"1," * 2_100_000 + b"1]", "too many values"),
        (b"[" + b"9" * 5000 + b"]", "whole number of 5000 digits"),
        (b"\xff", "utf-8"),
        (b"{", "Expecting"),
    ],
)
def test_json_that_is_too_much_is_refused(text, why):
    with pytest.raises(ValueError, match=why):
        reading.parse_json(text)


def test_json_is_nested_64_deep_at_most():
    assert reading.parse_json(hostile.nested(64)) is not None


def test_long_fractions_are_no_long_whole_numbers():
    assert reading.parse_json(b"[0.12345678901234567890123, -12]") == [0.12345678901234568, -12]


def test_a_document_is_an_object(tmp_path):
    path = tmp_path / "a.json"
    path.write_text("[1]")
    with pytest.raises(DefplanError, match=r"run .*a\.json holds no object"):
        reading.read_json(path, "run")
    path.write_text('{"a": 1}')
    assert reading.read_json(path, "run") == {"a": 1}
    with pytest.raises(DefplanError, match="is too large: 8 bytes, at most 4 are read"):
        reading.read_bytes(path, "run", 4)
    with pytest.raises(DefplanError, match="it is a folder"):
        reading.read_bytes(tmp_path, "run", 4)


QUICK = ("claims", "lzma", "nested", "10^")


@pytest.mark.parametrize("name", [n for n in hostile.archive_bombs() if any(q in n for q in QUICK)])
def test_archives_that_ask_for_too_much_are_refused_with_the_reason(tmp_path, name):
    path = tmp_path / "gait.npz"
    path.write_bytes(hostile.archive_bombs()[name]())
    from defplan_mj.gait.gait import Gait

    with pytest.raises(DefplanError, match=r"gait\.npz is (not a whole|no) gait"):
        Gait.load(path)


def test_an_archive_in_memory_is_read_as_one_on_disk(tmp_path):
    path = tmp_path / "a.npz"
    arrays: dict = {
        "a": np.arange(5.0),
        "b": np.zeros((2, 0)),
        "c": np.array("x"),
        "d": np.float64(3),
    }
    files.save_archive(path, "thing", 1, arrays, {"k": [1]})
    on_disk = files.load_archive(path, "thing", 1)
    packed = files.load_archive(reading.Packed("a of b", path.read_bytes()), "thing", 1)
    assert on_disk[1:] == packed[1:]
    assert all(np.array_equal(on_disk[0][n], packed[0][n]) for n in arrays)
    with pytest.raises(DefplanError, match="a of b is not a whole thing file"):
        files.load_archive(reading.Packed("a of b", b"PK"), "thing", 1)


SENSELESS = st.one_of(
    st.none(), st.booleans(), st.integers(-(2**80), 2**80), st.floats(), st.text(), st.just([]),
    st.lists(st.integers(), max_size=3), st.just({}),
)  # fmt: skip
SHAPES = st.lists(st.integers(0, 3), max_size=4).map(tuple)


@given(
    field=st.sampled_from(
        ["body_hash", "task_names", "timestep", "steps_per_cycle", "substeps", "integrator"]
    ),
    value=SENSELESS,
)
def test_a_gait_of_any_meta_is_whole_or_one_sentence(tmp_path_factory, field, value):
    _load(tmp_path_factory, hostile.gait_archive(**{field: value}))


@given(
    field=st.sampled_from(["alpha", "beta", "mu", "amplitude", "surprise"]),
    shape=SHAPES,
    number=st.sampled_from([0.0, -1.0, 1e308, float("nan"), float("inf")]),
    kind=st.sampled_from([np.float64, np.float32, np.int64, np.bool_, np.complex128, "U3"]),
)
@pytest.mark.filterwarnings("ignore")
def test_a_gait_of_any_arrays_is_whole_or_one_sentence(
    tmp_path_factory, field, shape, number, kind
):
    if kind is np.int64 and not np.isfinite(number):
        number = 7.0
    _load(tmp_path_factory, hostile.gait_archive(**{field: np.full(shape, number).astype(kind)}))


def _load(tmp_path_factory, data: bytes) -> None:
    from defplan_mj.gait.gait import Gait

    path = tmp_path_factory.mktemp("gait") / "gait.npz"
    path.write_bytes(data)
    try:
        gait = Gait.load(path)
    except DefplanError as error:
        assert str(path) in str(error) and "\n" not in str(error)
        return
    assert np.isfinite(gait.table()).all()
