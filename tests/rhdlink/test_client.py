"""The client, tested with servers that send scripted data or recordings of the original server."""

from __future__ import annotations

import contextlib
import os
import threading
import time
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import rhdlink
import rhdlink.sync.connection
from linkcore.errors import (
    BadAddress,
    BadValue,
    Closed,
    ConnectFailed,
    ConnectionLost,
    LinkTimeout,
    LocalError,
    PacketError,
    WrongPeer,
)
from linkcore.streaming.connection_life import ConnectionEvent
from rhdlink import (
    AccessDenied,
    ConnectionState,
    Int32,
    NotThere,
    Read,
    Scaled,
    Variables,
    Write,
    WrongVariables,
)
from rhdlink.address import Address, parse_address
from rhdlink.host.plugins.turtle import Turtle
from rhdlink.sync.connection import Connection
from rhdlink.sync.replica import Replica
from rhdlink.sync.sync_thread import Subscribers
from rhdlink.variables.database import Database, TimeStamp
from rhdlink.wire.decoder import ServerDecoder
from rhdlink.wire.messages import SymbolRow
from tests import platforms
from tests.fakes.rhd import Peer, Robot, ScriptedServer, endless, entries, nothing_more_after_greeting, serving
from tests.rhdlink import recorded
from tests.waiting import until

pytestmark = pytest.mark.simulated_time


class Recording:
    """Handshake and batches of a recorded server."""

    def __init__(self, name: str) -> None:
        data = recorded.from_server(name)
        stream = ServerDecoder()
        stream.feed(data)
        assert stream.take_handshake() is not None
        self.handshake = data[: stream.offset]
        self.batches: list[bytes] = []
        at = stream.offset
        while (batch := stream.take_batch()) is not None:
            self.batches.append(data[at : at + batch.size])
            at += batch.size


class Smr(Variables):
    tick = Read(Int32)
    encl = Read(Int32, unit="ticks", doc="left wheel")
    speedl = Write(Scaled(0.01, unit="m/s"))


def without_stamps(request: bytes) -> bytes:
    """Return a writer's request for one-word variables with all its time stamps set to 0."""
    cut = bytearray(request)
    for at in range(8, len(cut) - 2, 16):
        cut[at + 4 : at + 12] = bytes(8)
    return bytes(cut)


@pytest.fixture(autouse=True)
def leaves_no_thread() -> Iterator[None]:
    before = set(threading.enumerate())
    yield
    until(lambda: not set(threading.enumerate()) - before)


# -- recorded servers --------------------------------------------------------------------------


@pytest.mark.captures("rhd")
@pytest.mark.parametrize("name", ["reader64", "reader64naive", "reader32", "reader_orig2014", "reader64_with_master"])
def test_recorded_server_is_read_as_by_the_original_client(name: str) -> None:
    recording, tables = Recording(name), recorded.printed(name)

    def script(peer: Peer) -> None:
        peer.expect(b"ar")
        peer.send(recording.handshake)
        for batch in recording.batches:
            peer.expect(b"rree")
            peer.send(batch)
        assert peer.is_left()

    with ScriptedServer(script) as server, rhdlink.connect(server.address) as robot:
        for number, lines in enumerate(tables[:-1]):
            if number:
                robot.sync()
            for line in lines:
                assert np.atleast_1d(robot[line.name]).tolist() == line.values
                assert robot.stamp(line.name).seconds == line.seconds
                assert robot.updated(line.name) == line.updated
        assert robot.width == (4 if name == "reader64naive" else 2)
        # The original server sends a variable forever once it was set; only `fresh` shows that its value is not new.
        assert robot.updated("once")
        assert not robot.fresh("once")
        assert robot.fresh("tick")


@pytest.mark.captures("rhd")
@pytest.mark.parametrize("name", ["writer64", "writer64naive", "writer32", "writer_orig2014"])
def test_writer_sends_the_bytes_of_the_original_client(name: str) -> None:
    recording = Recording(name)
    width = 4 if name == "writer64naive" else 2
    asked = recorded.from_client(name)
    size = (len(asked) - 2) // 50

    def script(peer: Peer) -> None:
        peer.expect(b"aw")
        peer.send(recording.handshake)
        for number, batch in enumerate(recording.batches):
            theirs, ours = asked[2 + number * size :][:size], peer.read(size)
            at = 8
            for length in (1, 1, 4):  # all bytes except the time stamps, which differ
                theirs, ours = (
                    each[: at + 4] + bytes(4 * width) + each[at + 4 + 4 * width :] for each in (theirs, ours)
                )
                at += 4 * (1 + width + length)
            assert ours == theirs
            peer.send(batch)

    with ScriptedServer(script) as server, rhdlink.connect(server.address, access="w") as robot:
        assert robot.access == "w"
        for number in range(50):
            robot["speedl"] = 10 + number
            robot["speedr"] = -5 + number
            robot["cmdarr"] = [0, 0, 0, 1000 + number]
            assert robot.updated("speedl")
            robot.sync()
            assert not robot.updated("speedl")


