from __future__ import annotations

import contextlib
import itertools
import random
import socket
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import pytest

import linkcore.clock
import urlink
from linkcore.errors import BadAddress, BadValue, LocalError
from tests.fakes.clock import Clock
from tests.waiting import until
from urlink.protocol.enums import SafetyMode
from urlink.protocol.firmware import NEWEST, release_of
from urlink.protocol.primary.robot_message import RobotCommMessage, SafetyModeMessage, VersionMessage
from urlink.protocol.realtime.packets import RealtimeState
from urlink.session.address import RobotAddress, parse_address
from urlink.simulator import PORTS, Controller, Reaction, Setpoint, Still
from urlink.simulator.interfaces.interface import LONGEST_LINE
from urlink.simulator.robot.signals import ToolCommunication

pytestmark = pytest.mark.simulated_time

Connect = Callable[[Controller, str], Any]
Eventually = Callable[[Callable[[], object]], None]


#: Ports that a controller with firmware 5.11 serves.
SERVED = [name for name in PORTS if name not in ("robot_api", "onrobot")]


def times(link: Any, count: int) -> list[float]:
    return [RealtimeState.LAYOUTS.decode(link.packet()).time for _ in range(count)]


@pytest.mark.parametrize(
    ("name", "firmware", "period"), [("UR5e", "5.11", 0.002), ("UR10", "3.14", 0.008), ("UR5", "1.6", 0.008)]
)
def test_realtime_packets_come_once_per_cycle(name: str, firmware: str, period: float, connect: Connect) -> None:
    with Controller(name, firmware) as controller:
        link = connect(controller, "realtime")
        begin, first = time.monotonic(), times(link, 1)[0]
        stamps = times(link, 100)
        elapsed = time.monotonic() - begin
    for before, after in itertools.pairwise([first, *stamps]):
        assert after - before == pytest.approx(period, abs=1e-9)
    assert elapsed > 100 * period - 0.05


def test_new_client_gets_no_old_packets(connect: Connect, eventually: Eventually) -> None:
    with Controller("UR5e", "5.11") as controller:
        # Without a client on a real-time port, the clock advances ten times a second, by fifty cycles.
        for _ in range(5):
            eventually(lambda: controller.cycle % 50 == 0)
            # The pause deliberately ends between two of these moments; it does not wait for an event.
            time.sleep(0.06)
            link = connect(controller, "realtime")
            connected = time.monotonic()
            first = times(link, 1)[0]
            # Packets must not arrive before they are due: fifty cycles at once would bring ten packets immediately.
            stamps = times(link, 10)
            assert time.monotonic() - connected > 0.015
            assert stamps[-1] == pytest.approx(first + 0.02, abs=1e-9)
            link.close()
        assert controller.counters.sent < 500


@pytest.mark.parametrize("port", ["primary", "realtime", "dashboard"])
def test_client_that_disconnects_before_accept_does_no_harm(port: str, connect: Connect) -> None:
    with Controller("UR5e", "5.11") as controller:

        def come_and_go() -> None:
            with socket.create_connection((controller.host, controller.ports[port])) as link:
                link.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))

        # The client runs in the thread that accepts, so its connection cannot be accepted before it is closed.
        controller.call(come_and_go)
        times(connect(controller, "realtime"), 3)


@pytest.mark.parametrize("port", ["primary", "primary_readonly", "secondary", "secondary_readonly"])
def test_packages_are_sent_at_ten_hertz_after_the_greeting(port: str, connect: Connect) -> None:
    with Controller("UR5", "3.10") as controller:
        link = connect(controller, port)
        head = [(len(package), package[4]) for package in (link.packet() for _ in range(4))]
        tolerances = [(181, 24)] if port.startswith("primary") else [(682, 16)]
        assert sorted(head) == sorted([(55, 20), (24, 20), *tolerances, (1352, 16)])
        assert head[:2] == [(55, 20), (24, 20)]
        stamps = []
        for _ in range(8):
            package = link.packet()
            assert (len(package), package[4]) == (682, 16)
            stamps.append(int.from_bytes(package[10:18], "big"))
    # Two states are 12.5 cycles of 8 ms apart, so the gaps alternate between 12 and 13 cycles.
    gaps = [after - before for before, after in itertools.pairwise(stamps)]
    assert set(gaps) == {96_000, 104_000}
    assert sum(gaps[:6]) == 600_000


