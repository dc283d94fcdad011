"""Trajectory that the robot requests point by point: requests, answers, and checks of its arm."""

from __future__ import annotations

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import ArrayLike

from linkcore.errors import BadValue, ConnectionLost, LinkTimeout
from tests.fakes.rehearsal import HOME, turned
from tests.urlink.motion.bench import PLAYING, Bench
from urlink.errors import ProgramStopped, ToleranceExceeded
from urlink.motion.moves.trajectory import Trajectory
from urlink.motion.servo.following import Tolerances
from urlink.motion.servo.waypoints import WaypointServer
from urlink.protocol.firmware import Firmware
from urlink.script.links import ReverseSocket

#: The intervals differ, so that each point shows its time after the previous one.
PATH = Trajectory.from_arrays([0.0, 0.5, 2.0], [HOME, turned(0.3), turned(0.5)])
TOLERANCES = Tolerances(path=0.1, goal=0.01, goal_time=1.0, start=0.05)


class Served:
    """A program that requests points, and its arm, on a clock that the test controls: each `step` is a state."""

    BEGIN = 50.0

    def __init__(self, path: Trajectory = PATH) -> None:
        self.server = WaypointServer(path, TOLERANCES, Firmware.parse("5.11"), 0.1, 300.0)
        self.seconds = 0.0
        self.angle, self.speed = 0.0, 0.0

    def step(self, said: bytes = b"", seconds: float = 0.0) -> list[list[float]]:
        """Pass a request after some seconds, and return the answers."""
        self.seconds += seconds
        speeds = np.array([0.0] * 5 + [self.speed])
        state: Any = SimpleNamespace(
            time=self.BEGIN + self.seconds,
            q_target=np.array(turned(self.angle)),
            q_actual=np.array(turned(self.angle)),
            qd_target=speeds,
            qd_actual=speeds,
            **PLAYING,
        )
        answers = self.server.step(said, state, 1000.0 + self.seconds).decode().splitlines()
        return [[float(each) for each in answer.strip("()").split(",")] for answer in answers]

    def set_out(self) -> None:
        """Request points until the arm has its first target and moves."""
        for said in (b"0\n", b"1\n", b"2\n"):
            self.step(said)

    def resume(self, q: ArrayLike | None = None) -> None:
        """Resume after a pause, at joint positions `q`; at the current position, if none are given."""
        there = np.array(turned(self.angle) if q is None else q)
        state: Any = SimpleNamespace(time=self.BEGIN + self.seconds, q_target=there, **PLAYING)
        self.server.resume(state)


def test_points_are_sent_on_request() -> None:
    """Requests may come in any pieces. The first point is the position of the arm."""
    served = Served()
    served.angle = 0.02
    assert served.step(b"-1\n0") == [[1.0]]
    assert served.step() == []
    ((number, *rest),) = served.step(b"\n")
    assert number == 0
    assert rest == pytest.approx([*turned(0.02), *[0.0] * 6, 0.0])
    answers = served.step(b"1\n-1\n2\n")
    assert [answer[0] for answer in answers] == [1.0, 1.0, 2.0]
    assert answers[0][1:] == pytest.approx([*turned(0.3), *PATH.qd[1], 0.5])
    assert answers[2][1:] == pytest.approx([*turned(0.5), *[0.0] * 6, 1.5])
    assert not served.server.survives_its_program
    assert served.step(b"3\n") == [[-1.0, *[0.0] * 13]]
    assert served.server.survives_its_program


def test_accelerations_are_sent_if_given() -> None:
    quintic = Trajectory.from_arrays(PATH.time, PATH.q, PATH.qd, np.arange(18).reshape(3, 6) / 100)
    served = Served(quintic)
    assert [answer[13:19] for answer in served.step(b"0\n1\n2\n")] == [
        pytest.approx(row) for row in np.arange(18).reshape(3, 6) / 100
    ]
    assert served.step(b"3\n") == [[-1.0, *[0.0] * 19]]