@pytest.mark.captures("rhd")
def test_second_writer_is_denied_access() -> None:
    def script(peer: Peer) -> None:
        peer.expect(b"aw")
        peer.send(Recording("second_writer64").handshake)
        assert peer.is_left()

    with ScriptedServer(script) as server, pytest.raises(AccessDenied, match="refuses write access"):
        rhdlink.connect(server.address, access="w")


@pytest.mark.captures("rhd")
def test_second_writer_can_fall_back_to_reading() -> None:
    recording = Recording("reader64")

    def refuse(peer: Peer) -> None:
        peer.expect(b"aw")
        peer.send(Recording("second_writer64").handshake)
        assert peer.is_left()  # the original would nevertheless serve the client as a writer

    def serve(peer: Peer) -> None:
        peer.expect(b"ar")
        peer.send(recording.handshake)
        peer.expect(b"rree")
        peer.send(recording.batches[0])

    with (
        ScriptedServer(refuse, serve) as server,
        rhdlink.connect(server.address, access="w", fallback="r") as robot,
    ):
        assert robot.access == "r"
        robot.sync()
        with pytest.raises(AccessDenied, match="speedl cannot be set with access 'r'"):
            robot["speedl"] = 5


def test_client_accepts_less_access_than_requested() -> None:
    robot_side = Robot()

    def script(peer: Peer) -> None:
        peer.expect(b"aw")
        peer.send(robot_side.database.encode_handshake("r"))

    with ScriptedServer(script, script) as server:
        with rhdlink.connect(server.address, access="w", fallback="r") as robot:
            assert robot.access == "r"
        with pytest.raises(AccessDenied):
            rhdlink.connect(server.address, access="w")


@pytest.mark.real_time
@pytest.mark.captures("rhd")
@pytest.mark.parametrize("name", ["late_first_sync64", "late_first_sync_orig2014"])
def test_first_sync_gets_its_own_reply_after_unsolicited_batch(name: str) -> None:
    """The unsolicited batch arrives before the first request: it is applied, and each sync gets its own reply."""
    recording = Recording(name)
    unasked, *answers = recording.batches
    is_connected, is_said = threading.Event(), threading.Event()

    def script(peer: Peer) -> None:
        peer.expect(b"ar")
        peer.send(recording.handshake)
        assert is_connected.wait(10)
        peer.send(unasked)
        is_said.set()
        for batch in answers:
            peer.expect(b"rree")
            peer.send(batch)

    with ScriptedServer(script) as server, rhdlink.connect(server.address) as robot:
        is_connected.set()
        assert is_said.wait(10)
        ticks = []
        for _ in answers:
            robot.sync()
            ticks.append(robot["tick"])
    stream = ServerDecoder()
    stream.feed(recording.handshake + b"".join(answers))
    assert stream.take_handshake() is not None
    expected = []
    while (batch := stream.take_batch()) is not None:
        expected += [int(value[0]) for identity, _, value in entries(batch.data[-1]) if identity == 0]
    assert ticks == expected


@pytest.mark.captures("rhd")
def test_client_continues_after_a_corrupted_batch() -> None:
    """Threads of the server mixed tables of another client into the last reply; the tables contain nothing new."""
    recording = Recording("race_corrupted_reader64")

    def script(peer: Peer) -> None:
        peer.expect(b"ar")
        peer.send(recording.handshake)
        for batch in recording.batches:
            peer.expect(b"rree")
            peer.send(batch)

    with ScriptedServer(script) as server, rhdlink.connect(server.address) as robot:
        before = 0
        for _ in recording.batches:
            robot.sync()
            assert robot["tick"] >= before
            before = robot["tick"]
    assert b"speedl\0" in recording.batches[-1]


# -- in step -----------------------------------------------------------------------------------