def test_state_with_the_stop_precedes_its_message(connect: Connect) -> None:
    """The vendor's primary client waits for the message, and then reads the last state that it has received."""
    with Controller("UR5e", "5.25", stepped=True) as controller:
        link = connect(controller, "primary")
        controller.step(100)
        link.until(lambda packet: packet[4] == 16)
        # The moments are spread over the time between two states, which are 50 cycles apart.
        for cycles in (1, 7, 49, 50, 51, 20):
            controller.step(cycles)
            for change, mode in (
                (controller.faults.protective_stop, SafetyMode.PROTECTIVE_STOP),
                (controller.faults.clear, SafetyMode.NORMAL),
            ):
                change()
                controller.step()
                newest, kinds = None, set()
                while SafetyModeMessage not in kinds:
                    for package in urlink.decode(link.packet(), "primary", "5.25"):
                        kinds.add(type(package))
                        newest = package if isinstance(package, urlink.packets.RobotState) else newest
                        if isinstance(package, (SafetyModeMessage, RobotCommMessage)):
                            assert isinstance(newest, urlink.packets.RobotState)
                            assert newest.robot_mode_data is not None
                            assert newest.robot_mode_data.is_protective_stopped is (mode is SafetyMode.PROTECTIVE_STOP)
                assert (RobotCommMessage in kinds) is (mode is SafetyMode.PROTECTIVE_STOP)


def test_all_clients_of_a_port_get_the_same_bytes(connect: Connect) -> None:
    with Controller("UR5e", "5.11") as controller:
        links = [connect(controller, port) for port in ["realtime"] * 10 + ["realtime_readonly"] * 10]
        begun = [link.packet() for link in links]
        last = max(begun, key=lambda packet: float(RealtimeState.LAYOUTS.decode(packet).time))

        def catch_up(link: Any, packet: bytes) -> list[bytes]:
            if packet != last:
                assert link.until(lambda packet: packet == last) == last
            return [link.packet() for _ in range(20)]

        streams = [catch_up(link, packet) for link, packet in zip(links, begun, strict=True)]
        assert len(set(streams[0])) == 20
        assert all(stream == streams[0] for stream in streams)
        assert controller.counters.connections == 20


def test_client_that_does_not_read_delays_no_other_client(connect: Connect, eventually: Eventually) -> None:
    with Controller("UR5e", "5.11", output_limit=20_000) as controller:
        reader, sleeper = connect(controller, "realtime"), connect(controller, "realtime")
        sleeper.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        stamps: list[float] = []

        def left_out() -> bool:
            stamps.extend(times(reader, 25))
            return controller.counters.unread > 50

        eventually(left_out)
        # Public clients exist that connect only to send programs, so text from this client is still accepted.
        sleeper.send(b"set speed 0.5\n")
        eventually(lambda: controller.speed_fraction == 0.5)
        assert controller.counters.dropped == 0
        gaps = [after - before for before, after in itertools.pairwise(stamps)]
        assert max(gaps) == pytest.approx(0.002, abs=1e-9)
        assert len(reader.packet()) == 1220


def test_clients_can_connect_and_disconnect_at_any_time(connect: Connect, eventually: Eventually) -> None:
    with Controller("UR5e", "5.11") as controller:
        steady = connect(controller, "realtime")
        for port in itertools.islice(itertools.cycle(SERVED), 60):
            link = connect(controller, port)
            link.close()
        eventually(lambda: controller.counters.connections == 61)
        assert len(steady.packet()) == 1220
        assert controller.counters.dropped == 0


