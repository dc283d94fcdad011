"""Tests that calls leave no reference cycles, so a program may switch off the garbage collector (docs/real-time.md).

Each public method that sends something is called several times with the collector off, on a controller in its own
process. Afterwards, no object may be left that only the collector finds. `URLINK_CYCLES` sets the number of calls, as
in `URLINK_CYCLES=10000 pytest tests/urlink/test_cycles.py`. In simulated time, `python -m tests.urlink.many_cycles`
makes ten thousand calls of each method.
"""

from __future__ import annotations

import contextlib
import gc
import itertools
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import urlink
from linkcore.errors import ConnectionLost, LinkError
from linkcore.handle import Handle
from tests import platforms
from tests.garbage import no_garbage
from tests.spawning import spawning
from tests.waiting import until
from urlink.command.interpreter import Interpreter
from urlink.command.io import IO
from urlink.command.safety import Safety
from urlink.command.scripts import Scripts
from urlink.motion.motions import Motions
from urlink.motion.servo.force_control import ForceMode, Torque
from urlink.motion.servo.impedance import Impedance
from urlink.motion.servo.jog import Jog
from urlink.motion.servo.servo import Servo
from urlink.motion.stream.point_stream import PointStream
from urlink.motion.teaching import Teaching
from urlink.packets import VersionMessage
from urlink.protocol.dashboard.client import Dashboard
from urlink.protocol.gripper.client import Gripper
from urlink.protocol.tool_serial import ToolSerial
from urlink.robot import Robot
from urlink.rtde import Inputs, Registers, Rtde

pytestmark = [pytest.mark.real_time, platforms.needs_prompt_release]

#: Longest time until a state shows a setting, in s. It is long because the computer may be busy.
CONFIRM = 10.0
#: Time without a message after which the robot brakes, in s. It is long for the same reason.
WATCHDOG = 2.0
HOME = np.array([0.0, -1.57, 1.57, -1.57, -1.57, 0.0])
NEAR = HOME + 0.01
#: Number of calls of each method. With `URLINK_CYCLES=10000`, cycles of one call in 10,000 are found.
COUNT = int(os.environ.get("URLINK_CYCLES", "2"))


@pytest.fixture(scope="module")
def address() -> Iterator[str]:
    for start in spawning("urlink.cli"):
        process = start("sim", "--model", "UR5e", "--firmware", "5.25", stderr=None)
        assert process.stdout is not None
        yield process.stdout.readline().strip()


@pytest.fixture(scope="module")
def robot(address: str) -> Iterator[Robot]:
    with urlink.connect(address, stale_after=60.0, silence=60.0) as robot:
        until(lambda: _has_moved(robot), 60.0)
        robot.gripper.activate()
        yield robot


@pytest.fixture(scope="module")
def closed(address: str) -> Robot:
    """Provide a robot that was used and then closed."""
    with urlink.connect(address, stale_after=60.0, silence=60.0) as robot:
        until(lambda: _has_moved(robot), 60.0)
        robot.registers.read_bit(64)
        robot.registers.write_bit(70, True)
    return robot


def _has_moved(robot: Robot) -> bool:
    with contextlib.suppress(LinkError):
        robot.motion.move_joints(HOME, wait=30)
        return True
    return False


def _trajectory() -> urlink.Trajectory:
    return urlink.Trajectory([urlink.TrajectoryPoint(HOME, 0.0), urlink.TrajectoryPoint(HOME, 0.3)])


#: Request for the status of a Modbus gripper.
STATUS = bytes.fromhex("09 03 07 D0 00 01 85 CF")


class Within:
    """A call of a block that has to be opened first.

    Args:
        opened: Function that returns the block of a robot, as a context manager.
        use: Call within the block; by default, the block is only opened.
        is_once: Whether each block allows one call only, because the call ends or fills the block, or because the
            test is of opening the block.
    """

    def __init__(
        self,
        opened: Callable[[Robot], contextlib.AbstractContextManager[Any]],
        use: Callable[[Any], object] = lambda opened: None,
        *,
        is_once: bool = False,
    ) -> None:
        self.opened = opened
        self.use = use
        self.is_once = is_once

    def __call__(self, robot: Robot, count: int = 1) -> None:
        for is_last in (False, False, False, True):
            try:
                with self.opened(robot) as opened:
                    for _ in range(count):
                        self.use(opened)
                return
            except ConnectionLost:  # on a busy computer, messages may be late, so the robot brakes
                if is_last:
                    raise


