from __future__ import annotations

import itertools
import struct
import time
from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from linkcore.errors import BadValue
from tests import platforms
from urlink.protocol.enums import RobotMode, SafetyMode
from urlink.protocol.firmware import NEWEST, Firmware
from urlink.protocol.primary.robot_message import SafetyModeMessage, VersionMessage
from urlink.protocol.realtime.packets import RealtimeState
from urlink.simulator import Controller, Demonstration, ScheduledFault, parse_fault
from urlink.simulator.faults import FAULTS
from urlink.simulator.faults.link import (
    LinkFaults,
    Segmenter,
    with_garbage_inside,
    with_sub_package,
    with_tail,
    with_tails,
)

Connect = Callable[[Controller, str], Any]
Eventually = Callable[[Callable[[], object]], None]


def sub_packages(state: bytes) -> list[tuple[int, int]]:
    """Return the type and size of each sub-package."""
    found = []
    offset = 5
    while offset < len(state):
        size = int.from_bytes(state[offset : offset + 4], "big")
        found.append((state[offset + 4], size))
        offset += size
    assert offset == len(state) == int.from_bytes(state[:4], "big")
    return found


def time_of(packet: bytes) -> float:
    (time,) = struct.unpack_from(">d", packet, 4)
    return float(time)


# -- faults as text ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("protective_stop@5", ScheduledFault("protective_stop", (), 5.0)),
        ("reboot@1e1", ScheduledFault("reboot", (), 10.0)),
        ("reboot=5.12@10", ScheduledFault("reboot", (Firmware(5, 12),), 10.0)),
        ("stall=2.5@0", ScheduledFault("stall", (2.5,), 0.0)),
        ("split=1460@1", ScheduledFault("split", ((1460,),), 1.0)),
        ("split=100+200@1", ScheduledFault("split", ((100, 200),), 1.0)),
        ("merge=3@1", ScheduledFault("merge", (3,), 1.0)),
        ("garbage=16@1", ScheduledFault("garbage", (16,), 1.0)),
        ("append=8@1", ScheduledFault("append", (8,), 1.0)),
        ("cut@0.5", ScheduledFault("cut", (), 0.5)),
        ("cut=realtime@0.5", ScheduledFault("cut", ("realtime",), 0.5)),
        ("unknown_package=42@1", ScheduledFault("unknown_package", (42,), 1.0)),
    ],
)
def test_fault_is_parsed_from_text(text: str, fault: ScheduledFault) -> None:
    assert parse_fault(text) == fault


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("protective_stop", "no time"),
        ("", "no time"),
        ("protective_stop@soon", "'soon' is not a number of seconds"),
        ("protective_stop@-1", "'-1' is not a number of seconds"),
        ("protective_stop@inf", "'inf' is not a number of seconds"),
        ("protective_stop@nan", "'nan' is not a number of seconds"),
        ("fire@1", "no fault is called 'fire'; expected one of protective_stop"),
        ("protective_stop=3@1", "takes no argument"),
        ("stall@1", "needs seconds"),
        ("stall=x@1", "invalid argument 'x'; expected seconds"),
        ("stall=-1@1", "invalid argument '-1'; expected seconds"),
        ("split=@1", "invalid argument ''; expected sizes"),
        ("split=0@1", "invalid argument '0'; expected sizes"),
        ("merge=0@1", "invalid argument '0'; expected packets"),
        ("reboot=new@1", "invalid argument 'new'; expected the firmware"),
        ("cut=modbus@1", "invalid argument 'modbus'; expected the port"),
        ("unknown_package=256@1", "invalid argument '256'; expected the type"),
    ],
)
def test_invalid_fault_text_raises_the_reason(text: str, complaint: str) -> None:
    with pytest.raises(BadValue, match=complaint):
        parse_fault(text)


@pytest.mark.property
@given(st.text() | st.builds("{}={}@{}".format, st.sampled_from(sorted(FAULTS)), st.text(), st.text()))
def test_any_text_is_a_fault_or_a_clear_error(text: str) -> None:
    try:
        fault = parse_fault(text)
    except BadValue as error:
        complaint = str(error)
    else:
        complaint = ""
        assert fault.name in FAULTS
    assert complaint == "" or complaint.startswith(repr(text))


