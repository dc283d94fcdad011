"""Serial line in the tool connector: its bytes, its settings, and a gripper that answers with Modbus RTU."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator

import pytest
from hypothesis import given
from hypothesis import strategies as st

import urlink
from urlink.simulator import Controller
from urlink.simulator.robot.gripper import ModbusGripper, SimulatedGripper, crc

pytestmark = pytest.mark.simulated_time


def of(text: str) -> bytes:
    return bytes.fromhex(text)


#: Examples from the manufacturer's manual of the 2F-85: reset, activate, status of an inactive gripper, close.
RESET = of("09 10 03 E8 00 03 06 00 00 00 00 00 00 73 30")
ACTIVATE = of("09 10 03 E8 00 03 06 01 00 00 00 00 00 72 E1")
DONE = of("09 10 03 E8 00 03 01 30")
STATUS = of("09 03 07 D0 00 01 85 CF")
CLOSE = of("09 10 03 E8 00 03 06 09 00 00 FF FF FF 42 29")


@pytest.fixture
def robot() -> Iterator[urlink.Robot]:
    with urlink.connect("sim://ur5e?firmware=5.11") as robot:
        yield robot


# -- the gripper, without the serial line -------------------------------------------------------------------------


def test_examples_of_the_manual_are_answered() -> None:
    now = 0.0
    gripper = SimulatedGripper(lambda: now)
    device = ModbusGripper(gripper)
    assert [frame[-2:] for frame in (RESET, ACTIVATE, STATUS, CLOSE)] == [
        crc(frame[:-2]) for frame in (RESET, ACTIVATE, STATUS, CLOSE)
    ]
    assert device(RESET) == DONE
    assert device(ACTIVATE) == DONE
    # The status without the object bits: activation was requested, and later it is complete.
    assert device(STATUS)[3] & 0x3F == 0x11
    now = 10.0
    assert device(STATUS)[3] & 0x3F == 0x31
    assert device(CLOSE) == DONE
    now = 20.0
    assert gripper.position == 255


@pytest.mark.parametrize(
    ("request_", "answer"),
    [
        ("09 05 03 E8 00 03", "09 85 01"),
        ("09 03 07 D1 00 03", "09 83 02"),
        ("09 03 07 D0 00 09", "09 83 03"),
        ("09 10 03 EA 00 02 04 00 00 00 00", "09 90 02"),
        ("09 10 03 E8 00 03 04 00 00 00 00", "09 90 03"),
    ],
)
def test_unsupported_request_gets_exception_reply(request_: str, answer: str) -> None:
    device = ModbusGripper(SimulatedGripper(lambda: 0.0))
    assert device(of(request_) + crc(of(request_))) == of(answer) + crc(of(answer))


def test_foreign_and_damaged_requests_get_no_reply() -> None:
    device = ModbusGripper(SimulatedGripper(lambda: 0.0))
    other = of("08 03 07 D0 00 01")
    assert device(other + crc(other)) == b""
    assert device(STATUS[:-1] + b"\0") == b""
    assert device(STATUS) != b""


@pytest.mark.property
@given(st.lists(st.sampled_from([STATUS, RESET, ACTIVATE, CLOSE]), max_size=4), st.integers(1, 9))
def test_replies_do_not_depend_on_chunking(frames: list[bytes], size: int) -> None:
    data = b"".join(frames)
    whole, parts = (ModbusGripper(SimulatedGripper(lambda: 0.0)) for _ in range(2))
    pieces = b"".join(parts(data[at : at + size]) for at in range(0, len(data), size))
    assert pieces == whole(data)


@pytest.mark.property
@given(st.binary(max_size=200))
def test_any_bytes_raise_no_error(data: bytes) -> None:
    ModbusGripper(SimulatedGripper(lambda: 0.0))(data)


# -- the serial line ------------------------------------------------------------------------------------------------


def test_gripper_answers_over_serial_line(robot: urlink.Robot) -> None:
    robot.io.set_tool_communication(baud_rate=115200, parity="none")
    serial = robot.tool_serial
    assert serial.ask(ACTIVATE, 8) == DONE
    assert serial.ask(STATUS, 7)[:3] == of("09 03 02")
    serial.write(STATUS)
    assert serial.read(3) + serial.read(4) == serial.ask(STATUS, 7)
    assert serial.discard() == b""


def test_robot_state_shows_serial_settings(robot: urlink.Robot) -> None:
    robot.io.set_tool_communication(baud_rate=19200, parity="even", stop_bits=2, rx_idle_chars=1.7, tx_idle_chars=0.0)
    info = robot.primary.of(urlink.packets.ToolCommunicationInfo).wait()
    shown = (info.is_enabled, info.baud_rate, info.parity, info.stop_bits, round(info.rx_idle_chars, 6))
    assert shown == (True, 19200, 2, 2, 1.7)
    robot.io.set_tool_communication(False)
    assert not robot.primary.of(urlink.packets.ToolCommunicationInfo).wait().is_enabled


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda robot: robot.io.set_tool_communication(baud_rate=1200), "baud_rate is 1200; expected one of 9600"),
        (lambda robot: robot.io.set_tool_communication(parity="mark"), "parity is 'mark'; expected one of none"),
        (lambda robot: robot.io.set_tool_communication(stop_bits=3), "stop_bits is 3"),
        (lambda robot: robot.io.set_tool_communication(rx_idle_chars=0.5), "rx_idle_chars is 0.5"),
        (lambda robot: robot.tool_serial.write(b""), "at least one byte"),
        (lambda robot: robot.tool_serial.write("text"), "cannot write 'text'"),
        (lambda robot: robot.tool_serial.read(0), "size=0"),
        (lambda robot: robot.tool_serial.read(1, timeout=0.0), "timeout"),
    ],
)
def test_invalid_serial_arguments_are_rejected(
    robot: urlink.Robot, call: Callable[[urlink.Robot], object], said: str
) -> None:
    with pytest.raises(urlink.BadValue, match=said):
        call(robot)


def test_timeout_names_number_of_received_bytes(robot: urlink.Robot) -> None:
    with pytest.raises(
        urlink.LinkTimeout, match=r"only 0 of 7 bytes arrived within 0\.2 s; it might still be executed"
    ):
        robot.tool_serial.ask(STATUS, 7, timeout=0.2)
    robot.io.set_tool_communication()
    assert len(robot.tool_serial.ask(STATUS, 7)) == 7


def test_late_reply_is_not_used_for_next_request(robot: urlink.Robot) -> None:
    robot.io.set_tool_communication()
    robot.controller.tool_serial.device = lambda data: data[:1]
    with pytest.raises(urlink.LinkTimeout, match="1 of 2 bytes"):
        robot.tool_serial.ask(b"ab", 2, timeout=0.2)
    robot.controller.tool_serial.device = lambda data: data
    assert robot.tool_serial.ask(b"cd", 2) == b"cd"


def test_serial_line_reconnects_after_a_cut(robot: urlink.Robot) -> None:
    robot.io.set_tool_communication()
    robot.controller.tool_serial.device = lambda data: data
    assert robot.tool_serial.ask(b"ab", 2) == b"ab"
    robot.controller.faults.cut("tool_serial")
    time.sleep(0.1)
    assert robot.tool_serial.ask(b"cd", 2) == b"cd"


def test_serial_requests_of_threads_are_serialised(robot: urlink.Robot) -> None:
    robot.io.set_tool_communication()
    robot.controller.tool_serial.device = lambda data: data
    wrong = []

    def ask(number: int) -> None:
        data = bytes((number,)) * 20
        wrong.extend([data for _ in range(20) if robot.tool_serial.ask(data, 20) != data])

    threads = [threading.Thread(target=ask, args=(number,)) for number in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not wrong


def test_robot_close_closes_serial_line(robot: urlink.Robot) -> None:
    serial = robot.tool_serial
    robot.close()
    with pytest.raises(urlink.Closed):
        serial.write(b"a")


def test_older_controller_has_no_serial_line() -> None:
    with Controller("UR5", "3.15") as controller, urlink.connect(controller.address) as robot:
        with pytest.raises(urlink.LocalError, match=r"an e-Series 5\.0 or later has one"):
            robot.tool_serial.write(b"a")
        with pytest.raises(urlink.LocalError, match=r"5\.0 or later"):
            robot.io.set_tool_communication()


@pytest.mark.slow
def test_servo_misses_no_state_during_serial_traffic(robot: urlink.Robot) -> None:
    robot.io.set_tool_communication()
    over = threading.Event()
    asked = []

    def ask() -> None:
        while not over.is_set():
            asked.append(robot.tool_serial.ask(STATUS, 7))

    with robot.realtime.subscribe(lambda state: None):
        thread = threading.Thread(target=ask)
        with robot.motion.servo() as servo:
            q = robot.realtime.wait().q_target
            thread.start()
            for step in range(200):
                servo.send(q + 0.0002 * step)
                robot.realtime.wait()
        over.set()
        thread.join()
        stats = robot.realtime.stats
    assert len(asked) > 40
    assert (stats.missed, stats.failed, servo.phase.name) == (0, 0, "DONE")
