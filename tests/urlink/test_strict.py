"""Tests of URLINK_STRICT=1, which makes unknown bytes an error."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

import linkcore.wire.framing
import urlink
from linkcore.clock import Stamp
from linkcore.errors import PacketError
from linkcore.streaming.receiver import Receiver
from linkcore.streaming.statistics import StreamCounters
from urlink.protocol.primary.protocol import PrimaryProtocol
from urlink.protocol.realtime.protocol import RealtimeProtocol
from urlink.simulator import Controller
from urlink.simulator.faults.link import with_sub_package, with_tail


@pytest.fixture
def strict(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(linkcore.wire.framing, "_STRICT", True)


@pytest.fixture(scope="module")
def packets() -> dict[str, bytes]:
    controller = Controller("UR5e", "5.11")
    controller.step(10)
    return {"realtime": controller.realtime_packet(), "primary": controller.state_package(first=True)}


@pytest.mark.usefixtures("strict")
def test_tails_and_unknown_types_are_errors_when_strict(packets: dict[str, bytes]) -> None:
    for interface in ("realtime", "primary"):
        assert len(urlink.decode(packets[interface], interface)) == 1
    with pytest.raises(PacketError, match="ends in unknown bytes"):
        urlink.decode(with_tail(packets["realtime"], b"what may this be"), "realtime")
    with pytest.raises(PacketError, match=r"has an unknown type \(URLINK_STRICT\)"):
        urlink.decode(packets["primary"] + with_sub_package(packets["primary"], 77, b"new"), "primary", "5.11")


@pytest.mark.usefixtures("strict")
def test_receiver_counts_unknown_bytes_as_failed_when_strict(packets: dict[str, bytes]) -> None:
    counters = StreamCounters()
    realtime = Receiver("realtime", RealtimeProtocol(), counters)
    tailed = with_tail(packets["realtime"], bytes(16))
    assert len(realtime.feed(tailed * 3, Stamp(0, 0))) == 0
    assert (counters.received, counters.failed) == (3, 3)
    counters = StreamCounters()
    primary = Receiver("primary", PrimaryProtocol(), counters)
    data = packets["primary"] + with_sub_package(packets["primary"], 77, b"new") + packets["primary"]
    assert len(primary.feed(data, Stamp(0, 0))) == 2
    assert (counters.received, counters.failed) == (3, 1)


def test_decode_keeps_tails_when_not_strict(packets: dict[str, bytes]) -> None:
    (state,) = urlink.decode(with_tail(packets["realtime"], b"what may this be"), "realtime")
    assert state.tail == b"what may this be"


@pytest.mark.real_time
def test_environment_variable_sets_strict() -> None:
    program = "from linkcore.wire.framing import is_strict; print(is_strict())"
    for value, said in (("1", "True"), ("0", "False"), ("", "False")):
        done = subprocess.run(
            [sys.executable, "-c", program], env={**os.environ, "URLINK_STRICT": value}, capture_output=True, text=True
        )
        assert done.stdout.strip() == said