def test_every_listed_fault_is_a_method() -> None:
    for name in FAULTS:
        assert callable(getattr(Controller().faults, name))


def test_schedule_runs_in_order_and_at_the_exact_cycle() -> None:
    controller = Controller("UR5e", "5.11", motion=Demonstration())
    controller.schedule("clear@0.2", "protective_stop@0.1")
    modes = []
    for cycles in (49, 1, 49, 1):
        controller.step(cycles)
        modes.append(controller.modes.safety_mode)
    stop = SafetyMode.PROTECTIVE_STOP
    assert modes == [SafetyMode.NORMAL, stop, stop, SafetyMode.NORMAL]


def test_impossible_scheduled_fault_is_logged(caplog: pytest.LogCaptureFixture) -> None:
    controller = Controller("UR5e", "5.11", motion=Demonstration())
    controller.schedule(ScheduledFault("cut", ("modbus",), 0.01), "protective_stop@0.02")
    controller.step(10)
    assert "no port is called 'modbus'" in caplog.text
    assert controller.modes.safety_mode is SafetyMode.PROTECTIVE_STOP
    with pytest.raises(BadValue, match="no fault is called 'call'"):
        controller.schedule(ScheduledFault("call", (), 0.01))


@pytest.mark.simulated_time
def test_scheduled_faults_are_on_time_on_slow_ports(connect: Connect) -> None:
    # The clock wakes up ten times per second for these ports, and additionally for scheduled faults.
    with Controller("UR5e", "5.11", motion=Demonstration()) as controller:
        link = connect(controller, "primary")
        controller.schedule("protective_stop@0.55", "clear@0.75", "protective_stop@0.95")
        before_state = []
        for due in (550_000, 750_000, 950_000):
            change = link.until(lambda package: package[4] == 20 and package[14] == 5)
            came = time.monotonic()
            assert int.from_bytes(change[5:13], "big") == due
            link.until(lambda package: package[4] == 16)
            before_state.append(time.monotonic() - came)
    assert min(before_state) > 0.02  # the next state follows 50 ms later


def test_reboot_rejects_firmware_of_another_generation() -> None:
    controller = Controller("UR5e", "5.11", motion=Demonstration())
    with pytest.raises(BadValue, match=r"does not run firmware 3\.14"):
        controller.schedule("reboot=3.14@1")
    with pytest.raises(BadValue, match=r"does not run firmware 3\.14"):
        controller.faults.reboot("3.14")


@pytest.mark.parametrize(
    "wrong",
    [
        lambda faults: faults.split(0),
        lambda faults: faults.split([]),
        lambda faults: faults.merge(0),
        lambda faults: faults.garbage(0),
        lambda faults: faults.append(-1),
        lambda faults: faults.stall(-1.0),
        lambda faults: faults.stall(1.0, "modbus"),
        lambda faults: faults.reboot(downtime=float("nan")),
        lambda faults: faults.unknown_package(256),
        lambda faults: faults.unknown_package(42, port="realtime"),
        lambda faults: faults.unknown_sub_package(-1),
    ],
)
def test_faults_reject_wrong_arguments(wrong: Callable[[Any], None]) -> None:
    with pytest.raises(BadValue):
        wrong(Controller().faults)


# -- bytes ---------------------------------------------------------------------------------------


def test_tail_extends_packets_and_their_sizes() -> None:
    controller = Controller("UR5e", NEWEST, motion=Demonstration())
    packet, state = controller.realtime_packet(), controller.state_package()
    grown = with_tail(packet, b"12345678")
    assert grown[4:] == packet[4:] + b"12345678"
    assert int.from_bytes(grown[:4], "big") == len(grown) == len(packet) + 8
    assert RealtimeState.LAYOUTS.decode(grown).tail == b"12345678"
    grown = with_tails(state, b"abc")
    assert sub_packages(grown) == [(kind, size + 3) for kind, size in sub_packages(state)]
    assert grown.endswith(b"abc")


