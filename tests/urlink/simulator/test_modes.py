from __future__ import annotations

import pytest

from urlink.protocol.enums import (
    JointMode,
    MasterOnOffState,
    MasterSafetyState,
    ProgramState,
    RobotMode,
    RobotModeCB2,
    SafetyMode,
    ToolMode,
)
from urlink.protocol.primary.robot_state import MasterboardData, RobotModeData, ToolData
from urlink.protocol.realtime.packets import RealtimeState
from urlink.simulator import Controller, Demonstration

CASES = [
    # Model, firmware, then the robot modes while running, in a protective stop, in an emergency stop, and powered off.
    pytest.param(
        "UR5",
        "1.8",
        [
            RobotModeCB2.RUNNING,
            RobotModeCB2.SECURITY_STOPPED,
            RobotModeCB2.EMERGENCY_STOPPED,
            RobotModeCB2.NO_POWER,
        ],
        id="CB2",
    ),
    pytest.param(
        "UR10", "3.14", [RobotMode.RUNNING, RobotMode.RUNNING, RobotMode.POWER_OFF, RobotMode.POWER_OFF], id="CB3"
    ),
    pytest.param(
        "UR16e", "5.11", [RobotMode.RUNNING, RobotMode.RUNNING, RobotMode.POWER_OFF, RobotMode.POWER_OFF], id="e-Series"
    ),
]


def realtime(controller: Controller) -> RealtimeState:
    state: RealtimeState = RealtimeState.LAYOUTS.decode(controller.realtime_packet())
    return state


def sub_package(controller: Controller, kind: int, cls: type) -> object:
    state = controller.state_package()
    offset = 5
    while state[offset + 4] != kind:
        offset += int.from_bytes(state[offset : offset + 4], "big")
    size = int.from_bytes(state[offset : offset + 4], "big")
    return cls.LAYOUTS.decode(state[offset : offset + size], controller.firmware)  # type: ignore[attr-defined]


def mode_data(controller: Controller) -> RobotModeData:
    found = sub_package(controller, 0, RobotModeData)
    assert isinstance(found, RobotModeData)
    return found


def masterboard(controller: Controller) -> MasterboardData:
    found = sub_package(controller, 3, MasterboardData)
    assert isinstance(found, MasterboardData)
    return found


def second(controller: Controller) -> None:
    controller.step(controller.firmware.rate)


@pytest.mark.parametrize(("name", "firmware", "modes"), CASES)
def test_flags_and_modes_follow_every_event(name: str, firmware: str, modes: list[int]) -> None:
    controller = Controller(name, firmware, motion=Demonstration())
    running, protective, emergency, off = modes
    second(controller)

    def shown() -> tuple[object, ...]:
        now, mode = realtime(controller), mode_data(controller)
        assert now.robot_mode == mode.robot_mode
        return (
            mode.robot_mode,
            mode.is_power_on,
            mode.is_emergency_stopped,
            mode.is_protective_stopped,
            mode.is_program_running,
            mode.is_program_paused,
        )

    assert shown() == (running, True, False, False, True, False)
    controller.faults.protective_stop()
    second(controller)
    assert shown() == (protective, True, False, True, False, True)
    controller.faults.clear()
    second(controller)
    assert shown() == (running, True, False, False, True, False)
    controller.faults.emergency_stop()
    second(controller)
    assert shown() == (emergency, False, True, False, False, False)
    controller.faults.power_on()
    second(controller)
    assert shown() == (emergency, False, True, False, False, False)
    controller.faults.clear()
    second(controller)
    assert shown() == (off, False, False, False, False, False)
    controller.faults.power_on()
    second(controller)
    assert shown() == (running, True, False, False, True, False)
    controller.faults.power_off()
    second(controller)
    assert shown() == (off, False, False, False, False, False)
    assert not any(realtime(controller).qd_target)


