"""The benchmark: what it runs is what it says, and every figure that is promised is there."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest

from defplan_mj import bench, registry
from defplan_mj.cli.text import bench_text
from defplan_mj.dynamics.reduced import ReducedDynamics


def test_a_timing_knows_median_and_p99():
    timing = bench.Timing(np.arange(1, 1001) * 1e-6)
    assert timing.median == pytest.approx(500.5e-6)
    assert timing.p99 == pytest.approx(990e-6, rel=1e-3)
    assert timing.scaled(1e-6) == {"median": 500.5, "p99": pytest.approx(990.01)}


def test_measure_calls_as_often_as_it_says():
    calls = []
    timing = bench.measure(lambda: calls.append(0), repeats=7, warm=2)
    assert len(calls) == 9 and len(timing.samples) == 7
    assert (timing.samples > 0).all()


def test_the_vigorous_gait_swings_every_mode_through_most_of_its_amplitude(small_fish):
    table = bench.vigorous_gait(small_fish, 0.04, 11).table()[0]
    swing = np.abs(table).max(0) / small_fish.amplitude
    assert (swing > 0.85).all() and (swing <= bench.VIGOUR + 1e-12).all()


def test_single_steps_by_address_are_those_of_the_rollout(small_fish):
    dynamics = ReducedDynamics(small_fish, 0.04)
    shapes = bench.vigorous_gait(small_fish, 0.04, 11).table()[0]
    states = dynamics.rollout(dynamics.rest_state(), shapes)
    kernel = bench.Kernel(dynamics)
    out = np.empty(dynamics.nx)
    call = kernel.function("dp_step", bench.ctypes.c_int, *[bench.ctypes.c_void_p] * 5)
    model = bench.ctypes.addressof(dynamics.model)
    address = [model, *(a.ctypes.data for a in (states[4], shapes[4], out))]
    assert call(*address, None) == 0
    np.testing.assert_array_equal(out, states[5])
    assert len(kernel.steps(states, shapes).samples) == len(shapes)


def test_all_promised_figures_are_there_and_the_table_shows_them(small_fish):
    fish = registry.get_task("fish-swim")
    spec = dataclasses.replace(fish, body=dataclasses.replace(fish.body, vertices=300))
    data = bench.bench(spec, small_fish, quick=True)
    json.dumps(data, allow_nan=False)
    assert set(data["reduced_step_us"]) == {"fish"}
    assert set(data["reduced_step_us"]["fish"]) == {"median", "p99"}
    assert set(data["mujoco_flex_step_ms"]) == {"full", "trilinear"}
    sensing = (
        "laser_scan_us",
        "spherical_laser_scan_us",
        "observation_us",
        "spatial_observation_us",
    )
    for name in ("full_fem_step_ms", "surrogate_transitions_per_s", *sensing):
        assert data[name] > 0
    assert set(data["feedback_decision_us"]) == {"ilqg"} == set(data["feedback_real_time_factor"])
    decision, step = data["feedback_decision_us"]["ilqg"], data["reduced_step_us"]["fish"]
    assert (
        decision["median"] > 10 * step["median"]
    )  # its horizon alone is 5 steps, and more than once
    text = bench_text(data)
    assert "reduced step" in text and "not to be quoted" in text
