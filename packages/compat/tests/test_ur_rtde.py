"""Calls of ur_rtde, implemented with urlink. tests/interop compares the motion of the arm with ur_rtde itself."""

from __future__ import annotations

import inspect
import logging
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import urlink
from linkcore.errors import BadValue, LocalError
from tests.waiting import until
from urlink import NotOffered
from urlink.simulator import HOME, Controller, Plane, Still
from urlink_compat.rtde_control import Path as MovePath
from urlink_compat.rtde_control import PathEntry, RTDEControlInterface
from urlink_compat.rtde_io import RTDEIOInterface
from urlink_compat.rtde_receive import RTDEReceiveInterface

pytestmark = pytest.mark.simulated_time

NEAR = [0.1, -1.5, 1.5, -1.5, -1.5, 0.1]


@pytest.fixture
def controller() -> Iterator[Controller]:
    with Controller("UR5e", "5.11", motion=Still()) as controller:
        yield controller


@pytest.fixture
def control(controller: Controller) -> Iterator[RTDEControlInterface]:
    with RTDEControlInterface(controller.address) as control:
        yield control


@pytest.fixture
def receive(controller: Controller) -> Iterator[RTDEReceiveInterface]:
    with RTDEReceiveInterface(controller.address, 125.0) as receive:
        yield receive


def near(values: object, wanted: object, within: float = 1e-6) -> bool:
    return bool(np.allclose(values, wanted, rtol=0, atol=within))  # type: ignore[arg-type]


def test_getters_return_plain_values(controller: Controller, receive: RTDEReceiveInterface) -> None:
    skipped = {"getDigitalInState", "getDigitalOutState", "getOutputIntRegister", "getOutputDoubleRegister"}
    for name, get in inspect.getmembers(receive, inspect.ismethod):
        if name.startswith(("get", "isP", "isE")) and name not in skipped:
            value = get()
            assert isinstance(value, (bool, int, float, list)), name
            assert type(value) is not list or all(type(each) in (int, float) for each in value), name
    controller.registers.outputs.integers[12] = -3
    controller.registers.outputs.floats[36] = 0.25
    controller.signals.set_digital_input(9, True)
    until(lambda: receive.getOutputIntRegister(12) == -3 and receive.getOutputDoubleRegister(36) == 0.25)
    until(lambda: receive.getDigitalInState(9))
    assert near(receive.getActualQ(), controller.arm.setpoint.q, 1e-3)


def test_error_names_variable_that_is_not_received(controller: Controller) -> None:
    with RTDEReceiveInterface(controller.address, variables=["timestamp", "actual_q"]) as receive:
        assert len(receive.getActualQ()) == 6
        with pytest.raises(LocalError, match="actual_qd is not received"):
            receive.getActualQd()
    with pytest.raises(urlink.NoSuchVariable, match="did you mean actual_q"):
        RTDEReceiveInterface(controller.address, variables=["actual_Q"])


def test_file_recording_writes_csv(receive: RTDEReceiveInterface, tmp_path: Path) -> None:
    assert not receive.stopFileRecording()
    assert receive.startFileRecording(str(tmp_path / "run.csv"), ["timestamp", "actual_q", "joint_mode"])
    with pytest.raises(LocalError, match="in progress"):
        receive.startFileRecording(str(tmp_path / "other.csv"))
    began = receive.getTimestamp()
    until(lambda: receive.getTimestamp() > began + 0.1)
    assert receive.stopFileRecording()
    head, *rows = (tmp_path / "run.csv").read_text().splitlines()
    columns = ["timestamp", *(f"actual_q_{i}" for i in range(6)), *(f"joint_mode_{i}" for i in range(6))]
    assert head.split(",") == columns
    times = [float(row.split(",")[0]) for row in rows]
    assert len(times) > 5
    assert near(np.diff(times), 0.008)
    with pytest.raises(BadValue, match="cannot write"):
        receive.startFileRecording(str(tmp_path / "none" / "run.csv"))


def test_io_sets_outputs_and_registers(controller: Controller, caplog: pytest.LogCaptureFixture) -> None:
    with RTDEIOInterface(controller.address) as io, urlink.connect(controller.address) as other:
        assert io.setStandardDigitalOut(3, True)
        assert io.setToolDigitalOut(1, True)
        assert io.setAnalogOutputVoltage(1, 0.5)
        assert io.setAnalogOutputCurrent(0, 0.25)
        assert io.setInputIntRegister(18, 5)
        assert io.setInputDoubleRegister(46, 0.25)
        until(lambda: controller.signals.digital_outputs == 1 << 3 | 1 << 17)
        until(lambda: near(controller.signals.analog_outputs, [0.008, 5.0]))
        until(lambda: controller.registers.inputs.floats[46] == 0.25)
        with other.rtde.inputs("speed_slider_fraction", "input_int_register_24", "configurable_digital_output"):
            assert io.setSpeedSlider(0.5)  # set by a script
            assert io.setConfigurableDigitalOut(0, True)
            with caplog.at_level(logging.WARNING):
                assert not io.setInputIntRegister(24, 1)
            assert "another client or a fieldbus holds input_int_register_24" in caplog.text
        until(lambda: controller.speed_fraction == 0.5 and bool(controller.signals.digital_outputs >> 8 & 1))
        assert io.setStandardDigitalOut(3, False)
        other.set_speed_slider(1.0)
        with pytest.raises(BadValue):
            io.setStandardDigitalOut(8, True)