def servo(robot: Robot, **options: Any) -> Servo:
    robot.motion.move_joints(HOME, wait=True)
    return robot.motion.servo(watchdog=WATCHDOG, **options)


def pressing(robot: Robot) -> Any:
    return robot.motion.force_mode("base", (0, 0, 1, 0, 0, 0), [0] * 6, [0.1] * 6, watchdog=WATCHDOG)


def measured(block: Servo) -> None:
    with contextlib.suppress(LinkError):  # raised if the arm does not follow in time, on a busy computer
        block.measure_delay()


def appended(stream: PointStream) -> None:
    stream.append(urlink.TrajectoryPoint(NEAR, stream.end + 0.5, [0] * 6))


def replaced(stream: PointStream) -> None:
    stream.replace(stream.time, urlink.TrajectoryPoint(NEAR, stream.time + 0.5, [0] * 6))


def asked_over_the_line(robot: Robot) -> None:
    robot.io.set_tool_communication(confirm=CONFIRM)
    robot.tool_serial.ask(STATUS, 7)


def read_over_the_line(robot: Robot) -> None:
    robot.io.set_tool_communication(confirm=CONFIRM)
    robot.tool_serial.write(STATUS)
    robot.tool_serial.read(7)


def pose(robot: Robot) -> Any:
    return robot.realtime.wait().tool_vector_actual


def moved_by(robot: Robot, offset: tuple[float, float, float]) -> Any:
    there = np.array(pose(robot))
    there[:3] += offset
    return there


def moved(robot: Robot) -> None:
    robot.motion.move_linear(moved_by(robot, (0, 0, 0.002 * next(_directions))), wait=True)


def circled(robot: Robot) -> None:
    by = 0.002 * next(_directions)
    via, end = moved_by(robot, (by, 0, 0.002)), moved_by(robot, (2 * by, 0, 0))
    robot.motion.move_circular(via, end, wait=True)


def recorded(robot: Robot, folder: Path) -> None:
    path = folder / "run.urlog"
    path.unlink(missing_ok=True)
    with robot.record(path):
        robot.realtime.wait()


def cancelled(robot: Robot) -> None:
    motion = robot.motion.move_joints(HOME + 0.2)
    motion.cancel()
    with contextlib.suppress(LinkError):
        motion.wait(10)


def untouched(robot: Robot) -> None:
    with contextlib.suppress(urlink.NoContact):
        robot.motion.until_contact([0, 0, next(_directions)], speed=0.05, distance=0.001, wait=True)


def payload_refused(robot: Robot) -> None:
    """Call it without consent, so that the arm stays in place for any number of calls."""
    with contextlib.suppress(urlink.BadValue):
        robot.measure_payload(1.0)


def payload_by_hand(robot: Robot) -> None:
    with contextlib.suppress(urlink.LinkTimeout):
        robot.measure_payload_by_hand(rest=0.1, posture_timeout=1.0, watchdog=WATCHDOG)


def connected(address: str) -> None:
    with urlink.connect(address) as robot:
        robot.realtime.wait()


_dials = itertools.cycle([True, False])
#: Alternating directions, so that the arm stays in place for any number of calls.
_directions = itertools.cycle([1, -1])

