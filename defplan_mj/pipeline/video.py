"""The stage that draws one logged episode as a video, for the report."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from defplan_mj.base.errors import DefplanError
from defplan_mj.pipeline.stage import Stage

if TYPE_CHECKING:
    from defplan_mj.pipeline.run import Run

VIDEO_FILE = "episode.mp4"
SIZE, FPS, SECONDS = (480, 270), 15.0, 12.0
"""What keeps it below a megabyte, and quick to draw without a GPU."""


def _inputs(run: Run) -> dict[str, Any]:
    return {"options": {"size": SIZE, "fps": FPS, "seconds": SECONDS}}


def _make(run: Run) -> Iterable[Path]:
    """Draw the start of the first episode in an unseen scene; without a way to draw, nothing."""
    from defplan_mj.log.replay import write_video

    logs = sorted(run.folder.path.glob("novel-[0-9]*.mcap"))
    logs += sorted(run.folder.path.glob("k2-[0-9]*.mcap"))
    if not logs:
        return []
    path = run.file(VIDEO_FILE)
    try:
        write_video(logs[0], path, SIZE, FPS, "chase", run.progress_of("video"), (0.0, SECONDS))
    except DefplanError as error:
        run.consent.say(f"the report has no video: {error}")
        return []
    return [path]


VIDEO = Stage("video", _inputs, _make, needs=("evaluation",), guarded=False)
