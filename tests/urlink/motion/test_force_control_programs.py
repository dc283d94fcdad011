"""Programs of a compliant arm, driven through registers on a simulated controller that the test steps."""

from __future__ import annotations

from collections.abc import Sequence

import pytest

from urlink.motion.servo.block_motion import KeptMessage
from urlink.protocol.firmware import Firmware
from urlink.protocol.realtime.packets import RealtimeState
from urlink.script import force_control, links
from urlink.script.force_control import Pressing
from urlink.script.links import FOLLOW, STOP, InputRegisters
from urlink.script.messages import STOP_MESSAGE, WAIT_MESSAGE, read_message
from urlink.script.wrapping import program
from urlink.simulator import Controller, Plane, Still

LINK = InputRegisters(first_float=36, first_integer=44, token=77)
DOWN = (False, False, True, False, False, False)
FIRMWARES = ["3.15", "5.11", "5.25", "10.12"]


class Bench:
    """A controller with one program; `write_messages` writes a message in each cycle."""

    def __init__(self, firmware: str) -> None:
        self.controller = Controller(None, firmware, motion=Still(), noise=False)
        self.controller.step()
        self.firmware = self.controller.firmware
        self.start = self.pose
        self._count = 0

    @property
    def pose(self) -> list[float]:
        arm = self.controller.arm
        return list(arm.kinematics.forward(arm.setpoint.q, arm.tcp).tolist())

    @property
    def date(self) -> int:
        """Date of a message of this cycle."""
        return round(self.controller.time * self.firmware.rate)

    @property
    def is_running(self) -> bool:
        return self.controller.program_name is not None

    def take(self, body: Sequence[str]) -> None:
        self.controller.take(program("tried", body, None).text)

    def write_messages(
        self, values: Sequence[float], seconds: float, mode: int = FOLLOW, *, date: int | None = None
    ) -> None:
        """Write a new message in each cycle, with the date of that cycle or an older date."""
        inputs = self.controller.registers.inputs
        inputs.integers[LINK.proof] = LINK.token
        for _ in range(max(round(seconds * self.firmware.rate), 1)):
            self._count += 1
            inputs.integers[LINK.date] = self.date if date is None else date
            inputs.integers[LINK.message], inputs.integers[LINK.mode] = self._count, mode
            for i, value in enumerate(values):
                inputs.floats[LINK.first_float + i] = value
            # Writing past RTDE does not feed the controller's own watchdog, which another test covers.
            self.controller._state.watchdogs.clear()
            self.controller.step()

    def silent(self, seconds: float) -> None:
        self.controller.step(round(seconds * self.firmware.rate))

    def table(self, below: float) -> None:
        x, y, z = self.start[:3]
        self.controller.world.add(Plane((x, y, z - below)))


def pressing(firmware: str) -> Bench:
    bench = Bench(firmware)
    is_new = bench.firmware >= (5, 0)
    pressing = Pressing((0.0,) * 6, DOWN, (0.1,) * 6, kind=2, damping=0.01, gain=1.0 if is_new else None)
    body = force_control.force_mode(bench.firmware, LINK, pressing, watchdog=0.2)
    bench.table(0.002)
    bench.take(body)
    return bench


@pytest.mark.parametrize(
    ("firmware", "way"),
    [("3.15", "stopped"), ("3.15", "silent"), ("3.15", "preempted"), ("5.25", "silent"), ("10.12", "stopped")],
)
def test_force_mode_presses_until_program_ends(firmware: str, way: str) -> None:
    bench = pressing(firmware)
    bench.write_messages([0, 0, -10.0, 0, 0, 0], 0.8)
    assert bench.controller.arm.wrench[2] == pytest.approx(10.0, abs=0.5)
    bench.write_messages([0, 0, -20.0, 0, 0, 0], 0.4)
    assert bench.controller.arm.wrench[2] == pytest.approx(20.0, abs=0.5)
    if way == "stopped":
        bench.write_messages([0.0] * 6, 0.5, STOP)
    elif way == "silent":
        # The mode continues for the time of the watchdog.
        bench.silent(0.15)
        bench.controller.push([0, 0, 15.0, 0, 0, 0])
        bench.silent(0.03)
        bench.controller.push([0.0] * 6)
        bench.silent(0.5)
    else:
        bench.controller.take("def other():\n  sleep(0.1)\nend")
        bench.silent(0.5)
    assert not bench.is_running
    at = bench.pose
    bench.controller.push([0, 0, 30.0, 0, 0, 0])
    bench.silent(0.2)
    assert bench.pose == at


@pytest.mark.parametrize("firmware", ["3.15", "5.11"])
def test_freedrive_lasts_while_messages_arrive(firmware: str) -> None:
    bench = Bench(firmware)
    axes = [True, False, True, False, False, False] if bench.firmware >= (5, 10) else None
    bench.take(force_control.freedrive(bench.firmware, LINK, axes, [0.0] * 6, watchdog=0.2))
    bench.write_messages([0.0] * 6, 0.1)
    bench.controller.push([0, 0, 10.0, 0, 0, 0])
    bench.write_messages([0.0] * 6, 0.5)
    assert bench.pose[2] - bench.start[2] > 0.005
    bench.silent(0.4)
    assert not bench.is_running
    at = bench.pose
    bench.silent(0.2)
    assert bench.pose == at


