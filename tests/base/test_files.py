"""Files are whole or absent: atomic writes, damaged archives, full disks, Ctrl-C."""

from __future__ import annotations

import dataclasses
import errno
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from defplan_mj.base import files
from defplan_mj.base.errors import DefplanError

ARRAYS = {"a": np.arange(2000.0).reshape(20, 100), "b": np.array([1, 2, 3])}
META = {"name": "fish", "seconds": 1.5}


@pytest.fixture
def archive(tmp_path):
    """Return the path of a small archive."""
    path = tmp_path / "thing.npz"
    files.save_archive(path, "thing", 1, ARRAYS, META)
    return path


def test_the_same_content_gives_the_same_bytes(tmp_path):
    paths = [tmp_path / "one.npz", tmp_path / "two.npz"]
    for path in paths:
        files.save_archive(path, "thing", 1, ARRAYS, META)
    assert paths[0].read_bytes() == paths[1].read_bytes()


def test_an_archive_cut_at_any_byte_is_refused(archive):
    data = archive.read_bytes()
    for size in [*range(0, len(data), 97), len(data) - 1]:
        archive.write_bytes(data[:size])
        with pytest.raises(DefplanError, match="is not a whole thing file|does not match its hash"):
            files.load_archive(archive, "thing", 1)


def test_another_kind_or_version_is_named(archive):
    with pytest.raises(DefplanError, match="is a thing file, not a body file"):
        files.load_archive(archive, "body", 1)
    with pytest.raises(
        DefplanError, match="has thing format 1, this version reads 2: make it anew"
    ):
        files.load_archive(archive, "thing", 2)


def test_a_file_that_is_missing_or_no_archive_is_named(tmp_path):
    with pytest.raises(DefplanError, match="body file .*none.npz does not exist"):
        files.load_archive(tmp_path / "none.npz", "body", 1)
    other = tmp_path / "other.npz"
    np.savez(other, a=np.zeros(3))
    with pytest.raises(DefplanError, match="is not a whole body file"):
        files.load_archive(other, "body", 1)
    text = tmp_path / "text.npz"
    text.write_text("not an archive")
    with pytest.raises(DefplanError, match="is not a whole body file"):
        files.load_archive(text, "body", 1)


@pytest.mark.parametrize("error", [RuntimeError("odd"), KeyboardInterrupt()])
def test_an_interrupted_write_leaves_the_old_file_and_nothing_else(tmp_path, error):
    path = tmp_path / "a.txt"
    files.write_text(path, "old")
    with pytest.raises(type(error)), files.atomic_path(path) as temporary:
        temporary.write_text("half of the ne")
        raise error
    assert path.read_text() == "old"
    assert os.listdir(tmp_path) == ["a.txt"]


def test_a_full_disk_is_one_sentence_and_leaves_the_old_file(archive, monkeypatch):
    before = archive.read_bytes()

    def full(*_args, **_kwargs):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(np, "savez_compressed", full)
    with pytest.raises(DefplanError, match=r"cannot write .*thing.npz: No space left on device"):
        files.save_archive(archive, "thing", 1, {"a": np.zeros(3)}, {})
    assert archive.read_bytes() == before
    assert os.listdir(archive.parent) == [archive.name]


def test_a_folder_that_cannot_be_made_is_one_sentence(tmp_path):
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(DefplanError, match="cannot write"):
        files.write_text(tmp_path / "file" / "a.txt", "text")


def test_a_process_killed_while_writing_leaves_the_old_file(tmp_path):
    path = tmp_path / "a.txt"
    files.write_text(path, "old")
    code = (
        "import sys, time; from defplan_mj.base import files\n"
        "with files.atomic_path(sys.argv[1]) as temporary:\n"
        "    temporary.write_text('half'); print('writing', flush=True); time.sleep(60)"
    )
    writer = subprocess.Popen([sys.executable, "-c", code, str(path)], stdout=subprocess.PIPE)
    assert writer.stdout is not None
    assert writer.stdout.readline() == b"writing\n"
    time.sleep(0.05)
    writer.send_signal(signal.SIGKILL)
    writer.wait(10)
    writer.stdout.close()
    assert path.read_text() == "old"


