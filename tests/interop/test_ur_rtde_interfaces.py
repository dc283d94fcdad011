"""The receive, I/O and control interfaces of the third-party library ur_rtde with the simulator's RTDE.

Their values and effects are compared with the controller itself, and their computations with the library.
"""

from __future__ import annotations

import json
import os
import queue
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.waiting import until
from urlink.arm.dynamics import Dynamics
from urlink.arm.poses import compose
from urlink.protocol.ports import PORTS
from urlink.protocol.rtde.variables import OUTPUTS
from urlink.simulator import HOME, Controller, Plane, Still
from urlink.simulator.rtde_variables import OUTPUT_VALUES

pytest.importorskip("rtde_control", reason="ur_rtde is not installed; `nox -s interop` installs it where it can be had")

pytestmark = pytest.mark.real_time

#: ur_rtde always uses the standard ports, so each process of the tests has its own address.
HOST = f"127.30.0.{4 + int(os.environ.get('PYTEST_XDIST_WORKER', 'gw0')[2:])}"
FLAG_UPLOAD_SCRIPT, FLAG_UPPER_RANGE_REGISTERS = 1, 8
FIRMWARES = ["3.15", "5.4", "5.11", "5.25", "10.12"]
#: The standard ports without those that these tests do not use, and that may need special rights: 80 and 502.
STANDARD = {name: number for name, number in PORTS.items() if name not in ("robot_api", "onrobot")}
NEAR = [0.1, -1.4, 1.3, -1.5, -1.5, 0.2]


class Rtde:
    """ur_rtde in a separate process, in which `call` makes the calls."""

    def __init__(self) -> None:
        self._process = subprocess.Popen(
            [sys.executable, str(Path(__file__).with_name("rtde_process.py"))],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
        )
        self._replies: queue.Queue[Any] = queue.Queue()
        self._said: list[str] = []
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()

    def _read(self) -> None:
        assert self._process.stderr is not None
        for line in self._process.stderr:
            if line.startswith(">>>"):
                self._replies.put(json.loads(line[3:]))
            else:
                self._said.append(line)
        self._replies.put({"error": f"the process has ended; its last output: {''.join(self._said[-20:])}"})

    def call(self, name: str, method: str, *arguments: Any) -> Any:
        """Call a method in the process, and return its result.

        Raises:
            RuntimeError: If the method raised an error, or the process has ended.
        """
        assert self._process.stdin is not None
        self._process.stdin.write(json.dumps([name, method, arguments]) + "\n")
        self._process.stdin.flush()
        reply = self._replies.get(timeout=30)
        if "error" in reply:
            raise RuntimeError(reply["error"])
        return reply["value"]

    def make(self, name: str, *arguments: Any) -> Interface:
        """Make one of the interfaces, which connects."""
        self.call(name, "", HOST, *arguments)
        return Interface(self, name)

    def close(self) -> None:
        self._process.kill()
        self._process.wait(10)
        self._thread.join(10)
        for pipe in (self._process.stdin, self._process.stderr):
            assert pipe is not None
            pipe.close()


class Interface:
    """Interface of ur_rtde in the other process, with the methods of ur_rtde."""

    def __init__(self, rtde: Rtde, name: str) -> None:
        self._rtde = rtde
        self._name = name

    def __getattr__(self, method: str) -> Callable[..., Any]:
        return partial(self._rtde.call, self._name, method)


@pytest.fixture(params=FIRMWARES)
def controller(request: pytest.FixtureRequest) -> Iterator[Controller]:
    with Controller(None, request.param, host=HOST, ports=STANDARD, motion=Still()) as controller:
        yield controller


@pytest.fixture
def rtde() -> Iterator[Rtde]:
    rtde = Rtde()
    yield rtde
    rtde.close()


def near(values: Any, wanted: Any, within: float = 1e-9) -> bool:
    return bool(np.allclose(values, wanted, rtol=0, atol=within))


def eventually(read: Callable[[], Any], wanted: Any, within: float = 1e-9) -> None:
    until(lambda: near(read(), wanted, within))


# -- receive -------------------------------------------------------------------------------------------