def test_moves_and_paths_reach_goals(controller: Controller, control: RTDEControlInterface) -> None:
    assert control.moveJ(NEAR, 2.0, 6.0)
    assert near(controller.arm.setpoint.q, NEAR)
    there = controller.arm.sample.pose_target
    assert control.moveL([there[0], there[1] + 0.02, *there[2:]], 0.5, 2.0)
    assert near(controller.arm.sample.pose_target[1], there[1] + 0.02)
    path = MovePath()
    path.addEntry(PathEntry(PathEntry.MoveJ, PathEntry.PositionJoints, [*NEAR, 2.0, 6.0, 0.0]))
    path.appendMovelPath([[*there, 0.5, 2.0, 0.0]])
    assert (path.size(), control.movePath(path)) == (2, True)
    assert control.moveJ([[*HOME, 2.0, 6.0, 0.0]], True)
    status = control.getAsyncOperationProgressEx()
    assert status.isAsyncOperationRunning()
    until(lambda: controller.arm.is_moving)
    control.stopL(4.0)
    assert not controller.arm.is_moving
    assert not control.getAsyncOperationProgressEx().isAsyncOperationRunning()
    assert control.getAsyncOperationProgress() in (-1, -2)
    with pytest.raises(NotOffered, match="MoveC"):
        PathEntry(PathEntry.MoveC, PathEntry.PositionTcpPose, [*there, 0.5, 2.0, 0.0])
    with pytest.raises(BadValue, match="speed"):
        control.moveJ(NEAR, 20.0)


@pytest.mark.slow
def test_servo_and_speed_calls_move_arm(controller: Controller, control: RTDEControlInterface) -> None:
    assert control.moveJ(NEAR, 2.0, 6.0)
    q = list(NEAR)
    for _ in range(20):
        begun = control.initPeriod()
        q[5] += 0.0004
        assert control.servoJ(q, 0.5, 0.5, 0.002, 0.05, 300)
        control.waitPeriod(begun)
    until(lambda: control.kickWatchdog() and near(controller.arm.setpoint.q, q, 1e-3))
    time.sleep(0.6)  # longer than the watchdog of the robot: the next set-point starts the servo again
    pose = control.getForwardKinematics(controller.arm.setpoint.q)
    assert control.servoL(pose, 0.5, 0.5, 0.002, 0.1, 300)
    assert control.speedJ([0, 0, 0, 0, 0, 0.2], 4.0)
    until(lambda: near(controller.arm.setpoint.qd[5], 0.2))
    time.sleep(0.6)  # the motion continues
    assert near(controller.arm.setpoint.qd[5], 0.2)
    assert control.speedL([0, 0, 0.03, 0, 0, 0], 1.0)
    until(lambda: near(controller.arm.sample.speed_target[:3], [0, 0, 0.03], 1e-3))
    assert control.jogStart([0, 0, 0.02, 0, 0, 0], RTDEControlInterface.FEATURE_TOOL, 1.0)
    until(lambda: near(np.linalg.norm(controller.arm.sample.speed_target[:3]), 0.02, 1e-3))
    assert control.jogStop()
    assert not controller.arm.is_moving


@pytest.mark.slow
def test_contact_force_mode_and_freedrive_calls_work(controller: Controller, control: RTDEControlInterface) -> None:
    assert control.moveJ(HOME, 2.0, 6.0)
    x, y, z = controller.arm.sample.pose_target[:3]
    controller.world.add(Plane((x, y, z - 0.005)))
    down = [0.0, 0.0, -0.1, 0.0, 0.0, 0.0]
    assert control.moveUntilContact(down)
    assert near(controller.arm.sample.pose_target[2], z - 0.005, 2e-3)
    assert control.forceModeSetDamping(0.005)
    for newtons in (10.0, 15.0):
        assert control.forceMode([0.0] * 6, [0, 0, 1, 0, 0, 0], [0, 0, -newtons, 0, 0, 0], 2, [0.1] * 6)
        until(lambda newtons=newtons: near(controller.arm.wrench[2], newtons, 0.5))  # type: ignore[misc]
    assert control.forceModeStop()
    controller.world.clear()
    assert control.freedriveMode()
    at = controller.arm.setpoint.q
    controller.push([0, 0, 10.0, 0, 0, 0])
    until(lambda: not near(controller.arm.setpoint.q, at, 1e-3))
    controller.push([0.0] * 6)
    assert control.endFreedriveMode()
    assert control.moveJ(HOME, 2.0, 6.0)