@pytest.mark.parametrize("firmware", ["3.4", "5.11"])
def test_requesting_program_moves_arm_along_trajectory(firmware: str) -> None:
    """Run both ends on the clock of the bench. ``servoj`` receives the look-ahead time and the gain."""
    path = Trajectory.from_arrays([0.0, 0.1, 0.25], [HOME, turned(0.05), turned(0.08)])
    server = WaypointServer(path, TOLERANCES, Firmware.parse(firmware), 0.05, 700.0)
    bench = Bench(server.body(ReverseSocket("10.0.0.1", 50001, 7)), Firmware.parse(firmware))
    received: set[tuple[float, ...]] = set()
    servoj = bench.motion.servoj

    def watched(q: Sequence[float], *parameters: float) -> object:
        received.add(parameters)
        return servoj(q, *parameters)

    bench.motion.servoj = watched  # type: ignore[method-assign,assignment]

    def answer() -> None:
        said = bytes(bench.sockets.sent).removeprefix(b"\0\0\0\7")
        bench.sockets.sent.clear()
        at = bench.motion.setpoint
        q, qd = np.array(at.q), np.array(at.qd)
        state: Any = SimpleNamespace(
            time=bench.cycle * bench.period, q_target=q, q_actual=q, qd_target=qd, qd_actual=qd, **PLAYING
        )
        bench.sockets.waiting.extend(server.step(said, state, 1000.0 + state.time))

    bench.run(round(1.0 / bench.period), answer)
    assert bench.has_finished
    assert bench.said == []
    assert server.survives_its_program
    assert np.abs(np.array(bench.path)[:, 5]).max() == pytest.approx(0.08, abs=1e-4)
    assert received == {(bench.period, 0.05, 700.0)}


def test_server_answers_when_arm_is_at_rest() -> None:
    served = Served()
    served.speed = 0.5
    assert served.step(b"0\n-1\n") == []
    assert served.step(seconds=1.0) == []
    served.speed = 0.0
    assert [answer[0] for answer in served.step()] == [0.0, 1.0]

    waiting = Served()
    waiting.speed = 0.5
    waiting.step(b"0\n")
    with pytest.raises(LinkTimeout, match=r"did not come to rest within 1\.5 s"):
        waiting.step(seconds=1.6)

    elsewhere = Served()
    elsewhere.angle = 0.06
    with pytest.raises(BadValue, match="too far from the position of the arm"):
        elsewhere.step(b"0\n")


def test_arm_is_checked_since_start_of_motion() -> None:
    """The motion starts when the point after the first target is requested. Repeated requests change nothing."""
    served = Served()
    served.step(b"0\n1\n")
    served.step(seconds=0.5)
    assert (served.server.progress, served.server.times(50.5)) == (0.0, None)
    served.step(b"2\n", 0.25)
    assert (served.server.progress, served.server.times(50.75)) == (0.0, (0.0, 0.0))
    served.angle = 0.3
    served.step(b"2\n", 0.5)
    assert (served.server.progress, served.server.times(51.25)) == (0.25, (0.5, 0.5))
    # The arm has not reached the first point, because the program would have requested another one.
    served.step(b"-1\n", 1.5)
    assert (served.server.progress, served.server.times(52.75)) == (0.25, (2.0, 0.5))
    # At the end of the trajectory, the program may be behind, so the arm is not checked yet.
    served.step(b"3\n", 0.5)
    served.angle = 0.5
    served.step(b"-1\n", 1.5)
    assert not served.server.is_over
    served.angle = 0.3
    served.step(seconds=0.5)
    assert served.server.progress == 0.25
    served.step(b"-2\n")
    assert served.server.progress == 1.25
    served.angle = 0.5
    assert not served.server.is_over
    served.step()
    assert served.server.is_over


def test_state_with_earlier_time_counts_as_one_cycle() -> None:
    served = Served()
    served.step(b"0\n1\n2\n")
    served.BEGIN = 20.0
    served.step()
    assert served.server.progress == pytest.approx(0.002 / 2.0)


def test_arm_off_path_raises_tolerance_exceeded() -> None:
    served = Served()
    served.step(b"0\n1\n2\n")
    with pytest.raises(ToleranceExceeded, match=r"0\.500 s into its path; the tolerance is 0\.1 rad"):
        served.step(seconds=0.5)

    late = Served()
    late.step(b"0\n1\n2\n3\n")
    assert late.step(b"-2\n-1\n", 2.5) == [[1.0]]
    assert not late.server.is_over
    with pytest.raises(ToleranceExceeded, match="1 s after the end of its path"):
        late.step(seconds=0.6)


def test_program_ending_before_checks_ends_motion() -> None:
    served = Served()
    served.step(b"0\n1\n")
    assert not served.server.is_over
    served.server.conclude()
    served.step()
    assert served.server.is_over