#: Each method that sends something -> its call.
CALLS: dict[str, Callable[[Robot], object]] = {
    "Robot.freedrive": Within(lambda robot: robot.freedrive(watchdog=WATCHDOG)),
    "Robot.interpreter": Within(lambda robot: robot.interpreter()),
    "Robot.measure_payload": payload_refused,
    "Robot.measure_payload_by_hand": payload_by_hand,
    "Robot.popup": lambda robot: robot.popup("x"),
    "Robot.set_gravity": lambda robot: robot.set_gravity((0, 0, -9.82)),
    "Robot.set_payload": lambda robot: robot.set_payload(0.5, (0, 0, 0.01), confirm=CONFIRM),
    "Robot.set_speed_slider": lambda robot: robot.set_speed_slider(1.0, confirm=CONFIRM),
    "Robot.set_tcp": lambda robot: robot.set_tcp((0, 0, 0.1, 0, 0, 0), confirm=CONFIRM),
    "Robot.teach": Within(
        lambda robot: robot.teach(watchdog=WATCHDOG), lambda teaching: teaching.record(), is_once=True
    ),
    "Robot.zero_force_sensor": lambda robot: robot.zero_force_sensor(),
    "Motions.follow": lambda robot: robot.motion.follow(
        _trajectory(), start_tolerance=1.0, watchdog=WATCHDOG, wait=True
    ),
    "Motions.force_mode": Within(pressing, lambda mode: mode.set_wrench([0] * 6), is_once=True),
    "Motions.impedance": Within(
        lambda robot: robot.motion.impedance(watchdog=WATCHDOG), lambda soft: soft.send(HOME), is_once=True
    ),
    "Motions.jog": Within(
        lambda robot: robot.motion.jog(watchdog=WATCHDOG), lambda jog: jog.move([0.0] * 6), is_once=True
    ),
    "Motions.move_circular": circled,
    "Motions.move_joints": lambda robot: robot.motion.move_joints(NEAR, wait=True),
    "Motions.move_linear": moved,
    "Motions.path": lambda robot: robot.motion.path([urlink.Joint(NEAR)], wait=True),
    "Motions.servo": Within(servo, lambda block: block.send(HOME), is_once=True),
    "Motions.stream": Within(
        lambda robot: robot.motion.stream(watchdog=WATCHDOG), lambda stream: stream.clear(), is_once=True
    ),
    "Motions.speed_joints": lambda robot: robot.motion.speed_joints([0.0] * 6, duration=0.02).wait(),
    "Motions.speed_linear": lambda robot: robot.motion.speed_linear([0.0] * 6, duration=0.02).wait(),
    "Motions.stop": lambda robot: robot.motion.stop(wait=True),
    "Motions.torque": Within(
        lambda robot: robot.motion.torque(watchdog=1.0), lambda torque: torque.send([0.0] * 6), is_once=True
    ),
    "Motions.until_contact": untouched,
    "Scripts.run": lambda robot: robot.script.run("sync()", wait=True, on_text=lambda text: None),
    "Scripts.send_line": lambda robot: robot.script.send_line("set_flag(1, True)"),
    "IO.set_analog_out": lambda robot: robot.io.set_analog_out(0, 0.5, confirm=CONFIRM),
    "IO.set_configurable_digital_out": lambda robot: robot.io.set_configurable_digital_out(
        0, next(_dials), confirm=CONFIRM
    ),
    "IO.set_digital_out": lambda robot: robot.io.set_digital_out(0, next(_dials), confirm=CONFIRM),
    "IO.set_flag": lambda robot: robot.io.set_flag(1, True),
    "IO.set_tool_digital_out": lambda robot: robot.io.set_tool_digital_out(0, next(_dials), confirm=CONFIRM),
    "IO.set_tool_communication": lambda robot: robot.io.set_tool_communication(confirm=CONFIRM),
    "IO.set_tool_voltage": lambda robot: robot.io.set_tool_voltage(12, confirm=CONFIRM),
    "Interpreter.abort": Within(lambda robot: robot.interpreter(), lambda interpreter: interpreter.abort()),
    "Interpreter.clear": Within(lambda robot: robot.interpreter(), lambda interpreter: interpreter.clear()),
    "Interpreter.end": Within(lambda robot: robot.interpreter(), lambda interpreter: interpreter.end(), is_once=True),
    "Interpreter.execute": Within(lambda robot: robot.interpreter(), lambda interpreter: interpreter.execute("a = 1")),
    "Interpreter.skip": Within(lambda robot: robot.interpreter(), lambda interpreter: interpreter.skip()),
    "Servo.send": Within(lambda robot: servo(robot, target_filter="jerk_limited"), lambda block: block.send(HOME)),
    "Servo.schedule": Within(servo, lambda block: block.schedule(HOME, 1e6)),
    "Servo.measure_delay": Within(servo, measured),
    "PointStream.append": Within(lambda robot: robot.motion.stream(watchdog=WATCHDOG), appended, is_once=True),
    "PointStream.clear": Within(lambda robot: robot.motion.stream(watchdog=WATCHDOG), lambda stream: stream.clear()),
    "PointStream.replace": Within(lambda robot: robot.motion.stream(watchdog=WATCHDOG), replaced),
    "PointStream.wait_until_dry": Within(
        lambda robot: robot.motion.stream(watchdog=WATCHDOG), lambda stream: stream.wait_until_dry()
    ),
    "Jog.move": Within(lambda robot: robot.motion.jog(watchdog=WATCHDOG), lambda jog: jog.move([0.01] * 6)),
    "Jog.stop": Within(lambda robot: robot.motion.jog(watchdog=WATCHDOG), lambda jog: jog.stop()),
    "Impedance.send": Within(lambda robot: robot.motion.impedance(watchdog=WATCHDOG), lambda soft: soft.send(HOME)),
    "Impedance.set_gains": Within(
        lambda robot: robot.motion.impedance(watchdog=WATCHDOG), lambda soft: soft.set_gains(500)
    ),
    "Torque.send": Within(lambda robot: robot.motion.torque(watchdog=1.0), lambda torque: torque.send([0.01] * 6)),
    "Handle.cancel": cancelled,
    "Registers.write_bit": lambda robot: robot.registers.write_bit(64, True),
    "Registers.write_float": lambda robot: robot.registers.write_float(24, 1.0),
    "Registers.write_integer": lambda robot: robot.registers.write_integer(24, 1),
    "Registers.read_integer": lambda robot: robot.registers.read_integer(24),
    "Registers.read_bit": lambda robot: robot.registers.read_bit(64),
    "Registers.read_float": lambda robot: robot.registers.read_float(24),
    "Rtde.inputs": Within(lambda robot: robot.rtde.inputs("input_int_register_30")),
    "Rtde.outputs": Within(lambda robot: robot.rtde.outputs("timestamp"), lambda outputs: outputs.wait()),
    "Rtde.missing": lambda robot: robot.rtde.missing(),
    "Rtde.who_holds": lambda robot: robot.rtde.who_holds(),
    "Inputs.send": Within(
        lambda robot: robot.rtde.inputs("input_int_register_30"), lambda inputs: inputs.send(input_int_register_30=1)
    ),
    "Gripper.activate": lambda robot: robot.gripper.activate(),
    "Gripper.open": lambda robot: robot.gripper.open(wait=False),
    "Gripper.close": lambda robot: robot.gripper.close(wait=False),
    "Gripper.move": lambda robot: robot.gripper.move(10, wait=False),
    "Gripper.stop": lambda robot: robot.gripper.stop(),
    "Gripper.get": lambda robot: robot.gripper.get("POS"),
    "Gripper.status": lambda robot: robot.gripper.status(),
    "Gripper.set": lambda robot: robot.gripper.set(POS=10),
    "ToolSerial.ask": asked_over_the_line,
    "ToolSerial.read": read_over_the_line,
    "ToolSerial.write": lambda robot: robot.tool_serial.write(STATUS),
    "ForceMode.set_wrench": Within(pressing, lambda mode: mode.set_wrench([0] * 6)),
}


