"""A streamed episode reaches a viewer as what a log of it would hold."""

from __future__ import annotations

import asyncio
import json
import struct
import threading

import numpy as np
import pytest

from defplan_mj.base.errors import DefplanError
from defplan_mj.log import channels
from defplan_mj.log.run_files import RunFiles
from defplan_mj.log.schemas import LabelledNumbers
from tests.samples.logs import (
    TIMESTEP,
    sample_body,
    sample_gait,
    sample_scene,
    sample_surrogate,
    state,
)

foxglove = pytest.importorskip("foxglove")
websockets = pytest.importorskip("websockets")


async def _watch(address: str, topics: set[str], ready: threading.Event, enough: int) -> dict:
    """Subscribe to topics as a viewer does; return the bytes of each topic's messages."""
    got: dict[str, list[bytes]] = {topic: [] for topic in topics}
    protocol = websockets.Subprotocol("foxglove.sdk.v1")
    async with websockets.connect(address, subprotocols=[protocol], max_size=None) as socket:
        names: dict[int, str] = {}
        ready.set()
        async for message in socket:
            if isinstance(message, str):
                told = json.loads(message)
                for channel in told.get("channels", []):
                    if told["op"] == "advertise" and channel["topic"] in topics:
                        names[channel["id"]] = channel["topic"]
                        wanted = [{"id": channel["id"], "channelId": channel["id"]}]
                        await socket.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))
                continue
            if message[0] != 1:  # the time
                continue
            subscription = struct.unpack_from("<I", message, 1)[0]
            got[names[subscription]].append(message[13:])
            if all(len(parts) >= enough for parts in got.values()):
                return got
    return got


def test_a_viewer_gets_the_states_to_the_bit():
    from defplan_mj.log.live import Live, Server

    body = sample_body()
    files = RunFiles.of(body, sample_gait(body), sample_surrogate(body))
    rng = np.random.default_rng(0)
    states = [state(np.array([0.1 * i, 0, 0, 1.0, 0, 0, 0]), rng) for i in range(400)]
    topics = {channels.STATE, channels.SCENE, channels.MESH}
    ready, result, done = threading.Event(), [], threading.Event()
    with Server(port=0) as server:

        def view() -> None:
            watched = _watch(f"ws://127.0.0.1:{server.port}", topics, ready, 3)
            result.append(asyncio.run(asyncio.wait_for(watched, 30)))
            done.set()

        watcher = threading.Thread(target=view, daemon=True)
        watcher.start()
        assert ready.wait(20)
        live = Live(server, files, speed=5.0)
        with live:
            context = {"timestep": TIMESTEP, "substeps": 2, "integrator": "variational"}
            live.begin({**context, "state": states[0]}, sample_scene())
            for i, x in enumerate(states[1:], start=1):
                live.step(i * TIMESTEP, x, np.zeros(2), 0.5)
                if done.is_set():
                    break
            live.end("success")
        watcher.join(30)
    assert result, "nothing arrived"
    numbers = [np.array(LabelledNumbers.FromString(m).values) for m in result[0][channels.STATE]]
    known = {x.tobytes() for x in states}
    assert all(x.tobytes() in known for x in numbers)
    assert not live.path.exists() and not live.partial.exists()


def test_a_port_that_is_taken_is_one_sentence():
    from defplan_mj.log.live import Server

    with Server(port=0) as server, pytest.raises(DefplanError, match="choose another --port"):
        Server(server.port)
