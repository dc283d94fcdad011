"""`robot.gripper`: its protocol with random bytes, the simulated gripper, and scripted replies."""

from __future__ import annotations

import contextlib
import socket
import threading
from collections.abc import Callable, Iterator

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

import urlink
from linkcore.errors import BadValue, Closed, ConnectFailed, LinkError, LinkTimeout, LocalError, PacketError, WrongPeer
from tests.fakes.clock import Clock
from tests.waiting import threads_named, until
from urlink.protocol.gripper.client import Gripper, ObjectStatus
from urlink.protocol.gripper.protocol import READABLE, WRITABLE, GripperProtocol, get_line, set_line, value_of
from urlink.protocol.gripper.robotiq import GripperFault
from urlink.simulator import Controller
from urlink.simulator.robot.gripper import SimulatedGripper

pytestmark = pytest.mark.simulated_time

# -- the protocol ----------------------------------------------------------------------------------------


@pytest.mark.property
@given(st.sampled_from(READABLE), st.integers(0, 255), st.sampled_from(["\n", "\r\n", ""]), st.integers(0, 9))
def test_gripper_value_does_not_depend_on_chunking_or_line_end(name: str, value: int, end: str, at: int) -> None:
    protocol = GripperProtocol()
    assert protocol.is_in_step
    assert protocol.ask(get_line(name)) == f"GET {name}\n".encode()
    data = f"{name} {value}{end}".encode()
    found = protocol.feed(data[:at]) if data[:at] else None
    assert found is None or at >= len(data)
    found = found or (protocol.feed(data[at:]) if data[at:] else None)
    if found is None:
        assert protocol.settling is not None
        found = protocol.feed(b"")  # no more bytes have arrived
    assert value_of(name, found or "") == value
    assert protocol.is_in_step
    # The acknowledgement of a command has no line end, or its line end arrives later.
    assert protocol.ask(set_line({"POS": value, "GTO": 1})) == f"SET POS {value} GTO 1\n".encode()
    assert [protocol.feed(piece) for piece in (b"a", b"ck")] == [None, "ack"]
    assert protocol.feed(end.encode()) is None
    assert protocol.is_in_step


@pytest.mark.property
@given(st.booleans(), st.lists(st.binary(max_size=300), max_size=5))
def test_any_bytes_give_reply_or_wrong_peer(is_set: bool, pieces: list[bytes]) -> None:
    protocol = GripperProtocol()
    protocol.ask(set_line({"ACT": 1}) if is_set else get_line("POS"))
    for piece in [*pieces, b""]:
        try:
            reply = protocol.feed(piece)
        except WrongPeer:
            return
        if reply is not None:
            with contextlib.suppress(PacketError):
                assert value_of("POS", reply) is None or reply.startswith("POS ")
            return


def test_invalid_requests_are_rejected() -> None:
    for values, error in (
        ({}, "no variable to set"),
        ({"PRE": 1}, "'PRE' cannot be set"),
        ({"POS": 256}, "from 0 to 255"),
    ):
        with pytest.raises(BadValue, match=error):
            set_line(values)
    for value in (True, 1.0, -1):
        with pytest.raises(BadValue, match="POS is"):
            set_line({"POS": value})  # type: ignore[dict-item]
    with pytest.raises(BadValue, match="three capital letters"):
        get_line("POS\nSET ACT 1")
    protocol = GripperProtocol()
    protocol.ask(get_line("POS"))
    with pytest.raises(LocalError, match="out of step"):
        protocol.ask(get_line("POS"))


# -- the simulated gripper -------------------------------------------------------------------------------


class GripperMachine(RuleBasedStateMachine):
    """Random operations: registers stay in their ranges, and fingers never pass through an object."""

    def __init__(self) -> None:
        super().__init__()
        self.clock = Clock()
        self.gripper = SimulatedGripper(self.clock)
        self.object: tuple[int, bool] | None = None
        self.last = 0

    @rule(seconds=st.floats(0.0, 2.0))
    def wait(self, seconds: float) -> None:
        self.clock.sleep(seconds)
        assert abs(self.gripper.position - self.last) <= seconds * 450 + 1

    @rule(name=st.sampled_from(sorted(WRITABLE)), value=st.integers(0, 255))
    def set(self, name: str, value: int) -> None:
        assert self.gripper.reply(f"SET {name} {value}") == ("ack" if value <= WRITABLE[name] else "?")

    @rule(line=st.text("GSETPOACT 019", max_size=12))
    def send_line(self, line: str) -> None:
        self.gripper.reply(line)

    @rule(width=st.floats(0.0, 0.085), inside=st.booleans())
    def place(self, width: float, inside: bool) -> None:
        self.gripper.place(width, inside=inside)
        self.object = Gripper.position_of(width), inside

    @rule()
    def take_away(self) -> None:
        self.gripper.take_away()
        self.object = None

    @invariant()
    def registers_and_fingers_stay_in_range(self) -> None:
        values = {name: value_of(name, self.gripper.reply(f"GET {name}") or "") for name in READABLE}
        self.last = self.gripper.position
        assert values["OBJ"] in (0, 1, 2, 3)
        assert values["STA"] in (0, 1, 3)
        assert 0 <= self.last <= 255
        if self.object is not None:
            at, is_inside = self.object
            assert self.last >= at if is_inside else self.last <= at


