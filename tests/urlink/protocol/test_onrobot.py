"""OnRobot RG2 and RG6: Modbus TCP frames, register blocks, and the gripper of a user."""

from __future__ import annotations

import asyncio
import contextlib
import dataclasses
from collections.abc import Iterator

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

import urlink
from linkcore.errors import BadValue, Closed, ConnectFailed, LinkTimeout, LocalError, PacketError, WrongPeer
from tests.fakes.clock import Clock
from tests.waiting import until
from urlink.protocol.gripper.modbus_tcp import (
    MOST_READ,
    MOST_WRITTEN,
    ModbusTcpProtocol,
    frame,
    read_line,
    rejection,
    split_frame,
    values_of,
    write_line,
)
from urlink.protocol.gripper.onrobot import (
    BUSY,
    COUNT,
    DETECTED,
    FLAGS,
    GRIP,
    LIMITS,
    OFFSET,
    SAFETY,
    STOP,
    UNIT,
    WIDTH,
    command_of,
    status_of,
)
from urlink.simulator import Controller
from urlink.simulator.interfaces.compute_box import ComputeBoxInterface
from urlink.simulator.robot.rg_gripper import SimulatedRGGripper
from urlink.simulator.state import Counters

pytestmark = pytest.mark.simulated_time

REGISTERS = st.lists(st.integers(0, 0xFFFF), min_size=1, max_size=MOST_WRITTEN)

# -- frames ----------------------------------------------------------------------------------------------


def test_requests_equal_frames_of_the_standard() -> None:
    protocol = ModbusTcpProtocol(UNIT)
    assert protocol.ask(read_line(258, 18)).hex(" ") == "00 01 00 00 00 06 41 03 01 02 00 12"
    assert protocol.feed(frame(1, UNIT, bytes((3, 36)) + bytes(36))) == " ".join(["0"] * 18)
    sent = protocol.ask(write_line(0, (200, 1100, 16))).hex(" ")
    assert sent == "00 02 00 00 00 0d 41 10 00 00 00 03 06 00 c8 04 4c 00 10"
    assert protocol.feed(bytes.fromhex("00 02 00 00 00 06 41 10 00 00 00 03")) == "written"
    protocol.ask(read_line(0, 1))
    reply = protocol.feed(frame(3, UNIT, b"\x83\x02"))
    assert (reply, values_of(reply or "")) == ("exception 2", None)
    assert rejection(reply or "") == "exception 2: a register does not exist"


@pytest.mark.property
@given(REGISTERS, st.integers(0, 255), st.integers(0, 200))
def test_register_values_do_not_depend_on_chunking(values: list[int], unit: int, at: int) -> None:
    protocol = ModbusTcpProtocol(unit)
    request = protocol.ask(read_line(0, len(values)))
    assert split_frame(request) == (1, unit, request[7:], b"")
    body = b"".join(value.to_bytes(2, "big") for value in values)
    reply = frame(1, unit, bytes((3, len(body))) + body)
    found = protocol.feed(reply[:at]) or protocol.feed(reply[at:])
    assert values_of(found or "") == tuple(values)
    assert protocol.is_in_step


@pytest.mark.property
@given(st.booleans(), st.lists(st.binary(max_size=300), max_size=5))
def test_any_bytes_give_reply_or_remote_error(is_write: bool, pieces: list[bytes]) -> None:
    protocol = ModbusTcpProtocol(UNIT)
    protocol.ask(write_line(0, (1, 2)) if is_write else read_line(0, 2))
    for piece in pieces:
        with contextlib.suppress(WrongPeer, PacketError):
            reply = protocol.feed(piece)
            assert reply is None or reply == "written" or reply.startswith("exception") or len(reply.split()) == 2
            continue
        return


@pytest.mark.parametrize(
    ("body", "transaction", "error"),
    [
        (b"\x03\x04\x00\x01\x00\x02", 2, WrongPeer),
        (b"\x04\x04\x00\x01\x00\x02", 1, WrongPeer),
        (b"\x03\x02\x00\x01", 1, PacketError),
        (b"\x03\x04\x00\x01", 1, PacketError),
    ],
)
def test_reply_to_another_request_raises(body: bytes, transaction: int, error: type[Exception]) -> None:
    protocol = ModbusTcpProtocol(UNIT)
    protocol.ask(read_line(0, 2))
    with pytest.raises(error):
        protocol.feed(frame(transaction, UNIT, body))


