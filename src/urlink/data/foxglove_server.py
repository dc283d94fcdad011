"""A robot live in Foxglove: messages of ROS 2 by WebSocket, as they are in an MCAP file."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import numpy as np

from linkcore.errors import ConnectFailed
from linkcore.lazy import needs
from linkcore.recording.mcap_file import Topic
from linkcore.streaming.packet_queue import drop_oldest
from linkcore.streaming.stream import Stream
from linkcore.wire.packet import State

from ..interfaces.primary.robot_message import RobotMessage
from ..kinematics import Arm
from .live import topics_of_states
from .ros_messages import description_topic

if TYPE_CHECKING:
    from typing_extensions import Self

#: Seconds after which the arm is described again: the server keeps no message for viewers that connect later.
_AGAIN = 2.0
#: Most messages of the controller that are kept until the next `show`; the oldest are dropped.
_ROOM = 1024


class FoxgloveServer:
    """Serves topics to any number of viewers. A context manager.

    Args:
        name: shown by viewers.
        host: address to listen on.
        port: to listen on; 0 for a free one.

    Raises:
        ConnectFailed: it cannot listen on the port.
        LocalError: the extra ``foxglove`` is not installed.
    """

    def __init__(self, name: str, host: str = "127.0.0.1", port: int = 8765) -> None:
        with needs("foxglove", "a view in Foxglove"):
            import foxglove
        self._foxglove = foxglove
        # A context of its own: other parts of the program may use Foxglove too.
        self._context = foxglove.Context()
        try:
            self._server = foxglove.start_server(name=name, host=host, port=port, context=self._context)
        except (OSError, RuntimeError) as error:
            raise ConnectFailed(f"cannot serve Foxglove at {host}:{port}: {error}") from error
        self._channels: dict[tuple[str, str], Any] = {}
        self.host = host

    @property
    def port(self) -> int:
        """The TCP port that it listens on."""
        return int(self._server.port)

    @property
    def address(self) -> str:
        """The address for viewers: ``ws://host:port``."""
        return f"ws://{self.host}:{self.port}"

    def write(self, topics: Iterable[Topic]) -> None:
        """Send messages to the viewers that are subscribed to their topics."""
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
    """Shows a robot on a server: `show` sends the newest state of each stream, and all messages since the last call.

    Args:
        realtime, primary: streams of the robot.
        arm: the arm to draw; None draws none.
        server: the server that sends.

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
        """Send the newest states, and the messages since the last call."""
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
        """Stop collecting messages; idempotent."""
        self._subscription.close()