# Variables of the getters. Noisy values are compared in a cycle in which nothing is sent.
GETTERS = {
    "getTargetQ": "target_q",
    "getTargetQd": "target_qd",
    "getTargetQdd": "target_qdd",
    "getTargetCurrent": "target_current",
    "getTargetMoment": "target_moment",
    "getActualQ": "actual_q",
    "getActualQd": "actual_qd",
    "getActualCurrent": "actual_current",
    "getJointControlOutput": "joint_control_output",
    "getActualTCPPose": "actual_TCP_pose",
    "getActualTCPSpeed": "actual_TCP_speed",
    "getActualTCPForce": "actual_TCP_force",
    "getTargetTCPPose": "target_TCP_pose",
    "getTargetTCPSpeed": "target_TCP_speed",
    "getActualDigitalInputBits": "actual_digital_input_bits",
    "getJointTemperatures": "joint_temperatures",
    "getActualExecutionTime": "actual_execution_time",
    "getRobotMode": "robot_mode",
    "getJointMode": "joint_mode",
    "getSafetyMode": "safety_mode",
    "getActualToolAccelerometer": "actual_tool_accelerometer",
    "getSpeedScaling": "speed_scaling",
    "getTargetSpeedFraction": "target_speed_fraction",
    "getActualMomentum": "actual_momentum",
    "getActualMainVoltage": "actual_main_voltage",
    "getActualRobotVoltage": "actual_robot_voltage",
    "getActualRobotCurrent": "actual_robot_current",
    "getActualJointVoltage": "actual_joint_voltage",
    "getActualDigitalOutputBits": "actual_digital_output_bits",
    "getRuntimeState": "runtime_state",
    "getStandardAnalogInput0": "standard_analog_input0",
    "getStandardAnalogInput1": "standard_analog_input1",
    "getStandardAnalogOutput0": "standard_analog_output0",
    "getStandardAnalogOutput1": "standard_analog_output1",
    "getRobotStatus": "robot_status_bits",
    "getSafetyStatusBits": "safety_status_bits",
    "getTimestamp": "timestamp",
}
# Since 3.11/5.5.1, 3.15/5.11 and 5.9.
LATER_GETTERS = {
    "getPayload": "payload",
    "getPayloadCog": "payload_cog",
    "getPayloadInertia": "payload_inertia",
    "getFtRawWrench": "ft_raw_wrench",
}


def test_received_values_equal_the_sent_variables(controller: Controller, rtde: Rtde) -> None:
    signals, registers = controller.signals, controller.registers.outputs
    signals.set_digital_input(5, True)
    signals.set_digital_output(17, True)
    signals.set_analog_input(1, 0.75)
    controller.arm.payload, controller.arm.payload_cog = 1.25, (0.0, 0.01, 0.02)
    controller.speed_fraction = 0.5
    registers.integers[12], registers.floats[19] = -12, 0.125
    receive = rtde.make("receive")
    assert receive.isConnected()
    assert receive.getActualDigitalInputBits() == 1 << 5
    # During the stall no further package arrives, so the received values can be compared with the controller.
    controller.faults.stall(1000.0, "rtde")
    time.sleep(0.1)
    last = receive.getTimestamp()
    names = {**GETTERS, **{getter: name for getter, name in LATER_GETTERS.items() if has(controller, name)}}
    got = {name: getattr(receive, getter)() for getter, name in names.items()}
    assert receive.getOutputIntRegister(12) == -12
    assert receive.getOutputDoubleRegister(19) == 0.125
    steady = {name: value for name, value in got.items() if not name.startswith(NOISY) and name != "timestamp"}
    assert len(steady) > 20
    for name, value in steady.items():
        assert near(value, sent(controller, name), 1e-12), name
    for name, value in got.items():
        if name.startswith(NOISY):
            # The noise changes the sign of rotation vectors near half a turn.
            assert near(np.ravel(value)[:3], np.ravel(sent(controller, name))[:3], 2.0), name
    assert 45.0 < last < controller.time + 45.0


NOISY = (
    "actual_q",
    "actual_TCP",
    "actual_current",
    "actual_joint_voltage",
    "actual_tool",
    "actual_robot_current",
    "actual_momentum",
    "ft_raw",
)


def has(controller: Controller, name: str) -> bool:
    """Whether the controller has the variable and ur_rtde asks for it; ur_rtde checks only the minor version."""
    firmware = controller.firmware
    return OUTPUTS[name].is_in(firmware) and not firmware.is_polyscope_x


