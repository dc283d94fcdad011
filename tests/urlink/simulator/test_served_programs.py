"""Programs and the dashboard over real TCP ports."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest

import urlink
from linkcore.errors import BadValue
from tests.waiting import until
from urlink.protocol.enums import ProgramState, RobotMode
from urlink.protocol.firmware import Firmware
from urlink.simulator import Controller
from urlink.simulator.programs.loader import BUDGET, LEAST, LONG, MOST_WAITING
from urlink.simulator.robot.setpoint_sources import Still
from urlink.simulator.urscript import Script, compile_script

pytestmark = pytest.mark.simulated_time

Connect = Callable[[Controller, str], Any]

TURN = "def turn():\n  movej([0.2, -1.57, 1.57, -1.57, -1.57, 0], a=4, v=2)\nend\n"
WAIT = "def wait():\n  sleep(60)\nend\n"
#: Long enough to be compiled in a thread, while the clock keeps running.
PADDING = "".join(f"  x{n} = (1 + 2) * 3 - 4\n" for n in range(2000))


@pytest.fixture
def controller() -> Iterator[Controller]:
    with Controller("UR5e", "5.11", motion=Still(), files={"turn.urp": TURN, "wait.urp": WAIT}) as controller:
        yield controller


@pytest.fixture
def listener() -> Iterator[socket.socket]:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        listener.settimeout(10)
        yield listener


def messages(link: Any, kind: type, count: int) -> list[Any]:
    """Return the next `count` messages of a kind on a primary interface."""
    found: list[Any] = []
    deadline = time.monotonic() + 30
    while len(found) < count:
        assert time.monotonic() < deadline, found
        found += [m for m in urlink.decode(link.packet(), "primary", "5.11") if isinstance(m, kind)]
    return found


def keys(link: Any, count: int) -> list[str]:
    return [
        f"{message.title.rpartition('_')[2].lower()} {message.text}"
        for message in messages(link, urlink.packets.KeyMessage, count)
    ]


def reply(link: Any, line: str) -> str:
    link.send(line.encode() + b"\n")
    data = b""
    while not data.endswith(b"\n"):
        data += link.segment()
    return data.decode().removesuffix("\n")


# -- text ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("port", ["primary", "secondary", "realtime"])
def test_program_may_arrive_in_pieces_on_any_port(port: str, controller: Controller, connect: Connect) -> None:
    primary = connect(controller, "primary")
    link = connect(controller, port)
    for part in ("de", "f turn():\r", "\n  movej([0.2, -1.57, 1.57,", " -1.57, -1.57, 0], a=4, v=2)\r\nen", "d\r\n"):
        link.send(part.encode())
    assert keys(primary, 2) == ["started turn", "stopped turn"]
    assert controller.arm.setpoint.q[0] == pytest.approx(0.2, abs=1e-9)


def test_two_programs_in_one_segment_run_in_order(controller: Controller, connect: Connect) -> None:
    primary = connect(controller, "primary")
    primary.send((WAIT + TURN + "sec s():\n  set_digital_out(2, True)\nend\n").encode())
    assert keys(primary, 4) == ["started wait", "stopped wait", "started turn", "stopped turn"]
    until(lambda: controller.signals.digital_outputs == 4)


def test_half_a_program_is_discarded_when_its_client_leaves(controller: Controller, connect: Connect) -> None:
    primary = connect(controller, "primary")
    leaving = connect(controller, "secondary")
    leaving.send(b"def half():\n  sleep(60)\n")
    until(lambda: len(controller.received) == 2)
    leaving.close()
    primary.send(b"end\n" + TURN.encode())
    # The `end` is then a line on its own, which is not a program.
    assert len(messages(primary, urlink.packets.RuntimeExceptionMessage, 1)) == 1
    assert keys(primary, 2) == ["started turn", "stopped turn"]


def test_local_control_refuses_programs_of_a_port(controller: Controller, connect: Connect) -> None:
    controller.remote_control = False
    primary = connect(controller, "primary")
    primary.send(TURN.encode())
    until(lambda: controller.counters.refused_programs == 1)
    controller.remote_control = True
    primary.send(TURN.encode())
    assert keys(primary, 2) == ["started turn", "stopped turn"]


# -- long programs -------------------------------------------------------------------------------------


class Compiling:
    """Compiler of long programs that waits until the test releases it."""

    def __init__(self) -> None:
        self.has_begun = threading.Event()
        self.may_end = threading.Event()

    def __call__(self, text: str, firmware: Firmware) -> Script:
        if len(text) >= LONG:
            self.has_begun.set()
            assert self.may_end.wait(10)
        return compile_script(text, firmware)


@pytest.fixture
def compiling(monkeypatch: pytest.MonkeyPatch) -> Iterator[Compiling]:
    compiling = Compiling()
    monkeypatch.setattr("urlink.simulator.programs.loader.compile_script", compiling)
    yield compiling
    compiling.may_end.set()


@pytest.mark.slow
def test_long_program_does_not_delay_the_clock(controller: Controller, connect: Connect, compiling: Compiling) -> None:
    realtime, primary = connect(controller, "realtime"), connect(controller, "primary")
    # Programs that the same client sends later have to wait for this one.
    primary.send(f"def long():\n{PADDING}end\n{TURN}".encode())
    assert compiling.has_begun.wait(10)
    for _ in range(20):
        realtime.packet()
    assert not controller.is_running_program
    compiling.may_end.set()
    assert keys(primary, 4) == ["started long", "stopped long", "started turn", "stopped turn"]


def test_long_program_does_not_delay_other_clients(
    controller: Controller, connect: Connect, compiling: Compiling
) -> None:
    primary, other = connect(controller, "primary"), connect(controller, "secondary")
    primary.send(f"def long():\n{PADDING}end\n".encode())
    assert compiling.has_begun.wait(10)
    other.send(TURN.encode())
    assert keys(primary, 2) == ["started turn", "stopped turn"]
    compiling.may_end.set()
    assert keys(primary, 2) == ["started long", "stopped long"]


def test_long_programs_are_compiled_one_at_a_time(
    controller: Controller, connect: Connect, compiling: Compiling
) -> None:
    primary, other = connect(controller, "primary"), connect(controller, "secondary")
    primary.send(f"def first():\n{PADDING}end\n".encode())
    assert compiling.has_begun.wait(10)
    other.send(f"def second():\n{PADDING}end\n".encode())
    until(lambda: len(controller.received) == 2 * (PADDING.count("\n") + 2) or len(controller.received) == 1000)
    assert threading.active_count() < 20
    compiling.may_end.set()
    assert keys(primary, 4) == ["started first", "stopped first", "started second", "stopped second"]


@pytest.mark.slow
def test_compile_errors_of_long_programs_are_reported(controller: Controller, connect: Connect) -> None:
    primary = connect(controller, "primary")
    primary.send(f"def long():\n{PADDING}  nonsense()\nend\n".encode())
    (error,) = messages(primary, urlink.packets.RuntimeExceptionMessage, 1)
    assert error.line == 2002
    primary.send(b"def long():\n" + b"  # " + b"x" * 60_000 + b"\n" * 250_000 + b"end\n")
    (error,) = messages(primary, urlink.packets.RuntimeExceptionMessage, 1)
    assert error.text.startswith("program_too_long")
    primary.send(TURN.encode())
    assert keys(primary, 2) == ["started turn", "stopped turn"]


def test_reboot_discards_a_program_that_is_being_compiled(
    controller: Controller, connect: Connect, compiling: Compiling
) -> None:
    primary = connect(controller, "primary")
    primary.send(f"def long():\n{PADDING}  sleep(60)\nend\n".encode())
    assert compiling.has_begun.wait(10)
    controller.faults.reboot(downtime=0.01)
    until(lambda: controller.is_up)
    compiling.may_end.set()
    primary = connect(controller, "primary")
    primary.send(TURN.encode())
    assert keys(primary, 2) == ["started turn", "stopped turn"]


def test_close_waits_for_the_compilation(connect: Connect, compiling: Compiling) -> None:
    before = set(threading.enumerate())
    with Controller("UR5e", "5.11") as controller:
        connect(controller, "primary").send(f"def long():\n{PADDING}  sleep(60)\nend\n".encode())
        assert compiling.has_begun.wait(10)
        threading.Timer(0.1, compiling.may_end.set).start()
    until(lambda: set(threading.enumerate()) <= before)
    assert not controller.is_running_program


def test_compilation_per_cycle_is_bounded() -> None:
    """A flood of lines, each of them a program, adds only a little to each cycle, and other clients get their turn."""
    controller = Controller("UR5e", "5.11", motion=Still())
    loader = controller._loader
    flood, other = loader.open(), loader.open()
    for _ in range(100):
        assert flood.put("nonsense()")
    other.put(TURN)
    in_a_cycle = -(-BUDGET // LEAST)
    begun = [len(controller.take_messages())]
    while loader.is_waiting:
        controller.step()
        loader.advance()
        begun.append(len(controller.take_messages()))
        loader.advance()
        assert not controller.take_messages()  # nothing more in this cycle
    assert begun[0] == in_a_cycle
    assert max(begun) <= in_a_cycle + 1
    assert controller.program_name == "turn"
    assert sum(begun) == 101


def test_queued_programs_are_bounded_per_client() -> None:
    controller = Controller("UR5e", "5.11", motion=Still())
    compiled = threading.Event()
    loader = controller._loader
    loader.on_compiled = compiled.set
    queue, other = loader.open(), loader.open()
    assert queue.put(f"def long():\n{PADDING}end\n")
    assert queue.put("x" * (MOST_WAITING - 100))
    assert not queue.put("y" * 101)
    # A full queue of one client does not block another client.
    assert other.put("y" * 101)
    assert queue.put(TURN)
    assert compiled.wait(10)
    loader.advance()
    assert controller.program_name == "long"
    loader.close()


# -- sockets of programs -------------------------------------------------------------------------------


def test_program_reads_integers_from_its_sender(
    controller: Controller, connect: Connect, listener: socket.socket
) -> None:
    port = listener.getsockname()[1]
    link = connect(controller, "secondary")
    program = (
        f'def f():\n  socket_open("127.0.0.1", {port}, "back")\n'
        '  socket_send_line("ready", "back")\n'
        '  got = socket_read_binary_integer(3, "back", 10)\n'
        '  socket_send_int(got[0], "back")\n  socket_send_int(got[1] + got[3], "back")\n'
        '  socket_send_int(get_list_length(got), "back")\nend\n'
    )
    link.send(program.encode())
    peer, _ = listener.accept()
    with peer:
        peer.settimeout(10)
        # Even if no client reads the state of the arm, every cycle of a program is executed.
        assert peer.recv(6) == b"ready\n"
        for part in ((-70_000).to_bytes(4, "big", signed=True), b"\0\0", b"\0\1", (70_007).to_bytes(4, "big")):
            peer.sendall(part)
        answer = b""
        while data := peer.recv(100):
            answer += data
    assert [int.from_bytes(answer[at : at + 4], "big", signed=True) for at in (0, 4, 8)] == [3, 7, 4]
    # The program has ended, which also closed its socket.
    until(lambda: controller.program_name is None)


def test_program_answers_50_requests_over_a_socket(
    controller: Controller, connect: Connect, listener: socket.socket
) -> None:
    port = listener.getsockname()[1]
    program = (
        f'def f():\n  socket_open("127.0.0.1", {port})\n  n = 0\n  while n < 50:\n'
        "    got = socket_read_binary_integer(1)\n    socket_send_int(got[1] + 1)\n    n = n + 1\n  end\nend\n"
    )
    connect(controller, "primary").send(program.encode())
    peer, _ = listener.accept()
    with peer:
        peer.settimeout(10)
        for number in range(50):
            peer.sendall(number.to_bytes(4, "big"))
            assert int.from_bytes(peer.recv(4), "big") == number + 1
        assert peer.recv(4) == b""


@pytest.mark.parametrize("end", ["stop", "reboot", "close", "new"])
def test_end_of_a_program_closes_its_sockets(
    end: str, controller: Controller, connect: Connect, listener: socket.socket
) -> None:
    port = listener.getsockname()[1]
    primary = connect(controller, "primary")
    primary.send(f'def f():\n  socket_open("127.0.0.1", {port})\n  sleep(60)\nend\n'.encode())
    peer, _ = listener.accept()
    with peer:
        peer.settimeout(10)
        if end == "stop":
            controller.call(controller.pendant.stop)
        elif end == "reboot":
            controller.faults.reboot(downtime=0.1)
        elif end == "close":
            controller.close()
        else:
            primary.send(WAIT.encode())
        assert peer.recv(1) == b""


def test_end_of_a_secondary_program_closes_its_sockets(
    controller: Controller, connect: Connect, listener: socket.socket
) -> None:
    port = listener.getsockname()[1]
    connect(controller, "primary").send(f'sec s():\n  socket_open("127.0.0.1", {port})\nend\n'.encode())
    peer, _ = listener.accept()
    with peer:
        peer.settimeout(10)
        assert peer.recv(1) == b""


def test_heavy_program_does_not_block_calls_or_the_dashboard(controller: Controller, connect: Connect) -> None:
    link = connect(controller, "primary")
    # Each cycle takes many times its period to compute.
    loop = (
        "    i = 0\n    while i < 400:\n      get_inverse_kin(p[0.3, 0.2, 0.3, 0, 3.1, 0])\n      i = i + 1\n    end\n"
    )
    link.send(f"def heavy():\n  while True:\n{loop}    sync()\n  end\nend\n".encode())
    until(lambda: controller.program_name == "heavy")
    for _ in range(20):
        controller.call(lambda: None)
    asking = connect(controller, "dashboard")
    assert asking.segment().startswith(b"Connected")
    assert reply(asking, "running") == "Program running: true"
    # Each line waits for its turn, but does not wait for all the late cycles.
    asking.send(b"running\n" * 400)
    data = b""
    while data.count(b"\n") < 400:
        data += asking.segment()
    assert reply(asking, "stop") == "Stopped"


# -- dashboard -----------------------------------------------------------------------------------------


def test_dashboard_starts_a_program_from_power_off() -> None:
    with urlink.connect("sim://ur5e") as robot:
        controller, dashboard = robot.controller, robot.dashboard
        assert controller is not None
        controller.pendant.files.update({"turn.urp": TURN, "wait.urp": WAIT})
        dashboard.stop()
        dashboard.power_off()
        until(lambda: dashboard.robot_mode() is RobotMode.POWER_OFF)
        with pytest.raises(urlink.DashboardRefused):
            dashboard.play()
        dashboard.power_on()
        until(lambda: dashboard.robot_mode() is RobotMode.IDLE)
        dashboard.brake_release()
        until(lambda: dashboard.robot_mode() is RobotMode.RUNNING)
        dashboard.load("wait.urp")
        dashboard.play()
        assert dashboard.program_state().state is ProgramState.PLAYING
        dashboard.pause()
        assert dashboard.program_state().state is ProgramState.PAUSED
        dashboard.play()
        assert dashboard.program_state().state is ProgramState.PLAYING
        dashboard.stop()
        assert dashboard.program_state().state is ProgramState.STOPPED
        controller.faults.protective_stop()
        with pytest.raises(urlink.DashboardRefused, match="5s"):
            dashboard.unlock_protective_stop()
        controller.remote_control = False
        with pytest.raises(urlink.DashboardRefused, match="Remote Control"):
            dashboard.play()
        dashboard.quit()
        assert not dashboard.is_in_remote_control()


def test_dashboard_replies_to_quit_before_disconnecting(controller: Controller, connect: Connect) -> None:
    link = connect(controller, "dashboard")
    assert link.segment() == b"Connected: Universal Robots Dashboard Server\n"
    link.send(b"robotmode\nquit\nrobotmode\n")
    data = b""
    while data.count(b"\n") < 2:
        data += link.segment()
    assert data == b"Robotmode: RUNNING\nDisconnected\n"
    assert link.is_ended()


def test_dashboard_commands_in_one_segment_run_in_order(controller: Controller, connect: Connect) -> None:
    link = connect(controller, "dashboard")
    assert link.segment().startswith(b"Connected")
    link.send(b"load wait.urp\r\nplay\r\nprogramState\r\npause\r\nprogramState\r\nplay\r\nstop\r\nprogramState\r\n")
    data = b""
    while data.count(b"\n") < 8:
        data += link.segment()
    assert data.decode().splitlines() == [
        "Loading program: wait.urp",
        "Starting program",
        "PLAYING wait.urp",
        "Pausing program",
        "PAUSED wait.urp",
        "Starting program",
        "Stopped",
        "STOPPED wait.urp",
    ]


def test_connection_faults_also_affect_the_dashboard(controller: Controller, connect: Connect) -> None:
    link = connect(controller, "dashboard")
    assert link.segment().startswith(b"Connected")
    controller.faults.garbage(b"???", "dashboard")
    assert reply(link, "running") == "???Program running: false"
    controller.faults.stall(60.0, "dashboard")
    link.send(b"load wait.urp\nplay\n")
    # The reply is lost, but the command is executed.
    until(lambda: controller.program_name == "wait")
    controller.faults.heal()
    assert reply(link, "running") == "Program running: true"
    controller.faults.cut("dashboard")
    assert link.is_ended()
    with pytest.raises(BadValue, match="packages"):
        controller.faults.unknown_package(port="dashboard")


# -- the controller as seen by its programs ----------------------------------------------------------


@pytest.mark.parametrize("host", ["127.0.0.1", "localhost"])
def test_program_can_connect_to_ports_of_its_own_controller(
    controller: Controller, connect: Connect, host: str
) -> None:
    """Public programs move the speed slider in this way. To a program, the actual port of 30003 is always 30003."""
    link = connect(controller, "primary")
    program = f"""def slider():
  socket_open("{host}", 30003, "own")
  socket_send_line("set speed 0.4", "own")
  socket_close("own")
  socket_open("{host}", 29999)
  textmsg(socket_read_line())
end
"""
    link.send(program.encode())
    (greeting,) = messages(link, urlink.packets.TextMessage, 1)
    assert greeting.text == "Connected: Universal Robots Dashboard Server"
    until(lambda: controller.speed_fraction == 0.4)


def test_own_port_that_is_not_served_refuses_a_program(connect: Connect) -> None:
    with Controller("UR5e", "5.11", motion=Still(), ports={"primary": 0}) as controller:
        link = connect(controller, "primary")
        link.send(b'textmsg(socket_open("127.0.0.1", 29999))\n')
        (answer,) = messages(link, urlink.packets.TextMessage, 1)
        assert answer.text == "False"
