"""Set-points over input registers: written values, and the program on the robot, cycle by cycle."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping

import numpy as np
import pytest

from linkcore.errors import ConnectFailed, ConnectionLost, LinkTimeout
from tests.fakes.rehearsal import HOME, turned
from tests.urlink.motion.bench import Bench
from urlink.motion.links import register_link
from urlink.motion.links.register_link import SETPOINT_INPUTS, RegisterLink, RegisterPort
from urlink.motion.moves.trajectory import Trajectory
from urlink.protocol.firmware import Firmware
from urlink.script import links
from urlink.script.messages import LARGEST, STOP_MESSAGE, WAIT_MESSAGE, dated, setpoint
from urlink.script.streaming import streaming
from urlink.simulator.registers import Bank

FIRMWARES = [Firmware(3, 15), Firmware(5, 11), Firmware(10, 12)]
#: Largest speed of each joint of a UR5, in rad/s.
SPEEDS = [np.pi] * 6
STILL = [0.0] * 6
PATH = Trajectory.from_arrays([0, 0.5, 1.0], [turned(0), turned(0.2), turned(0)])


def write(inputs: Bank, package: Mapping[str, float]) -> None:
    """Write a package of RTDE inputs, as a controller does."""
    for name, value in package.items():
        _, kind, _, number = name.split("_")
        if kind == "double":
            inputs.floats[int(number)] = float(value)
        else:
            assert -(1 << 31) <= value < 1 << 31
            inputs.integers[int(number)] = int(value)


class Inputs:
    """Claimed RTDE inputs."""

    def __init__(self, take: Callable[[dict[str, float]], object]) -> None:
        self._take = take

    def _write(self, values: Mapping[str, float]) -> None:
        self._take(dict(values))


class Led(Bench):
    """A streaming program and its link; all registers contain values from other clients."""

    def __init__(self, firmware: Firmware, **options: float) -> None:
        self.link = RegisterLink(Inputs(lambda package: write(self.registers.inputs, package)))
        super().__init__(streaming(firmware, self.link.endpoint, speeds=SPEEDS, **options), firmware)
        self.registers.inputs.floats = [0.5] * 48
        self.registers.inputs.integers = [1] * 48  # FOLLOW, for a program that ignores the token

    def connect(self) -> Led:
        self.run(3)
        assert self.link.poll(has_begun=True)
        self.deliver(WAIT_MESSAGE, cycles=3)
        return self

    def deliver(self, message: bytes, cycles: int = 1) -> None:
        self.link.send(dated(message, self.cycle))
        self.run(cycles)


def test_link_writes_all_inputs() -> None:
    packages: list[dict[str, float]] = []
    link = RegisterLink(Inputs(packages.append))
    assert not link.is_up
    assert not link.poll(has_begun=False)
    assert link.poll(has_begun=True)
    link.send(dated(setpoint([0.1, -0.2, 0.3, -0.4, 0.5, -0.6], [1.1, -1.2, 1.3, -1.4, 1.5, -1.6]), 500))
    link.send(dated(STOP_MESSAGE, 501))
    assert [tuple(package) for package in packages] == [SETPOINT_INPUTS, SETPOINT_INPUTS]
    token = link.endpoint.token
    assert list(packages[0].values()) == pytest.approx(
        [0.1, -0.2, 0.3, -0.4, 0.5, -0.6, 1.1, -1.2, 1.3, -1.4, 1.5, -1.6, 500, 1, links.FOLLOW, token]
    )
    assert list(packages[1].values()) == [0.0] * 12 + [501, 2, links.STOP, token]
    assert link.received() == b""
    link.close(farewell=True)
    assert [link.is_up, link.poll(has_begun=True)] == [False, False]
    with pytest.raises(ConnectionLost):
        link.send(WAIT_MESSAGE)
    assert isinstance(link.absence("nothing came"), ConnectFailed)


def test_message_numbers_and_cycle_counts_fit_a_register(monkeypatch: pytest.MonkeyPatch) -> None:
    """They are never 0, because an unwritten register holds 0."""
    packages: list[dict[str, float]] = []
    link = RegisterLink(Inputs(packages.append))
    assert LARGEST == 0x7FFF_FFFF  # reached after 50 days at 500 Hz
    monkeypatch.setattr(register_link, "LARGEST", 2)
    for date in range(4):
        link.send(dated(WAIT_MESSAGE, date))
    assert [package["input_int_register_45"] for package in packages] == [1, 2, 1, 2]
    link.send(dated(WAIT_MESSAGE, 0x8000_0000))
    assert packages[-1]["input_int_register_44"] == 0x7FFF_FFFF


def test_registers_are_claimed_only_for_first_program() -> None:
    claimed: list[tuple[str, ...]] = []

    def claim(names: tuple[str, ...]) -> Inputs:
        claimed.append(names)
        return Inputs(lambda package: None)

    port = RegisterPort(claim, 1.0, SETPOINT_INPUTS, RegisterLink)
    assert claimed == []
    opened = [port.open() for _ in range(3)]
    assert claimed == [SETPOINT_INPUTS]
    # Each link has a different token, which is not the initial value of a register.
    tokens = {link.endpoint.token for link in opened}
    assert len(tokens) == 3
    assert all(0 < token < links.TOKENS for token in tokens)


@pytest.mark.simulated_time
def test_two_threads_claim_the_registers_once() -> None:
    claimed: list[float] = []

    def claim(names: tuple[str, ...]) -> Inputs:
        claimed.append(time.monotonic())
        time.sleep(0.5)  # until the controller answers
        return Inputs(lambda package: None)

    port = RegisterPort(claim, 1.0, SETPOINT_INPUTS, RegisterLink)
    opened: list[RegisterLink] = []
    threads = [threading.Thread(target=lambda: opened.append(port.open())) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(opened) == 2
    assert len(claimed) == 1


@pytest.mark.simulated_time
def test_claim_is_awaited_no_longer_than_timeout() -> None:
    def claim(names: tuple[str, ...]) -> Inputs:
        with pytest.raises(LinkTimeout, match="still being claimed after 1 s"):
            port.open()  # as a signal handler does
        raise ConnectionLost("cut")

    port = RegisterPort(claim, 1.0, SETPOINT_INPUTS, RegisterLink)
    for _ in range(2):  # the second attempt claims again
        with pytest.raises(ConnectionLost, match=r"^cut$"):
            port.open()


@pytest.mark.parametrize("firmware", FIRMWARES, ids=str)
def test_program_follows_written_set_points(firmware: Firmware) -> None:
    bench = Led(firmware, lookahead_time=0.03).connect()
    times = np.arange(round(PATH.duration * firmware.rate)) * bench.period
    for t in times:
        bench.deliver(setpoint(*PATH.sample(float(t))[:2]))
    wanted = PATH.at(times)[0]
    fastest = np.abs(PATH.at(np.linspace(0, 1, 1000))[1]).max()
    assert np.abs(np.array(bench.path[-len(times) :]) - wanted).max() < 0.06 * fastest
    bench.deliver(STOP_MESSAGE, cycles=200)
    assert bench.has_finished
    assert bench.motion.is_standing
    assert bench.said == []
    # The controller's own watchdog expires after the program's watchdog.
    ((variable, frequency, action),) = bench.watched
    assert (variable, action) == ("input_int_register_45", "stop")
    assert frequency == pytest.approx(1 / 1.1)


@pytest.mark.parametrize("firmware", FIRMWARES, ids=str)
def test_first_message_may_be_a_set_point(firmware: Firmware) -> None:
    """The set-point arrives in the same package as the token."""
    bench = Led(firmware)
    targets: list[list[float]] = []
    bench.watch_servoj(targets.append)
    bench.run(3)
    for _ in range(5):
        bench.deliver(setpoint(HOME, STILL))
    assert np.array(targets) == pytest.approx(np.tile(HOME, (len(targets), 1)), abs=1e-6)
    assert len(targets) >= 4


@pytest.mark.parametrize("firmware", FIRMWARES, ids=str)
def test_program_ignores_messages_without_token(firmware: Firmware) -> None:
    """Registers keep the last written values; without the token, they are not for this program."""
    bench = Led(firmware)
    bench.run(5 * firmware.rate - 5)
    assert not bench.execution.is_over
    bench.run(20)
    assert bench.has_finished
    assert bench.said == [links.NO_CONNECTION]
    assert all(q == list(HOME) for q in bench.path)


@pytest.mark.parametrize("firmware", FIRMWARES, ids=str)
def test_program_brakes_without_new_messages(firmware: Firmware) -> None:
    bench = Led(firmware, watchdog=0.1).connect()
    for i in range(50):
        bench.deliver(setpoint(turned(1.0 * i * bench.period), [*STILL[:5], 1.0]))
    bench.run(round(np.ceil(0.1 / bench.period)))
    assert bench.said == []
    bench.run(2)
    assert bench.said == [links.STARVED]
    bench.run(round(0.6 / bench.period))
    assert bench.motion.is_standing
    assert bench.has_finished


@pytest.mark.parametrize("firmware", FIRMWARES, ids=str)
def test_missing_message_does_not_disturb_the_path(firmware: Firmware) -> None:
    smooth, gappy = Led(firmware).connect(), Led(firmware).connect()
    for bench in (smooth, gappy):
        for i in range(100):
            if bench is smooth or i % 10:
                bench.deliver(setpoint(turned(0.5 * i * bench.period), [*STILL[:5], 0.5]))
            else:
                bench.run()
    assert np.abs(np.array(smooth.path[-60:]) - gappy.path[-60:]).max() < 0.5 * 0.5 * smooth.period


@pytest.mark.parametrize("firmware", FIRMWARES, ids=str)
def test_distant_set_point_is_reached_without_jump(firmware: Firmware) -> None:
    bench = Led(firmware, watchdog=0.1).connect()
    targets: list[list[float]] = []
    bench.watch_servoj(targets.append, is_followed=False)
    bench.deliver(setpoint(HOME, STILL))
    for _ in range(firmware.rate // 2):
        bench.deliver(setpoint(turned(0.5), STILL))
    assert np.abs(np.diff(np.array(targets), axis=0)).max() <= np.pi / firmware.rate + 1e-9
    assert targets[-1] == pytest.approx(turned(0.5), abs=1e-6)