def test_what_json_does_not_know_becomes_plain_data_or_is_refused():
    @dataclasses.dataclass
    class Pair:
        a: int
        b: float

    data = {"n": np.int64(3), "v": np.arange(2.0), "p": Path("a") / "b", "d": Pair(1, 0.5)}
    plain = json.loads(json.dumps(data, default=files.plain))
    assert plain == {"n": 3, "v": [0.0, 1.0], "p": "a/b", "d": {"a": 1, "b": 0.5}}
    with pytest.raises(TypeError, match="cannot write a object as JSON"):
        json.dumps(object(), default=files.plain)


ANY_ARRAY = hnp.arrays(
    st.sampled_from([np.float64, np.float32, np.int64, np.uint8, np.bool_]),
    hnp.array_shapes(min_dims=0, max_dims=3, min_side=0, max_side=5),
)
ANY_META = st.dictionaries(st.text(max_size=8), st.integers(-(2**31), 2**31) | st.text(max_size=8))


@settings(deadline=None)
@given(st.dictionaries(st.sampled_from(["a", "b", "c"]), ANY_ARRAY), ANY_META)
def test_any_arrays_come_back_to_the_bit(tmp_path_factory, arrays, meta):
    path = tmp_path_factory.mktemp("any") / "x.npz"
    digest = files.save_archive(path, "thing", 1, arrays, meta)
    again, meta_again, hash_again = files.load_archive(path, "thing", 1)
    assert (meta_again, hash_again, set(again)) == (meta, digest, set(arrays))
    assert digest == files.content_hash(arrays, meta)
    for name, array in arrays.items():
        assert again[name].dtype == array.dtype and again[name].shape == array.shape
        assert again[name].tobytes() == array.tobytes()


@settings(deadline=None, max_examples=200)
@given(place=st.floats(0, 1), mask=st.integers(1, 255), cut=st.booleans())
def test_a_damaged_archive_is_one_sentence_or_whole(tmp_path_factory, place, mask, cut):
    path = tmp_path_factory.mktemp("damaged") / "x.npz"
    files.save_archive(path, "thing", 1, ARRAYS, META)
    data = bytearray(path.read_bytes())
    at = min(int(place * len(data)), len(data) - 1)
    if cut:
        del data[at:]
    else:
        data[at] ^= mask
    path.write_bytes(data)
    try:
        arrays, meta, _ = files.load_archive(path, "thing", 1)
    except DefplanError as error:
        assert str(path) in str(error) and "\n" not in str(error)
        return
    assert meta == META and all(np.array_equal(arrays[n], ARRAYS[n]) for n in ARRAYS)


class _Trap:
    def __reduce__(self):
        return os.mkdir, ("unpickled",)


def test_an_archive_with_an_object_in_it_is_refused_and_not_unpickled(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    np.savez("x.npz", a=np.array([_Trap()], object))
    with pytest.raises(DefplanError, match="not a whole thing file"):
        files.load_archive("x.npz", "thing", 1)
    assert not os.path.exists("unpickled")


def test_wall_times_have_no_part_in_a_content_hash(tmp_path):
    arrays = {"a": np.arange(3.0)}
    slow = {"seconds": 9.0, "stages": [{"name": "x", "seconds": 4.0}], "cycle_seconds": 0.4}
    fast = {"seconds": 1.0, "stages": [{"name": "x", "seconds": 2.0}], "cycle_seconds": 0.4}
    assert files.content_hash(arrays, slow) == files.content_hash(arrays, fast)
    assert files.content_hash(arrays, slow) != files.content_hash(
        arrays, {**slow, "cycle_seconds": 1.0}
    )
    digest = files.save_archive(tmp_path / "a.npz", "gait", 1, arrays, slow)
    assert files.load_archive(tmp_path / "a.npz", "gait", 1)[1:] == (slow, digest)
