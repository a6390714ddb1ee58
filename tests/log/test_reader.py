"""A log that is cut or damaged anywhere gives what is there and says so, or one clear sentence."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.opcode import Opcode

from defplan_mj.base.errors import DefplanError
from defplan_mj.log.reader import read_log
from defplan_mj.log.run_files import RunFiles
from tests.samples.logs import record_episode, sample_body, sample_gait, sample_surrogate


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    path = tmp_path_factory.mktemp("log") / "whole.mcap"
    kept = record_episode(path, cycles=12)
    return path.read_bytes(), kept


def boundaries(data: bytes) -> list[int]:
    """Return where each record of the file starts, and the file's end."""
    places = [8]
    while places[-1] + 9 <= len(data) - 8:
        length = struct.unpack_from("<Q", data, places[-1] + 1)[0]
        places.append(places[-1] + 9 + length)
    return [0, *places, len(data)]


def is_start_of(log, kept) -> bool:
    """Whether a log holds the first steps and cycles of what was recorded, and nothing else."""
    n, m = len(log.target_shapes), len(log.gait_index)
    return (
        np.array_equal(log.states, kept["states"][: n + 1])
        and np.array_equal(log.target_shapes, kept["target_shapes"][:n])
        and np.array_equal(log.clearance, kept["clearance"][:n])
        and np.array_equal(log.gait_index, kept["gait_index"][:m])
        and np.array_equal(log.laser.ravel(), kept["laser"][:m].ravel())
    )


def test_a_log_cut_anywhere_gives_its_start_or_one_sentence(whole, tmp_path):
    data, kept = whole
    places = {round(len(data) * i / 100) for i in range(100)}
    places |= {b + d for b in boundaries(data) for d in (-1, 0, 9)}
    path = tmp_path / "cut.mcap"
    read = 0
    for place in sorted(p for p in places if 0 <= p < len(data)):
        path.write_bytes(data[:place])
        try:
            log = read_log(path)
        except DefplanError as error:
            assert str(path) in str(error) and str(error).count("\n") == 0
            continue
        read += 1
        assert not log.whole and f"cut at byte {place}" == log.fault
        assert is_start_of(log, kept)
    assert read > 40


@settings(deadline=None, max_examples=60)
@given(data=st.data())
def test_any_part_of_a_log_followed_by_anything_gives_its_start_or_one_sentence(
    whole, tmp_path_factory, data
):
    content, kept = whole
    place = data.draw(st.integers(0, len(content)))
    tail = data.draw(st.binary(min_size=1, max_size=40))
    path = tmp_path_factory.mktemp("cut") / "cut.mcap"
    path.write_bytes(content[:place] + tail)
    try:
        log = read_log(path)
    except DefplanError as error:
        assert str(path) in str(error) and str(error).count("\n") == 0
        return
    assert is_start_of(log, kept)


def test_a_later_cut_never_gives_less(whole, tmp_path):
    data, kept = whole
    path = tmp_path / "cut.mcap"
    steps = []
    for place in boundaries(data)[:-1]:
        path.write_bytes(data[:place])
        try:
            steps.append(len(read_log(path).target_shapes))
        except DefplanError:
            steps.append(-1)
    assert steps == sorted(steps) and steps[-1] == len(kept["clearance"])


def test_a_flipped_bit_in_the_data_is_found(whole, tmp_path):
    data, kept = whole
    data_end = next(b for b in boundaries(data)[1:] if data[b] == Opcode.DATA_END)
    path = tmp_path / "damaged.mcap"
    rng = np.random.default_rng(0)
    for place in rng.integers(8, data_end, 150):
        damaged = bytearray(data)
        damaged[place] ^= 1 << rng.integers(8)
        path.write_bytes(damaged)
        try:
            assert read_log(path).fault.startswith(("damaged", "cut"))
        except DefplanError as error:
            assert str(path) in str(error)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"solid fish", "is not an MCAP log"),
        (b"", r"holds no step of its episode \(cut at byte 0\)"),
        (b"\x89MCAP0\r\n", r"holds no step of its episode \(cut at byte 8\)"),
    ],
)
def test_what_is_no_log_is_one_sentence(tmp_path, content, message):
    (tmp_path / "x.mcap").write_bytes(content)
    with pytest.raises(DefplanError, match=message):
        read_log(tmp_path / "x.mcap")


def test_a_missing_log_is_one_sentence(tmp_path):
    with pytest.raises(DefplanError, match="does not exist"):
        read_log(tmp_path / "none.mcap")
    with pytest.raises(DefplanError, match="cannot read log"):
        read_log(tmp_path)


def test_anothers_mcap_file_is_refused(tmp_path):
    from mcap.writer import Writer

    with open(tmp_path / "other.mcap", "wb") as stream:
        writer = Writer(stream)
        writer.start()
        writer.finish()
    with pytest.raises(DefplanError, match="not a log of this program"):
        read_log(tmp_path / "other.mcap")


def test_a_log_without_gait_says_so(tmp_path, whole):
    body = sample_body()
    files = RunFiles(body, sample_gait(body), sample_surrogate(body))
    record_episode(tmp_path / "bare.mcap", files=files)
    with pytest.raises(DefplanError, match=r"holds no gait\.npz"):
        _ = read_log(tmp_path / "bare.mcap").gait