def test_invalid_modbus_requests_are_rejected() -> None:
    for first, count in ((-1, 1), (0xFFFF, 2), (0, 0), (0, MOST_READ + 1)):
        with pytest.raises(BadValue):
            read_line(first, count)
    for values in ((), (-1,), (0x10000,), (0,) * (MOST_WRITTEN + 1)):
        with pytest.raises(BadValue):
            write_line(0, values)
    protocol = ModbusTcpProtocol(UNIT)
    with pytest.raises(BadValue, match="not a request"):
        protocol.ask("reset 0")
    protocol.ask(read_line(0, 1))
    with pytest.raises(LocalError, match="out of step"):
        protocol.ask(read_line(0, 1))


# -- register blocks -------------------------------------------------------------------------------------


@pytest.mark.property
@given(st.sampled_from(sorted(LIMITS)), st.floats(0.0, 1.0), st.floats(0.0, 1.0))
def test_command_registers_stay_within_limits(model: str, width: float, force: float) -> None:
    widest, strongest = LIMITS[model]
    registers = command_of(model, width * widest, force * strongest)
    assert registers[0] / 10.0 == pytest.approx(force * strongest, abs=0.051)
    assert registers[1] / 10_000.0 == pytest.approx(width * widest, abs=0.000051)
    assert registers[2] == GRIP
    assert write_line(0, registers)


@pytest.mark.property
@given(st.integers(-0x8000, 0x7FFF), st.integers(-0x8000, 0x7FFF), st.integers(0, 0x7F))
def test_status_of_any_registers(width: int, offset: int, flags: int) -> None:
    registers = [0] * COUNT
    registers[WIDTH], registers[OFFSET], registers[FLAGS] = width & 0xFFFF, offset & 0xFFFF, flags
    status = status_of(registers)
    assert (status.width, status.fingertip_offset) == (width / 10_000.0, offset / 10_000.0)
    assert (status.is_moving, status.object_detected) == (bool(flags & BUSY), bool(flags & DETECTED))
    assert status.fault == flags & 0b1101000


@pytest.mark.parametrize(("width", "force"), [(0.111, 20.0), (-0.001, 20.0), (0.05, 40.1), (0.05, -1.0), ("x", 1.0)])
def test_command_beyond_limits_is_rejected(width: float, force: float) -> None:
    with pytest.raises(BadValue, match=r"limits of an RG2|expected a number"):
        command_of("rg2", width, force)


# -- the simulated gripper -------------------------------------------------------------------------------


@dataclasses.dataclass
class Client:
    """Client of the simulated Compute Box, without a connection."""

    sent: bytes = b""
    is_open: bool = True
    pending: int = 0

    def send(self, packet: bytes) -> None:
        self.sent += packet

    def finish(self) -> None:
        self.is_open = False

    def drop(self) -> None:
        self.is_open = False


