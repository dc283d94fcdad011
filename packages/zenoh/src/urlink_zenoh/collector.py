"""Recording all robots that there are, in one process."""

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

#: Seconds that a clock goes on at most between two packets; more is the time of something else.
_ANOTHER_CLOCK = 3600.0

_log = logging.getLogger("urlink.zenoh")


class Collected(NamedTuple):
    """What has been recorded of one robot.

    Attributes:
        packets: that were written.
        missed: by the numbers of the packets: received by the server, and not arrived here.
        missing: by the controller's own clock: cycles of which no packet is in the recording, for whatever reason.
        restarts: times that its server began anew, or was out of sight.
        path: the recording, which `urlink.connect` opens.
    """

    packets: int
    missed: int
    missing: int
    restarts: int
    path: Path


class _File:
    """The recording of one robot."""

    def __init__(self, path: Path, info: Mapping[str, object]) -> None:
        self.writer = RecordingWriter(path)
        self.channel = self.writer.add_channel(info)
        self.packets = self.missed = self.missing = self.restarts = 0
        rate = info.get("rate")
        self.period = 1.0 / rate if isinstance(rate, (int, float)) and rate > 0 else None
        self.time: float | None = None  # of the last packet, by the controller's clock
        self.expected: int | None = None

    def add(self, sample: Sample) -> None:
        expected = self.expected
        if expected is not None and sample.sequence < expected:
            if sample.sequence == expected - 1:
                return  # the newest value, again, after a router came back
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
        # Backwards, or far ahead: it was started again.
        if before is not None and 1.5 * self.period < state.time - before < _ANOTHER_CLOCK:
            self.missing += max(round((state.time - before) / self.period) - 1, 1)


class Collector:
    """Records every robot, also those that come later, each into a file of its own; a context manager.

    A recording has the name of the robot and the time at which it began, and opens as any other does. Packets are
    written in a thread of its own, which a slow disk keeps, and not the network.

    Args:
        session: of Zenoh; it is not closed with the collector.
        directory: where the recordings go; it is made.
        prefix: what all keys begin with.
        interface: whose packets are recorded, "realtime" or "primary".

    Raises:
        OSError: the directory cannot be made.
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
        """What has been recorded, by robot."""
        return {
            name: Collected(file.packets, file.missed, file.missing, file.restarts, file.writer.path)
            for name, file in list(self._files.items())
        }

    def close(self) -> None:
        """Write what has come, and close the recordings; idempotent."""
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
                    _log.error("%s is not recorded until the cause is gone: %s", name, error)

    def _file(self, name: str) -> _File:
        """The recording of a robot, made when its first packet comes."""
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
        error = None if is_there else ConnectionLost(f"whoever serves {name} is out of sight")
        file.writer.add(file.channel, ConnectionEvent(state, name, error, Stamp.now()))