def test_arrays_are_accepted_like_lists(controller: Controller, control: RTDEControlInterface, tmp_path: Path) -> None:
    """Arrays are also accepted for optional arguments, whose default is an empty list.

    An array has no truth value.
    """
    # Any, as in users' programs, because the calls are declared with sequences.
    zeros: Any = np.zeros(6)
    joints: Any = np.array(NEAR)
    tool: Any = np.array([0.0, 0.01, 0.15, 0.1, 0.0, 0.2])
    cog: Any = np.array([0.0, 0.0, 0.05])
    assert near(control.getForwardKinematics(zeros, tool), controller.arm.kinematics.forward(zeros, tool))
    pose: Any = np.array(control.getForwardKinematics(joints, zeros))
    assert near(pose, controller.arm.kinematics.forward(NEAR))
    assert near(control.getInverseKinematics(pose, joints), NEAR)
    assert control.getInverseKinematicsHasSolution(pose, joints)
    assert control.setPayload(1.0, cog)
    assert (controller.arm.payload, list(controller.arm.payload_cog)) == (1.0, cog.tolist())
    assert control.setTargetPayload(1.5, 2.0 * cog, zeros)
    assert (controller.arm.payload, list(controller.arm.payload_cog)) == (1.5, (2.0 * cog).tolist())
    names: Any = np.array(["timestamp", "actual_q"])
    with RTDEReceiveInterface(controller.address, variables=names) as receive:
        assert receive.startFileRecording(str(tmp_path / "q.csv"), names[1:])
    assert (tmp_path / "q.csv").read_text(encoding="utf-8").startswith("actual_q_0,")


def test_kinematics_tool_and_status_calls_return_values(controller: Controller, control: RTDEControlInterface) -> None:
    tool = [0.0, 0.01, 0.15, 0.1, 0.0, 0.2]
    assert control.setTcp(tool)
    assert near(control.getTCPOffset(), tool, 1e-9)
    pose = control.getForwardKinematics(NEAR)
    assert near(pose, controller.arm.kinematics.forward(NEAR, tool), 1e-9)
    assert near(control.getInverseKinematics(pose, NEAR), NEAR, 1e-9)
    assert not control.getInverseKinematicsHasSolution([5.0, 0, 0, 0, 0, 0])
    assert control.isPoseWithinSafetyLimits(pose)
    assert control.isSteady()
    assert len(control.getJointTorques()) == 6
    assert control.getStepTime() == 0.002
    assert control.setPayload(1.0, [0.0, 0.0, 0.05])
    assert controller.arm.payload == 1.0
    assert control.sendCustomScriptFunction("half", "set_standard_digital_out(5, True)\nsleep(0.01)")
    assert controller.signals.digital_outputs >> 5 & 1
    assert control.setTcp([0] * 6)


@pytest.mark.slow
def test_ur_rtde_calls_work_after_a_stop_and_a_reconnection(
    controller: Controller, control: RTDEControlInterface, caplog: pytest.LogCaptureFixture
) -> None:
    assert control.isProgramRunning()
    controller.faults.protective_stop()
    until(lambda: not control.isProgramRunning())
    with caplog.at_level(logging.WARNING):
        assert not control.moveJ(NEAR)
    assert "protective stop" in caplog.text
    controller.faults.clear()
    assert control.reuploadScript()
    assert control.moveJ(NEAR, 2.0, 6.0)
    controller.faults.cut()
    assert control.reconnect()
    assert control.isConnected()
    assert control.moveJ(HOME, 2.0, 6.0)


def test_reupload_script_allows_immediate_move(controller: Controller, control: RTDEControlInterface) -> None:
    for _ in range(3):
        assert control.reuploadScript()
        assert control.moveJ(NEAR, 2.0, 6.0)
        assert control.moveJ(HOME, 0.1, 6.0, True)
        until(lambda: controller.arm.is_moving)
    controller.call(controller.pendant.stop)
    assert control.reuploadScript()
    assert control.moveJ(NEAR, 2.0, 6.0)


def test_unsupported_calls_raise_not_offered(controller: Controller) -> None:
    with pytest.raises(NotOffered, match=r"servoC is not offered; use robot.motion.move_circular"):
        RTDEControlInterface.servoC([0.0] * 6)
    with pytest.raises(NotOffered, match="FLAG_CUSTOM_SCRIPT"):
        RTDEControlInterface(controller.address, -1.0, RTDEControlInterface.FLAG_CUSTOM_SCRIPT)