def test_received_lines_are_kept(connect: Connect, eventually: Eventually) -> None:
    with Controller("UR5e", "5.11") as controller:
        for port in ("primary", "secondary", "realtime"):
            connect(controller, port).send(f"popup({port})\n".encode())
        eventually(lambda: len(controller.received) == 3)
        assert sorted(controller.received) == [
            ("primary", "popup(primary)"),
            ("realtime", "popup(realtime)"),
            ("secondary", "popup(secondary)"),
        ]
        controller.received.clear()
        link = connect(controller, "secondary")
        for part in (b"de", b"f f():\n  text", b'msg("\xff")\r\nend', b"\n"):
            link.send(part)
        eventually(lambda: len(controller.received) == 3)
        assert [text for _, text in controller.received] == ["def f():", '  textmsg("\\xff")', "end"]


def test_line_without_end_is_discarded(connect: Connect, eventually: Eventually) -> None:
    with Controller("UR5e", "5.11") as controller:
        link = connect(controller, "primary")
        link.send(b"x" * (3 * LONGEST_LINE) + b"\nset_digital_out(0, True)\n")
        eventually(lambda: len(controller.received) == 1)
        assert controller.received.pop() == ("primary", "set_digital_out(0, True)")
        assert controller.counters.refused_bytes == 3 * LONGEST_LINE


def test_text_to_read_only_ports_has_no_effect(connect: Connect, eventually: Eventually) -> None:
    with Controller("UR5e", "5.11") as controller:
        connect(controller, "realtime_readonly").send(b"stopj(2)\n")
        eventually(lambda: controller.counters.refused_bytes == 9)
        assert not controller.received


def test_number_of_received_lines_is_bounded(connect: Connect, eventually: Eventually) -> None:
    with Controller("UR5e", "5.11") as controller:
        connect(controller, "primary").send(b"a\n" * 5000 + b"last\n")
        eventually(lambda: controller.received and controller.received[-1] == ("primary", "last"))
        assert len(controller.received) == 1000


def test_close_leaves_no_thread_or_socket(connect: Connect) -> None:
    before = threading.active_count()
    controller = Controller("UR5e", "5.11").start()
    controller.signals.tool_communication = ToolCommunication(is_enabled=True)
    controller.tool_serial.device = bytes.upper
    links = [connect(controller, port) for port in SERVED]
    # These ports send nothing before a request.
    asked = {"rtde": b"\0\3v", "gripper": b"GET POS\n", "interpreter": b"x = 1\n", "tool_serial": b"a"}
    for port, link in zip(SERVED, links, strict=True):
        link.send(asked.get(port, b""))
        link.segment()
    assert threading.active_count() == before + 1
    host, ports = controller.host, controller.ports
    begin = time.monotonic()
    controller.close()
    controller.close()
    assert time.monotonic() - begin < 2.0
    assert threading.active_count() == before
    assert all(link.is_ended() for link in links)
    for number in ports.values():
        with pytest.raises(ConnectionRefusedError):
            socket.create_connection((host, number), timeout=5)
    assert controller.ports == {}


def test_controller_can_be_closed_while_down_or_stalled(connect: Connect) -> None:
    before = threading.active_count()
    disturbances: list[Callable[[Any], None]] = [lambda f: f.reboot(downtime=60.0), lambda f: f.stall(60.0)]
    for disturb in disturbances:
        with Controller("UR5e", "5.11") as controller:
            links = [connect(controller, "primary")]
            disturb(controller.faults)
            if controller.is_up:
                links.append(connect(controller, "primary"))
            begin = time.monotonic()
        assert time.monotonic() - begin < 2.0
        assert threading.active_count() == before
        assert all(link.is_ended() for link in links)


