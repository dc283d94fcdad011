"""Live streams as ROS 2 messages: recorded into an MCAP file, or served to Foxglove over WebSocket."""

from __future__ import annotations

import contextlib
import logging
import os
import threading
import time
from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from linkcore import clock
from urlink import ConnectFailed, LocalError, Recorder, Stream, Subscription, Table, WrongPeer, drop_oldest
from urlink.arm.kinematics import Arm
from urlink.packets import RobotMessage, RobotState, State
from urlink.tools import (
    McapFile,
    PacketColumns,
    RobotStates,
    Topic,
    described_identity,
    description_topic,
    log_topic,
    needs,
    new_file,
    states_of,
    topics_of,
)

_log = logging.getLogger(__name__)

#: Time for which packets are gathered, in seconds. Making many messages at a time is faster.
_GATHER = 0.1
#: Interval for reading the queue of a stream, in seconds.
_LOOK = 0.02
#: Bytes of messages that are compressed together. A killed program loses at most these and the gathered packets.
_CHUNK = 1 << 14
#: Interval at which the arm is described again, in seconds. The server keeps no message for viewers that connect later.
_AGAIN = 2.0
#: Maximum number of controller messages that are kept until the next `show`; the oldest are dropped.
_ROOM = 1024


class McapRecorder(Recorder):
    """`Recorder` that writes an MCAP file with ROS 2 messages, which Foxglove and `ros2 bag` read.

    A killed program loses at most the packets of the last 0.1 s and 16 kB of messages.

    Args:
        path: Path of the new file, which must not exist yet.

    Raises:
        BadRecording: If the file exists, or cannot be created.
        LocalError: If mcap is not installed.
    """

    _writer: _McapWriter  # type: ignore[assignment]  # it has all members that `Recorder` uses

    def _open(self, path: str | os.PathLike[str]) -> Any:
        return _McapWriter(Path(path))

    def add(self, stream: Stream[Any], info: Mapping[str, Any]) -> Subscription:
        """Record `stream` too; see `Recorder.add`. The first `info` that identifies an arm describes the arm."""
        writer, name, kind = self._writer, info["name"], self._kind_of(stream)
        writer.say(info)
        with contextlib.suppress(LocalError, WrongPeer):
            writer.describe(described_identity(info).kinematics)

        def write(state: State) -> None:
            if isinstance(state, (kind, RobotMessage)):
                writer.add(name, state)

        # One subscription for all classes, because a second one would miss the packets that arrive before it is made.
        return self._subscribe(stream, State, write, _LOOK)


class _McapWriter:
    """Writer that gathers the states of all streams, and writes them as messages."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.failure: str | None = None
        self._lock = threading.RLock()  # re-entrant: a signal handler may close the robot
        self._is_closing = False
        self._waiting: dict[str, list[State]] = {}
        self._since = clock.now()
        self._owners: dict[str, str] = {}
        self._arm: Arm | None = None
        self._is_said = False
        self._file = new_file(path)
        try:
            self._mcap = McapFile(self._file, _CHUNK)
        except BaseException:
            self._file.close()
            path.unlink(missing_ok=True)
            raise

    def say(self, info: Mapping[str, Any]) -> None:
        """Write the metadata of the robot, once, as in an exported file."""
        about = {"robot": info.get("model"), "firmware": info.get("firmware"), "address": info.get("address")}
        with self._lock:
            if self._is_said:
                return
            self._is_said = True
            about["start"] = f"{np.datetime64(time.time_ns(), 'ns')}Z"
            about["clock"] = (
                "log_time: UTC of the computer that recorded, when a state arrived; "
                "time and timestamp: the controller's own clock"
            )
            self._mcap.describe({key: str(value) for key, value in about.items() if value is not None})

    def describe(self, arm: Arm) -> None:
        """Write the description of the arm, once."""
        with self._lock:
            if self._arm is None:
                self._arm = arm
                self._write([description_topic(arm, np.datetime64(time.time_ns(), "ns"))])

    def add(self, name: str, state: State) -> None:
        """Add a state of the stream called `name`; may be called from several threads."""
        with self._lock:
            self._waiting.setdefault(name, []).append(state)
            if clock.now() - self._since >= _GATHER:
                self._flush()

    def _flush(self) -> None:
        waiting, self._waiting = self._waiting, {}
        self._since = clock.now()
        topics = []
        for name, states in waiting.items():
            for topic in topics_of_states(name, states, self._arm):
                # If several streams have the same topic, only the first one writes it.
                if self._owners.setdefault(topic.name, name) == name:
                    topics.append(topic)
        self._write(topics)

    def _write(self, topics: list[Topic]) -> None:
        if self.failure is not None or self._file.closed:
            return
        try:
            self._mcap.write(topics)
            self._file.flush()
        except OSError as error:
            self.failure = f"cannot write {self.path}: {error.strerror or error}"
            _log.error("%s; the streams continue without recording", self.failure)

    def close(self, *, complete: bool = True) -> None:
        """Write what was gathered, and the index; idempotent."""
        with self._lock:
            if self._is_closing:  # perhaps by the call that a signal handler interrupted
                return
            self._is_closing = True
            self._flush()
            try:
                if complete and self.failure is None:
                    self._mcap.finish()
            except OSError as error:
                self.failure = f"cannot write {self.path}: {error.strerror or error}"
            finally:
                self._file.close()


class FoxgloveServer:
    """Foxglove server that sends topics to any number of viewers, until it is closed.

    Args:
        name: Name that viewers show.
        host: Address to listen on.
        port: Port to listen on; 0 for a free port.

    Raises:
        ConnectFailed: If the server cannot listen on the port.
        LocalError: If the extra ``foxglove`` is not installed.
    """

    def __init__(self, name: str, host: str = "127.0.0.1", port: int = 8765) -> None:
        with needs("foxglove", "a view in Foxglove", "urlink-view"):
            import foxglove
        self._foxglove = foxglove
        # A separate context, because other parts of the program might use Foxglove too.
        self._context = foxglove.Context()
        try:
            self._server = foxglove.start_server(name=name, host=host, port=port, context=self._context)
        except (OSError, RuntimeError) as error:
            raise ConnectFailed(f"cannot serve Foxglove at {host}:{port}: {error}") from error
        self._channels: dict[tuple[str, str], Any] = {}
        self.host = host

    @property
    def port(self) -> int:
        """TCP port that the server listens on."""
        return int(self._server.port)

    @property
    def address(self) -> str:
        """Address for viewers: ``ws://host:port``."""
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
            stamps = topic.wall.astype("M8[ns]").astype(np.int64).tolist()
            for message, stamp in zip(topic.messages, stamps, strict=True):
                channel.log(message, log_time=stamp)

    def close(self) -> None:
        """Disconnect every viewer; idempotent."""
        for channel in self._channels.values():
            channel.close()
        self._channels = {}
        self._server.stop()