class RGMachine(RuleBasedStateMachine):
    """Random requests: fingers stay in their range, never pass an object, and every frame gets one reply."""

    def __init__(self) -> None:
        super().__init__()
        self.clock, self.client = Clock(), Client()
        self.gripper = SimulatedRGGripper("rg2", self.clock)
        self.receiver = ComputeBoxInterface(self.gripper, Counters()).receiver(self.client)
        self.object: tuple[float, bool] | None = None

    def ask(self, body: bytes) -> bytes:
        self.client.sent = b""
        self.receiver.feed(frame(7, UNIT, body))
        found = split_frame(self.client.sent)
        assert found is not None
        assert (found[0], found[1], found[3]) == (7, UNIT, b"")
        return found[2]

    @rule(seconds=st.floats(0.0, 1.0))
    def wait(self, seconds: float) -> None:
        before = self.gripper.width
        self.clock.sleep(seconds)
        assert abs(self.gripper.width - before) <= 0.1 * seconds + 1e-9

    @rule(first=st.integers(0, 3), values=st.lists(st.integers(0, 2000) | st.sampled_from([STOP, GRIP]), max_size=4))
    def write(self, first: int, values: list[int]) -> None:
        words = b"".join(value.to_bytes(2, "big") for value in values)
        head = bytes((16, 0, first, 0, len(values), len(words)))
        is_right = bool(values) and first + len(values) <= 3
        assert (self.ask(head + words)[0] == 16) == is_right

    @rule(body=st.binary(min_size=2, max_size=250))
    def send(self, body: bytes) -> None:
        assert self.ask(body)[0] & 0x7F == body[0] & 0x7F

    @rule(width=st.floats(0.0, 0.11), inside=st.booleans())
    def place(self, width: float, inside: bool) -> None:
        self.gripper.place(width, inside=inside)
        self.object = width, inside

    @rule()
    def take_away(self) -> None:
        self.gripper.take_away()
        self.object = None

    @invariant()
    def fingers_stay_in_range(self) -> None:
        reply = self.ask(bytes((3, 1, 2, 0, COUNT)))
        assert len(reply) == 2 + 2 * COUNT
        width = self.gripper.width
        assert 0.0 <= width <= 0.11
        if self.object is not None:
            at, is_inside = self.object
            assert width <= at + 1e-9 if is_inside else width >= at - 1e-9


RGMachine.TestCase.settings = settings(stateful_step_count=20)
test_rg_machine = pytest.mark.property(RGMachine.TestCase)


def test_compute_box_rejects_what_it_does_not_have() -> None:
    machine = RGMachine()
    assert machine.ask(bytes((3, 0, 200, 0, 1))) == b"\x83\x02"
    assert machine.ask(bytes((3, 1, 2, 0, 0))) == b"\x83\x03"
    assert machine.ask(bytes((4, 1, 2, 0, 1))) == b"\x84\x01"
    assert machine.ask(bytes((6, 0, 1, 0, 9))) == bytes((6, 0, 1, 0, 9))
    machine.receiver.feed(b"GET POS and more\n")
    assert not machine.client.is_open


# -- the gripper of a user -------------------------------------------------------------------------------


@pytest.fixture
def controller() -> Iterator[Controller]:
    with Controller("UR5e", "5.11", gripper="rg2") as controller:
        yield controller


def test_rg_gripper_moves_grips_and_stops(controller: Controller) -> None:
    with urlink.connect(controller.address) as robot:
        gripper = robot.gripper("rg2")
        assert gripper is robot.gripper("rg2")
        assert gripper.status() == (0.11, 0.0, False, False, 0)
        controller.rg_gripper.place(0.05)
        held = gripper.close(force=10.0)
        assert (held.width, held.object_detected, gripper.object_detected()) == (0.05, True, True)
        assert controller.rg_gripper.force == 10.0
        assert controller.rg_gripper.holds_object
        controller.rg_gripper.take_away()
        assert gripper.wait(5.0).width == 0.0
        assert controller.rg_gripper.force == 10.0
        controller.rg_gripper.place(0.08, inside=True)
        assert gripper.open().object_detected
        assert gripper.width() == 0.08
        assert controller.rg_gripper.force == 20.0
        controller.rg_gripper.take_away()
        gripper.wait()
        # A new motion replaces the running one, although a moving gripper ignores commands.
        assert gripper.close(wait=False).is_moving
        assert gripper.move(0.07).width == pytest.approx(0.07)
        gripper.close(wait=False)
        with pytest.raises(LinkTimeout, match=r"did not come to rest within 0\.05 s"):
            gripper.wait(0.05)
        gripper.stop()
        assert 0.0 < gripper.wait(1.0).width < 0.07
    with pytest.raises(Closed):
        gripper.width()
    with pytest.raises(Closed):
        robot.gripper("rg6")


