"""Tests of the public names of urlink. A change of these names affects users, and must be in the changelog."""

from __future__ import annotations

import asyncio
import inspect
from collections import Counter

import pytest

import urlink
from tests.listed import assert_listed

NAMES = [
    "AsyncRobot",
    "Backoff",
    "BadAddress",
    "BadRecording",
    "BadValue",
    "BadVersion",
    "Cancelled",
    "Circular",
    "Closed",
    "CompileError",
    "ConnectFailed",
    "ConnectionEvent",
    "ConnectionLost",
    "ConnectionState",
    "Dashboard",
    "DashboardRefused",
    "Expiry",
    "Feed",
    "Firmware",
    "Gripper",
    "GripperFault",
    "Group",
    "Handle",
    "History",
    "IO",
    "InputInUse",
    "Interpreter",
    "Joint",
    "LimitExceeded",
    "Linear",
    "LinkError",
    "LinkTimeout",
    "LocalError",
    "Motion",
    "NoContact",
    "NoSuchPoint",
    "NoSuchVariable",
    "NotConfirmed",
    "NotEnabled",
    "NotOffered",
    "NotRunning",
    "PacketError",
    "PendingCall",
    "Phase",
    "Point",
    "Policy",
    "Program",
    "ProgramStopped",
    "RGGripper",
    "RealtimeReport",
    "RealtimeState",
    "Recorder",
    "Recording",
    "RecordingWriter",
    "RemoteError",
    "Robot",
    "RobotModeData",
    "RtdeRefused",
    "Safety",
    "SafetyStop",
    "ScriptError",
    "ScriptFailed",
    "Scripts",
    "SessionLimits",
    "Simulation",
    "StatementDiscarded",
    "StopCause",
    "StopCurves",
    "StopExplanation",
    "Stream",
    "Subscription",
    "Table",
    "Taught",
    "ToleranceExceeded",
    "Trajectory",
    "TrajectoryPoint",
    "UnknownModel",
    "Unreachable",
    "VacuumGripper",
    "WrongPeer",
    "block",
    "connect",
    "connect_async",
    "decode",
    "drop_oldest",
    "latest",
    "load",
    "realtime_options",
    "schema",
    "simulated_time",
]


#: This file, for messages.
HERE = "tests/urlink/test_public_names.py"
#: Modules that users import names from.
MODULES = ["dynamics", "kinematics", "models", "motion", "packets", "poses", "rtde", "urdf"]


#: Packets that first scripts subscribe to, which are in both `urlink` and `urlink.packets`.
FIRST = ("RealtimeState", "RobotModeData")


def test_dir_lists_the_public_names() -> None:
    assert_listed(vars(urlink)["__all__"], NAMES, f"NAMES in {HERE}")
    assert_listed(dir(urlink), [*NAMES, *MODULES], f"NAMES or MODULES in {HERE}")
    assert dir(urlink) == sorted(dir(urlink))
    assert sorted(NAMES) == NAMES
    assert len(set(NAMES)) == len(NAMES)


def test_public_names_are_in_one_module_only() -> None:
    places = [urlink, urlink.packets, urlink.motion, urlink.rtde]
    names = Counter(name for place in places for name in vars(place)["__all__"])
    twice = [name for name, count in names.items() if count > 1]
    assert_listed(twice, FIRST, f"FIRST in {HERE}, which has the names in two __all__ of src/urlink/,")
    for name in FIRST:
        assert getattr(urlink, name) is getattr(urlink.packets, name)


def test_public_names_have_docstrings() -> None:
    for name in NAMES:
        value = getattr(urlink, name)
        if inspect.isclass(value) or inspect.isfunction(value):
            assert inspect.getdoc(value), f"{name} has no docstring"


def public(held: object) -> list[str]:
    return [name for name in dir(held) if not name.startswith("_")]