@pytest.mark.parametrize("firmware", FIRMWARES)
@pytest.mark.parametrize("kind", ["force_mode", "freedrive"])
def test_old_messages_do_not_feed_watchdog(firmware: str, kind: str) -> None:
    """Such messages were queued while the controller hung; the mode ends as if none had arrived."""
    if kind == "force_mode":
        bench = pressing(firmware)
        wrench = [0, 0, -10.0, 0, 0, 0]
    else:
        bench, wrench = Bench(firmware), [0.0] * 6
        bench.take(force_control.freedrive(bench.firmware, LINK, None, [0.0] * 6, watchdog=0.2))
    bench.write_messages(wrench, 0.5)
    # Because of jitter, messages may be late by the watchdog's time. After the same time again, the mode ends.
    first = bench.date
    running = []
    for seconds in (0.35, 0.25):
        bench.write_messages(wrench, seconds, date=first)
        running.append(bench.is_running)
    assert running == [True, False]
    bench.controller.push([0, 0, 30.0, 0, 0, 0])
    at = bench.pose
    bench.silent(0.2)
    assert bench.pose == at


@pytest.mark.parametrize("firmware", ["5.25"])
def test_torques_move_the_arm_and_fade_without_messages(firmware: str) -> None:
    bench = Bench(firmware)
    bench.take(force_control.torque(bench.firmware, LINK, friction_compensation=True, watchdog=0.05))
    bench.write_messages([0, 0, 0, 0, 0, 0], 0.05)
    bench.write_messages([0, 0, 0, 0, 0, 0.5], 0.2)
    assert bench.controller.arm.setpoint.qd[5] > 0.1
    bench.silent(0.5)
    assert not bench.is_running
    assert not any(bench.controller.arm.setpoint.qd)


@pytest.mark.parametrize(("firmware", "force"), [("3.15", 20.0), ("5.4", None)])
def test_motion_ends_at_contact_and_reports_position(firmware: str, force: float | None) -> None:
    bench = Bench(firmware)
    bench.table(0.01)
    bench.take(force_control.until_contact(bench.firmware, [0, 0, -1.0], 0.05, 0.5, 0.1, force=force, retracts=True))
    messages: list[bytes] = []
    for _ in range(round(2.0 * bench.firmware.rate)):
        bench.controller.step()
        messages += bench.controller.take_messages()
        if not bench.is_running and messages:
            break
    assert not bench.is_running
    (text,) = [m[m.index(b"urlink: contact") :].decode().strip("\0\n") for m in messages if b"urlink: contact" in m]
    q = force_control.contact_of(text)
    assert q is not None
    assert bench.controller.arm.setpoint.q == pytest.approx(q, abs=1e-4)
    assert bench.pose[2] - bench.start[2] == pytest.approx(-0.01, abs=5e-4 if force is None else 2e-3)


def test_motion_stops_after_distance_without_contact() -> None:
    bench = Bench("5.11")
    bench.take(force_control.until_contact(bench.firmware, [0, 0, -1.0], 0.1, 0.5, 0.02, force=None, retracts=True))
    bench.silent(1.0)
    assert not bench.is_running
    # The distance, plus at most twice the distance needed to accelerate and to brake.
    assert -0.05 <= bench.pose[2] - bench.start[2] <= -0.02


@pytest.mark.parametrize("text", ["urlink: contact ", "urlink: contact [1,2]", "urlink: contact [a,b,c,d,e,f]", "else"])
def test_invalid_contact_message_gives_no_contact(text: str) -> None:
    assert force_control.contact_of(text) is None


@pytest.mark.parametrize("firmware", FIRMWARES)
def test_programs_compile_with_socket_link(firmware: str) -> None:
    from urlink.simulator.urscript import compile_script

    version = Firmware.parse(firmware)
    link = links.ReverseSocket("10.0.0.1", 50001, 5)
    bodies = [
        force_control.force_mode(
            version, link, Pressing((0.0,) * 6, DOWN, (0.1,) * 6, kind=2, damping=None, gain=None), watchdog=0.5
        ),
        force_control.freedrive(version, link, None, [0.0] * 6, watchdog=0.5),
    ]
    for body, end in zip(bodies, ("end_force_mode()", "end_freedrive_mode()"), strict=True):
        compile_script(program("p", body, None).text, version)
        # The mode ends before the arm brakes, for every kind of end.
        assert body.index(f"  {end}") < body.index("  stopj(4.0)")


def test_kept_message_is_sent_with_each_state_until_muted() -> None:
    dialogue = KeptMessage(lambda link: [])
    state = RealtimeState(Firmware(5, 11))
    assert dialogue.step(b"", state, 0.0) == WAIT_MESSAGE
    dialogue.values = (1.0, 2.0, 3.0, 4.0, 5.0, 6.0)
    for _ in range(2):
        assert read_message(dialogue.step(b"", state, 0.0))[0] == [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]
    dialogue.is_mute = True
    assert dialogue.step(b"", state, 0.0) == b""
    assert dialogue.farewell == STOP_MESSAGE
