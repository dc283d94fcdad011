"""A compliant arm, from the client to the simulated controller: each mode and each way to end it."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable, Iterator

import numpy as np
import pytest

import urlink
from linkcore.errors import BadValue, LinkError, LocalError
from tests.waiting import until
from urlink.errors import NoContact
from urlink.motion.motions import LinkName
from urlink.motion.servo.force_control import ForceMode
from urlink.robot import Robot
from urlink.simulator import Controller, Plane, Still

pytestmark = pytest.mark.simulated_time

TIMEOUT = 120.0
#: Time in s without messages that the programs accept: the test machine may be busy.
WATCHDOG = 2.0

Made = tuple[Controller, Robot]


@pytest.fixture
def made() -> Iterator[Callable[[str], Made]]:
    """Return a function that makes a robot and its simulated arm at rest, with a table 2 mm below the tool."""
    with contextlib.ExitStack() as stack:

        def make(firmware: str) -> Made:
            controller = stack.enter_context(Controller(None, firmware, motion=Still()))
            x, y, z = controller.arm.kinematics.forward(controller.arm.setpoint.q)[:3]
            controller.world.add(Plane((x, y, z - 0.002)))
            robot = stack.enter_context(urlink.connect(controller.address, stale_after=20.0, silence=30.0))
            return controller, robot

        yield make


def force(controller: Controller) -> float:
    return float(controller.arm.wrench[2])


def press(robot: Robot, link: LinkName = "reverse", newtons: float = 10.0) -> ForceMode:
    return robot.motion.force_mode(
        "base", [0, 0, 1, 0, 0, 0], [0, 0, -newtons, 0, 0, 0], [0.1] * 6, watchdog=WATCHDOG, link=link
    )


def is_rigid(controller: Controller) -> bool:
    """Whether the arm has left its mode: it does not yield when it is pushed."""
    until(lambda: controller.program_name is None and not controller.arm.is_moving, TIMEOUT)
    at = controller.arm.setpoint.q
    controller.push([0, 0, 30.0, 0, 0, 0])
    cycle = controller.cycle
    until(lambda: controller.cycle > cycle + 20)
    controller.push([0.0] * 6)
    return controller.arm.setpoint.q == at


@pytest.mark.slow
@pytest.mark.parametrize(("firmware", "link"), [("3.15", "rtde"), ("5.11", "reverse"), ("10.12", "rtde")])
def test_force_mode_presses_until_block_ends(made: Callable[[str], Made], firmware: str, link: LinkName) -> None:
    controller, robot = made(firmware)
    with press(robot, link) as pressing:
        until(lambda: abs(force(controller) - 10.0) < 0.5, TIMEOUT)
        assert robot.motion.current is pressing
        pressing.set_wrench([0, 0, -15.0, 0, 0, 0])
        assert pressing.wrench.tolist() == [0, 0, -15.0, 0, 0, 0]
        until(lambda: abs(force(controller) - 15.0) < 0.5, TIMEOUT)
        until(lambda: abs(robot.realtime.wait(5).tcp_force[2] - 15.0) < 0.8, TIMEOUT)
    assert is_rigid(controller)
    with pytest.raises(LinkError):
        pressing.set_wrench([0.0] * 6)


@pytest.mark.slow
@pytest.mark.parametrize("end", ["exception", "close"])
def test_exception_or_close_ends_freedrive(made: Callable[[str], Made], end: str) -> None:
    controller, robot = made("5.11")
    with contextlib.ExitStack() as stack:
        if end == "exception":
            stack.enter_context(pytest.raises(ZeroDivisionError))
        stack.enter_context(robot.freedrive(watchdog=WATCHDOG))
        controller.push([0, 0, 10.0, 0, 0, 0])
        q = controller.arm.setpoint.q
        until(lambda: np.abs(np.subtract(controller.arm.setpoint.q, q)).max() > 1e-3, TIMEOUT)
        controller.push([0.0] * 6)
        if end == "exception":
            raise ZeroDivisionError
        robot.close()
    assert is_rigid(controller)


@pytest.mark.slow
def test_async_robot_supports_force_mode_and_teaching(made: Callable[[str], Made]) -> None:
    controller, _ = made("5.11")

    async def press_softly() -> None:
        async with urlink.connect_async(controller.address) as robot:
            await robot.zero_force_sensor()
            down = [0, 0, 1, 0, 0, 0], [0, 0, -10, 0, 0, 0], [0.1] * 6
            async with robot.motion.force_mode("base", *down, watchdog=WATCHDOG):
                while abs(force(controller) - 10.0) > 0.5:
                    await asyncio.sleep(0.01)
            async with robot.teach(watchdog=WATCHDOG) as teaching:
                await teaching.record()
            assert len(teaching.taught) == 1

    asyncio.run(asyncio.wait_for(press_softly(), TIMEOUT))
    assert is_rigid(controller)


@pytest.mark.slow
def test_loop_can_send_torques(made: Callable[[str], Made]) -> None:
    controller, robot = made("5.25")
    controller.world.clear()
    with robot.motion.torque(watchdog=1.0, limits=[10, 10, 10, 5, 5, 5]) as torque:
        with pytest.raises(BadValue, match=r"torque\[5\] \(wrist 3\) is 6 Nm; expected at most 5 Nm"):
            torque.send([0, 0, 0, 0, 0, 6])
        # A spring and a damper around a position 0.1 rad away.
        for state in robot.realtime:
            q, qd = state.q_actual, state.qd_actual
            torque.send([0, 0, 0, 0, 0, float(np.clip(5.0 * (0.1 - q[5]) - 1.5 * qd[5], -5, 5))])
            if abs(q[5] - 0.1) < 0.01 and abs(qd[5]) < 0.05:
                break
    assert is_rigid(controller)


@pytest.mark.slow
@pytest.mark.parametrize("firmware", ["3.15", "5.11"])
def test_motion_ends_at_contact(made: Callable[[str], Made], firmware: str) -> None:
    controller, robot = made(firmware)
    motion = robot.motion.until_contact([0, 0, -1], 0.02, wait=TIMEOUT)
    contact = motion.contact
    assert contact is not None
    assert contact.pose is not None
    start = controller.arm.kinematics.forward(controller.arm.setpoint.q)
    assert contact.pose[:3] == pytest.approx(start[:3], abs=2e-3)
    robot.zero_force_sensor()
    # On CB3, the tool had returned to the place where it pressed with 20 N.
    # This force vanishes when the tool leaves the table.
    force = 40.0 if firmware == "3.15" else None
    with pytest.raises(NoContact, match=r"nothing was touched within 0\.004 m"):
        robot.motion.until_contact([0, 0, 1], 0.05, distance=0.004, force=force, wait=TIMEOUT)


def test_invalid_options_are_rejected_before_sending(made: Callable[[str], Made]) -> None:
    controller, robot = made("5.11")
    calls: list[tuple[str, Callable[[], object]]] = [
        ("selection is", lambda: robot.motion.force_mode("base", [0, 0, 2, 0, 0, 0], [0] * 6, [1] * 6)),
        ("selection is", lambda: robot.motion.force_mode("base", [0, 0, 1], [0] * 6, [1] * 6)),
        ("frame is 'flange'", lambda: robot.motion.force_mode("flange", [1] * 6, [0] * 6, [1] * 6)),
        (r"limits\[z\]", lambda: robot.motion.force_mode("base", [1] * 6, [0] * 6, [1, 1, 0, 1, 1, 1])),
        (r"wrench\[x\] is .* N\b", lambda: robot.motion.force_mode("base", [1] * 6, [2000, 0, 0, 0, 0, 0], [1] * 6)),
        (r"wrench\[rx\] is .* Nm", lambda: robot.motion.force_mode("base", [1] * 6, [0, 0, 0, 2000, 0, 0], [1] * 6)),
        ("kind is 4", lambda: robot.motion.force_mode("base", [1] * 6, [0] * 6, [1] * 6, kind=4)),
        ("damping", lambda: robot.motion.force_mode("base", [1] * 6, [0] * 6, [1] * 6, damping=2.0)),
        ("watchdog", lambda: robot.motion.force_mode("base", [1] * 6, [0] * 6, [1] * 6, watchdog=0)),
        ("no axis is free", lambda: robot.freedrive([0] * 6)),
        ("direction is", lambda: robot.motion.until_contact([0, 0, 0])),
        ("direction is", lambda: robot.motion.until_contact([0, 1])),
        ("force", lambda: robot.motion.until_contact([0, 0, 1], force=0)),
    ]
    for text, call in calls:
        with pytest.raises(BadValue, match=text):
            call()
    with pytest.raises(LocalError, match=r"firmware 5\.11 has no direct torque; 5\.23"):
        robot.motion.torque()
    with pytest.raises(LocalError, match="within its block"):
        press(robot).set_wrench([0] * 6)
    assert not controller.received


@pytest.mark.parametrize(
    ("firmware", "text", "call"),
    [
        ("1.8", "does not support force mode; 3.0 or later", lambda robot: press(robot)),
        ("1.8", "does not support freedrive; 3.0 or later", lambda robot: robot.freedrive()),
        ("1.8", "cannot zero", lambda robot: robot.zero_force_sensor()),
        ("3.1", "cannot move until contact; 3.3 or later", lambda robot: robot.motion.until_contact([0, 0, 1])),
        (
            "3.4",
            "does not support damping",
            lambda robot: robot.motion.force_mode("base", [1] * 6, [0] * 6, [1] * 6, damping=1),
        ),
        (
            "3.15",
            "does not support gain",
            lambda robot: robot.motion.force_mode("base", [1] * 6, [0] * 6, [1] * 6, gain=1),
        ),
        ("5.9", "5.10 or later is required to select axes", lambda robot: robot.freedrive([1, 0, 0, 0, 0, 0])),
    ],
)
def test_missing_firmware_feature_is_reported(
    made: Callable[[str], Made], firmware: str, text: str, call: Callable[[Robot], object]
) -> None:
    controller, robot = made(firmware)
    with pytest.raises(LocalError, match=text):
        call(robot)
    assert not controller.received