HANDLE = "add_done_callback cancel done error name phase wait"
#: Attributes and methods of the objects that users hold, as tab completion shows them.
SURFACES = {
    "robot": """address clock close controller dashboard firmware freedrive gripper identity interpreter io kinematics
        limits measure_payload measure_payload_by_hand model motion points popup primary realtime record registers rtde
        safety script secondary set_gravity set_payload set_speed_slider set_tcp teach tool_serial view wrench
        zero_force_sensor""",
    "robot.tool_serial": "ask close discard read write",
    "robot.gripper": """activate close deactivate get move object_detected open position position_of set status stop
        wait""",
    "robot.interpreter()": f"{HANDLE} abort clear end execute skip state texts wait_executed",
    "robot.clock": "bound drift offset restarts to_controller to_local",
    "robot.identity": "arm description dh_table firmware kinematics model said_so",
    "robot.motion": """current follow force_mode impedance jog move_circular move_joints move_linear path servo
        speed_joints speed_linear stop stream torque until_contact""",
    "robot.motion.force_mode('base', [1] * 6, [0] * 6, [1] * 6)": f"{HANDLE} progress set_wrench wrench",
    "robot.motion.until_contact([0, 0, 1])": f"{HANDLE} contact progress",
    "robot.motion.stop()": f"{HANDLE} progress",
    "robot.motion.path([urlink.Joint([0, -1.5, 1.5, -1.5, -1.5, 0])])": f"{HANDLE} progress segment segments",
    "robot.motion.jog()": f"{HANDLE} frame limit move progress stop timeout",
    "robot.motion.stream()": f"""{HANDLE} append buffer buffered clear end is_dry progress replace room starved time
        wait_until_dry""",
    "robot.teach()": "freedrive record taught",
    "robot.teach().taught": "add load model play points remove_last save waypoints",
    "robot.freedrive()": f"{HANDLE} progress",
    "robot.motion.servo()": f"{HANDLE} measure_delay progress rate scaling schedule send stats",
    "robot.script": "run send_line",
    "robot.script.run('sync()')": f"{HANDLE} texts",
    "robot.io": """analog_in analog_out configurable_digital_in configurable_digital_out digital_in digital_out
        set_analog_out set_configurable_digital_out set_digital_out set_flag set_tool_communication
        set_tool_digital_out set_tool_voltage tool_analog_in tool_digital_in tool_digital_out tool_voltage
        wait_configurable_digital_in wait_digital_in wait_tool_digital_in""",
    "robot.safety": """cause enable explain is_enabled mode on_stop policy refusal robot_mode wait_enabled wait_for_stop
        wait_until_clear""",
    "robot.dashboard": """add_to_log brake_release clear_operational_mode close close_popup close_safety_popup
        download_program generate_flight_report generate_support_file is_in_remote_control is_program_saved load
        load_installation loaded_program operational_mode pause play polyscope_version popup power_off power_on
        program_state programs quit restart_safety robot_mode robot_model running safety_mode safety_status
        save_log send serial_number set_operational_mode set_user_role shutdown start stop
        unlock_protective_stop upload_program user_role version""",
    "robot.rtde": "close inputs is_recorded missing outputs registers who_holds",
    "robot.registers": "read_bit read_float read_integer write_bit write_float write_integer",
    "urlink.Trajectory.from_arrays([0, 1], [[0] * 6] * 2)": """at check duration from_arrays from_csv from_poses
        has_velocities is_quintic plot points q qd qdd retimed sample time to_csv""",
    "robot.controller": """address arm call close counters cycle dashboard faults fieldbus firmware flags
        follow greeting gripper has_local_control host is_running_program is_serving is_up modbus model modes
        passing pendant ports program_name push realtime_packet received registers remote_control rg_gripper
        robot_api rtde schedule serial signals speed_fraction start state_package step stopped_since take take_messages
        teach_button time tool_serial vacuum_gripper world""",
    "robot.controller.world": """add carry clear contacts force_limit is_empty joint_torques load push push_joints
        remove scene wrench""",
    "robot.controller.gripper": """exchange fault holds_object is_active is_connected place position registers reply
        take_away""",
    "robot.controller.tool_serial": """device exchange greeting is_offered last_ahead last_steady later_packets
        next_cycle packets receiver send_ahead skip steady_packet""",
    "robot.controller.faults": """append clear cut drag emergency_stop garbage heal merge power_off power_on
        protective_stop reboot rtde_data_before_start rtde_hello rtde_late_data rtde_no_data rtde_reboot_at_request
        rtde_refuse_protocol_2 rtde_refuse_start rtde_stale_inputs rtde_text rtde_text_before_reply
        rtde_text_instead_of_reply safeguard_stop split stall unknown_package unknown_sub_package""",
}