def test_power_on_passes_through_all_modes() -> None:
    controller = Controller("UR5e", "5.11", motion=Demonstration())
    controller.faults.power_off()
    second(controller)
    controller.faults.power_on()
    seen: list[tuple[object, ...]] = []
    for _ in range(500):
        controller.step()
        now = realtime(controller)
        assert now.joint_modes is not None
        tool = sub_package(controller, 2, ToolData)
        assert isinstance(tool, ToolData)
        step = (now.robot_mode, now.joint_modes[5], tool.tool_mode, bool(any(now.qd_target)))
        if not seen or seen[-1] != step:
            seen.append(step)
    assert seen == [
        (RobotMode.POWER_ON, JointMode.BOOTING, ToolMode.BOOTING, False),
        (RobotMode.IDLE, JointMode.IDLE, ToolMode.IDLE, False),
        (RobotMode.RUNNING, JointMode.RUNNING, ToolMode.RUNNING, False),
        (RobotMode.RUNNING, JointMode.RUNNING, ToolMode.RUNNING, True),
    ]


def test_arm_keeps_power_until_it_is_at_rest() -> None:
    controller = Controller("UR5e", "5.11", motion=Demonstration())
    second(controller)
    second(controller)
    controller.faults.emergency_stop()
    controller.step()
    now = realtime(controller)
    assert now.safety_mode == SafetyMode.ROBOT_EMERGENCY_STOP
    assert now.safety_status == SafetyMode.ROBOT_EMERGENCY_STOP
    assert now.robot_mode == RobotMode.RUNNING
    assert now.program_state == ProgramState.STOPPING
    assert any(now.qd_target)
    second(controller)
    now = realtime(controller)
    assert now.robot_mode == RobotMode.POWER_OFF
    assert now.joint_modes == (JointMode.POWER_OFF,) * 6
    assert now.program_state == ProgramState.STOPPED


def test_protective_stop_pauses_the_program() -> None:
    controller = Controller("UR3", "3.14", motion=Demonstration())
    second(controller)
    second(controller)
    assert realtime(controller).program_state == ProgramState.PLAYING
    assert realtime(controller).speed_scaling == 1.0
    controller.faults.protective_stop()
    controller.step()
    assert realtime(controller).program_state == ProgramState.PAUSING
    second(controller)
    assert realtime(controller).program_state == ProgramState.PAUSED
    assert realtime(controller).safety_mode == SafetyMode.PROTECTIVE_STOP
    # Captured packets without a program contain 0.0 on 3.10 and later, and 1.0 on 3.3.
    assert realtime(controller).speed_scaling == 0.0
    older = Controller("UR3", "3.3")
    older.faults.protective_stop()
    second(older)
    assert realtime(older).speed_scaling == 1.0


def test_emergency_stop_overrides_a_protective_stop() -> None:
    controller = Controller("UR5e", motion=Demonstration())
    controller.faults.emergency_stop()
    controller.faults.protective_stop()
    second(controller)
    assert realtime(controller).safety_mode == SafetyMode.ROBOT_EMERGENCY_STOP


def test_arm_without_power_ignores_a_protective_stop() -> None:
    controller = Controller("UR5e", motion=Demonstration())
    controller.faults.power_off()
    second(controller)
    controller.faults.protective_stop()
    second(controller)
    assert realtime(controller).safety_mode == SafetyMode.NORMAL


def test_cb2_masterboard_reports_its_states() -> None:
    controller = Controller("UR10", "1.8", motion=Demonstration())
    board = masterboard(controller)
    assert (board.master_safety_state, board.master_on_off_state) == (MasterSafetyState.OK, MasterOnOffState.ON)
    second(controller)
    controller.faults.emergency_stop()
    controller.step()
    board = masterboard(controller)
    assert board.master_safety_state == MasterSafetyState.ROBOT_EMERGENCY_STOP
    assert board.master_on_off_state == MasterOnOffState.TURNING_OFF
    second(controller)
    board = masterboard(controller)
    assert board.master_on_off_state == MasterOnOffState.OFF
    assert board.robot_voltage_48V == 0.0
    assert realtime(controller).joint_modes == (JointMode(240),) * 6
    controller.faults.clear()
    controller.faults.power_on()
    controller.step()
    assert masterboard(controller).master_on_off_state == MasterOnOffState.TURNING_ON
    assert realtime(controller).robot_mode == RobotModeCB2.INITIALIZING
