"""Tests that calls of the asyncio robot and of `urlink_compat` leave no reference cycles, as in `test_cycles.py`.

The same applies to a real-time connection without packets.
"""

from __future__ import annotations

import asyncio
import contextlib
import itertools
from collections.abc import Callable, Iterator
from typing import Any

import pytest

import urlink
from linkcore.errors import LinkError
from tests import platforms
from tests.spawning import spawning
from tests.urlink.test_cycles import COUNT, HOME, NEAR, collector_off
from tests.waiting import until
from urlink.protocol.realtime.protocol import RealtimeProtocol
from urlink_compat import rtde_control, rtde_io, urx

pytestmark = [pytest.mark.real_time, platforms.needs_prompt_release]

ZEROS = [0.0] * 6
DOWN = ([0, 0, 1, 0, 0, 0], ZEROS, [0.1] * 6)
_dials = itertools.cycle([True, False])


@pytest.fixture(scope="module")
def address() -> Iterator[str]:
    for start in spawning("urlink.cli"):
        process = start("sim", "--model", "UR5e", "--firmware", "5.25", stderr=None)
        assert process.stdout is not None
        yield process.stdout.readline().strip()


def is_home(address: str) -> bool:
    with contextlib.suppress(LinkError), urlink.connect(address, stale_after=60.0, silence=60.0) as robot:
        robot.motion.move_joints(HOME, wait=30)
        return True
    return False


def test_realtime_protocol_alone_leaves_no_reference_cycle() -> None:
    with collector_off():
        for _ in range(COUNT):
            RealtimeProtocol()


# -- asyncio ---------------------------------------------------------------------------------------------------------


async def block(entering: Any, use: Callable[[Any], Any] | None = None) -> None:
    async with entering as opened:
        if use is not None:
            result = use(opened)
            if hasattr(result, "__await__"):
                await result


async def cancelled(robot: urlink.AsyncRobot) -> None:
    moving = asyncio.ensure_future(_moved(robot))
    await asyncio.sleep(0.05)
    moving.cancel()
    with contextlib.suppress(asyncio.CancelledError, LinkError):
        await moving
    await robot.motion.stop(wait=True)


async def _moved(robot: urlink.AsyncRobot) -> None:
    await robot.motion.move_joints(HOME + 0.2, wait=True)


async def read(robot: urlink.AsyncRobot) -> None:
    await robot.realtime.wait(timeout=30)


#: Awaited calls of an asynchronous robot.
AWAITED: dict[str, Callable[[urlink.AsyncRobot], Any]] = {
    "identify": lambda robot: robot.identify(),
    "realtime.wait": read,
    "popup": lambda robot: robot.popup("x"),
    "set_payload": lambda robot: robot.set_payload(0.5, (0, 0, 0.01)),
    "set_speed_slider": lambda robot: robot.set_speed_slider(1.0),
    "set_tcp": lambda robot: robot.set_tcp((0, 0, 0.1, 0, 0, 0)),
    "zero_force_sensor": lambda robot: robot.zero_force_sensor(),
    "freedrive": lambda robot: block(robot.freedrive()),
    "teach": lambda robot: block(robot.teach()),
    "motion.move_joints": lambda robot: robot.motion.move_joints(NEAR, wait=True),
    "motion.move_joints, cancelled": cancelled,
    "motion.stop": lambda robot: robot.motion.stop(wait=True),
    "motion.speed_joints": lambda robot: robot.motion.speed_joints(ZEROS, duration=0.02, wait=True),
    "motion.servo": lambda robot: block(robot.motion.servo(watchdog=2.0)),
    "motion.jog": lambda robot: block(robot.motion.jog(), lambda jog: jog.move(ZEROS)),
    "motion.force_mode": lambda robot: block(robot.motion.force_mode("base", DOWN[0], DOWN[1], DOWN[2])),
    "script.run": lambda robot: robot.script.run("sync()", wait=True),
    "script.send_line": lambda robot: robot.script.send_line("set_flag(1, True)"),
    "io.set_digital_out": lambda robot: robot.io.set_digital_out(0, next(_dials)),
    "io.set_analog_out": lambda robot: robot.io.set_analog_out(0, 0.5),
    "safety.enable": lambda robot: robot.safety.enable(),
    "dashboard.robot_mode": lambda robot: robot.dashboard.robot_mode(),
    "dashboard.play": lambda robot: robot.dashboard.play(),
    "rtde.outputs": lambda robot: block(robot.rtde.outputs("timestamp"), lambda outputs: outputs.wait(timeout=30)),
    "rtde.inputs": lambda robot: block(robot.rtde.inputs("input_int_register_30")),
    "rtde.missing": lambda robot: robot.rtde.missing(),
    "registers.write_integer": lambda robot: robot.registers.write_integer(24, 1),
    "registers.read_integer": lambda robot: robot.registers.read_integer(24),
}