#: Attributes and methods of an asyncio robot and its parts.
ASYNC_SURFACES = {
    "robot": """address call clock close controller dashboard firmware freedrive gripper identify identity interpreter
        io kinematics limits measure_payload measure_payload_by_hand model motion points popup primary realtime record
        registers rtde safety script secondary set_gravity set_payload set_speed_slider set_tcp teach tool_serial view
        wrench zero_force_sensor""",
    "robot.realtime": """close connection description failure history iterate join latest name of plot start
        stats stream subscribe wait wait_until""",
    "robot.realtime.of(urlink.packets.RealtimeState)": "history iterate latest plot subscribe wait wait_until",
    "robot.realtime.iterate()": "aclose next open stats",
    "robot.motion": """current follow force_mode impedance jog move_circular move_joints move_linear path servo
        speed_joints speed_linear stop stream torque until_contact""",
}


@pytest.mark.simulated_time
def test_async_robot_has_the_listed_attributes() -> None:
    async def look() -> None:
        async with urlink.connect_async("sim://ur5e?firmware=5.11") as robot:
            for path in ASYNC_SURFACES:
                held = eval(path, {"robot": robot, "urlink": urlink})
                assert_listed(public(held), ASYNC_SURFACES[path].split(), f"ASYNC_SURFACES[{path!r}] in {HERE}")

    asyncio.run(look())


@pytest.mark.simulated_time
def test_robot_objects_have_the_listed_attributes() -> None:
    with urlink.connect("sim://ur5e?firmware=5.11") as robot:
        for path in SURFACES:
            held = eval(path, {"robot": robot, "urlink": urlink})
            assert_listed(public(held), SURFACES[path].split(), f"SURFACES[{path!r}] in {HERE}")


