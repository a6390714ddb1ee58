"""The run that is stopped and started again in other tests: its stand-ins are still those of the task."""

from __future__ import annotations

from defplan_solvers.dql.training import Recipe
from tests.samples.tiny_run import short


def test_the_short_training_names_fields_that_there_are():
    fields = dict(zip(Recipe.__dataclass_fields__, short(Recipe), strict=True))
    assert Recipe(**fields).transitions == 3000
