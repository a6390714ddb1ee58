"""The examples: each runs, in seconds, and gives the number that its equation promises."""

from __future__ import annotations

import re

import numpy as np
import pytest

from tests.samples.examples import example
from tests.samples.paths import EXAMPLES, ROOT


def test_a_body_weighs_its_volume_of_water():
    module = example("body")
    body = module.main()
    volume = 4 / 3 * np.pi * np.prod(module.AXES)
    assert body.mass == pytest.approx(body.material.density * volume, rel=0.05)


def test_modes_have_the_frequencies_of_their_stiffness_and_mass():
    found, told = example("modes").main()
    assert found == pytest.approx(told, rel=1e-9)


def test_a_step_s_derivative_is_that_of_differences():
    assert example("step").main() < 1e-7


def test_a_bent_fish_loses_its_energy():
    energy = example("rollout").main()
    assert energy[-1] < 0.05 * energy.max()


def test_a_gait_s_table_is_its_dmp_and_takes_the_fish_ahead():
    module = example("gait")
    assert module.main() > 0.4
    gait = module.Gait.load(module.get_task("fish-swim").shipped[1])
    assert module.shapes(gait, 1) == pytest.approx(gait.table()[1], abs=1e-12)


def test_the_surrogate_is_right_about_a_steady_cycle():
    assert example("surrogate").main() < 0.15


def test_a_planner_brings_the_fish_to_its_targets():
    result = example("plan").main()
    assert [episode.outcome for episode in result.episodes].count("success") >= 2


def test_a_log_replays_to_the_bit():
    assert example("log").main()


def test_a_gait_takes_the_fish_of_the_suite_a_body_length_ahead():
    assert example("environment").main() > 1.0


def test_a_policy_learns_to_swim_and_its_curve_is_the_file_s(tmp_path):
    """The whole training takes minutes: here its first rollout, which is that of the curve in the repository."""
    module = example("train")
    module.main(tmp_path, module.ROBOTS * module.ROLLOUT)
    new, kept = ((f / "train.csv").read_text().splitlines() for f in (tmp_path, EXAMPLES))
    assert new[0] == kept[0] and len(new) == 2
    assert np.fromstring(new[1], sep=",") == pytest.approx(
        np.fromstring(kept[1], sep=","), rel=0.02
    )
    rewards = np.loadtxt(kept, delimiter=",", skiprows=1)[:, 1]
    assert len(rewards) == module.DECISIONS / (module.ROBOTS * module.ROLLOUT)
    assert rewards[-8:].mean() > 2.5 * rewards[:8].mean()
    assert (tmp_path / "train.png").stat().st_size > 1000


def test_every_example_is_named_where_examples_are_listed_and_run_by_a_test():
    page = (ROOT / "docs/index.md").read_text()
    tests = "".join(p.read_text() for p in (ROOT / "tests").rglob("test_*.py"))
    for path in EXAMPLES.glob("*.py"):
        assert f"examples/{path.name}" in page
        assert re.search(rf'example(?:_named)?\("{path.stem}"\)|"{path.stem}:SENSOR"', tests), (
            path.stem
        )
        assert path.read_text().count("\n") < 160
