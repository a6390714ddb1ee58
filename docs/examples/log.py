"""A log: write an episode of one's own, read it, simulate it again to the bit.

python docs/examples/log.py
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np

from defplan_mj.body.model import Body
from defplan_mj.dynamics.reduced import ReducedDynamics
from defplan_mj.gait.gait import Gait
from defplan_mj.log.reader import EpisodeLog, read_log
from defplan_mj.log.recorder import Recorder
from defplan_mj.log.run_files import RunFiles
from defplan_mj.planning.scene import Scene
from defplan_mj.registry import get_task

OPEN_WATER = Scene(np.array([10.0, 0, 0]), np.zeros((0, 3)), np.zeros(0), np.zeros((0, 3)))


def swim(path: Path, cycles: int = 3) -> None:
    """Log some cycles of the fish's first gait."""
    shipped = get_task("fish-swim").shipped
    assert shipped is not None
    body, gait = Body.load(shipped[0]), Gait.load(shipped[1])
    f = ReducedDynamics(body, gait.timestep, **gait.stepping)
    x, time, far = f.rest_state(), 0.0, np.full(64, 10.0)
    with Recorder(path, RunFiles.of(body, gait)) as recorder:
        context = {"task": "example", "timestep": f.timestep, **f.stepping, "state": x}
        recorder.begin(context, OPEN_WATER)
        for cycle in range(cycles):
            began, start = time, x
            for u in gait.table()[0]:
                x, time = f.step(x, u), time + f.timestep
                recorder.step(time, x, u, clearance=1.0)
            recorder.cycle(cycle, began, start, 0, np.zeros(3), reward=0.0, laser=far)
        recorder.end("timeout")


def again(log: EpisodeLog) -> np.ndarray:
    """Return the states that the log's controls lead to from its start."""
    f = ReducedDynamics(log.body, log.timestep, log.terrain, **log.stepping)
    return f.rollout(log.states[0], log.target_shapes)


def main() -> bool:
    """Return whether the log replays to the bit."""
    with tempfile.TemporaryDirectory() as folder:
        swim(Path(folder) / "mine.mcap")
        log = read_log(Path(folder) / "mine.mcap")
    way = np.linalg.norm(log.states[-1, :3] - log.states[0, :3])
    same = np.array_equal(again(log), log.states)
    print(f"{len(log.target_shapes)} steps, {way:.2f} m; replayed to the bit: {same}")
    return same


if __name__ == "__main__":
    main()