#: Other public methods of these classes, which send nothing or have their own test.
SENDS_NOTHING = """
    Robot.wrench Safety.explain
    Robot.close Robot.record Robot.view
    ToolSerial.close ToolSerial.discard
    IO.analog_in IO.analog_out IO.configurable_digital_in IO.configurable_digital_out IO.digital_in IO.digital_out
    IO.tool_analog_in IO.tool_digital_in IO.tool_digital_out
    IO.wait_configurable_digital_in IO.wait_digital_in IO.wait_tool_digital_in
    Safety.enable Safety.on_stop Safety.wait_enabled Safety.wait_for_stop Safety.wait_until_clear
    Gripper.deactivate Gripper.object_detected Gripper.position Gripper.position_of Gripper.wait
    Rtde.close Rtde.registers
    Interpreter.wait_executed
    Handle.add_done_callback Handle.wait
    Inputs.close
    Teaching.record
"""
SURFACE = (
    Robot,
    Motions,
    Scripts,
    IO,
    Safety,
    Interpreter,
    Gripper,
    Impedance,
    ToolSerial,
    Rtde,
    Inputs,
    Registers,
    Servo,
    Jog,
    PointStream,
    ForceMode,
    Torque,
    Teaching,
    Handle,
)
#: Dashboard commands that require arguments -> their arguments.
ARGUMENTS: dict[str, tuple[Any, ...]] = {
    "add_to_log": ("x",),
    "download_program": ("x.urp",),
    "generate_support_file": ("/tmp",),
    "load": ("x.urp",),
    "load_installation": ("x.installation",),
    "popup": ("x",),
    "send": ("robotmode",),
    "set_operational_mode": ("automatic",),
    "set_user_role": ("programmer",),
    "upload_program": (__file__,),
}
#: Dashboard commands that end the controller, the client or the simulated power, or wait for it.
LAST = {"shutdown", "quit", "close", "start"}


