"""Messages of an impedance to its program, state by state: targets, gains and posture."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from linkcore.errors import BadValue, LocalError
from tests.fakes.rehearsal import HOME, TIMEOUT, Rehearsal
from tests.urlink.motion.test_servo import Beside
from urlink.arm.models import model
from urlink.errors import ProgramStopped
from urlink.motion.moves.path import check_joint_positions
from urlink.motion.servo.impedance import _Messages
from urlink.protocol.realtime.packets import RealtimeState
from urlink.script.links import FOLLOW
from urlink.script.messages import read_message
from urlink.script.springs import GAINS, POSTURE

READY = [0.0, -1.57, 1.57, -1.57, -1.57, 0.0]
GIVEN = [100.0, 200.0, 300.0, 400.0, 500.0, 600.0]
RATIOS = [0.1, 0.2, 0.3, 0.4, 0.5, 0.6]


def made(*, has_posture: bool = True) -> _Messages:
    return _Messages(lambda link: [], GIVEN, RATIOS, has_posture=has_posture)


def sent(messages: _Messages, count: int = 100) -> list[tuple[list[float], list[float], int]]:
    return [read_message(messages.step(b"", RealtimeState((5, 25)), 0.0)) for _ in range(count)]


def test_gains_and_posture_are_repeated_among_targets() -> None:
    """A message might be lost, because a register holds only the newest one."""
    messages = made()
    messages.lead([0.3] * 6, READY, 0.0)
    written = sent(messages)
    kinds = [mode for *_, mode in written]
    assert [kinds.count(mode) for mode in (FOLLOW, GAINS, POSTURE)] == pytest.approx([75, 12, 12], abs=2)
    number = [1.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    for first, second, mode in written:
        expected = {FOLLOW: ([0.3] * 6, number), POSTURE: (READY, number), GAINS: ([x / 1e3 for x in GIVEN], RATIOS)}
        assert [*first, *second] == pytest.approx([*expected[mode][0], *expected[mode][1]])


@pytest.mark.parametrize("has_posture", [False, True])
def test_gains_without_posture_are_sent_among_targets(has_posture: bool) -> None:
    """There is no posture before the first target, or if the program does not support one."""
    messages = made(has_posture=has_posture)
    if not has_posture:
        messages.lead([0.3] * 6, READY, 0.0)
    kinds = [mode for *_, mode in sent(messages)]
    assert [kinds.count(mode) for mode in (FOLLOW, GAINS)] == pytest.approx([75, 25], abs=2)


def test_targets_are_numbered_from_one_to_a_thousand() -> None:
    """The program detects a new target by its number; 0 means no target."""
    messages = made(has_posture=False)
    assert (messages.target, messages.posture) == (None, None)
    numbers = {second[0] for _, second, mode in sent(messages) if mode == FOLLOW}
    assert numbers == {0.0}
    for count in range(1, 1003):
        messages.lead([count / 1000.0] * 6, None, 0.0)
        assert messages.target == [count / 1000.0] * 6
        written = next(each for each in sent(messages, 3) if each[2] == FOLLOW)
        assert written[1][0] == (count - 1) % 1000 + 1


@pytest.mark.parametrize(("arm", "is_taken"), [("UR5e", False), (None, True)])
def test_target_must_be_in_joint_range_of_known_arm(arm: str | None, is_taken: bool) -> None:
    known = None if arm is None else model(arm)
    assert check_joint_positions(READY, "target", known).tolist() == READY
    far = [*READY[:5], 7.0]
    if is_taken:
        assert check_joint_positions(far, "target", known).tolist() == far
    else:
        with pytest.raises(BadValue, match="wrist 3"):
            check_joint_positions(far, "target", known)


@pytest.mark.simulated_time
def test_impedance_rejects_calls_outside_block(rehearsal: Callable[..., Rehearsal]) -> None:
    impedance = rehearsal("5.25").motion.impedance()
    with pytest.raises(LocalError, match="within its block"):
        impedance.send(HOME)
    with pytest.raises(LocalError, match="within its block"):
        impedance.set_gains()
    assert impedance.target is None


@pytest.mark.simulated_time
def test_gains_and_target_can_be_read(rehearsal: Callable[..., Rehearsal]) -> None:
    robot = rehearsal("5.25")
    impedance = robot.motion.impedance(stiffness=50.0, damping=0.5)
    with Beside(robot):
        impedance.__enter__()
    assert (impedance.stiffness.tolist(), impedance.damping.tolist()) == ([50.0] * 6, [0.5] * 6)
    impedance.set_gains(60.0)
    impedance.set_gains(damping=[0.7] * 6)
    assert (impedance.stiffness.tolist(), impedance.damping.tolist()) == ([60.0] * 6, [0.7] * 6)
    impedance.send(HOME)
    assert impedance.target is not None
    assert impedance.target.tolist() == list(HOME)
    robot.finish()
    with pytest.raises(ProgramStopped, match="ended unexpectedly"):
        impedance.wait(TIMEOUT)