@pytest.fixture(scope="module")
def loop() -> Iterator[asyncio.AbstractEventLoop]:
    loop = asyncio.new_event_loop()
    yield loop
    loop.close()


@pytest.fixture
def robot(loop: asyncio.AbstractEventLoop, address: str) -> Iterator[urlink.AsyncRobot]:
    until(lambda: is_home(address), 60.0)

    async def connect() -> urlink.AsyncRobot:
        return await urlink.connect_async(address, stale_after=60.0, silence=60.0)

    robot = loop.run_until_complete(connect())
    yield robot
    loop.run_until_complete(robot.close())


@pytest.mark.parametrize("name", AWAITED)
def test_awaited_call_leaves_no_reference_cycle(
    loop: asyncio.AbstractEventLoop, robot: urlink.AsyncRobot, name: str
) -> None:
    async def call(count: int) -> None:
        for _ in range(count):
            with contextlib.suppress(LinkError):  # for example, from a `play` without a loaded program
                await AWAITED[name](robot)

    loop.run_until_complete(call(2))
    with collector_off():
        loop.run_until_complete(call(COUNT))


def test_awaited_connection_leaves_no_reference_cycle(loop: asyncio.AbstractEventLoop, address: str) -> None:
    async def connect(count: int) -> None:
        for _ in range(count):
            async with urlink.connect_async(address) as robot:
                await robot.realtime.wait(timeout=30)
            with contextlib.suppress(LinkError):
                await urlink.connect_async("ur://127.0.0.1?primary=1", timeout=0.5)

    loop.run_until_complete(connect(2))
    with collector_off():
        loop.run_until_complete(connect(COUNT))


# -- names of other libraries ----------------------------------------------------------------------------------------

Control = rtde_control.RTDEControlInterface


def near(control: Control) -> list[float]:
    """Return a pose near the home position, above and below it in turn."""
    pose = control.getForwardKinematics(HOME.tolist())
    pose[2] += 0.002 * next(_dials)
    return pose


def both(first: Callable[[], object], then: Callable[[], object]) -> None:
    first()
    then()


CONTROL: dict[str, Callable[[Control], object]] = {
    "moveJ": lambda control: control.moveJ(NEAR.tolist() if next(_dials) else HOME.tolist(), 3.0, 10.0),
    "moveJ, asynchronous": lambda control: both(
        lambda: control.moveJ(HOME.tolist(), 1.0, 1.0, True), lambda: control.stopJ(10.0)
    ),
    "moveJ_IK": lambda control: control.moveJ_IK(near(control), 3.0, 10.0),
    "moveL": lambda control: control.moveL(near(control), 1.0, 5.0),
    "moveL_FK": lambda control: control.moveL_FK(HOME.tolist(), 1.0, 5.0),
    "stopL": lambda control: control.stopL(),
    "servoJ": lambda control: both(
        lambda: control.servoJ(HOME.tolist(), 0, 0, 0.01, 0.1, 300), lambda: control.servoStop()
    ),
    "speedJ": lambda control: both(lambda: control.speedJ(ZEROS, 0.5, 0.1), lambda: control.speedStop()),
    "speedL": lambda control: both(lambda: control.speedL(ZEROS, 0.5, 0.1), lambda: control.speedStop()),
    "jogStart": lambda control: both(lambda: control.jogStart(ZEROS), lambda: control.jogStop()),
    "forceMode": lambda control: both(
        lambda: control.forceMode(ZEROS, DOWN[0], ZEROS, 2, DOWN[2]), lambda: control.forceModeStop()
    ),
    "freedriveMode": lambda control: both(lambda: control.freedriveMode(), lambda: control.endFreedriveMode()),
    "teachMode": lambda control: both(lambda: control.teachMode(), lambda: control.endTeachMode()),
    "setTcp": lambda control: control.setTcp(ZEROS),
    "setPayload": lambda control: control.setPayload(0.5),
    "zeroFtSensor": lambda control: control.zeroFtSensor(),
    "setGravity": lambda control: control.setGravity([0, 0, 9.82]),
    "getInverseKinematics": lambda control: control.getInverseKinematics(near(control), HOME.tolist()),
    "reuploadScript": lambda control: control.reuploadScript(),
    "stopScript": lambda control: control.stopScript(),
    "sendCustomScript": lambda control: control.sendCustomScript("sync()"),
    "sendCustomScriptFunction": lambda control: control.sendCustomScriptFunction("f", "sync()"),
    "isSteady": lambda control: control.isSteady(),
    "reconnect": lambda control: control.reconnect(),
}


