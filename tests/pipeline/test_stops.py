"""A run that is stopped, at whatever moment, says so, leaves nothing behind and becomes the undisturbed one."""

from __future__ import annotations

import pytest

from tests.samples.stopping import stop_at_random, undisturbed


@pytest.mark.slow
def test_runs_stopped_at_random_moments_become_the_undisturbed_one_to_the_bit(tmp_path):
    wanted, seconds = undisturbed(tmp_path / "undisturbed")
    assert {"body.npz", "gait.npz", "policy.npz", "k2-00.mcap", "report.html"} <= set(wanted)
    found = stop_at_random(tmp_path, 12, wanted, seconds, seed=1)
    assert not found.faults, "\n".join(found.faults)
    assert found.stops == 12