@contextlib.contextmanager
def collector_off() -> Iterator[None]:
    """Switch the garbage collector off within the block, and check that the block leaves no garbage."""
    gc.disable()
    try:
        with no_garbage():
            yield
    finally:
        gc.enable()


def test_message_of_an_older_layout_leaves_no_reference_cycle() -> None:
    """The error of the newer layout must not keep the caller's frames. The message is the first one of a 3.2."""
    data = bytes(VersionMessage("3.2", build_date="short"))
    with collector_off():
        assert VersionMessage.LAYOUTS.decode(data).build_date == "short"


@pytest.mark.parametrize("name", CALLS)
def test_command_call_leaves_no_reference_cycle(robot: Robot, name: str) -> None:
    call = CALLS[name]
    call(robot)  # creates objects that are made only once, such as a connection
    with collector_off():
        for _ in range(COUNT):
            call(robot)


DASHBOARD = [name for name in vars(Dashboard) if not name.startswith("_") and name not in LAST]


@pytest.mark.parametrize("name", DASHBOARD)
def test_dashboard_command_leaves_no_reference_cycle(robot: Robot, name: str) -> None:
    """A command passes whether it is refused or not, because most commands are refused by some controller."""
    method = getattr(robot.dashboard, name)
    if name in ("power_off", "restart_safety"):
        pytest.skip("the other commands need an arm that is powered on")
    for _ in range(2):
        with contextlib.suppress(LinkError):
            method(*ARGUMENTS.get(name, ()))
    with collector_off():
        for _ in range(COUNT):
            with contextlib.suppress(LinkError):
                method(*ARGUMENTS.get(name, ()))


@pytest.mark.parametrize("name", CALLS)
def test_refused_call_leaves_no_reference_cycle(closed: Robot, name: str) -> None:
    call = CALLS[name]
    with contextlib.suppress(LinkError):
        call(closed)
    with collector_off():
        for _ in range(COUNT):
            with contextlib.suppress(LinkError):
                call(closed)


def refused() -> None:
    with contextlib.suppress(LinkError):
        urlink.connect("ur://127.0.0.1?primary=1", timeout=0.5)


@pytest.mark.slow
def test_connection_leaves_no_reference_cycle(address: str, tmp_path: Path) -> None:
    def connect() -> None:
        with urlink.connect(address) as robot:
            robot.realtime.wait()
            robot.primary.wait()
            with robot.rtde.outputs("timestamp") as outputs:
                outputs.wait()

    def record() -> None:
        path = tmp_path / "run.urlog"
        path.unlink(missing_ok=True)
        with urlink.connect(address) as robot, robot.record(path):
            robot.realtime.wait()

    def command() -> None:
        with urlink.connect(address) as robot:
            robot.realtime.wait()
            _has_moved(robot)

    def load() -> None:
        urlink.load(tmp_path / "run.urlog")

    for call in (connect, refused, record, load, command):
        call()
        with collector_off():
            for _ in range(COUNT):
                call()


@pytest.mark.slow
def test_reference_cycle_tests_cover_every_sending_method() -> None:
    own = {
        f"{held.__name__}.{name}"
        for held in SURFACE
        for name, member in vars(held).items()
        if not name.startswith("_") and (callable(member) or isinstance(member, staticmethod))
    }
    assert own == {*CALLS, *SENDS_NOTHING.split()}


@pytest.mark.slow
def test_wait_raises_a_copy_of_the_stored_error(robot: Robot) -> None:
    motion = robot.motion.move_joints(HOME + 0.2)
    motion.cancel()
    errors = []
    for _ in range(2):
        with pytest.raises(urlink.Cancelled) as caught:
            motion.wait(10)
        errors.append(caught.value)
    assert errors[0] is not errors[1]
    assert str(errors[0]) == str(errors[1]) == str(motion.error)
    assert motion.error is not None
    assert motion.error.__traceback__ is None