def test_unsolicited_batch_is_not_taken_as_the_reply(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The server sent the batch before it received the request, so the batch only looks like the reply."""
    side = Robot()
    is_settling = threading.Event()
    settle = Connection.settle

    def settle_slowly(link: Connection, period: float | None, end: float) -> None:
        if link._has_answered:
            is_settling.set()
        settle(link, period, end)

    monkeypatch.setattr(Connection, "settle", settle_slowly)
    monkeypatch.setattr(rhdlink.sync.connection, "_MOST_UNSOLICITED_WAIT", 10.0)  # enough for a slow machine

    def script(peer: Peer) -> None:
        side.greet(peer)
        peer.expect(b"rree")
        peer.send(side.batch(1))  # unsolicited
        assert is_settling.wait(10)
        peer.send(side.batch(2))  # the reply, one tick later
        for tick in range(3, 7):
            peer.expect(b"rree")
            assert peer.hears_nothing()
            peer.send(side.batch(tick))

    with ScriptedServer(script) as server, rhdlink.connect(server.address, Smr) as robot:
        robot.sync()
        assert robot.tick == 1
        for tick in range(3, 7):
            robot.sync()
            assert robot.tick == tick


def test_each_sync_sends_exactly_one_request() -> None:
    side = Robot()

    def script(peer: Peer) -> None:
        side.greet(peer)
        for tick in range(1, 6):
            peer.expect(b"rree")
            assert peer.hears_nothing()
            peer.send(side.batch(tick))
        assert peer.is_left()

    with ScriptedServer(script) as server, rhdlink.connect(server.address, Smr) as robot:
        for tick in range(1, 6):
            robot.sync()
            assert robot.tick == tick


def test_fresh_flags_stay_set_until_the_next_batch_arrives() -> None:
    """A sync takes a tick, during which the flags can be read."""
    side = Robot()
    is_asked, may_answer = threading.Event(), threading.Event()

    def script(peer: Peer) -> None:
        side.greet(peer)
        peer.expect(b"rree")
        peer.send(side.batch(1, encl=5))
        peer.expect(b"rree")
        is_asked.set()
        assert may_answer.wait(10)
        peer.send(side.batch(2))
        assert peer.is_left()

    with ScriptedServer(script) as server, rhdlink.connect(server.address, Smr) as robot:
        robot.sync()
        thread = threading.Thread(target=robot.sync)
        thread.start()
        assert is_asked.wait(10)
        flags = [ask("encl") for ask in (robot.fresh, robot.updated, robot.changed)]
        may_answer.set()
        thread.join(10)
        assert flags == [True] * 3
        assert not robot.fresh("encl")


def test_value_set_in_the_loss_callback_is_sent(monkeypatch: pytest.MonkeyPatch) -> None:
    with (
        ScriptedServer(lambda peer: Robot().greet(peer, "w")) as server,
        rhdlink.connect(server.address, Smr, access="w") as robot,
    ):
        tell = Subscribers.tell

        def stop(subscribers: Subscribers, event: ConnectionEvent) -> None:
            if event.state is ConnectionState.LOST:
                robot.speedl = 0
            tell(subscribers, event)

        monkeypatch.setattr(Subscribers, "tell", stop)
        robot.speedl = 1
        with pytest.raises(ConnectionLost):
            robot.sync()
        assert robot.updated("speedl")  # still to be sent


def closed_while_it_syncs(robot: Smr, has_begun: threading.Event) -> BaseException:
    """Return the exception that `sync` raises in another thread if the robot is closed during the sync."""
    raised: list[BaseException] = []

    def sync() -> None:
        try:
            robot.sync()
        except BaseException as error:
            raised.append(error)

    thread = threading.Thread(target=sync)
    thread.start()
    assert has_begun.wait(10)
    robot.close()
    thread.join(10)
    (error,) = raised
    return error


def test_robot_stays_closed_when_closed_during_a_reconnect() -> None:
    """Another thread is reconnecting at the time of the close."""
    is_greeted = threading.Event()

    def second(peer: Peer) -> None:
        peer.expect(b"ar")
        is_greeted.set()
        assert peer.is_left()

    with ScriptedServer(lambda peer: Robot().greet(peer), second) as server:
        robot = rhdlink.connect(server.address, Smr)
        with pytest.raises(ConnectionLost):
            robot.sync()
        assert type(closed_while_it_syncs(robot, is_greeted)) is Closed
        assert robot.connection is ConnectionState.CLOSED


def test_robot_does_not_reconnect_after_close() -> None:
    """The robot was never used before. A new connection would fail the test, because no script accepts it."""
    with ScriptedServer(lambda peer: Robot().greet(peer)) as server:
        robot = rhdlink.connect(server.address, Smr)
        robot.close()
        uses: list[Callable[[], object]] = [
            robot.sync,
            robot.background,
            lambda: robot.subscribe(print),
            lambda: robot.subscribe_connection(print),
        ]
        for use in uses:
            with pytest.raises(Closed):
                use()


def test_fresh_flags_cover_all_batches_of_a_sync() -> None:
    side = Robot()
    is_said = threading.Event()

    def script(peer: Peer) -> None:
        side.greet(peer)
        peer.send(side.batch(1, encl=5))
        is_said.set()
        peer.expect(b"rree")
        peer.send(side.batch(2))
        peer.expect(b"rree")
        peer.send(side.batch(3))

    with ScriptedServer(script) as server, rhdlink.connect(server.address, Smr) as robot:
        assert not robot.fresh("encl")
        assert is_said.wait(10)
        robot.sync()
        assert robot.encl == 5
        assert robot.fresh("encl")
        assert robot.updated("encl")
        assert robot.changed("encl")
        robot.sync()
        assert not robot.fresh("encl")
        assert not robot.updated("encl")


def test_late_reply_is_received_before_the_next_request() -> None:
    side = Robot()
    go_on = threading.Event()

    def script(peer: Peer) -> None:
        side.greet(peer, "w")
        assert without_stamps(peer.read(26)) == side.write(speedl=1)
        assert go_on.wait(10)
        assert peer.hears_nothing()
        peer.send(side.batch(1))
        # Only the newest value that was set meanwhile is sent, and only now.
        assert without_stamps(peer.read(26)) == side.write(speedl=300)
        peer.send(side.batch(2))

    with ScriptedServer(script) as server, rhdlink.connect(server.address, Smr, access="w") as robot:
        robot.speedl = 0.01
        with pytest.raises(LinkTimeout):
            robot.sync(timeout=0.05)
        for centimetres in (100, 200, 300):
            robot.speedl = centimetres / 100
            with pytest.raises(LinkTimeout):
                robot.sync(timeout=0.02)
        assert robot.connection is ConnectionState.CONNECTED
        go_on.set()
        robot.sync()
        assert robot.tick == 2


# -- values ------------------------------------------------------------------------------------


def test_values_are_read_and_set_by_name() -> None:
    side = Robot()
    side.database = Database([SymbolRow("tick", 1), SymbolRow("line", 3)], side.database.write.rows)
    side.database.read.set(1, [1, 2, 3])
    with (
        ScriptedServer(serving(side, "w", 1)) as server,
        rhdlink.connect(f"rhd://{server.address}", access="w") as robot,
    ):
        assert type(robot) is Variables
        robot.sync()
        value = robot["line"]
        assert value.dtype == np.int32
        assert (value.tolist(), value.flags.writeable) == ([1, 2, 3], False)
        assert (robot["tick"], type(robot["tick"]), int(robot["tick"])) == (1, int, 1)
        assert robot.stamp("tick") == (1000, 10_000)
        assert "tick" in robot
        assert "speedl" in robot
        assert "nothing" not in robot
        robot["speedr"] = np.int64(-7)
        assert robot["speedr"] == -7
        for use in (lambda: robot["nothing"], lambda: robot.stamp("nothing"), lambda: robot.fresh("nothing")):
            with pytest.raises(NotThere, match="no variable 'nothing'"):
                use()
        with pytest.raises(NotThere, match="no write variable 'tick'; it is a read variable"):
            robot["tick"] = 1
        for bad in (2**31, 1.5, [1, 2], "x"):
            with pytest.raises(BadValue, match="speedl: "):
                robot["speedl"] = bad


def test_values_are_read_and_set_by_declaration() -> None:
    side = Robot()
    with ScriptedServer(serving(side, "w", 1)) as server, rhdlink.connect(server.address, Smr, access="w") as robot:
        assert type(robot) is Smr
        robot.speedl = 0.5
        assert robot["speedl"] == 50
        robot.sync()
        assert robot.tick == 1
        with pytest.raises(LocalError, match="encl is a read variable; only the robot can set it"):
            robot.encl = 5


def test_reader_cannot_set_values() -> None:
    with (
        ScriptedServer(serving(Robot())) as server,
        rhdlink.connect(server.address, Smr) as robot,
        pytest.raises(AccessDenied, match="speedl cannot be set"),
    ):
        robot.speedl = 0.5


def test_all_missing_variables_are_in_one_error() -> None:
    class Wishes(Variables):
        tick = Read(Int32)
        encl = Write(Int32)
        speedl = Write(Int32, 2)
        wings = Read(Int32)

    def script(peer: Peer) -> None:
        Robot().greet(peer)
        assert peer.is_left()

    with ScriptedServer(script) as server, pytest.raises(WrongVariables) as caught:
        rhdlink.connect(server.address, Wishes)
    assert caught.value.differences == (
        "encl is a read variable, declared as write",
        "speedl has 1 words, declared as 2 (<Write(Int32, 2) speedl>)",
        "there is no read variable wings",
    )


def test_variables_are_shown_as_a_table() -> None:
    side = Robot(read=("tick", "encl", "<b>bold</b>"))
    side.database.read.set(0, 41, TimeStamp(5, 6))
    with ScriptedServer(serving(side)) as server, rhdlink.connect(server.address, Smr) as robot:
        names = [(each.name, each.direction, each.identity) for each in robot.variables]
        assert names == [
            ("tick", "r", 0),
            ("encl", "r", 1),
            ("<b>bold</b>", "r", 2),
            ("speedl", "w", 0),
            ("speedr", "w", 1),
        ]
        tick, encl, *_, speedl, speedr = robot.variables
        assert (tick.value, tick.stamp, tick.length) == (41, (5, 6), 1)
        assert (encl.unit, encl.doc) == ("ticks", "left wheel")
        assert type(speedl.value) is float
        assert speedr.value == 0
        shown = robot._repr_html_()
        assert "&lt;b&gt;bold&lt;/b&gt;" in shown
        assert "<b>" not in shown
        assert "5.000006" in shown
        assert "3 read and 2 write variables" in shown
        assert server.address in repr(robot)
    assert repr(Smr()) == "<Smr, not connected>"
    assert "not connected" in Smr()._repr_html_()
    assert "<td>" not in Smr()._repr_html_()
    with pytest.raises(LocalError, match="is not connected"):
        _ = Smr()["tick"]
    Smr().close()


# -- connections that fail ---------------------------------------------------------------------


def nothing_more(peer: Peer) -> None:
    assert peer.is_left()


@pytest.mark.parametrize(
    ("says", "error", "reason"),
    [
        (b"", LinkTimeout, "the handshake did not arrive in time; received 0 bytes of it"),
        (b"artw", LinkTimeout, "the handshake did not arrive in time; received 4 bytes of it"),
        (b"SSH-2.0-OpenSSH\r\n", WrongPeer, "is not an RHD server"),
        (b"ar" + b"tr\0\0\0\0", PacketError, "expected 'tw'"),
        (b"artw\x7f\xff\xff\xff", PacketError, "counts 2147483647"),
    ],
)
def test_connect_raises_the_reason_of_a_failed_handshake(says: bytes, error: type[Exception], reason: str) -> None:
    def script(peer: Peer) -> None:
        peer.expect(b"ar")
        peer.send(says)
        assert peer.is_left()

    with ScriptedServer(script) as server, pytest.raises(error, match=reason):
        rhdlink.connect(server.address, timeout=0.2 if error is LinkTimeout else 10)


def test_connect_suggests_that_all_client_slots_are_in_use() -> None:
    with (
        ScriptedServer(lambda peer: None) as server,
        pytest.raises(ConnectFailed, match=r"before sending a byte; are all its client slots in use\?"),
    ):
        rhdlink.connect(server.address)


def test_connect_raises_when_the_server_closes_early() -> None:
    def script(peer: Peer) -> None:
        peer.expect(b"ar")
        peer.send(b"artw\0\0")

    with ScriptedServer(script) as server, pytest.raises(ConnectionLost, match="closed the connection"):
        rhdlink.connect(server.address)


def test_connect_raises_when_no_server_listens() -> None:
    with ScriptedServer() as server:
        pass
    with pytest.raises(ConnectFailed):
        rhdlink.connect(server.address)


@pytest.mark.parametrize("text", ["", " ", "a b", "http://x", "host:0", "host:65536", "host:x", "rhd://", "h/p", "u@h"])
def test_connect_rejects_invalid_addresses(text: str) -> None:
    with pytest.raises(BadAddress):
        rhdlink.connect(text)


def test_addresses_are_parsed_and_printed() -> None:
    assert parse_address(" smr12 ") == Address("smr12", 24902)
    assert parse_address("rhd://[::1]:8001") == Address("::1", 8001)
    assert (str(Address("::1", 1)), str(Address("smr", 1))) == ("[::1]:1", "smr:1")


@pytest.mark.parametrize(
    ("arguments", "options", "text"),
    [
        (("localhost",), {"access": "x"}, "access='x'; expected 'r' or 'w'"),
        (("localhost",), {"fallback": "w"}, "fallback='w'; expected None or 'r'"),
        (("localhost",), {"unsent": "maybe"}, "unsent='maybe'; expected 'discard' or 'send'"),
        (("localhost",), {"timeout": 0}, "timeout=0; expected a positive number of seconds"),
        (("localhost",), {"timeout": "5"}, "timeout='5'; expected a positive number of seconds"),
        (("localhost",), {"timeout": True}, "timeout=True; expected a positive number of seconds"),
        (("localhost",), {"timeout": float("inf")}, "timeout=inf; expected a positive number of seconds"),
        (("localhost",), {"width": 3}, "width=3; expected None or 2 or 4"),
        (("localhost",), {"limits": 3}, r"limits=3; expected rhdlink.variables.Limits\(...\)"),
        (("localhost", Smr()), {}, "expected a class that derives from rhdlink.Variables"),
        (("localhost", int), {}, "expected a class that derives from rhdlink.Variables"),
        ((None,), {}, "invalid address None; expected a host and a port, as in localhost:24902"),
        ((24902,), {}, "invalid address 24902; expected a host and a port, as in localhost:24902"),
        ((Path("drive.urlog"),), {}, "invalid address .*; to play a recording, use `rhdlink replay`"),
    ],
)
def test_connect_rejects_invalid_arguments(arguments: tuple[Any, ...], options: dict[str, Any], text: str) -> None:
    with pytest.raises((BadValue, BadAddress), match=text):
        rhdlink.connect(*arguments, **options)


def test_misspelt_names_get_a_suggestion() -> None:
    with ScriptedServer(serving(Robot(), "w")) as server, rhdlink.connect(server.address, Smr, access="w") as robot:
        with pytest.raises(NotThere, match="has no variable 'encI'; did you mean 'encl'"):
            _ = robot["encI"]
        with pytest.raises(NotThere, match="has no write variable 'speedL'; did you mean 'speedl'"):
            robot["speedL"] = 5
        with pytest.raises(NotThere, match="Smr does not declare speedL; did you mean 'speedl'"):
            robot.speedL = 5
        assert list(robot) == robot._ipython_key_completions_() == ["tick", "encl", "speedl", "speedr"]


@pytest.mark.parametrize(
    ("arguments", "options", "text"),
    [
        ((3,), {}, "callback=3; expected a function"),
        ((print,), {"policy": "latest"}, "policy"),
        ((print,), {"lifespan": 0}, "lifespan=0; expected a positive number of seconds"),
        ((print,), {"deadline": -1}, "deadline=-1; expected a positive number of seconds"),
        ((print,), {"deadline": 1, "on_deadline": 3}, "on_deadline=3; expected a function"),
        ((print,), {"on_deadline": print}, "on_deadline was given without a deadline"),
        ((print, "wings"), {}, "has no variable 'wings'"),
    ],
)
def test_subscribe_rejects_invalid_arguments(arguments: tuple[Any, ...], options: dict[str, Any], text: str) -> None:
    with (
        ScriptedServer(nothing_more_after_greeting) as server,
        rhdlink.connect(server.address) as robot,
        pytest.raises((BadValue, NotThere), match=text),
    ):
        robot.subscribe(*arguments, **options)


# -- connections that end ----------------------------------------------------------------------


@pytest.mark.parametrize("ending", [Peer.reset, lambda peer: None, lambda peer: peer.send(b"dr\0\0\0\xff")])
def test_client_reconnects_and_finds_variables_by_name(ending: Callable[[Peer], object]) -> None:
    before, after = Robot(), Robot(read=("new", "encl", "tick"), write=("speedr", "new", "speedl"))

    def first(peer: Peer) -> None:
        before.greet(peer, "w")
        peer.read(26)
        peer.send(before.batch(1, encl=7))
        peer.read(26)
        ending(peer)

    def second(peer: Peer) -> None:
        after.greet(peer, "w")
        assert without_stamps(peer.read(26)) == after.write(speedl=300)
        peer.send(after.batch(5, encl=8))
        peer.expect(b"rwdw\0\0\0\0ee")
        peer.send(after.batch(6))

    with ScriptedServer(first, second) as server, rhdlink.connect(server.address, Smr, access="w") as robot:
        states: list[ConnectionState] = []
        robot.subscribe_connection(lambda event: states.append(event.state))
        robot.speedl = 1
        robot.sync()
        assert (robot.encl, robot.reconnects) == (7, 0)
        robot.speedl = 2
        with pytest.raises((ConnectionLost, PacketError)):
            robot.sync()
        assert robot.connection is ConnectionState.LOST
        robot.speedl = 3
        robot.sync()
        assert (robot.encl, robot.tick, robot.reconnects) == (8, 5, 1)
        assert "new" in robot
        robot.sync()
        assert robot.tick == 6
    assert states == [
        ConnectionState.LOST,
        ConnectionState.CONNECTING,
        ConnectionState.CONNECTED,
        ConnectionState.CLOSED,
    ]


def test_unsent_values_are_discarded_when_the_connection_is_lost(caplog: pytest.LogCaptureFixture) -> None:
    side = Robot()

    def first(peer: Peer) -> None:
        side.greet(peer, "w")

    def second(peer: Peer) -> None:
        side.greet(peer, "w")
        peer.expect(b"rwdw\0\0\0\0ee")
        peer.send(side.batch(1))

    with ScriptedServer(first, second) as server, rhdlink.connect(server.address, Smr, access="w") as robot:
        robot.speedl = 1
        robot["speedr"] = 2
        with pytest.raises(ConnectionLost):
            robot.sync()
        assert not robot.updated("speedl")
        robot.sync()
        assert robot.discarded == 2
    assert "lost the values set for 'speedl', 'speedr': the connection was lost" in caplog.text


def test_values_are_discarded_with_each_failed_reconnect(
    caplog: pytest.LogCaptureFixture,
) -> None:
    """A value is sent by the next sync or never, however long the robot is away."""
    side = Robot()

    def leaves(peer: Peer) -> None:
        peer.expect(b"aw")

    def last(peer: Peer) -> None:
        side.greet(peer, "w")
        assert without_stamps(peer.read(26)) == side.write(speedl=900)
        peer.send(side.batch(1))

    scripts = [lambda peer: side.greet(peer, "w"), leaves, leaves, leaves, last]
    with ScriptedServer(*scripts) as server, rhdlink.connect(server.address, Smr, access="w") as robot:
        for metres in (1, 2, 3, 4):
            robot.speedl = metres
            with pytest.raises((ConnectionLost, ConnectFailed)):
                robot.sync()
        assert robot.discarded == 4
        robot.speedl = 9
        assert robot.updated("speedl")
        robot.sync()
        assert robot.discarded == 4
    # The outage is logged once, however many attempts failed.
    assert caplog.text.count("lost the values set") == 1


def test_values_can_be_kept_until_they_are_sent() -> None:
    side = Robot()

    def leaves(peer: Peer) -> None:
        peer.expect(b"aw")

    def last(peer: Peer) -> None:
        side.greet(peer, "w")
        assert without_stamps(peer.read(42)) == side.write(speedl=100, speedr=7)
        peer.send(side.batch(1))

    scripts = [lambda peer: side.greet(peer, "w"), leaves, last]
    with (
        ScriptedServer(*scripts) as server,
        rhdlink.connect(server.address, Smr, access="w", unsent="send") as robot,
    ):
        with pytest.raises(ConnectionLost):
            robot.sync()
        robot.speedl = 1
        with pytest.raises(ConnectFailed):
            robot.sync()
        robot["speedr"] = 7
        robot.sync()
        assert robot.discarded == 0


def test_values_that_arrived_are_not_counted_as_discarded() -> None:
    side = Robot()

    def script(peer: Peer) -> None:
        side.greet(peer, "w")
        for tick in (1, 2):
            peer.read(26 if tick == 1 else 10)
            peer.send(side.batch(tick))

    with ScriptedServer(script) as server, rhdlink.connect(server.address, Smr, access="w") as robot:
        robot.speedl = 1
        robot.sync()
        robot.sync()
        with pytest.raises(ConnectionLost):
            robot.sync()
        assert robot.discarded == 0


def test_kept_value_counts_as_discarded_if_variable_is_removed(caplog: pytest.LogCaptureFixture) -> None:
    before, after = Robot(), Robot(write=("speedl",))

    def last(peer: Peer) -> None:
        after.greet(peer, "w")
        peer.expect(b"rwdw\0\0\0\0ee")
        peer.send(after.batch(1))

    scripts = [lambda peer: before.greet(peer, "w"), last]
    with (
        ScriptedServer(*scripts) as server,
        rhdlink.connect(server.address, access="w", unsent="send") as robot,
    ):
        with pytest.raises(ConnectionLost):
            robot.sync()
        robot["speedr"] = 7
        robot.sync()
        assert robot.discarded == 1
    assert "lost the values set for 'speedr': the robot no longer has these variables" in caplog.text


@pytest.mark.real_time
@platforms.needs_fork
def test_forked_child_cannot_sync_or_end_the_connection() -> None:
    with ScriptedServer(endless(Robot())) as server, rhdlink.connect(server.address, Smr) as robot:
        robot.sync()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)  # forking with threads is intended here
            child = os.fork()
        if not child:  # pragma: no cover
            status = 1
            try:
                robot.sync()
            except LocalError as error:
                status = 0 if "by the parent process" in str(error) else 2
            with contextlib.suppress(BaseException):
                robot.close()
            os._exit(status)
        assert os.waitpid(child, 0)[1] == 0
        for _ in range(3):
            robot.sync()


def test_reconnect_rejects_a_robot_with_other_variables() -> None:
    def first(peer: Peer) -> None:
        Robot().greet(peer)

    def second(peer: Peer) -> None:
        Robot(read=("tick",)).greet(peer)
        assert peer.is_left()

    def third(peer: Peer) -> None:
        serving(Robot(), syncs=1)(peer)

    with ScriptedServer(first, second, third) as server, rhdlink.connect(server.address, Smr) as robot:
        with pytest.raises(ConnectionLost):
            robot.sync()
        with pytest.raises(WrongVariables, match="no read variable encl"):
            robot.sync()
        assert robot.connection is ConnectionState.LOST
        robot.sync()
        assert robot.tick == 1


def test_close_interrupts_a_sync_in_another_thread() -> None:
    is_asked = threading.Event()

    def script(peer: Peer) -> None:
        Robot().greet(peer)
        peer.expect(b"rree")
        is_asked.set()
        assert peer.is_left()

    with ScriptedServer(script) as server:
        robot = rhdlink.connect(server.address, Smr)
        assert type(closed_while_it_syncs(robot, is_asked)) is Closed
        robot.close()
        assert robot.connection is ConnectionState.CLOSED
        for use in (robot.sync, robot.background, lambda: robot.subscribe(print)):
            with pytest.raises(Closed):
                use()
        assert robot.tick == 0  # the last values can still be read


@pytest.mark.parametrize("timeout", [0, -1, float("nan")])
def test_sync_rejects_invalid_timeouts(timeout: float) -> None:
    with (
        ScriptedServer(nothing_more_after_greeting) as server,
        rhdlink.connect(server.address) as robot,
        pytest.raises(BadValue, match="expected a positive number"),
    ):
        robot.sync(timeout)


@pytest.mark.slow
def test_sync_ends_even_if_the_server_floods() -> None:
    side = Robot()

    def script(peer: Peer) -> None:
        side.greet(peer)
        try:
            while True:
                peer.send(side.batch(1) * 100)
        except ConnectionError:
            pass

    with ScriptedServer(script) as server, rhdlink.connect(server.address, Smr) as robot:
        # The sync returns with the received data or times out.
        for _ in range(3):
            with contextlib.suppress(LinkTimeout):
                robot.sync(timeout=0.2)
        assert robot.tick == 1


# -- subscriptions ----------------------------------------------------------------------------


def test_close_ends_the_background_and_delivers_queued_updates() -> None:
    with ScriptedServer(endless(Robot())) as server:
        robot = rhdlink.connect(server.address, Smr)
        ticks: list[int] = []
        robot.subscribe(lambda update: ticks.append(update["tick"]), "tick", policy=rhdlink.block)
        background = robot.background()
        until(lambda: ticks)
        robot.close()
        assert not background.is_running
        assert ticks == list(range(1, background.syncs + 1))


def test_concurrent_syncs_deliver_each_update_once_in_order(monkeypatch: pytest.MonkeyPatch) -> None:
    changes = Replica.changes

    def after_a_moment(self: Replica, *arguments: Any) -> dict[str, rhdlink.variables.Change]:
        time.sleep(0.001)  # enough time for a sync in another thread
        return changes(self, *arguments)

    monkeypatch.setattr(Replica, "changes", after_a_moment)
    with rhdlink.Host([Turtle()], port=0, pacing="lockstep") as host, rhdlink.connect(host.address) as robot:
        ticks: list[int] = []
        robot.subscribe(lambda update: ticks.append(update["tick"]), "tick", policy=rhdlink.block)

        def sync() -> None:
            for _ in range(30):
                robot.sync()

        threads = [threading.Thread(target=sync) for _ in range(3)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join(30)
        until(lambda: len(ticks) >= 90)
    assert ticks == list(range(1, 91))


def test_update_older_than_its_lifespan_is_dropped() -> None:
    is_in, go_on = threading.Event(), threading.Event()
    ticks: list[int] = []

    def slow(update: rhdlink.variables.Update) -> None:
        ticks.append(update["tick"])
        is_in.set()
        assert go_on.wait(10)

    with ScriptedServer(endless(Robot())) as server, rhdlink.connect(server.address) as robot:
        updates = robot.subscribe(slow, "tick", lifespan=0.05)
        robot.sync()
        assert is_in.wait(10)
        robot.sync()
        old = robot.received.monotonic
        until(lambda: time.monotonic() > old + 0.1)
        go_on.set()
        until(lambda: updates.stats.expired == 1)
        robot.sync()
        until(lambda: len(ticks) == 2)
    assert ticks == [1, 3]
    stats = updates.stats
    assert (stats.delivered, stats.dropped, stats.expired) == (2, 1, 1)


def test_missed_deadline_is_reported() -> None:
    missed = threading.Event()
    with ScriptedServer(nothing_more_after_greeting) as server, rhdlink.connect(server.address) as robot:
        robot.subscribe(print, deadline=0.01, on_deadline=lambda age: missed.set())
        assert missed.wait(10)
