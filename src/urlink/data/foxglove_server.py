"""A robot live in Foxglove: messages of ROS 2 by WebSocket, as they are in an MCAP file."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import numpy as np

from linkcore.errors import ConnectFailed
from linkcore.extras import needs
from linkcore.recording.topics import Topic
from linkcore.streaming.policy import drop_oldest
from linkcore.streaming.stream import Stream
from linkcore.wire.packet import State

from ..interfaces.primary.robot_message import RobotMessage
from ..kinematics import Arm
from .live import topics_of_states
from .ros_messages import description_topic

if TYPE_CHECKING:
    from typing_extensions import Self

__all__ = ["FoxgloveServer", "RobotView"]

#: Seconds after which the arm is described again, for viewers that have come meanwhile: nothing is kept for them.
_AGAIN = 2.0
#: Messages of the controller that wait for the next round at most.
_ROOM = 1024


class FoxgloveServer:
    """Serves topics to any number of viewers. A context manager.

    Args:
        name: that viewers show.
        host: address to listen on.
        port: to listen on; 0 for a free one.

    Raises:
        ConnectFailed: the port cannot be had.
        LocalError: the extra ``foxglove`` is not installed.
    """

    def __init__(self, name: str, host: str = "127.0.0.1", port: int = 8765) -> None:
        with needs("foxglove", "a view in Foxglove"):
            import foxglove
        self._foxglove = foxglove
        # A context of its own: what else this program shows in Foxglove is no concern of ours.
        self._context = foxglove.Context()
        try:
            self._server = foxglove.start_server(name=name, host=host, port=port, context=self._context)
        except (OSError, RuntimeError) as error:
            raise ConnectFailed(f"cannot serve Foxglove at {host}:{port}: {error}") from error
        self._channels: dict[tuple[str, str], Any] = {}
        self.host = host

    @property
    def port(self) -> int:
        """That it listens on."""
        return int(self._server.port)

    @property
    def address(self) -> str:
        """What a viewer connects to."""
        return f"ws://{self.host}:{self.port}"

    def write(self, topics: Iterable[Topic]) -> None:
        """Send messages to whoever looks at their topics."""
        for topic in topics:
            key = (topic.name, topic.definition)
            if key not in self._channels:
                schema = self._foxglove.Schema(name=topic.type, encoding="ros2msg", data=topic.definition.encode())
                self._channels[key] = self._foxglove.Channel(
                    topic.name, schema=schema, message_encoding="cdr", context=self._context
                )
            channel = self._channels[key]
            for message, stamp in zip(
                topic.messages, topic.wall.astype("M8[ns]").astype(np.int64).tolist(), strict=True
            ):
                channel.log(message, log_time=stamp)

    def close(self) -> None:
        """Disconnect every viewer; idempotent."""
        for channel in self._channels.values():
            channel.close()
        self._channels = {}
        self._server.stop()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()


class RobotView:
    """What a robot says, handed to a server in rounds: the newest state of each stream, and every message.

    Args:
        realtime, primary: its streams.
        arm: which it is; None draws none.
        server: that shows it.

    Raises:
        RemoteError: a stream could not be opened.
    """

    def __init__(self, realtime: Stream[Any], primary: Stream[Any], arm: Arm | None, server: FoxgloveServer) -> None:
        self._server = server
        self._arm = arm
        self._streams = {"realtime": realtime, "primary": primary}
        self._shown: dict[str, State] = {}
        self._lock = threading.Lock()
        self._messages: list[State] = []
        self._described = -_AGAIN
        realtime.start()
        self._subscription = primary.subscribe(self._keep, RobotMessage, policy=drop_oldest(_ROOM))

    def _keep(self, message: State) -> None:
        with self._lock:
            self._messages.append(message)

    def show(self) -> None:
        """One round."""
        now = time.monotonic()
        if self._arm is not None and now - self._described >= _AGAIN:
            self._described = now
            self._server.write([description_topic(self._arm, np.datetime64(time.time_ns(), "ns"))])
        for name, stream in self._streams.items():
            state = stream.latest
            if state is not None and state is not self._shown.get(name):
                self._shown[name] = state
                self._server.write(topics_of_states(name, [state], self._arm))
        with self._lock:
            messages, self._messages = self._messages, []
        self._server.write(topics_of_states("primary", messages, None))

    def close(self) -> None:
        """Read the messages no more; idempotent."""
        self._subscription.close()
