"""A comparison finds exactly the error that was put into a log, and nothing in a perfect one."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from log_samples import (
    record_episode,
    sample_body,
    sample_gait,
    sample_surrogate,
    turn,
)

from defplan_mj.errors import DefplanError
from defplan_mj.log.compare import DRIFT_COLUMNS, TABLE_COLUMNS, compare_logs
from defplan_mj.log.poses import predict, quaternion, rotation_matrix, yaw
from defplan_mj.log.reader import read_log
from defplan_mj.log.recorder import RunFiles


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
    assert np.abs(comparison.heading).max() < 1e-12
    episode = comparison.episodes[0]
    assert episode.drift < 1e-12 and abs(episode.heading_drift) < 1e-12


def test_a_known_error_is_found_exactly(folder):
    comparison = compare_logs([folder / "left.mcap"])
    np.testing.assert_allclose(comparison.position, 0.03, atol=1e-12)
    np.testing.assert_allclose(comparison.heading, 0.02, atol=1e-12)
    left = comparison.truth - comparison.predicted
    # the error is to the left of the predicted heading, at the end of the cycle
    angle = np.array([0.0, 0.6, -0.6])[comparison.gait]
    np.testing.assert_allclose(left[:, 0], -0.03 * np.sin(angle), atol=1e-12)
    np.testing.assert_allclose(left[:, 1], 0.03 * np.cos(angle), atol=1e-12)
    assert comparison.episodes[0].heading_drift == pytest.approx(8 * 0.02)
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


def test_first_cycles_are_told_apart(folder):
    comparison = compare_logs([folder / "left.mcap", folder / "right.mcap"])
    np.testing.assert_array_equal(comparison.cycle, [*range(8), *range(8)])
    row = comparison.summaries()[-1]
    assert (row["name"], row["cycles"]) == ("all but each first 3", 10)


def test_heading_errors_wrap_around(folder, tmp_path):
    record_episode(tmp_path / "turned.mcap", error=(0.0, 3.0))
    comparison = compare_logs([tmp_path / "turned.mcap"])
    np.testing.assert_allclose(comparison.heading, 3.0, atol=1e-9)


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
    for name, angle in (("left", 0.6), ("right", -0.6)):
        some = comparison.gait == comparison.task_names.index(name)
        ends = comparison.predicted[some]
        np.testing.assert_allclose(ends, np.tile([0.4, np.sign(angle) * 0.1, 0], (len(ends), 1)))


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
    assert all(len(row) == len(TABLE_COLUMNS) for row in comparison.table())
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


def test_quaternions_and_matrices_agree_for_all_attitudes():
    rng = np.random.default_rng(0)
    q = rng.normal(size=(200, 4))
    q[:4] = np.eye(4)  # half turns too
    q[4:8] = np.eye(4) + 1e-9
    q /= np.linalg.norm(q, axis=1, keepdims=True)
    matrices = rotation_matrix(q)
    np.testing.assert_allclose(matrices @ np.swapaxes(matrices, 1, 2), np.tile(np.eye(3), (200, 1, 1)),
                               atol=1e-14)  # fmt: skip
    again = np.array([quaternion(m) for m in matrices])
    np.testing.assert_allclose(np.abs((again * q).sum(1)), 1, atol=1e-14)
    assert yaw(turn(0.7)) == pytest.approx(0.7)
    # against MuJoCo's own convention
    import mujoco

    out = np.empty(9)
    mujoco.mju_quat2Mat(out, q[20])
    np.testing.assert_allclose(matrices[20].ravel(), out, atol=1e-15)


def test_a_prediction_is_the_gaits_motion_in_the_bodys_frame():
    surrogate = sample_surrogate(sample_body())
    pose = np.array([1.0, 2.0, 0.0, *quaternion(turn(np.pi / 2))])
    after = predict(surrogate, pose, 1)
    np.testing.assert_allclose(after[:3], [0.9, 2.4, 0.0], atol=1e-15)
    assert yaw(rotation_matrix(after[3:])) == pytest.approx(np.pi / 2 + 0.6)