def test_unknown_sub_package_comes_last() -> None:
    state = Controller("UR5e", "5.11").state_package()
    grown = with_sub_package(state, 77, b"new")
    assert sub_packages(grown) == [*sub_packages(state), (77, 8)]
    assert grown.endswith(b"new")


def test_garbage_inside_a_packet_keeps_its_stated_size() -> None:
    assert with_garbage_inside(b"\0\0\0\x08abcd", b"??") == b"\0\0\0\x08??abcd"


@pytest.mark.property
@given(
    st.lists(st.binary(max_size=50), max_size=20),
    st.lists(st.integers(1, 40), max_size=4),
    st.integers(1, 5),
)
def test_segments_preserve_all_bytes_in_order(packets: list[bytes], sizes: list[int], count: int) -> None:
    segmenter = Segmenter(sizes, count)
    segments = [segment for packet in packets for segment in segmenter.put(packet)]
    if sizes:
        assert [len(segment) for segment in segments] == [sizes[i % len(sizes)] for i in range(len(segments))]
    else:
        assert len(segments) == len(packets) // count
    assert b"".join(segments) + segmenter.rest() == b"".join(packets)
    assert segmenter.rest() == b""


# -- over TCP ------------------------------------------------------------------------------------


@pytest.fixture
def controller() -> Any:
    with Controller("UR5e", "5.11", motion=Demonstration()) as controller:
        yield controller


@pytest.mark.real_time
def test_garbage_comes_once_and_before_a_packet(controller: Controller, connect: Connect) -> None:
    link = connect(controller, "realtime")
    link.packet()
    controller.faults.garbage(b"\xff\xff\xff\xffgarbage", "realtime")
    while (head := link.exactly(4)) != b"\xff\xff\xff\xff":
        assert head == b"\x00\x00\x04\xc4"
        link.exactly(1216)
    assert link.exactly(7) == b"garbage"
    assert [len(link.packet()) for _ in range(5)] == [1220] * 5


@pytest.mark.real_time
def test_garbage_inside_a_packet_shifts_the_next_packet(controller: Controller, connect: Connect) -> None:
    link = connect(controller, "realtime")
    link.packet()
    controller.faults.garbage(b"garbage!", "realtime", inside=True)
    assert b"garbage!" in link.until(lambda packet: b"garbage!" in packet)
    # The stated size does not include the garbage, so the last eight bytes arrive where the next packet should begin.
    link.exactly(8)
    assert [len(link.packet()) for _ in range(5)] == [1220] * 5


@pytest.mark.real_time
def test_random_garbage_depends_only_on_the_seed(connect: Connect) -> None:
    sent = []
    for _ in range(2):
        with Controller("UR5e", "5.11", seed=5, motion=Demonstration()) as controller:
            link = connect(controller, "primary")
            link.until(lambda package: package[4] == 16)
            controller.faults.garbage(64)
            data = b""
            while len(data) < 64:
                data += link.segment()
                while 5 <= (size := int.from_bytes(data[:4], "big")) <= min(len(data), 4096):
                    data = data[size:]  # sent before
            sent.append(data[:64])
    assert sent[0] == sent[1] != bytes(64)


@pytest.mark.real_time
def test_appended_bytes_are_included_in_every_size(controller: Controller, connect: Connect) -> None:
    realtime, primary = connect(controller, "realtime"), connect(controller, "primary")
    controller.faults.append(b"appended", None)
    packet = realtime.until(lambda packet: len(packet) == 1228)
    assert packet.endswith(b"appended")
    state = primary.until(lambda package: package[4] == 16 and package.endswith(b"appended"))
    assert len(sub_packages(state)) in (11, 13)
    # A new client gets an unchanged version message and an extended first state.
    late = connect(controller, "secondary")
    assert VersionMessage.LAYOUTS.decode(late.packet()).build_date == "01-01-2024, 00:00:00"
    first = late.until(lambda package: package[4] == 16)
    assert len(first) == 1386 + 13 * 8
    controller.faults.heal()
    realtime.until(lambda packet: len(packet) == 1220)


