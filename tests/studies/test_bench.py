"""The benchmark: what it runs is what it says, and every figure that is promised is there."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest

from defplan_mj import registry
from defplan_mj.cli.text import bench_text
from defplan_mj.dynamics.reduced import ReducedDynamics
from defplan_mj.studies import bench


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


class Falls:
    """An environment whose episodes end within their first cycle, or in its middle, as chosen."""

    def __init__(self, ends_after: list[float]) -> None:
        self.task = self.physics = self
        self.gait, self.cycle_seconds = self, 0.4
        self.outcome, self._ends, self._now = "fall", ends_after, 0.0
        self.cycles = self.resets = 0

    def timestep(self) -> float:
        return 0.04

    def time(self) -> float:
        return self._now

    def reset(self) -> None:
        self.outcome, self._now, self.resets = "running", 0.0, self.resets + 1

    def step(self, action: int) -> None:
        simulated = self._ends[self.cycles % len(self._ends)]
        self.cycles += 1
        self._now += simulated
        self.outcome = "running" if simulated == 0.4 else "fall"


@pytest.mark.parametrize("ends, wanted", [([0.2], 40), ([0.4], 20), ([0.4, 0.12], 20)])
def test_cycles_are_timed_also_when_every_one_ends_in_a_fall(ends, wanted):
    environment = Falls(ends)
    timing = bench._environment_cycles(environment, 20)
    assert len(timing.samples) == wanted
    assert environment.cycles <= 45


def test_errors_shrink_with_the_substeps_and_the_reference_has_none(small_fish):
    fish = registry.get_task("fish-swim")
    table = 0.3 * bench.vigorous_gait(small_fish, 0.04, 11).table()[0]
    rows = bench.error_against_time(bench.integrators(small_fish, fish), table, 2)
    errors = {row.name: row.advance_error for row in rows}
    substeps = {n: f"{n} substep{'s' if n > 1 else ''}" for n in (1, 2, 4, 8, 16)}
    variational = [errors[f"variational, {name}"] for name in substeps.values()]
    assert (np.diff(variational) < 0).all() and variational[-1] == 0
    euler = errors["implicit-euler, 1 substep"], errors["implicit-euler, 4 substeps"]
    assert euler[0] > euler[1] > variational[1]
    assert rows[-1].turn_error_rad == pytest.approx(0, abs=1e-7)
    assert all(row.step_us > 0 for row in rows)


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
    assert set(data["feedback_decision_us"]) == {"ilqg", "lqr"}
    assert set(data["feedback_real_time_factor"]) == {"ilqg", "lqr"}
    vector = data["vector_environment_steps_per_s"]
    assert vector["smooth"] > vector["random"] > 0
    decision, step = data["feedback_decision_us"]["ilqg"], data["reduced_step_us"]["fish"]
    assert (
        decision["median"] > 10 * step["median"]
    )  # its horizon alone is 5 steps, and more than once
    text = bench_text(data)
    assert f"take {vector['smooth']} control steps a second" in text
    assert "reduced step" in text and "not to be quoted" in text


def test_a_task_that_the_suite_does_not_have_has_no_vector_environment():
    assert bench.vector_steps_per_s("shark-swim", 1) is None