def sent(controller: Controller, name: str) -> Any:
    """Return the value of a variable that the controller would send now."""
    found: list[Any] = []
    controller.call(lambda: found.append(OUTPUT_VALUES[name](controller._state)))
    return found[0]


def test_receive_interface_works_with_selected_variables(controller: Controller, rtde: Rtde) -> None:
    receive = rtde.make("receive", 10.0, ["timestamp", "actual_q"])
    first = receive.getTimestamp()
    until(lambda: receive.getTimestamp() > first)
    assert receive.getTimestamp() - first == pytest.approx(0.1, abs=0.01)
    assert near(receive.getActualQ(), HOME, 1e-3)


# -- inputs and outputs --------------------------------------------------------------------------------


def test_outputs_slider_and_registers_are_set(controller: Controller, rtde: Rtde) -> None:
    io = rtde.make("io")
    assert io.setStandardDigitalOut(3, True)
    assert io.setConfigurableDigitalOut(1, True)
    assert io.setToolDigitalOut(1, True)
    until(lambda: controller.signals.digital_outputs == 1 << 3 | 1 << 9 | 1 << 17)
    assert io.setStandardDigitalOut(3, False)
    until(lambda: controller.signals.digital_outputs == 1 << 9 | 1 << 17)
    assert io.setSpeedSlider(0.25)
    until(lambda: controller.speed_fraction == 0.25)
    assert io.setAnalogOutputVoltage(1, 0.5)
    assert io.setAnalogOutputCurrent(0, 0.25)
    eventually(lambda: controller.signals.analog_outputs, [0.008, 5.0])
    assert controller.signals.analog_output_domains == [0, 1]
    for number in range(18, 23):
        assert io.setInputIntRegister(number, -number)
        assert io.setInputDoubleRegister(number, number / 8)
    until(lambda: controller.registers.inputs.integers[18:23] == [-18, -19, -20, -21, -22])
    until(lambda: controller.registers.inputs.floats[18:23] == [18 / 8, 19 / 8, 20 / 8, 21 / 8, 22 / 8])
    io.disconnect()


def test_registers_of_the_upper_range_are_set(controller: Controller, rtde: Rtde) -> None:
    io = rtde.make("io", False, True)
    assert io.setInputIntRegister(42, 7)
    assert io.setInputDoubleRegister(46, 0.5)
    until(lambda: controller.registers.inputs.integers[42] == 7)
    until(lambda: controller.registers.inputs.floats[46] == 0.5)


def test_input_in_use_raises_an_error(rtde: Rtde) -> None:
    with Controller("UR5e", "5.11", host=HOST, ports=STANDARD, motion=Still()) as controller:
        controller.fieldbus = "EtherNet/IP"
        with pytest.raises(RuntimeError, match="in use"):
            rtde.make("io")


# -- control -------------------------------------------------------------------------------------------


@pytest.fixture
def control(controller: Controller, rtde: Rtde) -> Interface:
    control = rtde.make("control")
    assert controller.program_name == "rtde_control"
    return control


def test_moves_reach_their_goals_and_can_be_stopped(controller: Controller, control: Interface) -> None:
    assert control.moveJ(NEAR, 2.0, 4.0)
    assert near(controller.arm.setpoint.q, NEAR)
    pose = controller.arm.sample.pose_target
    there = [pose[0], pose[1] + 0.05, pose[2] - 0.05, *pose[3:]]
    assert control.moveL(there, 0.5, 2.0)
    assert near(controller.arm.sample.pose_target, there, 1e-7)
    assert control.moveJ_IK(pose, 2.0, 4.0)
    assert near(controller.arm.setpoint.q, NEAR, 1e-6)
    assert control.moveL_FK(list(HOME), 0.5, 2.0)
    assert near(controller.arm.setpoint.q, HOME, 1e-6)
    assert control.moveJ(NEAR, 0.5, 1.0, True)
    until(lambda: controller.arm.is_moving)
    assert control.getAsyncOperationProgress() >= 0
    control.stopJ(4.0)
    until(lambda: not controller.arm.is_moving)
    assert not near(controller.arm.setpoint.q, NEAR)
    assert control.moveL(there, 0.1, 1.0, True)
    until(lambda: controller.arm.is_moving)
    control.stopL(2.0)
    until(lambda: not controller.arm.is_moving)
    assert not near(controller.arm.sample.pose_target, there, 1e-3)