def test_closed_controller_can_be_started_again(connect: Connect) -> None:
    controller = Controller("UR5e", "5.11")
    for _ in range(2):
        with controller as same:
            assert same is controller
            assert controller.start() is controller
            assert len(connect(controller, "realtime").packet()) == 1220
    controller.step()


def test_served_controller_cannot_be_stepped() -> None:
    with Controller("UR5e") as controller, pytest.raises(LocalError, match="cannot be stepped"):
        controller.step()


def test_only_the_requested_ports_are_served(connect: Connect) -> None:
    with Controller("UR5e", "5.11", ports={"realtime": 0}) as controller:
        assert list(controller.ports) == ["realtime"]
        assert len(connect(controller, "realtime").packet()) == 1220
        taken = controller.ports["realtime"]
        with pytest.raises(BadAddress, match=f":{taken} for primary"):
            Controller("UR5e", ports={"secondary": 0, "primary": taken}).start()


def test_standard_ports_are_those_of_a_real_controller() -> None:
    try:
        controller = Controller(ports="standard").start()
    except BadAddress as error:
        pytest.skip(str(error))
    with controller:
        assert controller.ports == {name: PORTS[name] for name in SERVED}


def test_foreign_host_address_is_a_clear_error() -> None:
    with pytest.raises(BadAddress, match=r"cannot listen on 192\.0\.2\.1:0"):
        Controller(host="192.0.2.1").start()


@pytest.mark.parametrize("host", ["", "0.0.0.0", "localhost"])
def test_address_can_be_connected_to_for_any_host(host: str) -> None:
    with Controller("UR5e", "5.11", host=host) as controller, urlink.connect(controller.address) as robot:
        assert str(robot.firmware).startswith("5.11")


@pytest.mark.slow
def test_twenty_controllers_run_at_the_same_time(connect: Connect) -> None:
    controllers = [Controller("UR5", "3.14") for _ in range(20)]
    try:
        for controller in controllers:
            controller.start()
        links = [connect(controller, "realtime") for controller in controllers]
        for controller, link in zip(controllers, links, strict=True):
            stamps = times(link, 60)
            # If the machine pauses for more than a second, the missing packets must have been counted.
            missing = round((stamps[-1] - stamps[0]) / 0.008) - 59
            assert 0 <= missing <= controller.counters.skipped
    finally:
        for controller in controllers:
            controller.close()


def test_exception_in_a_call_is_raised_in_the_caller(connect: Connect) -> None:
    def fail() -> None:
        raise BadValue("no")

    with Controller("UR5e", "5.11") as controller:
        with pytest.raises(BadValue, match="no"):
            controller.call(fail)
        assert len(connect(controller, "realtime").packet()) == 1220


def test_calls_run_in_the_thread_of_the_controller() -> None:
    seen: list[threading.Thread] = []

    def look() -> None:
        seen.append(threading.current_thread())
        # Within that thread, a call runs directly.
        controller.call(lambda: seen.append(threading.current_thread()))

    with Controller("UR5e") as controller:
        controller.call(look)
    assert seen[0] is seen[1] is not threading.current_thread()


def test_packets_are_computed_only_for_connected_clients(monkeypatch: pytest.MonkeyPatch, connect: Connect) -> None:
    with Controller("UR5e", "5.11") as controller:
        looks: list[str] = []
        ports: list[tuple[object, str]] = [(controller._realtime, "packet"), (controller._states, "of_cycle")]
        for port, name in ports:
            made = getattr(port, name)

            def look(*args: bool, name: str = name, made: Callable[..., object] = made, **options: bool) -> object:
                looks.append(name)
                return made(*args, **options)

            monkeypatch.setattr(port, name, look)
        link = connect(controller, "secondary")
        for _ in range(6):
            link.packet()
        assert set(looks) == {"of_cycle"}


@pytest.mark.real_time
def test_import_of_urlink_does_not_import_the_simulator() -> None:
    code = "import sys, urlink; print(sorted(name for name in sys.modules if 'urlink.simulator' in name))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