def test_rg_gripper_refuses_before_sending(controller: Controller) -> None:
    with urlink.connect(controller.address) as robot:
        gripper = robot.gripper("rg2")
        for call in (
            lambda: gripper.move(0.12),
            lambda: gripper.move(0.05, force=41.0),
            lambda: gripper.close(wait=-1.0),
            lambda: robot.gripper("rg3", host="a"),  # type: ignore[call-overload]
            lambda: robot.gripper("vacuum", host="a"),  # type: ignore[call-overload]
            lambda: robot.gripper("rg2", unit=0),
            lambda: urlink.RGGripper("a", model="rg3"),  # type: ignore[arg-type]
        ):
            with pytest.raises(BadValue):
                call()
        assert controller.rg_gripper.read(0, 3) == [0, 0, 0]
    with urlink.connect(controller.address, read_only=True) as reader, pytest.raises(LocalError, match="read_only"):
        _ = reader.gripper


def test_rg_gripper_of_real_robot_needs_host() -> None:
    with Controller("UR5e", "5.11") as controller, urlink.connect(controller.address) as robot:
        with pytest.raises(BadValue, match=r"missing host.*host='192\.168\.1\.1'"):
            robot.gripper("rg6")
        closed = robot.gripper("rg6", host="127.0.0.1", port=9)
        with pytest.raises(ConnectFailed, match="Compute Box"):
            closed.width()
        with pytest.raises(LocalError, match="no RG2 or RG6 is mounted: the controller was made with gripper=True"):
            controller.rg_gripper.place(0.0)


@pytest.mark.parametrize("flag", SAFETY)
def test_triggered_safety_switch_raises_gripper_fault(controller: Controller, flag: int) -> None:
    with urlink.connect(controller.address) as robot:
        controller.rg_gripper.fault = flag
        with pytest.raises(urlink.GripperFault, match=SAFETY[flag]) as caught:
            robot.gripper("rg2").close()
        assert caught.value.fault == flag
        assert controller.rg_gripper.width == 0.11


def test_disconnected_rg_gripper_raises_gripper_fault(controller: Controller) -> None:
    with urlink.connect(controller.address) as robot:
        controller.rg_gripper.is_connected = False
        with pytest.raises(urlink.GripperFault, match="exception 11: the device behind the gateway"):
            robot.gripper("rg2").width()
        controller.rg_gripper.is_connected = True
        with pytest.raises(urlink.GripperFault, match="exception 11"):
            robot.gripper("rg2", unit=66).stop()


def test_abandoned_rg_motion_is_stopped(controller: Controller) -> None:
    port = controller.ports["onrobot"]
    gripper = urlink.RGGripper(controller.host, port, model="rg2", timeout=0.3)
    assert not gripper.status().is_moving
    controller.faults.stall(0.7, "onrobot")
    with pytest.raises(LinkTimeout, match="it might still be executed"):
        gripper._write(0, command_of("rg2", 0.0, 5.0), moves=True)
    until(lambda: controller.rg_gripper.width < 0.109)
    until(lambda: not gripper._undos.pending)
    stopped = controller.rg_gripper.width
    # Closing takes 1.1 s, and the controller hung for 0.7 s.
    assert stopped > 0.0
    assert not gripper.status().is_moving
    assert gripper.width() == pytest.approx(stopped, abs=0.0001)
    gripper._disconnect()


def test_address_mounts_the_gripper() -> None:
    with urlink.connect("sim://ur5e?gripper=rg6") as robot:
        assert robot.gripper("rg6").move(0.16).width == 0.16
        assert robot.controller.rg_gripper.model == "rg6"
    with pytest.raises(urlink.BadAddress, match="gripper='2fg7'; expected vacuum or rg2 or rg6"):
        urlink.connect("sim://?gripper=2fg7")
    with pytest.raises(BadValue, match="gripper='2fg7'"):
        Controller(gripper="2fg7")  # type: ignore[arg-type]


def test_rg_gripper_is_awaitable() -> None:
    async def main() -> None:
        async with urlink.connect_async("sim://ur5e?gripper=rg2") as robot:
            gripper = robot.gripper("rg2")
            robot.controller.rg_gripper.place(0.03)
            assert (await gripper.close()).object_detected
            assert await gripper.width() == 0.03

    asyncio.run(main())
