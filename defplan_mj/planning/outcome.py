"""How an episode stands or has ended, and in which scenes: one list for MuJoCo, surrogate, logs and reports."""

from __future__ import annotations

from enum import StrEnum


class Outcome(StrEnum):
    """An episode's outcome, as JSON files and logs have it; a fall is of a robot that walks."""

    RUNNING = "running"
    SUCCESS = "success"
    COLLISION = "collision"
    FALL = "fall"
    TIMEOUT = "timeout"


ENDINGS = tuple(outcome for outcome in Outcome if outcome is not Outcome.RUNNING)
"""The outcomes of episodes that are over, in the order they are shown in."""

RUNNING, SUCCESS, COLLISION, FALL, TIMEOUT = range(len(Outcome))
"""Their numbers in arrays, where many episodes run side by side."""

SCENES = {"k2": "training targets", "novel": "unseen scenes"}
"""What the kinds of scenes of an evaluation are called for people."""
