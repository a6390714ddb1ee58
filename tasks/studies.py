"""The shipped studies: files that `defplan study NAME` carries out."""

from __future__ import annotations

from defplan_tasks.environments import ASSETS

PAPER = ASSETS / "paper.toml"
OPTIMISERS = ASSETS / "optimisers.toml"