def test_path_reaches_its_goal(controller: Controller, control: Interface) -> None:
    first = [*NEAR, 2.0, 4.0, 0.0]
    second = [*HOME, 2.0, 4.0, 0.0]
    assert control.movePath([["J", "joints", first], ["J", "joints", second]])
    # The path is sent as text with four decimals.
    assert near(controller.arm.setpoint.q, HOME, 1e-4)


def test_servo_speed_and_jog_move_the_arm(controller: Controller, control: Interface) -> None:
    q = list(HOME)
    period = 1.0 / controller.firmware.rate
    for _ in range(40):
        q[5] += 0.2 * period
        assert control.servoJ(q, 0, 0, period, 0.1, 300)
        time.sleep(period)
    until(lambda: controller.arm.setpoint.q[5] > HOME[5] + 0.005)
    assert control.servoStop(10.0)
    assert control.speedJ([0, 0, 0, 0, 0, 0.3], 2.0, 0)
    eventually(lambda: controller.arm.setpoint.qd[5], 0.3, 1e-6)
    assert control.speedStop(4.0)
    until(lambda: not controller.arm.is_moving)
    assert control.speedL([0, 0, -0.05, 0, 0, 0], 0.5, 0)
    eventually(lambda: controller.arm.sample.speed_target[2], -0.05, 1e-3)
    assert control.speedStop(4.0)
    until(lambda: not controller.arm.is_moving)
    pose = list(controller.arm.sample.pose_target)
    for _ in range(20):
        pose[2] += 0.02 * period
        assert control.servoL(pose, 0, 0, period, 0.1, 300)
        time.sleep(period)
    assert control.servoStop(10.0)
    assert control.jogStart([0, 0, 50, 0, 0, 0], 0) or True
    until(lambda: controller.arm.is_moving)
    assert control.jogStop()
    until(lambda: not controller.arm.is_moving)


def test_kinematics_equal_the_library(controller: Controller, control: Interface) -> None:
    arm = controller.arm.kinematics
    tool = [0.0, 0.01, 0.15, 0.1, 0.0, 0.2]
    assert control.setTcp(tool)
    until(lambda: near(controller.arm.tcp, tool))
    if controller.firmware >= (3, 6):
        assert near(control.getTCPOffset(), tool)
    pose = arm.forward(NEAR, tool).tolist()
    assert near(control.getForwardKinematics(NEAR, tool), pose)
    assert near(control.getInverseKinematics(pose, NEAR), NEAR, 1e-9)
    assert near(control.getInverseKinematics(pose), arm.inverse(pose, HOME, tool), 1e-9)
    assert near(control.poseTrans(pose, tool), compose(pose, tool))
    eventually(control.getActualToolFlangePose, arm.forward(list(HOME)), 1e-3)
    assert control.isPoseWithinSafetyLimits(pose)
    assert control.isJointsWithinSafetyLimits(NEAR)
    if controller.firmware >= (5, 10) or not controller.firmware.is_e_series:
        assert control.getInverseKinematicsHasSolution(pose)
        assert not control.getInverseKinematicsHasSolution([5.0, 0, 0, 0, 0, 0])


def test_payload_is_set_and_queries_are_answered(controller: Controller, control: Interface) -> None:
    assert control.setPayload(1.5, [0.0, 0.0, 0.05])
    until(lambda: controller.arm.payload == 1.5)
    assert near(controller.arm.payload_cog, [0, 0, 0.05])
    assert control.isSteady()
    assert control.isProgramRunning()
    assert control.zeroFtSensor()
    # ur_rtde does not wait for these results, so the first call returns the previous contents of the registers.
    eventually(control.getJointTorques, controller.arm.sample.M_target, 1e-6)
    assert control.setGravity([0.0, 0.0, 9.82]) or True
    if controller.firmware.is_e_series:
        eventually(control.getStepTime, 0.002)
        assert near(control.getTargetWaypoint(), controller.arm.sample.pose_target, 1e-6)
        eventually(partial(control.getActualJointPositionsHistory, 0), HOME, 1e-3)
        until(lambda: not control.toolContact([0, 0, 1, 0, 0, 0]))
    if controller.firmware >= (5, 23):
        dynamics = Dynamics(controller.arm.kinematics, payload=1.5, payload_cog=[0, 0, 0.05])
        # ur_rtde reads matrices column by column.
        wanted = controller.arm.kinematics.jacobian(list(HOME), controller.arm.tcp)
        eventually(control.getJacobian, wanted.T.ravel(), 1e-3)
        eventually(control.getMassMatrix, dynamics.mass_matrix(list(HOME)).T.ravel(), 1e-3)
        eventually(control.getCoriolisAndCentrifugalTorques, [0.0] * 6)
        eventually(control.getJacobianTimeDerivative, [0.0] * 36)


