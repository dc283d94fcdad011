"""Run the uploaded programs in the simulator's interpreter, cycle by cycle."""

from __future__ import annotations

import numpy as np
import pytest

from tests.fakes.line import START_PLACE
from tests.fakes.rehearsal import HOME, turned
from tests.urlink.motion.bench import Bench
from urlink.motion.moves.trajectory import Trajectory
from urlink.protocol.firmware import Firmware
from urlink.script import commands, links, waypoints
from urlink.script.messages import STOP_MESSAGE, WAIT_MESSAGE, setpoint
from urlink.script.streaming import streaming as streaming_program
from urlink.script.text import number
from urlink.script.wrapping import Permission, expiry_marker, grant

TOKEN = 0x01020304
#: Largest speed of each joint of a UR5, in rad/s.
SPEEDS = [np.pi] * 6
FIRMWARES = [Firmware(1, 8), Firmware(3, 4), Firmware(5, 11), Firmware(10, 12)]
NEW = FIRMWARES[1:]

#: Smooth: at rest at both ends, with accelerations.
WAVE = Trajectory.from_arrays(
    [0, 0.5, 1.0, 1.5],
    [turned(0), turned(0.2), turned(-0.1), turned(0)],
    np.array([[0.0] * 6, [0, 0, 0, 0, 0, 0.1], [0, 0, 0, 0, 0, -0.1], [0] * 6]),
    np.zeros((4, 6)),
)


STILL = [0.0] * 6


def spinning(speed: float) -> list[float]:
    """Return speeds with only the last joint turning, in rad/s."""
    return [*STILL[:5], speed]


def streaming(firmware: Firmware, **options: float) -> Bench:
    bench = Bench(
        streaming_program(firmware, links.ReverseSocket("10.0.0.1", 50001, TOKEN), speeds=SPEEDS, **options),
        firmware,
    )
    bench.run(3, lambda: bench.deliver(WAIT_MESSAGE))
    assert bytes(bench.sockets.sent) == TOKEN.to_bytes(4, "big")
    return bench


@pytest.mark.parametrize("firmware", FIRMWARES, ids=str)
def test_program_follows_streamed_set_points(firmware: Firmware) -> None:
    bench = streaming(firmware, lookahead_time=0.03)
    cycles = round(WAVE.duration / bench.period)
    times = iter(np.arange(cycles) * bench.period)
    bench.run(cycles, lambda: bench.deliver(setpoint(*WAVE.sample(next(times))[:2])))
    wanted = WAVE.at(np.arange(cycles) * bench.period)[0]
    # The arm never trails by more than the distance that it moves in 60 ms.
    fastest = np.abs(WAVE.at(np.linspace(0, 1.5, 1000))[1]).max()
    assert np.abs(np.array(bench.path[3:]) - wanted).max() < 0.06 * fastest
    bench.deliver(setpoint(HOME, STILL) + STOP_MESSAGE)
    bench.run(200)
    assert bench.has_finished
    assert bench.motion.is_standing
    assert bench.said == []
    assert not bench.sockets.is_open


@pytest.mark.parametrize("firmware", FIRMWARES, ids=str)
def test_missing_set_point_changes_path_by_less_than_half_a_step(firmware: Firmware) -> None:
    smooth, gappy = streaming(firmware), streaming(firmware)
    for bench in (smooth, gappy):
        for i in range(100):
            if bench is smooth or i % 10:
                bench.deliver(setpoint(turned(0.5 * i * bench.period), spinning(0.5)))
            bench.run()
    assert np.abs(np.array(smooth.path[-60:]) - gappy.path[-60:]).max() < 0.5 * 0.5 * smooth.period


@pytest.mark.parametrize("firmware", FIRMWARES, ids=str)
def test_program_coasts_at_decreasing_speed(firmware: Firmware) -> None:
    bench = streaming(firmware, watchdog=0.1)
    targets: list[list[float]] = []
    bench.watch_servoj(targets.append)
    speed = spinning(0.002 * firmware.rate)
    for i in (0, 1, 2):
        bench.deliver(setpoint(turned(0.002 * i), speed))
        bench.run()
    most = links.missable(0.1, firmware.rate)
    bench.run(most)
    steps = np.diff([q[5] for q in targets])[1:]
    assert np.allclose(steps, [0.002, *(0.002 * (1 - n / most) for n in range(1, most + 1))], rtol=0, atol=1e-9)