@pytest.mark.real_time
def test_stepping_starts_no_server() -> None:
    code = (
        "import sys, threading; from urlink.simulator import Controller\n"
        "controller = Controller(); controller.step(10)\n"
        "print(len(controller.realtime_packet()), threading.active_count(), 'urlink.simulator.server' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == [str(release_of(NEWEST).realtime), "1", "False"]


def test_greeting_of_cb2_is_only_the_version_message(connect: Connect) -> None:
    with Controller("UR5", "1.8") as controller:
        link = connect(controller, "primary")
        version = VersionMessage.LAYOUTS.decode(link.packet())
        assert (version.major, version.minor) == (1, 8)
        assert [len(link.packet()) for _ in range(2)] == [1254, 560]


# -- a machine that is busy with other work ------------------------------------------------------------


def clocked(clock: Clock, **options: Any) -> Controller:
    """Return a controller that reads this clock."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(linkcore.clock, "now", clock)
        return Controller("UR5e", "5.11", **options)


@pytest.fixture
def starved() -> Iterator[tuple[Controller, Clock]]:
    """Controller whose time advances only when the test advances it, as if the server's thread got no processor time
    in between."""
    clock = Clock()
    with clocked(clock) as controller:
        yield controller, clock


@pytest.mark.real_time
def test_clock_does_not_drift(starved: tuple[Controller, Clock]) -> None:
    """However irregularly the thread runs, cycle k is due k periods after the start."""
    controller, clock = starved
    begun, runs = clock.now, random.Random(0)
    for _ in range(500):
        clock.now += runs.choice([0.0001, 0.0019, 0.002, 0.0021, 0.0173])
        controller.call(lambda: None)
    assert controller.cycle == int((clock.now - begun) * 500)


def test_short_delays_are_caught_up(starved: tuple[Controller, Clock], connect: Connect) -> None:
    """A client gets every packet in order, though late."""
    controller, clock = starved
    link = connect(controller, "realtime")
    until(lambda: controller.counters.connections == 1)
    clock.now += 0.2001
    assert times(link, 100) == pytest.approx([0.002 * n for n in range(1, 101)], abs=1e-9)
    assert (controller.counters.late, controller.counters.skipped) == (99, 0)
    clock.now += 0.002
    assert times(link, 1) == pytest.approx([0.202], abs=1e-9)
    assert controller.counters.late == 99


def test_old_packets_are_not_sent_after_a_long_delay(starved: tuple[Controller, Clock], connect: Connect) -> None:
    """The controller has executed every cycle; only packets are missing."""
    controller, clock = starved
    link = connect(controller, "realtime")
    until(lambda: controller.counters.connections == 1)
    clock.now += 1.5001
    assert times(link, 501) == pytest.approx([0.5 + 0.002 * n for n in range(501)], abs=1e-9)
    assert (controller.cycle, controller.counters.skipped) == (750, 249)


class Slow:
    """Scene that needs 5 ms for a cycle of 2 ms."""

    def advance(self, setpoint: Setpoint, pose: Sequence[float], seconds: float) -> Reaction:
        time.sleep(0.005)
        return Reaction((0.0,) * 6)


@pytest.mark.parametrize("port", ["primary", "secondary"])
def test_controller_slower_than_real_time_still_sends_states(port: str, connect: Connect) -> None:
    with Controller("UR5e", "5.11") as controller:
        link = connect(controller, port)
        controller.world.scene = Slow()
        came: list[float] = []
        while len(came) < 40:
            if link.packet()[4] == 16:
                came.append(time.monotonic())
        assert controller.counters.skipped > 100
    # Two states are 50 cycles apart; every 20 ms the server checks which of them are due.
    assert max(after - before for before, after in itertools.pairwise(came[1:])) < 50 * 0.005 + 0.05


def test_clock_restarts_after_the_machine_has_slept(starved: tuple[Controller, Clock], connect: Connect) -> None:
    controller, clock = starved
    link = connect(controller, "realtime")
    until(lambda: controller.counters.connections == 1)
    clock.now += 3600.0
    assert times(link, 1) == pytest.approx([0.002], abs=1e-9)
    assert controller.counters.skipped == 3600 * 500 - 1
    clock.now += 0.0101
    assert times(link, 5) == pytest.approx([0.004, 0.006, 0.008, 0.01, 0.012], abs=1e-9)


@pytest.mark.slow
def test_programs_do_not_depend_on_delays(connect: Connect) -> None:
    """The same program has the same result in the same cycles, whatever the machine does."""

    def ends(leap: float) -> tuple[int, list[float]]:
        clock = Clock()
        with clocked(clock, motion=Still()) as controller:
            controller.take("def p():\n  movej([0.1, -1.57, 1.57, -1.57, -1.57, 0])\nend")
            while controller.is_running_program:
                clock.now += leap
                controller.call(lambda: None)
            return controller.cycle, controller.arm.setpoint.q

    (slow, there), (fast, same) = ends(0.0020001), ends(0.1)
    assert there == same
    assert slow <= fast <= slow + 50


# -- RTDE ----------------------------------------------------------------------------------------------


def rtde_package(link: Any) -> tuple[str, bytes]:
    head = link.exactly(3)
    return chr(head[2]), link.exactly(int.from_bytes(head[:2], "big") - 3)


def started(link: Any, names: bytes = b"timestamp") -> None:
    """Go through the whole handshake in one segment."""
    link.send(b"\0\5V\0\2" + struct.pack(">HBd", 11 + len(names), ord("O"), 500.0) + names + b"\0\3S")
    assert [rtde_package(link)[0] for _ in range(3)] == ["V", "O", "S"]


def test_each_rtde_client_gets_every_cycle(connect: Connect) -> None:
    with Controller("UR5e", "5.11") as controller:
        links = [connect(controller, "rtde") for _ in range(3)]
        for link in links:
            started(link)
        for link in links:
            packages = [rtde_package(link) for _ in range(100)]
            assert {kind for kind, _ in packages} == {"U"}
            stamps = [struct.unpack(">d", payload[1:])[0] for _, payload in packages]
            gaps = [after - before for before, after in itertools.pairwise(stamps)]
            assert max(gaps) == pytest.approx(0.002, abs=1e-9)


def test_reboot_ends_rtde_connections_and_frees_inputs(connect: Connect, eventually: Eventually) -> None:
    with Controller("UR5e", "5.11") as controller:
        link = connect(controller, "rtde")
        link.send(b"\0\x14Ispeed_slider_mask")
        assert rtde_package(link) == ("I", b"\1UINT32")
        controller.faults.reboot(downtime=0.05)
        assert link.is_ended()
        eventually(lambda: controller.is_up and not controller.rtde.sessions)
        made: list[Any] = []

        def is_there() -> bool:  # the server listens again a moment after `is_up`
            with contextlib.suppress(ConnectionRefusedError):
                made.append(connect(controller, "rtde"))
            return bool(made)

        eventually(is_there)
        (again,) = made
        again.send(b"\0\x14Ispeed_slider_mask")
        assert rtde_package(again) == ("I", b"\1UINT32")


def test_firmware_without_rtde_refuses_connections(connect: Connect, eventually: Eventually) -> None:
    with Controller("UR5", "1.8") as controller:
        assert "rtde" not in controller.ports
        place = parse_address(controller.address)
        assert isinstance(place, RobotAddress)
        with pytest.raises(ConnectionRefusedError):
            socket.create_connection((place.host, place.ports["rtde"]), 5)
        controller.faults.reboot("3.15", downtime=0.05)

        def is_there() -> bool:
            try:
                started(connect(controller, "rtde"))
            except (KeyError, ConnectionRefusedError):
                return False
            return True

        eventually(is_there)