def test_external_force_and_target_payload_are_set(controller: Controller, rtde: Rtde, control: Interface) -> None:
    control.triggerProtectiveStop()  # gets no confirmation, because the program waits
    until(lambda: controller.modes.safety_mode.name == "PROTECTIVE_STOP")
    controller.faults.clear()
    controller.call(controller.pendant.play)
    until(control.isProgramRunning)
    assert control.servoC(controller.arm.sample.pose_target, 0.1, 0.5, 0.0)
    # ur_rtde clears a command only when it sends the next one, which can time out after 3 s. So repeat it.
    until(lambda: control.servoStop(2.0))
    is_new = controller.firmware >= (5, 9)
    enable = control.ftRtdeInputEnable if is_new else control.enableExternalFtSensor
    assert enable(True, 0.5, [0.0, 0.0, 0.0], [0.0, 0.0, 0.05])
    # The package of ur_rtde is too short for its recipe, so it has no effect, but the connection continues.
    ignored = controller.counters.ignored_packages
    assert control.setExternalForceTorque([1.0, 2.0, 3.0, 0.0, 0.0, 0.0])
    until(lambda: controller.counters.ignored_packages > ignored)
    until(lambda: near(controller.arm.sample.force, [0.0] * 6))
    if controller.firmware >= (5, 10):
        assert control.setTargetPayload(2.0, [0.0, 0.0, 0.1], [0.01, 0.02, 0.03, 0.0, 0.0, 0.0])
        until(lambda: near(controller.arm.payload_inertia, [0.01, 0.02, 0.03, 0, 0, 0]))
    assert control.isConnected()


def table(controller: Controller, below: float) -> float:
    """Add a plane `below` the tool, in m; return its height."""
    x, y, z = controller.arm.kinematics.forward(controller.arm.setpoint.q, controller.arm.tcp)[:3].tolist()
    controller.world.add(Plane((x, y, z - below)))
    return float(z) - below


def height(controller: Controller) -> float:
    arm = controller.arm
    return float(arm.kinematics.forward(arm.setpoint.q, arm.tcp)[2])


def presses(controller: Controller, force: float, within: float) -> bool:
    return abs(controller.arm.wrench[2] - force) < within


def has_settled(controller: Controller, force: float) -> bool:
    return presses(controller, force, 0.05) and max(map(abs, controller.arm.setpoint.qd)) < 1e-3


def is_above(controller: Controller, wanted: float) -> bool:
    return height(controller) > wanted


def has_gone_on(controller: Controller, cycle: int) -> bool:
    return controller.cycle > cycle


def test_force_mode_holds_its_force(controller: Controller, rtde: Rtde, control: Interface) -> None:
    receive = rtde.make("receive")
    table(controller, 0.003)
    assert control.zeroFtSensor()
    assert control.forceModeSetDamping(0.01)
    if controller.firmware.is_e_series:
        assert control.forceModeSetGainScaling(1.0)
    for force in (10.0, 15.0):
        down = [0.0] * 6, [0, 0, 1, 0, 0, 0], [0.0, 0.0, -force, 0.0, 0.0, 0.0], 2, [0.1] * 6
        assert control.forceMode(*down)
        # The force stays constant once it has settled, and equals the value of the receive interface.
        until(partial(has_settled, controller, force))
        for _ in range(50):
            assert presses(controller, force, 0.5)
            time.sleep(0.005)
        eventually(receive.getActualTCPForce, controller.arm.wrench, 0.8)
    assert control.forceModeStop()
    until(lambda: not controller.arm.is_moving)
    at = controller.arm.setpoint.q
    controller.push([0.0, 0.0, 40.0, 0.0, 0.0, 0.0])
    until(lambda: abs(receive.getActualTCPForce()[2]) > 40.0)
    assert controller.arm.setpoint.q == at
    controller.push([0.0] * 6)