def tried(call: Callable[[], object], count: int) -> None:
    call()
    call()
    with collector_off():
        for _ in range(count):
            call()


@pytest.fixture(scope="module")
def control(address: str) -> Iterator[Control]:
    until(lambda: is_home(address), 60.0)
    control = Control(address)
    yield control
    control.disconnect()


@pytest.mark.parametrize("name", CONTROL)
def test_ur_rtde_command_leaves_no_reference_cycle(control: Control, name: str) -> None:
    tried(lambda: CONTROL[name](control), COUNT)


OUTPUTS: dict[str, Callable[[rtde_io.RTDEIOInterface], object]] = {
    "setStandardDigitalOut": lambda io: io.setStandardDigitalOut(0, next(_dials)),
    "setConfigurableDigitalOut": lambda io: io.setConfigurableDigitalOut(0, next(_dials)),
    "setToolDigitalOut": lambda io: io.setToolDigitalOut(0, next(_dials)),
    "setSpeedSlider": lambda io: io.setSpeedSlider(1.0),
    "setAnalogOutputVoltage": lambda io: io.setAnalogOutputVoltage(0, 0.5),
    "setAnalogOutputCurrent": lambda io: io.setAnalogOutputCurrent(0, 0.5),
    "setInputIntRegister": lambda io: io.setInputIntRegister(20, 1),
    "setInputDoubleRegister": lambda io: io.setInputDoubleRegister(20, 1.0),
}


@pytest.mark.parametrize("name", OUTPUTS)
def test_ur_rtde_output_leaves_no_reference_cycle(address: str, name: str) -> None:
    io = rtde_io.RTDEIOInterface(address)
    try:
        tried(lambda: OUTPUTS[name](io), COUNT)
    finally:
        io.disconnect()


URX: dict[str, Callable[[urx.Robot], object]] = {
    "movej": lambda robot: robot.movej(HOME.tolist(), 10, 3),
    "movel": lambda robot: robot.movel(robot.getl(), 5, 1),
    "translate": lambda robot: robot.translate((0, 0, 0.002 if next(_dials) else -0.002), 5, 1),
    "translate_tool": lambda robot: robot.translate_tool((0, 0, 0.002 if next(_dials) else -0.002), 5, 1),
    "speedj": lambda robot: both(lambda: robot.speedj(ZEROS, 1, 0.1), lambda: robot.stopj()),
    "speedl": lambda robot: both(lambda: robot.speedl(ZEROS, 1, 0.1), lambda: robot.stopl()),
    "stop": lambda robot: robot.stop(),
    "set_tcp": lambda robot: robot.set_tcp(ZEROS),
    "set_payload": lambda robot: robot.set_payload(0.5),
    "set_gravity": lambda robot: robot.set_gravity((0, 0, 9.82)),
    "set_digital_out": lambda robot: robot.set_digital_out(0, next(_dials)),
    "set_analog_out": lambda robot: robot.set_analog_out(0, 0.5),
    "set_tool_voltage": lambda robot: robot.set_tool_voltage(12),
    "send_program": lambda robot: robot.send_program("set_flag(1, True)"),
    "send_message": lambda robot: robot.send_message("x"),
}


@pytest.fixture(scope="module")
def by_urx(address: str) -> Iterator[urx.Robot]:
    until(lambda: is_home(address), 60.0)
    robot = urx.Robot(address)
    yield robot
    robot.close()


@pytest.mark.slow
@pytest.mark.parametrize("name", URX)
def test_urx_call_leaves_no_reference_cycle(by_urx: urx.Robot, name: str) -> None:
    def call() -> None:
        with contextlib.suppress(LinkError):
            URX[name](by_urx)

    tried(call, COUNT)