@pytest.mark.parametrize("firmware", NEW, ids=str)
def test_program_coasts_at_the_sent_speed(firmware: Firmware) -> None:
    most = links.missable(0.1, firmware.rate)
    late = streaming(firmware, watchdog=0.1)
    targets: list[list[float]] = []
    late.watch_servoj(targets.append)
    for step in (0, 1, None, None, 4, None):
        late.deliver(b"" if step is None else setpoint(turned(0.001 * step), spinning(-0.2)))
        late.run()
    assert targets[-1][5] - targets[-2][5] == pytest.approx(-0.2 / firmware.rate * (1 - 1 / most), abs=1e-9)


@pytest.mark.parametrize("firmware", FIRMWARES, ids=str)
def test_distant_set_point_is_reached_without_jump(firmware: Firmware) -> None:
    """The arm still gets there, at the largest speed of each joint; on CB2 it accelerates by 50 rad/s² at most."""
    bench = streaming(firmware, watchdog=0.1)
    targets: list[list[float]] = []
    bench.watch_servoj(targets.append, is_followed=False)
    away = [0.3, HOME[1] - 0.3, HOME[2] + 0.2, HOME[3] - 0.1, HOME[4] + 0.05, 0.5]
    for aim in (HOME, *[away] * round(0.5 * firmware.rate)):
        bench.deliver(setpoint(aim, STILL))
        bench.run()
    steps = np.abs(np.diff(np.array(targets), axis=0))
    assert steps.max() <= np.pi / firmware.rate + 1e-9
    first = 50.0 / firmware.rate**2 if firmware.is_cb2 else np.pi / firmware.rate
    assert steps[0] == pytest.approx([first] * 6, abs=1e-6)
    if firmware.is_cb2:
        assert np.abs(np.diff(np.array(targets), 2, axis=0)).max() <= first + 1e-9
    assert targets[-1] == pytest.approx(away, abs=1e-6)


@pytest.mark.parametrize("firmware", FIRMWARES, ids=str)
def test_program_brakes_if_set_points_are_missing(firmware: Firmware) -> None:
    bench = streaming(firmware, watchdog=0.1)
    for i in range(50):
        bench.deliver(setpoint(turned(1.0 * i * bench.period), spinning(1.0)))
        bench.run()
    watchdog = round(np.ceil(0.1 / bench.period))
    bench.run(watchdog)
    assert bench.said == []
    bench.run(2)
    assert bench.said == [links.STARVED]
    bench.run(round(0.6 / bench.period))
    assert bench.motion.is_standing
    assert not bench.execution.is_over
    # A set-point that arrives now is too late.
    bench.deliver(setpoint(turned(0), STILL))
    bench.run(10)
    assert bench.has_finished
    assert bench.motion.is_standing


@pytest.mark.parametrize("firmware", FIRMWARES, ids=str)
def test_program_brakes_and_ends_with_link(firmware: Firmware) -> None:
    bench = streaming(firmware)
    for i in range(50):
        bench.deliver(setpoint(turned(1.0 * i * bench.period), spinning(1.0)))
        bench.run()
    bench.sockets.is_open = False
    bench.run(round(0.6 / bench.period))
    assert bench.said == [links.LINK_ENDED]
    assert bench.has_finished
    assert bench.motion.is_standing


@pytest.mark.parametrize("firmware", FIRMWARES, ids=str)
def test_program_reports_failed_connection(firmware: Firmware) -> None:
    for body in (
        streaming_program(firmware, links.ReverseSocket("10.0.0.1", 50001, TOKEN), speeds=SPEEDS),
        waypoints.interpolating(firmware, "10.0.0.1", 50001, TOKEN, is_quintic=True),
    ):
        bench = Bench(body, firmware)
        bench.sockets.is_refused = True
        bench.run(20)
        assert bench.said == [links.NO_CONNECTION]
        assert bench.has_finished