def test_arm_can_be_pushed_in_teach_mode_and_freedrive(controller: Controller, control: Interface) -> None:
    modes = [(control.teachMode, control.endTeachMode)]
    if controller.firmware >= (5, 10):
        assert control.getFreedriveStatus() == 0
        modes.append((control.freedriveMode, control.endFreedriveMode))
    for begin, end in modes:
        at = height(controller)
        assert begin()
        controller.push([0.0, 0.0, 15.0, 0.0, 0.0, 0.0])
        until(partial(is_above, controller, at + 0.01))
        controller.push([0.0] * 6)
        assert end()
        until(lambda: not controller.arm.is_moving)
        at = height(controller)
        controller.push([0.0, 0.0, 15.0, 0.0, 0.0, 0.0])
        until(partial(has_gone_on, controller, controller.cycle + 30))
        controller.push([0.0] * 6)
        assert height(controller) == at


@pytest.mark.parametrize("controller", ["10.12"], indirect=True)
def test_direct_torque_moves_the_joint(controller: Controller, control: Interface) -> None:
    """The script has this call since 5.26, and 10.x counts as later. It never compensates for friction."""
    speed, joint = 0.6, 5
    motors = controller.arm.motors
    # At this speed, the torque equals the friction.
    torque = float(motors.friction_torque([0.0] * joint + [speed])[0][joint])
    for _ in range(20):  # the script repeats the last torque until another command arrives
        assert control.directTorque([0, 0, 0, 0, 0, torque], [0.9] * 6, [0.8] * 6)
    until(lambda: controller.arm.setpoint.qd[joint] == pytest.approx(speed, rel=0.01))
    assert near(controller.arm.setpoint.qd[:joint], [0.0] * joint, 0.05)
    control.stopJ(4.0)
    until(lambda: not controller.arm.is_moving)
    assert controller.arm.setpoint.q[joint] > HOME[joint]
    assert control.moveJ(NEAR, 2.0, 4.0)


def test_contacts_are_detected(controller: Controller, control: Interface) -> None:
    if not controller.firmware.is_e_series:
        pytest.skip("tool_contact exists since 5.4")
    at = table(controller, 0.01)
    assert control.moveUntilContact([0, 0, -0.03, 0, 0, 0], [0, 0, -1, 0, 0, 0], 0.5)
    assert height(controller) == pytest.approx(at, abs=5e-4)
    assert control.startContactDetection([0, 0, -1, 0, 0, 0])
    assert not control.readContactDetection()
    controller.push([0.0, 0.0, 20.0, 0.0, 0.0, 0.0])
    until(control.readContactDetection)
    until(lambda: control.toolContact([0, 0, -1, 0, 0, 0]) > 0)
    # ur_rtde does not wait for the answer, and may return the previous one.
    until(lambda: control.toolContact([0, 0, 1, 0, 0, 0]) == 0)
    assert control.stopContactDetection()
    controller.push([0.0] * 6)


def test_control_interface_can_use_upper_registers(rtde: Rtde) -> None:
    with Controller("UR5e", "5.11", host=HOST, ports=STANDARD, motion=Still()) as controller:
        control = rtde.make("control", -1.0, FLAG_UPLOAD_SCRIPT | FLAG_UPPER_RANGE_REGISTERS)
        assert control.moveJ(NEAR, 2.0, 4.0)
        assert near(controller.arm.setpoint.q, NEAR)
        until(lambda: controller.registers.outputs.integers[24] == 1)
        assert controller.registers.outputs.integers[0] == 0


def test_watchdog_stops_the_program(controller: Controller, control: Interface) -> None:
    assert control.setWatchdog(2.0)
    for _ in range(10):
        assert control.kickWatchdog()
        time.sleep(0.05)
    assert controller.program_name == "rtde_control"
    until(lambda: controller.program_name is None)
    until(lambda: not control.isProgramRunning())
    assert control.reuploadScript()
    until(lambda: controller.program_name == "rtde_control")
    until(control.isProgramRunning)
    assert control.moveJ(NEAR, 2.0, 4.0)