@pytest.mark.parametrize("said", [b"", b"-1\n"])
def test_silent_program_raises_connection_lost(said: bytes) -> None:
    served = Served()
    served.step(seconds=5.0)
    served.step(said, 3.0)
    if not said:
        with pytest.raises(ConnectionLost, match="has sent nothing for 3 s"):
            served.step(seconds=0.5)
    served.step(b"-2\n", 3.0)
    served.step(seconds=30.0)


def test_invalid_requests_raise_program_stopped() -> None:
    served = Served()
    assert served.step(b"0" * 32) == []
    with pytest.raises(ProgramStopped, match="sent b'0"):
        served.step(b"0")
    with pytest.raises(ProgramStopped, match="sent b'one'; expected a number"):
        Served().step(b"0\none\n")
    with pytest.raises(ProgramStopped, match="requested point -4"):
        Served().step(b"-4\n")


# -- a pause ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("braked", "skipped"), [(0.1, 0.1), (0.0, 0.0), (-0.1, 0.0)])
def test_program_asks_for_progress_of_arm_after_pause(braked: float, skipped: float) -> None:
    """The progress is along the path, and never back."""
    served = Served()
    served.set_out()
    for n in range(1, 6):
        served.angle = float(PATH.sample(0.05 * n)[0][5])
        served.step(seconds=0.05)
    before = served.server.progress * 2.0
    assert before == pytest.approx(0.25)
    served.angle = float(PATH.sample(before + braked)[0][5])
    served.resume()
    ((seconds,),) = served.step(b"-3\n")
    assert seconds == pytest.approx(1.0 + skipped, abs=0.005)
    assert served.step(b"-3\n") == [[1.0]]  # once
    assert served.step(b"-1\n") == [[1.0]]


def test_offset_from_path_is_faded_out_after_pause() -> None:
    served = Served()
    served.set_out()
    for n in range(1, 5):
        served.angle = float(PATH.sample(0.05 * n)[0][5])
        served.step(seconds=0.05)
    aside = 0.04
    q = np.array(PATH.sample(0.2)[0])
    q[0] += aside
    server = served.server
    before = server.desired(0.2)[0]
    assert before == pytest.approx(PATH.sample(0.2)[0])
    served.resume(q)
    began = 0.2
    for after, left in ((0.0, 1.0), (0.2, 0.5), (0.3, 1.0 - 0.75**2 * 1.5), (0.4, 0.0), (0.8, 0.0)):
        off = server.desired(began + after)[0][0] - PATH.sample(began + after)[0][0]
        assert off == pytest.approx(left * aside, abs=5e-4)


def test_pause_before_start_skips_no_waypoint() -> None:
    served = Served()
    served.step(b"0\n")
    served.resume(turned(0.1))
    assert served.step(b"-3\n") == [[1.0]]
    assert served.server.desired(0.0)[0] == pytest.approx(PATH.sample(0.0)[0])


def test_time_starts_slowly_after_a_long_pause() -> None:
    served = Served()
    served.set_out()
    served.step(seconds=0.1)
    before = served.server.progress
    served.seconds += 60.0
    served.angle = float(PATH.sample(0.1)[0][5])
    served.resume()
    served.step()
    served.step(seconds=0.08)
    assert served.server.progress == pytest.approx(before + 0.5 * 0.5 * 0.08 / 2.0, abs=2e-3)


def test_progress_is_derived_from_the_requested_points() -> None:
    """The program moves to the last but one of its requested points, regardless of the time on this computer."""
    served = Served(Trajectory.from_arrays([0.0, 0.5, 1.0, 1.5, 2.0], [turned(0.05 * n) for n in range(5)]))
    served.set_out()
    served.angle = 0.05
    served.step(b"3\n4\n", seconds=0.1)
    served.step()
    assert served.server.progress == pytest.approx(0.25)
    _, t = served.server.times(served.BEGIN + served.seconds + 3.0) or (0.0, 0.0)
    assert t == 1.0  # it has not requested the next point, so it has not passed its current target
    served.step(b"5\n")
    served.angle = 0.1
    served.step()
    assert served.server.progress == pytest.approx(0.5)
    _, t = served.server.times(served.BEGIN + served.seconds + 3.0) or (0.0, 0.0)
    assert t == pytest.approx(1.0 + 3.0)  # no request follows for the last point
