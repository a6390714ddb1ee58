"""An episode streamed while it is simulated: what a log would hold, sent to Foxglove or Lichtblick instead.

`foxglove-sdk` is an optional extra ('defplan[live]') that is imported here only. Its server speaks
Foxglove's websocket protocol, which both programs open as 'ws://localhost:8765'.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any, cast

import numpy as np
from mcap.writer import Writer
from mcap_protobuf.schema import register_schema

from defplan_mj.base.errors import DefplanError
from defplan_mj.log import channels
from defplan_mj.log.messages import scene_update
from defplan_mj.log.recorder import Recorder
from defplan_mj.log.run_files import RunFiles
from defplan_mj.planning.scene import Scene

PORT = 8765
"""What the viewers suggest."""

SCENE_SECONDS = 1.0
"""Still obstacles are sent again so often (simulated), for viewers that join late."""


class Server:
    """Sends messages to all viewers that are connected; a context manager.

    It has the part of an MCAP writer's methods that `Recorder` uses, so that both write the same.

    Args:
        port: on this machine, which only programs on this machine reach; 0: any that is free.

    Raises:
        DefplanError: foxglove-sdk is not installed, or the port is taken.
    """

    def __init__(self, port: int = PORT) -> None:
        try:
            import foxglove
        except ImportError as error:
            raise DefplanError(
                "streaming needs foxglove-sdk, which is not installed: pip install 'defplan[live]'"
            ) from error
        self._foxglove = foxglove
        self._context = foxglove.Context()
        self._schemas: list[Any] = []
        self._channels: list[Any] = []
        self._topics: dict[str, int] = {}
        # before there are viewers: one that is quick subscribes before the server knows a new channel
        for channel in channels.CHANNELS:
            self.register_channel(
                channel.topic, "protobuf", register_schema(cast(Writer, self), channel.message)
            )
        try:
            self._server = foxglove.start_server(
                name="defplan",
                port=port,
                capabilities=[foxglove.Capability.Time],
                context=self._context,
            )
        except Exception as error:  # the library's own kinds differ from version to version
            raise DefplanError(
                f"cannot serve on port {port}: {error}; choose another --port"
            ) from error
        self.port = self._server.port

    @property
    def address(self) -> str:
        """What a viewer opens."""
        return f"ws://localhost:{self.port}"

    def __enter__(self) -> Server:
        return self

    def __exit__(self, *_: object) -> None:
        self._server.stop()

    def begin(self) -> None:
        """Let viewers forget what they have seen: another episode begins, at time 0."""
        self._server.clear_session()

    def register_schema(self, name: str, encoding: str, data: bytes) -> int:
        """Return the number of a schema."""
        schema = self._foxglove.Schema(name=name, encoding=encoding, data=data)
        if schema not in self._schemas:
            self._schemas.append(schema)
        return self._schemas.index(schema)

    def register_channel(self, topic: str, message_encoding: str, schema_id: int) -> int:
        """Return the number of a topic, which stays the same from episode to episode."""
        if topic not in self._topics:
            channel = self._foxglove.Channel(
                topic,
                schema=self._schemas[schema_id],
                message_encoding=message_encoding,
                context=self._context,
            )
            self._topics[topic] = len(self._channels)
            self._channels.append(channel)
        return self._topics[topic]

    def add_message(
        self, channel_id: int, log_time: int, data: bytes, publish_time: int, sequence: int = 0
    ) -> None:
        """Send a message."""
        self._channels[channel_id].log(data, log_time=log_time)

    def tell_time(self, nanoseconds: int) -> None:
        """Tell viewers the simulated time."""
        self._server.broadcast_time(nanoseconds)

    def add_metadata(self, name: str, data: Mapping[str, str]) -> None:
        """Send nothing: metadata are for files."""

    def add_attachment(self, *_: Any, **__: Any) -> None:
        """Send nothing: attachments are for files."""

    def flush(self) -> None:
        """Do nothing: messages leave at once."""

    def finish(self) -> None:
        """Do nothing: the server serves the next episode, too."""


class Live(Recorder):
    """A `Recorder` that streams an episode, held to wall time, and writes no file.

    Args:
        server: to send to.
        files: of the run.
        speed: simulated seconds a second of wall time; 0: as fast as it goes.
    """

    def __init__(self, server: Server, files: RunFiles, speed: float = 1.0) -> None:
        super().__init__("live.mcap", files)
        self._server, self._speed = server, speed

    def _open(self) -> Any:
        self._server.begin()
        return self._server

    def begin(self, context: Mapping[str, Any], scene: Scene) -> None:
        """Begin to stream: see `Recorder.begin`."""
        super().begin(context, scene)
        self._wall, self._scene_time = time.monotonic(), 0.0

    def step(self, time: float, x: np.ndarray, target_shape: np.ndarray, clearance: float) -> None:
        """Stream one physics step when its time has come: see `Recorder.step`."""
        self._wait(time)
        super().step(time, x, target_shape, clearance)
        now = round(time * 1e9)
        if time - self._scene_time >= SCENE_SECONDS:
            self._scene_time = time
            self._write(channels.SCENE, now, scene_update(self._scene, now))
        self._server.tell_time(now)

    def end(self, outcome: str, reason: str = "") -> None:
        """End the episode; the server goes on."""
        self._close(None)

    def _close(self, ending: Mapping[str, str] | None) -> None:
        self._writer = None

    def _wait(self, simulated: float) -> None:
        if self._speed > 0:
            time.sleep(max(0.0, self._wall + simulated / self._speed - time.monotonic()))