def test_control_works_again_after_a_protective_stop(controller: Controller, rtde: Rtde, control: Interface) -> None:
    receive = rtde.make("receive")
    controller.faults.protective_stop()
    until(receive.isProtectiveStopped)
    controller.faults.clear()
    until(lambda: not receive.isProtectiveStopped())
    controller.call(controller.pendant.stop)
    until(lambda: controller.program_name is None)
    assert control.reuploadScript()
    # reuploadScript() returns before the program has started.
    until(lambda: controller.program_name == "rtde_control")
    until(control.isProgramRunning)
    assert control.moveJ(NEAR, 2.0, 4.0)
    assert near(controller.arm.setpoint.q, NEAR)


@pytest.mark.parametrize("is_stopped", [False, True], ids=["running", "stopped"])
def test_next_client_works_after_a_client_was_killed(
    controller: Controller, rtde: Rtde, control: Interface, is_stopped: bool
) -> None:
    assert control.moveJ(NEAR, 2.0, 4.0)
    rtde.close()
    until(lambda: not controller.rtde.sessions)
    if is_stopped:
        controller.call(controller.pendant.stop)
        until(lambda: controller.program_name is None)
    other = Rtde()
    try:
        control = other.make("control")
        assert control.isProgramRunning()
        assert control.moveJ(list(HOME), 2.0, 4.0)
        assert near(controller.arm.setpoint.q, HOME)
    finally:
        other.close()


def test_control_script_can_be_uploaded_again_or_replaced(
    controller: Controller, control: Interface, tmp_path: Path
) -> None:
    if controller.firmware.is_polyscope_x:
        pytest.skip("the process of ur_rtde crashes in reuploadScript() if there is no dashboard server")
    for is_running in (True, False):
        if not is_running:
            control.stopScript()
            until(lambda: controller.program_name is None)
        assert control.reuploadScript()
        until(lambda: controller.program_name == "rtde_control")
        until(control.isProgramRunning)
        assert control.moveJ(NEAR, 2.0, 4.0)
    own = tmp_path / "own.script"
    # 1 means ready. 255 is the command to end, which ur_rtde sends before it uploads again.
    own.write_text(
        "def own():\n  while read_input_integer_register(0) != 255:\n    write_output_integer_register(0, 1)\n"
        "    sync()\n  end\nend\n"
    )
    control.setCustomScriptFile(str(own))
    assert control.reuploadScript()
    until(lambda: controller.program_name == "own")
    until(control.isProgramRunning)
    control.setCustomScriptFile("")
    assert control.reuploadScript()
    until(lambda: controller.program_name == "rtde_control")


def test_forward_kinematics_with_a_tool_equals_the_library(controller: Controller, control: Interface) -> None:
    """For a zero tool, ur_rtde sends a package of 104 bytes for a recipe of 56 bytes that has no tool."""
    q = [0.3, -1.3, 1.2, -1.4, -1.4, 0.4]
    for tool in ([0.0] * 6, [0.0, 0.0, 0.1, 0.0, 0.0, 0.0]):
        got = control.getForwardKinematics(q, tool)
        assert near(got, controller._state.kinematics.forward(q, tool), 1e-7)


def test_receive_interface_reconnects_after_a_cut(controller: Controller, rtde: Rtde) -> None:
    receive = rtde.make("receive")
    controller.faults.cut()
    until(lambda: not receive.isConnected(), 20)
    assert receive.reconnect()
    assert near(receive.getActualQ(), HOME, 1e-3)
    receive.disconnect()
    until(lambda: not controller.rtde.sessions)


def test_control_interface_reconnects(controller: Controller, rtde: Rtde, control: Interface) -> None:
    if controller.firmware.is_polyscope_x:
        pytest.skip("the process of ur_rtde crashes in reconnect() if there is no dashboard server")
    control.stopScript()
    until(lambda: controller.program_name is None)
    control.disconnect()
    until(lambda: not controller.rtde.sessions)
    # After a cut, ur_rtde reconnects in its own thread. Other calls interfere with it and have crashed the process.
    assert control.reconnect()
    until(lambda: controller.program_name == "rtde_control")
    until(lambda: control.moveJ(NEAR, 2.0, 4.0))
    assert near(controller.arm.setpoint.q, NEAR)