GripperMachine.TestCase.settings = settings(stateful_step_count=20)
test_gripper_machine = pytest.mark.property(GripperMachine.TestCase)


def test_fingers_move_at_speeds_of_data_sheet() -> None:
    clock = Clock()
    gripper = SimulatedGripper(clock)
    gripper.reply("SET POS 255 GTO 1")
    assert gripper.reply("GET POS") == "POS 0"
    gripper.reply("SET ACT 1 GTO 0")
    clock.now += 1.0
    assert (gripper.reply("GET STA"), gripper.reply("GET OBJ")) == ("STA 1", "OBJ 0")
    gripper.reply("SET POS 0 GTO 1")
    assert gripper.reply("GET FLT") == "FLT 7"
    clock.now += 2.0
    assert gripper.is_active
    assert gripper.reply("GET FLT") == "FLT 0"
    for speed, seconds in ((255, 0.085 / 0.150), (0, 0.085 / 0.020)):
        gripper.reply(f"SET POS {255 if speed else 0} SPE {speed} GTO 1")
        clock.now += seconds - 0.01
        assert gripper.reply("GET OBJ") == "OBJ 0"
        clock.now += 0.02
        assert gripper.reply("GET OBJ") == "OBJ 3"


# -- the gripper of a user -------------------------------------------------------------------------------


def test_gripper_activates_moves_and_reports_faults() -> None:
    with Controller("UR5e", "5.11") as controller, urlink.connect(controller.address) as robot:
        gripper = robot.gripper
        assert not gripper.status().is_active
        with pytest.raises(GripperFault, match=r"not activated.*call activate\(\) first"):
            gripper.move(100)
        assert gripper.activate().is_active
        assert gripper.activate().position == 0  # activating an active gripper does nothing
        controller.gripper.place(width=0.05)
        held = gripper.close(speed=255, force=50)
        assert held.object_detected
        assert gripper.object_detected()
        assert held.position == gripper.position() == Gripper.position_of(0.05)
        assert held.opening() == pytest.approx(0.05, abs=0.001)
        assert controller.gripper.registers["FOR"] == 50
        controller.gripper.take_away()
        assert gripper.wait(5.0).object == ObjectStatus.AT_REQUEST
        assert gripper.position() == 255
        controller.gripper.place(width=0.05, inside=True)
        assert gripper.open().object == ObjectStatus.STOPPED_OPENING

        started = gripper.move(255, speed=0, wait=False)
        assert started.is_moving
        with pytest.raises(LinkTimeout, match=r"the fingers did not come to rest within 0\.05 s"):
            gripper.wait(0.05)
        gripper.stop()
        assert not gripper.wait(5.0).is_moving
        controller.gripper.fault = 10
        with pytest.raises(GripperFault, match="fault 10: the supply voltage is too low") as caught:
            gripper.open()
        assert caught.value.fault == 10
        controller.gripper.is_connected = False
        with pytest.raises(GripperFault, match="no gripper is connected to the controller"):
            gripper.status()
        controller.gripper.is_connected = True
        gripper.deactivate()
        assert not gripper.status().is_active
    with pytest.raises(Closed):
        gripper.position()


def test_program_uses_gripper_like_its_urcap() -> None:
    with Controller("UR5e", "5.11") as controller, urlink.connect(controller.address) as robot:
        program = robot.script.run(
            """def grip():
  socket_open("127.0.0.1", 63352, "gripper")
  socket_set_var("ACT", 1, "gripper")
  ack = socket_read_byte_list(3, "gripper", 1)
  textmsg(ack)
  textmsg("STA ", socket_get_var("STA", "gripper"))
  socket_close("gripper")
end"""
        )
        program.wait(10)
        assert program.texts == ("[3,97,99,107]", "STA 1")
        assert controller.gripper.registers["ACT"] == 1


def test_missing_gripper_raises() -> None:
    with Controller("UR5e", "5.11", gripper=False) as controller, urlink.connect(controller.address) as robot:
        with pytest.raises(ConnectFailed, match="needs its URCap"):
            robot.gripper.position()
        with pytest.raises(LocalError, match="gripper=False"):
            controller.gripper.place(0.0)
        with urlink.connect(controller.address, read_only=True) as reader, pytest.raises(LocalError, match="read_only"):
            _ = reader.gripper