class Server:
    """Server that answers a waypoint program, `late` cycles after each request."""

    def __init__(self, bench: Bench, path: Trajectory, late: int = 0, until: int = 99) -> None:
        self.bench, self.path, self.late, self.until = bench, path, late, until
        self.requests: list[int] = []
        self.beats = 0
        self._due: list[tuple[int, bytes]] = []
        self._is_introduced = False

    def __call__(self) -> None:
        if not self._is_introduced and len(self.bench.sockets.sent) >= 4:
            assert bytes(self.bench.sockets.sent[:4]) == TOKEN.to_bytes(4, "big")
            del self.bench.sockets.sent[:4]
            self._is_introduced = True
        if not self._is_introduced:
            return
        for request in self.bench.sockets.lines():
            self.requests.append(request)
            self._due.append((self.bench.cycle + self.late, self.answer(request)))
        while self._due and self._due[0][0] <= self.bench.cycle:
            self.bench.sockets.waiting.extend(self._due.pop(0)[1])

    def answer(self, request: int) -> bytes:
        if request == waypoints.BEAT:
            self.beats += 1
            return b"(1)\r\n"
        if request == waypoints.ARRIVED or request >= self.until:
            return b""
        if request >= len(self.path):
            numbers = [0.0] * (waypoints.numbers_of_point(self.path.is_quintic) - 1)
            return f"(-1, {', '.join(map(str, numbers))})\r\n".encode()
        path = self.path
        numbers = [*path.q[request], *path.qd[request]]
        if path.qdd is not None:
            numbers += [*path.qdd[request]]
        numbers.append(path.time[request] - path.time[max(request - 1, 0)])
        return f"({request}, {', '.join(map(number, numbers))})\r\n".encode()


def handing_over(firmware: Firmware, path: Trajectory = WAVE, **options: int) -> tuple[Bench, Server]:
    body = waypoints.interpolating(firmware, "10.0.0.1", 50001, TOKEN, is_quintic=path.is_quintic, lookahead_time=0.03)
    bench = Bench(body, firmware)
    return bench, Server(bench, path, **options)


@pytest.mark.parametrize("is_quintic", [False, True])
@pytest.mark.parametrize("firmware", NEW, ids=str)
def test_program_follows_requested_points(firmware: Firmware, is_quintic: bool) -> None:
    path = WAVE if is_quintic else Trajectory.from_arrays(WAVE.time, WAVE.q, WAVE.qd)
    bench, server = handing_over(firmware, path)
    targets: list[list[float]] = []
    bench.watch_servoj(targets.append)
    bench.run(round(4.0 / bench.period), server)
    server()
    assert bench.has_finished
    assert bench.said == []
    assert [each for each in server.requests if each != waypoints.BEAT] == [0, 1, 2, 3, 4, waypoints.ARRIVED]
    assert server.beats > 1
    assert bench.path[-1] == pytest.approx(WAVE.q[-1], abs=1e-6)
    # Between its first and last movement, the arm is sent to the current point of the trajectory in each cycle.
    moving = targets[int(np.flatnonzero(np.abs(np.diff([q[5] for q in targets])) > 0.0)[0]) :]
    times = np.arange(len(moving)) * bench.period
    assert np.abs(np.array(moving) - path.at(times)[0]).max() < 1e-8


@pytest.mark.parametrize("is_quintic", [False, True])
@pytest.mark.parametrize("firmware", NEW, ids=str)
def test_program_uses_speed_and_acceleration_of_each_point(firmware: Firmware, is_quintic: bool) -> None:
    """Points in between have speeds and accelerations in every joint, all of them different."""
    rng = np.random.default_rng(7)
    q = np.tile(HOME, (4, 1)) + 0.1 * rng.uniform(-1, 1, (4, 6))
    q[0] = HOME
    qd, qdd = 0.2 * rng.uniform(-1, 1, (4, 6)), 0.5 * rng.uniform(-1, 1, (4, 6))
    qd[[0, -1]] = 0.0
    path = Trajectory.from_arrays([0, 0.31, 0.72, 1.0], q, qd, qdd if is_quintic else None)
    bench, server = handing_over(firmware, path)
    targets: list[list[float]] = []
    bench.watch_servoj(targets.append)
    bench.run(round(2.5 / bench.period), server)
    assert bench.said == []
    moving = targets[int(np.flatnonzero(np.abs(np.diff([q[5] for q in targets])) > 0.0)[0]) :]
    times = np.arange(len(moving)) * bench.period
    assert np.abs(np.array(moving) - path.at(times)[0]).max() < 1e-8


@pytest.mark.parametrize("firmware", NEW, ids=str)
def test_requested_waypoint_may_arrive_nearly_one_segment_late(firmware: Firmware) -> None:
    bench, server = handing_over(firmware, late=round(0.4 * firmware.rate))
    bench.run(round(5.0 / bench.period), server)
    assert bench.said == []
    assert bench.path[-1] == pytest.approx(WAVE.q[-1], abs=1e-6)


