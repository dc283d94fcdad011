"""Messages of force mode, freedrive, torque and `until_contact` to the robot; the test plays the robot."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, TypeVar

import numpy as np
import pytest

from linkcore import clock
from linkcore.errors import BadValue, Cancelled, Closed, ConnectionLost, LinkTimeout, LocalError
from linkcore.handle import Phase
from tests.fakes.rehearsal import FOLLOW, HOME, STOP, TIMEOUT, WAIT, Rehearsal, freedrive, turned
from tests.urlink.motion.test_servo import Beside
from tests.waiting import until
from urlink.arm.kinematics import Arm
from urlink.arm.models import model
from urlink.arm.vectors import FloatArray, Numbers
from urlink.errors import NoContact, ProgramStopped
from urlink.motion.motions import LinkName
from urlink.motion.servo.block_motion import BlockMotion
from urlink.motion.servo.force_control import ForceMode
from urlink.motion.servo.linked_program import LinkedProgram

pytestmark = pytest.mark.simulated_time

DOWN = [0, 0, -10.0, 0, 0, 0.5]
B = TypeVar("B", bound=BlockMotion)


@contextmanager
def entered(robot: Rehearsal, block: B) -> Iterator[B]:
    """Enter a block and wait for its connection; cancel it at the end."""
    with Beside(robot):
        assert block.__enter__() is block
    yield block
    block.cancel()


def next_setpoint(robot: Rehearsal, until_it_is: list[float] | None = None) -> list[float]:
    """Return the set-point sent for the next state; with `until_it_is`, skip earlier messages."""
    while True:
        robot.tick()
        message = robot.message()
        assert message is not None
        if message[1] == FOLLOW and until_it_is in (None, message[0]):
            return message[0]


def link_of(robot: Rehearsal) -> LinkName:
    return "rtde" if robot.has_registers else "reverse"


def press(robot: Rehearsal, frame: Numbers | str = "base", **options: Any) -> ForceMode:
    axes, limits = [0, True, 1, 0, 0, 0], [0.1, 0.2, 0.3, 1, 2, 3]
    return robot.motion.force_mode(frame, axes, DOWN, limits, link=link_of(robot), **options)


def test_force_mode_sends_wrench_with_every_state(led: Rehearsal) -> None:
    with entered(led, press(led, [1, 2, 3, 0, 0, 0.5], kind=3, damping=0.25, gain=1.5, watchdog=0.5)) as pressing:
        call = (
            "force_mode(p[1.0, 2.0, 3.0, 0.0, 0.0, 0.5], [0, 1, 1, 0, 0, 0], wrench, 3, [0.1, 0.2, 0.3, 1.0, 2.0, 3.0])"
        )
        for part in (call, "force_mode_set_damping(0.25)", "force_mode_set_gain_scaling(1.5)", "missed < 250"):
            assert part in led.uploaded
        for _ in range(3):
            assert next_setpoint(led) == DOWN
            assert led.speeds == [0.0] * 6
        assert pressing.wrench.tolist() == DOWN
        with pytest.raises(BadValue, match=r"wrench\[z\]"):
            pressing.set_wrench([0, 0, -2000, 0, 0, 0])
        assert pressing.wrench.tolist() == DOWN
        pressing.set_wrench([0.0] * 6)
        assert next_setpoint(led, [0.0] * 6) == next_setpoint(led) == pressing.wrench.tolist() == [0.0] * 6
        assert len(led.sent) == 1
    with pytest.raises(Cancelled):
        pressing.set_wrench(DOWN)


@pytest.mark.parametrize(("kind", "is_taken"), [(0, False), (1, True), (2, True), (3, True), (4, False)])
def test_force_mode_accepts_kinds_one_to_three(robot: Rehearsal, kind: int, is_taken: bool) -> None:
    with contextlib.nullcontext() if is_taken else pytest.raises(BadValue, match=f"kind is {kind}"):
        press(robot, "base", kind=kind)


def test_unknown_frame_is_rejected(robot: Rehearsal) -> None:
    with pytest.raises(BadValue, match="frame is 'nonsense'; expected 'base', 'tool', or a pose"):
        press(robot, "nonsense")
    with pytest.raises(BadValue, match="frame='nonsense'"):
        robot.motion.impedance("nonsense")  # type: ignore[arg-type]


def test_force_mode_leaves_unset_options_to_the_controller(robot: Rehearsal) -> None:
    robot.q = turned(0.3)
    robot.show()
    with entered(robot, press(robot, "tool")):
        pose = ", ".join(f"{each:.4f}" for each in robot.pose)
        written = robot.uploaded.partition("force_mode(p[")[2].partition("]")[0]
        assert ", ".join(f"{float(each):.4f}" for each in written.split(",")) == pose
        assert "wrench, 2, [" in robot.uploaded
        assert "force_mode_set" not in robot.uploaded
    with entered(robot, press(robot)):
        assert "force_mode(p[0.0, 0.0, 0.0, 0.0, 0.0, 0.0], " in robot.uploaded


def test_freedrive_sends_a_message_per_state(led: Rehearsal) -> None:
    free = freedrive(led.motion, [1, 0, 0, 0, 0, True], frame=[1, 2, 3, 0, 0, 0.5], watchdog=0.4, link=link_of(led))
    with entered(led, free):
        call = "freedrive_mode(freeAxes=[1, 0, 0, 0, 0, 1], feature=p[1.0, 2.0, 3.0, 0.0, 0.0, 0.5])"
        assert call in led.uploaded
        assert "missed < 200" in led.uploaded
        for _ in range(3):
            assert next_setpoint(led) == [0.0] * 6
    assert free.phase is Phase.CANCELLED


@pytest.mark.parametrize("is_compensated", [True, False])
def test_torque_sends_only_set_points_given_by_the_loop(
    rehearsal: Callable[..., Rehearsal], is_compensated: bool
) -> None:
    robot = rehearsal("5.25", "UR5e")
    most = model("UR5e").max_torque.tolist()
    with entered(robot, robot.motion.torque(friction_compensation=is_compensated, watchdog=0.1)) as torque:
        assert f"friction_comp={is_compensated}" in robot.uploaded
        assert "missed < 50" in robot.uploaded
        robot.tick()
        assert (message := robot.message()) is not None
        assert message[1] == WAIT
        for joint, limit in enumerate(most):
            values = [0.0] * 6
            for sign in (1.0, -1.0):
                values[joint] = sign * np.nextafter(limit, 2 * limit)
                with pytest.raises(BadValue, match=rf"torque\[{joint}\] .* at most {limit:g} Nm"):
                    torque.send(values)
            values[joint] = -limit
            torque.send(values)
            while (message := robot.message()) is None or message[1] == WAIT:
                assert message is not None
            assert message == (values, FOLLOW)
        # A state on its own sends no message: only the loop sends set-points.
        robot.show()
        torque.send([1.0] * 6)
        assert robot.message() == ([1.0] * 6, FOLLOW)


def test_torque_respects_given_limits(rehearsal: Callable[..., Rehearsal]) -> None:
    robot = rehearsal("5.25", "UR5e")
    with pytest.raises(LocalError, match="within its block"):
        robot.motion.torque().send([0.0] * 6)
    with entered(robot, robot.motion.torque(limits=[10, 10, 10, 5, 0, 5])) as torque:
        torque.send([10, -10, 10, 5, 0, -5])
        for values in ([11, 0, 0, 0, 0, 0], [0, 0, 0, 0, 0.1, 0], [0, 0, 0, -6, 0, 0]):
            with pytest.raises(BadValue, match="at most"):
                torque.send(values)


def each_block(robot: Rehearsal) -> dict[str, Callable[[], BlockMotion]]:
    return {
        "force_mode": lambda: press(robot),
        "freedrive": lambda: freedrive(robot.motion),
        "torque": robot.motion.torque,
        "jog": robot.motion.jog,
        "servo": robot.motion.servo,
    }


BLOCKS = ["force_mode", "freedrive", "torque", "jog", "servo"]


@pytest.mark.parametrize("name", BLOCKS)
def test_block_cannot_be_entered_twice(rehearsal: Callable[..., Rehearsal], name: str) -> None:
    robot = rehearsal("5.25", "UR5e")
    block = each_block(robot)[name]()
    assert (block.name, robot.motion.current) == (name, None)
    with entered(robot, block):
        assert robot.motion.current is block
    while (message := robot.message()) is not None:
        last = message
    assert last == ([0.0] * 6, STOP)
    sent = len(robot.sent)
    with pytest.raises(LocalError, match=f"this {name} was used before"):
        block.__enter__()
    assert len(robot.sent) == sent


@pytest.mark.parametrize("name", BLOCKS)
def test_unexpected_program_end_ends_block(rehearsal: Callable[..., Rehearsal], name: str) -> None:
    robot = rehearsal("5.25", "UR5e")
    block = each_block(robot)[name]()
    with entered(robot, block):
        robot.finish()
        with pytest.raises(ProgramStopped, match=f"the program of {name} ended unexpectedly"):
            block.wait(TIMEOUT)


def test_command_after_leaving_block_raises_closed(robot: Rehearsal, monkeypatch: pytest.MonkeyPatch) -> None:
    with entered(robot, robot.motion.jog()) as jog:
        monkeypatch.setattr(jog, "wait", lambda seconds: None)
        jog.__exit__()  # the arm is not yet at rest
        with pytest.raises(Closed, match="the block of this jog was left"):
            jog.move([0.1] * 6)


def test_leaving_block_cancels_unfinished_program(robot: Rehearsal, monkeypatch: pytest.MonkeyPatch) -> None:
    waited: list[float] = []

    def wait(seconds: float) -> None:
        waited.append(seconds)
        raise LinkTimeout("still running")

    with entered(robot, robot.motion.jog()) as jog:
        monkeypatch.setattr(jog, "wait", wait)
        jog.__exit__()
        assert waited == [10.0]
        assert jog.phase is Phase.CANCELLED


def test_send_waits_for_reason_of_lost_connection(robot: Rehearsal, monkeypatch: pytest.MonkeyPatch) -> None:
    waited: list[float] = []

    def wait(seconds: float) -> None:
        waited.append(seconds)
        raise LinkTimeout("no reason was reported")

    def say(program: LinkedProgram, data: bytes) -> None:
        raise ConnectionLost("reset")

    with entered(robot, robot.motion.servo()) as servo:
        monkeypatch.setattr(servo, "wait", wait)
        monkeypatch.setattr(LinkedProgram, "say", say)
        with pytest.raises(ConnectionLost, match="reset"):
            servo.send(HOME)
        assert waited == [1.5]


def test_block_thread_enters_urgent_mode_inside_the_block(robot: Rehearsal, monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[str] = []

    @contextmanager
    def urgent() -> Iterator[None]:
        seen.append("begins")
        yield
        seen.append("ends")

    monkeypatch.setattr("urlink.motion.servo.block_motion.urgent", urgent)
    with entered(robot, robot.motion.jog()) as jog:
        assert seen == ["begins"]
        robot.finish()
        until(lambda: jog.done)
        jog.__exit__()
        assert seen == ["begins", "ends"]


def test_interrupted_start_cancels_block(robot: Rehearsal, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupt(future: object, seconds: float) -> bool:
        raise KeyboardInterrupt

    jog = robot.motion.jog()
    monkeypatch.setattr(clock, "is_done", interrupt)
    with pytest.raises(KeyboardInterrupt):
        jog.__enter__()
    assert jog.phase is Phase.CANCELLED
    assert "stopj" in robot.sent[-1]


def test_block_times_out_if_program_never_connects(robot: Rehearsal) -> None:
    """No states arrive either, which would report the missing connection after five seconds."""
    begun = clock.now()
    jog = robot.motion.jog()
    with pytest.raises(LinkTimeout, match="jog: the program on the robot did not connect within 6 s"):
        jog.__enter__()
    assert clock.now() - begun == pytest.approx(6.0, abs=0.05)
    assert jog.phase is Phase.CANCELLED
    assert "stopj" in robot.sent[-1]


# -- until contact -----------------------------------------------------------------------------------------


class Tooled(Rehearsal):
    """Robot with a tool that extends 0.1 m from its flange."""

    tcp = (0.0, 0.0, 0.1, 0.0, 0.0, 0.0)

    @property
    def pose(self) -> FloatArray:
        return Arm("UR5e").forward(self.q, self.tcp)


def test_contact_reports_joints_and_pose() -> None:
    at = turned(0.2)
    with Tooled() as robot:
        motion = robot.motion.until_contact([0, 0, -1])
        robot.begin()
        robot.text("user: something else")
        robot.text(f"urlink: contact {[round(each, 6) for each in at]}")
        until(lambda: motion.contact is not None)
        assert motion.contact is not None
        assert motion.contact.q == pytest.approx(at, abs=1e-6)
        assert motion.contact.pose == pytest.approx(Arm("UR5e").forward(at, Tooled.tcp), abs=1e-5)
        assert not motion.done
        robot.finish()
        motion.wait(TIMEOUT)


def test_contact_of_unknown_arm_has_no_pose(rehearsal: Callable[..., Rehearsal]) -> None:
    robot = rehearsal(model="UR9000")
    motion = robot.motion.until_contact([0, 0, -1])
    robot.begin()
    robot.text(f"urlink: contact {list(HOME)}")
    until(lambda: motion.contact is not None)
    assert motion.contact is not None
    assert motion.contact.q == pytest.approx(HOME)
    assert motion.contact.pose is None
    motion.cancel()
    assert "stopj" in robot.sent[-1]


def test_direction_may_have_any_length(robot: Rehearsal) -> None:
    for none in ([1.7e308] * 3, [0.0] * 3, [1.0, 0.0]):
        with pytest.raises(BadValue, match="direction is"):
            robot.motion.until_contact(none)
    assert robot.sent == []
    robot.motion.until_contact([0, 3e200, -4e200])
    assert "tool_contact(direction=[0.0, 0.6, -0.8, " in robot.uploaded


def test_missing_contact_raises_no_contact(robot: Rehearsal) -> None:
    motion = robot.motion.until_contact([0, 0, -1], distance=0.25)
    robot.begin()
    robot.text("urlink: no contact")
    with pytest.raises(NoContact, match=r"nothing was touched within 0\.25 m"):
        motion.wait(TIMEOUT)
    assert motion.contact is None