# -- scripted replies ------------------------------------------------------------------------------------


@pytest.fixture
def answering() -> Iterator[Callable[[dict[str, bytes]], Gripper]]:
    """Return a function that makes a gripper whose replies are in a table; other lines are not answered."""
    closing: list[Callable[[], object]] = []

    def answering(replies: dict[str, bytes]) -> Gripper:
        listener = socket.create_server(("127.0.0.1", 0))

        def serve() -> None:
            while True:
                try:
                    link, _ = listener.accept()
                except OSError:
                    return
                with link, link.makefile("r") as lines:
                    for line in lines:
                        link.sendall(replies.get(line.strip(), b""))

        thread = threading.Thread(target=serve)
        thread.start()
        gripper = Gripper("127.0.0.1", listener.getsockname()[1], timeout=0.5)

        def close() -> None:
            gripper._disconnect()
            listener.shutdown(socket.SHUT_RDWR)
            listener.close()
            thread.join(10)
            assert not thread.is_alive()

        closing.append(close)
        return gripper

    yield answering
    for close in closing:
        close()


def test_abandoned_command_is_undone_by_stopping_fingers(
    answering: Callable[[dict[str, bytes]], Gripper],
) -> None:
    replies = {"GET STA": b"STA 3\n"}
    gripper = answering(replies)
    with pytest.raises(LinkTimeout, match="it might still be executed"):
        gripper.set(POS=255, GTO=1)
    with pytest.raises(LinkTimeout, match="the abandoned command 'gripper' might still"):
        gripper.set(SPE=9)
    replies.update({"SET GTO 0": b"ack\n", "SET SPE 9": b"ack\n"})
    until(lambda: not threads_named("undo"))
    gripper.set(SPE=9)


def test_replies_without_line_end_are_read_and_wrong_ones_raise(
    answering: Callable[[dict[str, bytes]], Gripper],
) -> None:
    gripper = answering({"GET POS": b"POS 12", "GET STA": b"OBJ 3\n", "SET ACT 1": b"no\n", "GET COU": b"COU 5\nmore"})
    assert gripper.position() == 12
    assert gripper.get("COU") == 5
    assert gripper.position() == 12  # over a new connection
    with pytest.raises(PacketError, match="'OBJ 3' is not a value of STA"):
        gripper.get("STA")
    with pytest.raises(GripperFault, match="and answered 'no'"):
        gripper.set(ACT=1)
    with pytest.raises(LinkTimeout, match=r"no reply to 'GET PRE' within 0\.5 s"):
        gripper.get("PRE")
    assert gripper.position() == 12


class FingersThatMove(dict[str, bytes]):
    """Replies of fingers that rest at 0, accept position 75 after `accepted` requests, and reach it after `arrived`."""

    def __init__(self, accepted: int, arrived: int) -> None:
        self._accepted = accepted
        self._arrived = arrived
        self._asked = 0

    def get(self, line: str, default: bytes = b"") -> bytes:  # type: ignore[override]
        requested = 0 if self._asked < self._accepted else 75
        is_moving = self._accepted <= self._asked < self._arrived
        self._asked += 1
        position = 72 if is_moving else requested
        values = {"STA": 3, "OBJ": 0 if is_moving else 3, "POS": position, "PRE": requested, "FLT": 0}
        name = line.removeprefix("GET ")
        return f"{name} {values[name]}\n".encode()


@pytest.mark.parametrize(
    ("accepted", "arrived"), [(accepted, accepted + way) for accepted in range(6) for way in (1, 2, 4, 5, 20)]
)
def test_status_at_rest_has_final_position(
    answering: Callable[[dict[str, bytes]], Gripper], accepted: int, arrived: int
) -> None:
    gripper = answering(FingersThatMove(accepted, arrived))
    for _ in range(6):
        status = gripper.status()
        if not status.is_moving and status.requested == 75:
            assert status.position == 75
    assert status.position == 75


def test_gripper_commands_of_threads_are_serialised(answering: Callable[[dict[str, bytes]], Gripper]) -> None:
    gripper = answering({f"GET {name}": f"{name} {at}\n".encode() for at, name in enumerate(READABLE)})
    wrong: list[LinkError | str] = []

    def ask(name: str) -> None:
        for _ in range(10):
            try:
                if gripper.get(name) != READABLE.index(name):
                    wrong.append(name)
            except LinkError as error:
                wrong.append(error)

    threads = [threading.Thread(target=ask, args=(name,)) for name in READABLE[:4]]
    for thread in threads:
        thread.start()
    until(lambda: not any(thread.is_alive() for thread in threads))
    assert not wrong