@pytest.mark.real_time
def test_unknown_packages_and_sub_packages_are_sent(controller: Controller, connect: Connect) -> None:
    link = connect(controller, "primary")
    link.until(lambda package: package[4] == 16)
    controller.faults.unknown_package(42, b"what is this?")
    assert link.until(lambda package: package[4] == 42)[5:] == b"what is this?"
    controller.faults.unknown_sub_package(99, b"new")
    state = link.until(lambda package: package[4] == 16 and package.endswith(b"new"))
    assert sub_packages(state)[-1] == (99, 8)
    assert sub_packages(link.until(lambda package: package[4] == 16))[-1] == (99, 8)
    controller.faults.heal()
    link.until(lambda package: package[4] == 16 and not package.endswith(b"new"))


@pytest.mark.real_time
def test_split_packets_arrive_in_parts_and_complete(controller: Controller, connect: Connect) -> None:
    link = connect(controller, "realtime")
    controller.faults.split((700, 100), "realtime")
    # Bytes that do not fill a segment are held back. Of a packet of 1220 bytes, 800 arrive and 420 wait for the next
    # cycle, so between cycles the stream ends at a packet border only once in 20 packets.
    sizes = []
    received = 0
    for _ in range(30):
        received += len(link.segment())
        sizes.append(received % 1220)
    assert sum(1 for size in sizes if size) > 20
    link.exactly(-received % 1220)
    assert [len(link.packet()) for _ in range(10)] == [1220] * 10
    controller.faults.heal()
    assert [len(link.packet()) for _ in range(10)] == [1220] * 10


@pytest.mark.real_time
def test_merged_packets_arrive_together(controller: Controller, connect: Connect) -> None:
    controller.faults.merge(4, "realtime")
    link = connect(controller, "realtime")
    segments = [len(link.segment()) for _ in range(5)]
    # A slow reader might receive several segments at once, but never a part of a segment.
    assert all(size % (4 * 1220) == 0 for size in segments)


@pytest.mark.real_time
def test_stall_sends_nothing_but_stays_connected(controller: Controller, connect: Connect) -> None:
    link, other = connect(controller, "realtime"), connect(controller, "realtime_readonly")
    times = [time_of(link.packet())]
    controller.faults.stall(0.4, "realtime")
    # Packets already sent arrive first; then none arrives until the stall has ended.
    late = connect(controller, "realtime")
    times += [time_of(link.packet()) for _ in range(60)]
    gap = max(after - before for before, after in itertools.pairwise(times))
    assert 0.38 < gap < 0.8
    assert time_of(late.packet()) > times[0] + 0.38
    times = [time_of(other.packet()) for _ in range(100)]
    assert max(after - before for before, after in itertools.pairwise(times)) < 0.1


@pytest.mark.real_time
def test_heal_ends_a_stall(controller: Controller, connect: Connect) -> None:
    controller.faults.stall(3600.0)
    late = connect(controller, "primary")
    controller.faults.heal()
    assert VersionMessage.LAYOUTS.decode(late.packet()).major == 5


@pytest.mark.real_time
def test_client_can_reconnect_after_a_cut(controller: Controller, connect: Connect) -> None:
    link, other = connect(controller, "realtime"), connect(controller, "primary")
    link.packet()
    other.packet()
    controller.faults.cut("realtime")
    # Under Wine, `recv` reports a reset as an orderly end.
    with pytest.raises(AssertionError if platforms.IS_WINE else ConnectionResetError):
        link.until(lambda packet: False)
    assert len(connect(controller, "realtime").packet()) == 1220
    other.packet()
    controller.faults.cut()
    assert other.is_ended()


@pytest.mark.real_time
def test_reboot_refuses_clients_and_changes_the_firmware(
    controller: Controller, connect: Connect, eventually: Eventually
) -> None:
    link = connect(controller, "realtime")
    ports = controller.ports
    link.until(lambda packet: time_of(packet) > 0.1)
    controller.faults.reboot("5.4", downtime=0.3)
    assert link.is_ended()
    for port in ports:
        with pytest.raises(ConnectionRefusedError):
            connect(controller, port)
    eventually(lambda: controller.is_up)
    # Interpreter mode exists since 5.10.
    assert controller.ports == {name: port for name, port in ports.items() if name != "interpreter"}
    packet = connect(controller, "realtime").packet()
    assert len(packet) == 1116
    assert time_of(packet) < 1.0
    assert VersionMessage.LAYOUTS.decode(connect(controller, "primary").packet()).minor == 4


