"""Streams of points over registers: written values, reports, and lost messages."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from linkcore.errors import ConnectFailed, ConnectionLost
from tests.urlink.motion.streamed import Streamed
from tests.urlink.motion.test_register_link import FIRMWARES, Inputs, write
from tests.urlink.motion.test_stream import BESIDE, E_SERIES, wave, waves
from urlink.motion.links import register_link
from urlink.motion.links.register_link import POINT_INPUTS, POINT_OUTPUTS, PointLinks, PointRegisterLink
from urlink.motion.moves.trajectory import Trajectory
from urlink.motion.stream import stream_feed
from urlink.motion.stream.stream_feed import StreamFeed
from urlink.protocol.firmware import Firmware
from urlink.script import links
from urlink.script.buffering import MESSAGE
from urlink.script.messages import LARGEST


class Registered(Streamed):
    """A stream over registers.

    Args:
        lost: Fraction of the messages that another message overwrites before the program reads them.
    """

    def __init__(self, firmware: Firmware, lost: float = 0.0, **options: Any) -> None:
        self._lost, self._draw = lost, np.random.default_rng(5)
        self.link = PointRegisterLink(Inputs(self._write), self._outputs, lambda: 0.0)
        super().__init__(firmware, **options)

    def program(self, write: Callable[[Any], list[str]]) -> list[str]:
        return self.feed.body(self.link.endpoint)

    def run(self, cycles: int = 1, *, is_frozen: bool = False) -> None:
        for _ in range(cycles):
            if not is_frozen:
                self.link.send(self.answer(self.link.received()))
            self.bench.run()

    def _write(self, package: dict[str, float]) -> None:
        if self._draw.random() >= self._lost:
            write(self.bench.registers.inputs, package)

    def _outputs(self) -> SimpleNamespace:
        integers = self.bench.registers.outputs.integers
        return SimpleNamespace(**{name: integers[int(name.rpartition("_")[2])] for name in POINT_OUTPUTS})


@pytest.mark.slow
@pytest.mark.parametrize("firmware", FIRMWARES, ids=str)
def test_set_points_over_registers_equal_those_over_a_connection(firmware: Firmware) -> None:
    """The set-points of each cycle are the same as over a connection, apart from their start."""
    paths = []
    for stream in (Streamed(firmware), Registered(firmware)):
        stream.append(waves(0.05, 2.0))
        stream.until(lambda stream=stream: stream.feed.time > 1.9)
        assert stream.feed.starved == 0
        path = np.array(stream.path)
        begin = int(np.argmax(np.abs(path - path[0]).max(axis=1) > 1e-9))
        paths.append(path[begin : begin + round(1.8 / stream.period)])
    assert np.abs(paths[0] - paths[1]).max() < 1e-9


@pytest.mark.slow
def test_lost_messages_are_repeated() -> None:
    stream = Registered(E_SERIES, lost=0.3, buffer=0.5)
    stream.append(waves(0.05, 3.0, spacing=0.02))
    stream.until(lambda: stream.feed.time > 1.0)
    for _ in range(30):
        looked = stream.feed.time
        since = stream.replace(looked, [wave(looked + 0.05 * i) for i in range(1, 61)])
        # A lost message does not count as late. After a late message, the next one would get more time.
        assert since - looked < 0.03
    end = looked + 3.0
    stream.run_dry()
    path = np.array(stream.path)
    wanted = np.array([wave(end).q])
    assert np.abs(path - wanted).max(axis=1).min() < 5e-4
    _, qdd, _ = stream.derivatives()
    assert np.abs(qdd).max() < 11.0


@pytest.mark.slow
def test_last_points_can_be_replaced_and_cleared_over_registers() -> None:
    stream = Registered(E_SERIES)
    stream.append(waves(0.05, 3.0))
    stream.until(lambda: stream.feed.time > 0.5)
    way = Trajectory.from_arrays([0, 1, 2], [np.array(wave(0.5).q) + each * BESIDE for each in (0, 1, 2)])
    assert 0.5 < stream.replace(0.5, way) < 0.6
    stream.until(lambda: stream.feed.time > 1.0)
    stream.clear()
    stream.run_dry()
    assert stream.feed.starved == 0


def test_point_streams_use_only_their_documented_registers() -> None:
    """Integer inputs 24 to 29 are left to users, and so are outputs below 30 and above 36."""
    assert [name for name in POINT_INPUTS if "int" in name] == [f"input_int_register_{i}" for i in range(30, 44)]
    assert [name for name in POINT_INPUTS if "double" in name] == [f"input_double_register_{i}" for i in range(24, 36)]
    assert [*POINT_OUTPUTS] == [f"output_int_register_{i}" for i in range(30, 37)]
    endpoint = PointRegisterLink(Inputs(lambda package: None), lambda: None).endpoint
    assert (endpoint.first_float, endpoint.first_integer, endpoint.first_output) == (24, 30, 30)


def test_point_stream_requests_its_outputs_only_once() -> None:
    """Each link starts them, because the connection might have been closed meanwhile."""
    asked: list[tuple[str, ...]] = []
    started: list[None] = []
    stream = SimpleNamespace(latest=None, start=lambda: started.append(None))

    def outputs(*names: str) -> Any:
        asked.append(names)
        return stream

    links = PointLinks(outputs)
    for count in (1, 2):
        link = links(Inputs(lambda package: None))
        stream.latest = SimpleNamespace(**dict(zip(POINT_OUTPUTS, [*range(6), link.endpoint.token], strict=True)))
        assert link.received() == b"".join(each.to_bytes(4, "big") for each in range(6))
        assert len(started) == count
    assert asked == [POINT_OUTPUTS]


def test_message_number_wraps_to_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """The number is never 0, because an unwritten register holds 0."""
    packages: list[dict[str, float]] = []
    link = PointRegisterLink(Inputs(packages.append), lambda: None)
    assert LARGEST == 0x7FFF_FFFF  # reached after 49 days at 500 Hz
    monkeypatch.setattr(register_link, "LARGEST", 3)
    for _ in range(5):
        link.send(StreamFeed.farewell + bytes(4))
    assert [list(package.values())[12] for package in packages] == [1, 2, 3, 1, 2]


@pytest.mark.parametrize("after", [1, 60, 100, 101, 102, 110, 400])
def test_points_and_cuts_are_accepted_when_the_number_wraps(after: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """The numbers start again after some messages: before, during and after a cut, or when the stream is dry."""
    largest = 1000
    for module in (register_link, stream_feed):
        monkeypatch.setattr(module, "LARGEST", largest)
    stream = Registered(E_SERIES, lost=0.2)
    stream.run(largest - after - len(stream.sent))
    stream.append(waves(0.05, 0.5))
    stream.run(100)
    stream.replace(0.3, [wave(0.3 + 0.05 * i) for i in range(1, 7)])
    stream.run_dry()
    stream.append(wave(stream.feed.time + 0.5))
    stream.run_dry()
    assert stream.bench.registers.inputs.integers[stream.link.endpoint.message] < len(stream.sent)
    assert stream.feed.starved == 2
    assert stream.bench.texts == ["tried started"]


def test_stream_continues_without_outputs_for_a_second() -> None:
    there: list[Any] = [None]
    now = [8.0]
    link = PointRegisterLink(Inputs(lambda package: None), lambda: there[0], lambda: now[0])
    now[0] = 9.0
    assert link.received() == b""
    there[0], now[0] = SimpleNamespace(**dict.fromkeys(POINT_OUTPUTS, 0)), 16.0
    link.received()
    there[0], now[0] = None, 17.0
    assert link.received() == b""
    now[0] = 17.25
    with pytest.raises(ConnectionLost, match=r"have arrived for 1\.2 s"):
        link.received()


def test_link_writes_messages_and_reads_reports() -> None:
    packages: list[dict[str, float]] = []
    there: list[Any] = [None]
    now = [0.0]
    link = PointRegisterLink(Inputs(packages.append), lambda: there[0], lambda: now[0])
    assert not link.poll(has_begun=False)
    assert link.poll(has_begun=True)
    numbers = list(range(1, MESSAGE + 1))
    link.send(StreamFeed.farewell + (7).to_bytes(4, "big"))
    link.send(b"".join(each.to_bytes(4, "big") for each in (*numbers, 500)))
    token = link.endpoint.token
    assert [tuple(package) for package in packages] == [POINT_INPUTS, POINT_INPUTS]
    assert list(packages[0].values())[:14] == [links.STOP, *[0] * 10, 7, 1, token]
    assert list(packages[1].values()) == [*range(1, 12), 500, 2, token, *range(12, 24)]
    there[0] = SimpleNamespace(**dict(zip(POINT_OUTPUTS, [1, 2, 3, 4, 5, 6, token + 1], strict=True)))
    assert link.received() == b""  # the outputs belong to another program
    there[0] = SimpleNamespace(**dict(zip(POINT_OUTPUTS, [1, 2, 3, 4, 5, 6, token], strict=True)))
    assert link.received() == b"".join(each.to_bytes(4, "big") for each in range(1, 7))
    assert link.received() == b""
    there[0], now[0] = None, 0.9
    assert link.received() == b""
    now[0] = 1.1
    with pytest.raises(ConnectionLost, match="have arrived"):
        link.received()
    assert isinstance(link.absence("nothing came"), ConnectFailed)
    link.close(farewell=True)
    assert [link.is_up, link.poll(has_begun=True)] == [False, False]
    with pytest.raises(ConnectionLost):
        link.send(StreamFeed.farewell + bytes(4))