@pytest.mark.parametrize("firmware", NEW, ids=str)
def test_missing_waypoint_ends_program_at_rest(firmware: Firmware) -> None:
    bench, server = handing_over(firmware, until=2)
    bench.run(round(4.0 / bench.period), server)
    assert bench.said[0] in (links.STARVED, links.LINK_ENDED)
    assert bench.has_finished
    assert bench.motion.is_standing
    assert bench.path[-1][5] < 0.3


@pytest.mark.slow
@pytest.mark.parametrize("firmware", NEW, ids=str)
def test_lost_link_is_noticed_while_no_waypoint_is_requested(firmware: Firmware) -> None:
    slow = Trajectory.from_arrays([0, 10], [turned(0), turned(2)])
    bench, server = handing_over(firmware, slow)
    bench.run(round(5.0 / bench.period), server)
    bench.sockets.is_open = False
    bench.run(round(1.0 / bench.period), server)
    assert bench.said == [links.LINK_ENDED]
    assert bench.has_finished
    assert bench.motion.is_standing
    assert 0.9 < bench.path[-1][5] < 1.2


@pytest.mark.parametrize("firmware", NEW, ids=str)
def test_far_first_waypoint_ends_program(firmware: Firmware) -> None:
    far = Trajectory.from_arrays([0, 1], [turned(0.02), turned(0.02)])
    bench, server = handing_over(firmware, far)
    bench.run(50, server)
    assert bench.said == [links.TOO_FAR]
    assert bench.has_finished
    assert bench.path[-1] == list(HOME)


@pytest.mark.parametrize("version", ["1.8", "3.1", "3.4", "5.11"])
def test_speed_lasts_for_given_duration(version: str) -> None:
    firmware = Firmware.parse(version)
    bench = Bench(commands.speed_joints(firmware, [0, 0, 0, 0, 0, 0.5], 2.0, 0.5), firmware)
    bench.run(round(2.0 / bench.period))
    assert bench.has_finished
    assert bench.motion.is_standing
    # Firmware 3.1 starts to count the time when the speed is reached.
    assert 0.2 < bench.path[-1][5] < 0.4


# -- start permission ------------------------------------------------------------------------------------


def permission_on(firmware: Firmware, token: int = 5) -> Permission:
    return Permission(START_PLACE.on(firmware), token, cycles=40)


@pytest.mark.parametrize("firmware", FIRMWARES, ids=str)
@pytest.mark.parametrize("after", [0, 1, 38])
def test_program_waits_for_start_permission(firmware: Firmware, after: int) -> None:
    permission = permission_on(firmware)
    bench = Bench(commands.move_joints(turned(0.1), 1.0, 5.0), firmware, permission=permission)
    bench.beside(grant(permission))  # left over from an earlier program with the same token
    bench.run(1 + after)
    assert bench.texts == ["tried started"]
    assert bench.path[-1] == list(HOME)
    bench.beside(grant(permission))
    bench.run(2 * firmware.rate)
    assert bench.has_finished
    assert bench.path[-1] == pytest.approx(turned(0.1))


@pytest.mark.parametrize("firmware", FIRMWARES, ids=str)
def test_program_without_permission_ends_without_moving(firmware: Firmware) -> None:
    permission = permission_on(firmware)
    bench = Bench(commands.move_joints(turned(0.1), 1.0, 5.0), firmware, permission=permission)
    bench.beside(grant(permission))
    bench.run(40)
    assert [bench.execution.is_over] == [False]
    bench.run(5)
    assert [bench.execution.is_over] == [True]
    bench.beside(grant(permission))
    bench.run(100)
    assert bench.texts == ["tried started", expiry_marker("tried")]
    assert all(q == list(HOME) for q in bench.path)


@pytest.mark.parametrize("firmware", FIRMWARES, ids=str)
def test_permission_for_another_program_is_ignored(firmware: Firmware) -> None:
    permission = permission_on(firmware)
    bench = Bench(commands.move_joints(turned(0.1), 1.0, 5.0), firmware, permission=permission)
    bench.run(2)
    bench.beside(grant(permission))
    bench.beside(grant(permission_on(firmware, 7)))  # overwrites the right permission before the program reads it
    bench.run(2)
    assert bench.texts == ["tried started"] * 2  # so the program asks again
    assert bench.path[-1] == list(HOME)
    bench.beside(grant(permission))
    bench.run(2 * firmware.rate)
    assert bench.has_finished