@pytest.mark.slow
@pytest.mark.real_time
def test_client_can_connect_right_after_a_reboot(controller: Controller, connect: Connect) -> None:
    for _ in range(30):
        controller.faults.reboot(downtime=0.002)
        while not controller.is_up:  # no pause: it would give the controller time to open its ports
            pass
        connect(controller, "realtime_readonly").socket.close()


def test_moving_arm_stops_while_its_controller_reboots() -> None:
    controller = Controller("UR5e", "5.11", motion=Demonstration())
    controller.step(200)
    q = controller.arm.setpoint.q
    assert any(controller.arm.setpoint.qd)
    controller.faults.reboot(downtime=2.0)
    assert not any(controller.arm.setpoint.qd)
    controller.step(500)
    assert not controller.arm.is_moving
    assert controller.arm.setpoint.q == q


def test_reboot_keeps_posture_tcp_and_payload() -> None:
    controller = Controller("UR10", "3.14", motion=Demonstration())
    controller.step(500)
    controller.arm.tcp = [0.0, 0.0, 0.2, 0.0, 0.0, 0.0]
    controller.arm.payload = 3.0
    before = controller.arm.setpoint.q
    controller.faults.reboot("3.5", downtime=0.5)
    ups = []
    for cycles in (62, 1):
        controller.step(cycles)
        ups.append(controller.is_up)
    assert ups == [False, True]
    assert controller.time == 0.0
    assert str(controller.firmware) == "3.5"
    assert controller.arm.setpoint.q == pytest.approx(before)
    assert (controller.arm.tcp[2], controller.arm.payload) == (0.2, 3.0)
    assert len(controller.realtime_packet()) == 1108
    controller.step(10)
    assert controller.time == 0.08
    assert controller.cycle == 573


@pytest.mark.real_time
def test_stops_appear_in_the_packets(controller: Controller, connect: Connect) -> None:
    realtime, primary = connect(controller, "realtime"), connect(controller, "primary")
    primary.until(lambda package: package[4] == 16)
    controller.faults.protective_stop()
    change = primary.until(lambda package: package[4] == 20 and package[14] == 5)
    assert SafetyModeMessage.LAYOUTS.decode(change).safety_mode == SafetyMode.PROTECTIVE_STOP
    stopped = realtime.until(
        lambda packet: RealtimeState.LAYOUTS.decode(packet).safety_mode == SafetyMode.PROTECTIVE_STOP
    )
    assert RealtimeState.LAYOUTS.decode(stopped).robot_mode == RobotMode.RUNNING
    controller.faults.emergency_stop()
    realtime.until(lambda packet: RealtimeState.LAYOUTS.decode(packet).robot_mode == RobotMode.POWER_OFF)


@pytest.mark.real_time
def test_messages_are_sent_only_on_the_primary_interface(controller: Controller, connect: Connect) -> None:
    primary, secondary = connect(controller, "primary"), connect(controller, "secondary")
    # A greeting has two messages; the stop causes two more.
    controller.faults.protective_stop()
    primary.until(lambda package: package[4] == 20 and package[14] == 5)
    states = 0
    kinds = []
    while states < 4:
        package = secondary.packet()
        kinds.append((package[4], package[14] if package[4] == 20 else 0))
        states += package[4] == 16
    assert kinds[:2] == [(20, 3), (20, 12)]
    assert set(kinds[2:]) == {(16, 0)}


def test_garbage_for_a_port_without_clients_is_bounded() -> None:
    link = LinkFaults(lambda: 0)
    for number in range(100):
        link.insert(["realtime"], bytes([number]))
    assert link.on_the_wire("realtime", b"packet") == bytes(range(84, 100)) + b"packet"
    assert link.on_the_wire("realtime", b"packet") == b"packet"
