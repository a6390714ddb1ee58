"""A comparison finds exactly the error that was put into a log, and nothing in a perfect one."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from defplan_mj.base import rotations
from defplan_mj.base.errors import DefplanError
from defplan_mj.log.compare import DRIFT_COLUMNS, compare_logs
from defplan_mj.log.reader import read_log
from defplan_mj.log.run_files import RunFiles
from tests.samples.logs import (
    record_episode,
    sample_body,
    sample_gait,
    sample_surrogate,
    spatial_parts,
    spatial_scene,
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("logs")
    record_episode(folder / "perfect.mcap")
    record_episode(folder / "left.mcap", error=(0.03, 0.02))
    record_episode(folder / "right.mcap", error=(-0.05, -0.04))
    return folder


def test_a_truth_that_follows_the_surrogate_has_no_error(folder):
    comparison = compare_logs([folder / "perfect.mcap"])
    assert comparison.position.max() < 1e-12
    assert np.abs(comparison.turning).max() < 1e-12
    episode = comparison.episodes[0]
    assert episode.drift < 1e-12 and abs(episode.turning_drift) < 1e-12


def test_a_known_error_is_found_exactly(folder):
    comparison = compare_logs([folder / "left.mcap"])
    np.testing.assert_allclose(comparison.position, 0.03, atol=1e-12)
    np.testing.assert_allclose(comparison.turning, 0.02, atol=1e-12)
    left = comparison.truth - comparison.predicted
    # the error is to the left of the predicted heading, at the end of the cycle
    bend = np.array([0.0, 0.6, -0.6])[comparison.gait]
    np.testing.assert_allclose(left[:, 0], -0.03 * np.sin(bend), atol=1e-12)
    np.testing.assert_allclose(left[:, 1], 0.03 * np.cos(bend), atol=1e-12)
    assert comparison.episodes[0].turning_drift == pytest.approx(8 * 0.02)
    for row in comparison.summaries():
        assert row["position"]["sd"] == pytest.approx(0, abs=1e-12)
        assert row["spread"] == pytest.approx(0, abs=1e-9)  # every cycle errs alike


def test_figures_over_two_logs_are_those_of_their_cycles(folder):
    comparison = compare_logs([folder / "left.mcap", folder / "right.mcap"])
    row = comparison.summaries()[-2]
    assert row["name"] == "all"
    errors = np.repeat([0.03, 0.05], 8)
    assert row["cycles"] == 16
    assert row["position"]["mean"] == pytest.approx(errors.mean())
    assert row["position"]["sd"] == pytest.approx(errors.std(ddof=1))
    assert row["position"]["p95"] == pytest.approx(0.05)
    assert row["heading"]["mean"] == pytest.approx((0.02 - 0.04) / 2)
    assert row["heading"]["p95"] == pytest.approx(0.04)
    # half of the cycles end 4 cm left of their mean, half 4 cm right of it
    assert row["spread"] == pytest.approx(0.04)


@pytest.fixture(scope="module")
def tumbling(tmp_path_factory):
    """A spatial log whose truth ends 3 cm beside the prediction and 0.04 rad from it."""
    path = tmp_path_factory.mktemp("spatial") / "tumbling.mcap"
    body = sample_body()
    files = RunFiles.of(body, *spatial_parts(body))
    record_episode(path, cycles=20, error=(0.03, 0.04), scene=spatial_scene(), files=files)
    return path


def test_a_known_error_in_space_is_found_as_an_angle_whatever_the_attitude(tumbling):
    log = read_log(tumbling)
    up = rotations.matrix(log.states[log.cycle_steps][:, 3:7])[:, 2, 2]
    assert np.ptp(up) > 1  # it did tumble
    comparison = compare_logs([tumbling])
    assert comparison.turning_name == "rotation"
    np.testing.assert_allclose(comparison.position, 0.03, atol=1e-12)
    np.testing.assert_allclose(comparison.turning, 0.04, atol=1e-12)
    row = comparison.summaries()[-2]
    assert row["rotation"]["mean"] == pytest.approx(0.04) and "heading" not in row
    assert comparison.columns[5] == "rotation mean (rad)"
    assert all(len(cells) == len(comparison.columns) for cells in comparison.table())
    # displacements are those of the gaits, in the body frame at the cycle's start
    _, surrogate = spatial_parts(log.body)
    moves = surrogate.translations[log.gait_index]
    np.testing.assert_allclose(comparison.predicted, moves, atol=1e-12)


def test_a_chain_of_predictions_in_space_drifts_as_its_errors_add_up(tumbling):
    log = read_log(tumbling)
    _, surrogate = spatial_parts(log.body)
    place, frame = log.states[0, :3], Rotation.from_quat(log.states[0, 3:7], scalar_first=True)
    for gait in log.gait_index:  # SciPy's rotations: an independent chain
        place = place + frame.apply(surrogate.translations[gait])
        frame = frame * Rotation.from_matrix(surrogate.rotations[gait])
    end = log.states[-1]
    episode = compare_logs([tumbling]).episodes[0]
    assert episode.drift == pytest.approx(np.linalg.norm(end[:3] - place))
    apart = frame.inv() * Rotation.from_quat(end[3:7], scalar_first=True)
    assert episode.turning_drift == pytest.approx(apart.magnitude())


def test_planar_and_spatial_logs_are_not_mixed(folder, tumbling):
    with pytest.raises(DefplanError, match="is of a planar task"):
        compare_logs([folder / "left.mcap", tumbling])


def test_a_spatial_comparison_is_drawn(tumbling, tmp_path):
    compare_logs([tumbling]).plot(tmp_path / "a.png")
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")


def test_first_cycles_are_told_apart(folder):
    comparison = compare_logs([folder / "left.mcap", folder / "right.mcap"])
    np.testing.assert_array_equal(comparison.cycle, [*range(8), *range(8)])
    row = comparison.summaries()[-1]
    assert (row["name"], row["cycles"]) == ("all but each first 3", 10)


def test_heading_errors_wrap_around(folder, tmp_path):
    record_episode(tmp_path / "turned.mcap", error=(0.0, 3.0))
    comparison = compare_logs([tmp_path / "turned.mcap"])
    np.testing.assert_allclose(comparison.turning, 3.0, atol=1e-9)


def test_predictions_that_were_not_logged_are_made_from_the_attachment(folder):
    log = read_log(folder / "left.mcap")
    bare = replace(log, surrogate_pose=np.full_like(log.surrogate_pose, np.nan))
    np.testing.assert_allclose(
        compare_logs([bare]).position, compare_logs([log]).position, atol=1e-12
    )


def test_a_cycle_cut_short_is_left_out(folder):
    log = read_log(folder / "left.mcap")
    steps = log.cycle_steps.copy()
    steps[-1] -= 4  # the episode ended within its last cycle
    n = steps[-1]
    short = replace(
        log,
        cycle_steps=steps,
        states=log.states[: n + 1],
        target_shapes=log.target_shapes[:n],
        clearance=log.clearance[:n],
    )
    comparison = compare_logs([short])
    assert len(comparison.gait) == 7
    np.testing.assert_allclose(comparison.position, 0.03, atol=1e-12)


def test_gaits_of_different_logs_are_joined_by_name(folder, tmp_path):
    body = sample_body()
    gait, surrogate = sample_gait(body), sample_surrogate(body)
    names = ("right", "ahead", "left")
    order = [2, 0, 1]
    other = RunFiles.of(
        body,
        replace(gait, task_names=names, alpha=gait.alpha[order], beta=gait.beta[order]),
        replace(
            surrogate,
            task_names=names,
            rotations=surrogate.rotations[order],
            translations=surrogate.translations[order],
        ),
    )
    record_episode(tmp_path / "other.mcap", files=other)
    comparison = compare_logs([folder / "perfect.mcap", tmp_path / "other.mcap"])
    assert comparison.task_names == ("forward", "left", "right", "ahead")
    for name, bend in (("left", 0.6), ("right", -0.6)):
        some = comparison.gait == comparison.task_names.index(name)
        ends = comparison.predicted[some]
        np.testing.assert_allclose(ends, np.tile([0.4, np.sign(bend) * 0.1, 0], (len(ends), 1)))


def test_a_cut_log_is_compared_as_far_as_it_goes(folder, tmp_path):
    data = (folder / "left.mcap").read_bytes()
    whole = compare_logs([folder / "left.mcap"])
    (tmp_path / "cut.mcap").write_bytes(data[: int(len(data) * 0.6)])
    comparison = compare_logs([tmp_path / "cut.mcap"])
    n = len(comparison.gait)
    assert 0 < n < len(whole.gait)
    np.testing.assert_array_equal(comparison.position, whole.position[:n])
    assert comparison.to_json()["logs"][0]["whole"] is False


def test_table_json_and_plot_can_be_shown(folder, tmp_path):
    comparison = compare_logs([folder / "left.mcap", folder / "right.mcap"])
    assert all(len(row) == len(comparison.columns) for row in comparison.table())
    assert all(len(row) == len(DRIFT_COLUMNS) for row in comparison.drift_rows())
    data = json.loads(json.dumps(comparison.to_json(), allow_nan=False))
    assert [row["name"] for row in data["gaits"]][-2] == "all"
    assert len(data["logs"]) == 2
    comparison.plot(tmp_path / "a.png")
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")
    with pytest.raises(DefplanError, match=r"end its name in \.png"):
        comparison.plot(tmp_path / "a.docx")


def test_logs_without_a_whole_cycle_are_one_sentence(tmp_path):
    record_episode(tmp_path / "none.mcap", cycles=0)
    with pytest.raises(DefplanError, match="no whole gait cycle"):
        compare_logs([tmp_path / "none.mcap"])