class RobotView:
    """View of a robot on a server: `show` sends the newest state of each stream, and the messages since the last call.

    Until they are sent, only the newest 1024 messages are kept.

    Args:
        realtime, primary: Streams of the robot.
        arm: Arm to draw; None draws no arm.
        server: Server that sends the messages.

    Raises:
        RemoteError: If a stream cannot be opened.
    """

    def __init__(self, realtime: Stream[Any], primary: Stream[Any], arm: Arm | None, server: FoxgloveServer) -> None:
        self._server = server
        self._arm = arm
        self._streams = {"realtime": realtime, "primary": primary}
        self._shown: dict[str, State] = {}
        self._messages: deque[State] = deque(maxlen=_ROOM)
        self._described = -_AGAIN
        realtime.start()
        self._subscription = primary.subscribe(self._keep, RobotMessage, policy=drop_oldest(_ROOM))

    def _keep(self, message: State) -> None:
        self._messages.append(message)

    def show(self) -> None:
        """Send the newest states, and the messages since the last call."""
        now = clock.now()
        if self._arm is not None and now - self._described >= _AGAIN:
            self._described = now
            self._server.write([description_topic(self._arm, np.datetime64(time.time_ns(), "ns"))])
        for name, stream in self._streams.items():
            state = stream.latest
            if state is not None and state is not self._shown.get(name):
                self._shown[name] = state
                self._server.write(topics_of_states(name, [state], self._arm))
        messages = [self._messages.popleft() for _ in range(len(self._messages))]
        self._server.write(topics_of_states("primary", messages, None))

    def close(self) -> None:
        """Stop collecting messages; idempotent."""
        self._subscription.close()


def topics_of_states(name: str, states: Sequence[State], arm: Arm | None) -> list[Topic]:
    """Convert states of a live stream to ROS 2 messages."""
    rows = [state for state in states if not isinstance(state, RobotMessage)]
    topics = list(topics_of(name, table_of(name, rows), arm)) if rows else []
    messages = [state for state in states if isinstance(state, RobotMessage)]
    if messages:
        topics.append(log_topic(messages, _wall(messages)))
    return topics


def table_of(name: str, states: list[State]) -> Table:
    """Convert states of a live stream to columns; `Table.time` is the monotonic time of arrival, in seconds."""
    numbered = list(enumerate(states))
    wall = _wall(states)
    time = np.array([0.0 if state.received is None else state.received.monotonic for state in states])
    if isinstance(states[0], RobotState):
        return RobotStates(name, numbered, lambda rows: (time[rows], wall[rows]), [], ())
    return Table(name, PacketColumns(states_of(numbered)), time, wall)


def _wall(states: Sequence[State]) -> Any:
    stamps = [0.0 if state.received is None else state.received.wall for state in states]
    return np.round(np.array(stamps) * 1e9).astype(np.int64).astype("M8[ns]")