#: Defaults of arguments. A change affects users, for example the speed of an arm or the time of a wait.
DEFAULTS = {
    "robot.close": "timeout=2.0",
    "robot.freedrive": "axes=None, frame='base', watchdog=0.5, link='reverse'",
    "robot.interpreter": "start_timeout=10.0, finish_timeout=60.0, on_text=None",
    "robot.measure_payload": (
        "may_move=False, box=None, postures=8, speed=0.3, acceleration=0.5, rest=1.0, set_payload=None, "
        "gravity=(0.0, 0.0, 9.82), timeout=300.0, on_posture=None"
    ),
    "robot.measure_payload_by_hand": (
        "postures=8, rest=1.0, posture_timeout=60.0, set_payload=None, gravity=(0.0, 0.0, 9.82), timeout=600.0, "
        "on_posture=None, watchdog=0.5, link='reverse'"
    ),
    "robot.popup": "title='Popup', warning=False, error=False",
    "robot.record": "interfaces=('realtime', 'primary')",
    "robot.set_payload": "cog=None, inertia=None, transition_time=0.0, confirm=1.0",
    "robot.set_speed_slider": "confirm=1.0",
    "robot.set_tcp": "confirm=1.0",
    "robot.teach": (
        "digital_input=None, bank='standard', button=False, on_point=None, axes=None, frame='base', watchdog=0.5, "
        "link='reverse'"
    ),
    "robot.wrench": "frame='tcp'",
    "robot.view": "plots=('qd_actual', 'tcp_force'), urdf=None, jog=False, port=0",
    "robot.motion.follow": (
        "low_bandwidth=False, path_tolerance=None, goal_tolerance=0.01, goal_time=1.0, start_tolerance=0.05, "
        "feedback=None, delay=None, watchdog=0.1, lookahead_time=0.03, gain=300.0, scaling='follow', "
        "link='reverse', wait=False"
    ),
    "robot.motion.force_mode": "kind=2, damping=None, gain=None, watchdog=0.5, link='reverse'",
    "robot.motion.impedance": (
        "frame='joints', stiffness=None, damping=1.0, torque=None, speed=None, error=None, force=None, "
        "posture_stiffness=None, friction_compensation=True, watchdog=0.5, link='reverse'"
    ),
    "robot.motion.jog": "frame='joints', acceleration=1.2, timeout=0.3, watchdog=0.2, link='reverse'",
    "robot.motion.move_circular": "speed=0.25, acceleration=1.2, wait=False",
    "robot.motion.move_joints": "speed=1.05, acceleration=1.4, time=None, keep=None, wait=False",
    "robot.motion.move_linear": "speed=0.25, acceleration=1.2, time=None, keep=None, wait=False",
    "robot.motion.path": "speed=0.25, acceleration=1.2, joint_speed=1.05, joint_acceleration=1.4, wait=False",
    "robot.motion.stream": (
        "buffer=0.5, acceleration=10.0, jerk=100.0, watchdog=1.0, lookahead_time=0.03, gain=300.0, link='reverse'"
    ),
    "robot.motion.servo": (
        "rate=None, target_filter=None, speed=1.05, acceleration=3.0, jerk=30.0, delay=None, watchdog=0.1, "
        "lookahead_time=0.03, gain=300.0, link='reverse'"
    ),
    "robot.motion.speed_joints": "acceleration=1.4, duration=0.5, link='reverse', wait=False",
    "robot.motion.speed_linear": "acceleration=1.2, duration=0.5, link='reverse', wait=False",
    "robot.motion.stop": "acceleration=2.0, wait=False",
    "robot.motion.torque": "limits=None, friction_compensation=True, watchdog=0.05, link='reverse'",
    "robot.motion.until_contact": ("speed=0.02, acceleration=0.5, distance=0.3, force=None, retract=True, wait=False"),
    "robot.io.set_analog_out": "confirm=1.0",
    "robot.io.set_configurable_digital_out": "confirm=1.0",
    "robot.io.set_digital_out": "confirm=1.0",
    "robot.io.set_tool_communication": (
        "enabled=True, baud_rate=115200, parity='none', stop_bits=1, rx_idle_chars=1.5, tx_idle_chars=3.5, confirm=1.0"
    ),
    "robot.io.set_tool_digital_out": "confirm=1.0",
    "robot.io.set_tool_voltage": "confirm=1.0",
    "robot.io.wait_configurable_digital_in": "on=True, timeout=5.0",
    "robot.io.wait_digital_in": "on=True, timeout=5.0",
    "robot.io.wait_tool_digital_in": "on=True, timeout=5.0",
    "robot.script.run": "wait=False, detached=False, on_text=None",
    "robot.safety.explain": "timeout=1.0",
    "robot.safety.wait_enabled": "timeout=60.0",
    "robot.safety.wait_until_clear": "timeout=60.0",
}
FACADES = ("robot", "robot.motion", "robot.io", "robot.script", "robot.safety")


@pytest.mark.simulated_time
def test_default_arguments_equal_the_list() -> None:
    found = {}
    with urlink.connect("sim://ur5e?firmware=5.11") as robot:
        for path in FACADES:
            held = eval(path, {"robot": robot})
            for name, method in inspect.getmembers(type(held), inspect.isfunction):
                parameters = inspect.signature(method).parameters.values()
                given = [f"{each.name}={each.default!r}" for each in parameters if each.default is not each.empty]
                if given and not name.startswith("_"):
                    found[f"{path}.{name}"] = ", ".join(given)
    assert_listed(found, DEFAULTS, f"DEFAULTS in {HERE}")
    for path, defaults in found.items():
        assert defaults == DEFAULTS[path], f"{path}: edit DEFAULTS in {HERE} if the change is intended"
