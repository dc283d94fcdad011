"""Recording of all served robots in one process."""

from __future__ import annotations

import datetime
import logging
import os
import queue
import threading
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import zenoh

from urlink import ConnectionEvent, ConnectionLost, ConnectionState, LinkError, RecordingWriter
from urlink.packets import Chunk, RealtimeState, Stamp, State

from .client import RemoteRobot, Sample, Watch
from .keys import PREFIX, key_of

if TYPE_CHECKING:
    from typing_extensions import Self

__all__ = ["Collected", "Collector"]

#: Maximum plausible step, in s, of a controller's clock between two packets; a larger step is a change of the clock.
_ANOTHER_CLOCK = 3600.0

_log = logging.getLogger("urlink.zenoh")


class Collected(NamedTuple):
    """Counts and path of the recording of one robot.

    Attributes:
        packets: Number of packets that were written.
        missed: Number of packets that the server received but that did not arrive here, by the numbers of the packets.
        missing: Number of cycles without a packet in the recording, for any reason, by the controller's own clock.
        restarts: Number of times that the packet numbers started again, because the server was restarted.
        path: Path of the recording, which `urlink.connect` opens.
    """

    packets: int
    missed: int
    missing: int
    restarts: int
    path: Path


class _File:
    """Recording of one robot."""

    def __init__(self, path: Path, info: Mapping[str, object]) -> None:
        self.writer = RecordingWriter(path)
        self.channel = self.writer.add_channel(info)
        self.packets = self.missed = self.missing = self.restarts = 0
        rate = info.get("rate")
        self.period = 1.0 / rate if isinstance(rate, (int, float)) and rate > 0 else None
        self.time: float | None = None  # time of the last packet, by the controller's clock
        self.expected: int | None = None

    def add(self, sample: Sample) -> None:
        expected = self.expected
        if expected is not None and sample.sequence < expected:
            if sample.sequence == expected - 1:
                return  # the newest value arrives again after a router came back
            self.restarts += 1
        elif expected is not None:
            self.missed += sample.sequence - expected
        self.expected = sample.sequence + 1
        self.writer.add(self.channel, Chunk(bytes(sample.state), sample.received))
        self.packets += 1
        self._look_at_clock(sample.state)

    def _look_at_clock(self, state: State) -> None:
        if self.period is None or not isinstance(state, RealtimeState):
            return
        before, self.time = self.time, state.time
        # A step backwards or far ahead means that the controller was restarted.
        if before is not None and 1.5 * self.period < state.time - before < _ANOTHER_CLOCK:
            self.missing += max(round((state.time - before) / self.period) - 1, 1)


class Collector:
    """Record every robot into its own file; a context manager.

    A robot that appears later is recorded too. The file name of a recording consists of the name of the robot and the
    start time. A recording opens like any other. Packets are written in a dedicated thread, so a slow disk does not
    delay the network.

    Args:
        session: Zenoh session. It is not closed with the collector.
        directory: Directory for the recordings. It is created if needed.
        prefix: First part of all keys.
        interface: Interface whose packets are recorded, "realtime" or "primary".

    Raises:
        OSError: If the directory cannot be created.
    """

    def __init__(
        self,
        session: zenoh.Session,
        directory: str | os.PathLike[str],
        *,
        prefix: str = PREFIX,
        interface: str = "realtime",
    ) -> None:
        self.directory = Path(directory)
        self.directory.mkdir(parents=True, exist_ok=True)
        self._session = session
        self._prefix = prefix
        self._interface = interface
        self._files: dict[str, _File] = {}
        self._failed: set[str] = set()
        self._waiting: queue.SimpleQueue[Sample | tuple[str, bool] | None] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._write, name="urlink-zenoh collector", daemon=True)
        self._thread.start()
        self._watch = Watch(session, f"{key_of(prefix, '*')}/{interface}", self._waiting.put)
        self._alive = session.liveliness().declare_subscriber(f"{key_of(prefix, '*')}/alive", self._seen)

    @property
    def robots(self) -> dict[str, Collected]:
        """Counts of each recording, by the name of the robot."""
        return {
            name: Collected(file.packets, file.missed, file.missing, file.restarts, file.writer.path)
            for name, file in list(self._files.items())
        }

    def close(self) -> None:
        """Write the packets that have arrived, and close the recordings; idempotent."""
        if self._thread.is_alive():
            self._alive.undeclare()
            self._watch.close()
            self._waiting.put(None)
            self._thread.join(30.0)
        for file in self._files.values():
            file.writer.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

    def _seen(self, sample: zenoh.Sample) -> None:
        name = str(sample.key_expr).split("/")[-2]
        self._waiting.put((name, sample.kind == zenoh.SampleKind.PUT))

    def _write(self) -> None:
        while (item := self._waiting.get()) is not None:
            name = item.robot if isinstance(item, Sample) else item[0]
            try:
                if isinstance(item, Sample):
                    self._file(name).add(item)
                elif name in self._files:
                    self._note(self._files[name], name, item[1])
                self._failed.discard(name)
            except LinkError as error:
                if name not in self._failed:
                    self._failed.add(name)
                    _log.error("%s: not recorded until this error is fixed: %s", name, error)

    def _file(self, name: str) -> _File:
        """Return the recording of a robot; create it for the first packet."""
        file = self._files.get(name)
        if file is None:
            info = {"name": self._interface, "address": f"zenoh:{key_of(self._prefix, name)}"}
            with RemoteRobot(self._session, name, prefix=self._prefix) as robot:
                said = robot.info
            info |= said["recording"]
            if self._interface == "realtime":
                info["rate"] = said["published"]
            began = datetime.datetime.now().strftime("%Y%m%d-%H%M%S-%f")
            file = self._files[name] = _File(self.directory / f"{name}-{began}.urlog", info)
        return file

    @staticmethod
    def _note(file: _File, name: str, is_there: bool) -> None:
        state = ConnectionState.CONNECTED if is_there else ConnectionState.LOST
        error = None if is_there else ConnectionLost(f"the server of {name} is no longer visible")
        file.writer.add(file.channel, ConnectionEvent(state, name, error, Stamp.now()))
