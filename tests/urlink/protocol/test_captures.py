"""Every captured packet is decoded to its known values.

The values are copied from the manifest of the captures, or from the notes next to them. None of them comes from the
decoder under test.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import urlink
from linkcore.errors import PacketError
from linkcore.wire.packet import State
from urlink import decode
from urlink.packets import (
    KeyMessage,
    OtherPackage,
    PackageType,
    ProgramStateMessage,
    RealtimeState,
    RobotModeData,
    RobotState,
    RuntimeExceptionMessage,
    SafetyComplianceTolerances,
    SafetyModeMessage,
    UnnamedMessage12,
    VersionMessage,
)
from urlink.protocol.firmware import Firmware, infer
from urlink.protocol.ports import Interface
from urlink.protocol.primary.protocol import PrimaryProtocol
from urlink.protocol.realtime.protocol import RealtimeProtocol

pytestmark = pytest.mark.captures("ur")

NO_TIME = 0xFFFFFFFFFFFFFFFF
PI = math.pi

VERSION_5_4 = (
    VersionMessage,
    {"project_name": "URControl", "major": 5, "minor": 4, "bugfix": 0, "build": 2, "build_date": "21-06-2019, 10:03:02"}
    | {"timestamp": NO_TIME, "source": -2},
)
VERSION_3_3 = (
    VersionMessage,
    {"major": 3, "minor": 3, "bugfix": 1, "build": 60, "svn_revision": None, "build_date": "Jul 08 2016, 16:07:20"},
)
VERSION_5_11 = (
    VersionMessage,
    {"major": 5, "minor": 11, "bugfix": 11, "build": 0, "build_date": "11-04-2022, 07:48:21"},
)


def message_12(first: int, second: int) -> tuple[type[State], dict[str, Any]]:
    return UnnamedMessage12, {"first": first, "second": second, "third": 1, "timestamp": NO_TIME, "source": -2}


SAFETY_TOLERANCES = [0.15, 25, 0, 3, *[0.2] * 6, *[math.radians(3)] * 6, 0, 0, 0, math.radians(1), 0.001, 0.01]

# For each file: its interface, and its states with their known values. "a.b" is field b of sub-package a.
COMPLETE: dict[str, tuple[Interface, list[tuple[type[State], dict[str, Any]]]]] = {
    "cb2_rt_812.bin": (
        "realtime",
        [
            (
                RealtimeState,
                {
                    "time": 951.592,
                    "robot_mode": 0,
                    "joint_modes": (253,) * 6,
                    "digital_input_bits": 0,
                    "q_target": [1.2881, -1.5104, 0.99994, -0.94209, -1.5783, 0.92601],
                    "q_actual": [1.2881, -1.5104, 0.99992, -0.94207, -1.5783, 0.92599],
                    "qd_actual": [0] * 6,
                    "I_actual": [0.1502, -1.7217, -1.5872, 0.096078, 0.0091502, 0.0091502],
                    "tool_accelerometer": [-0.13785, -2.805, 8.3852],
                    "unused": [0] * 15,
                    "tcp_force": [-3.539, 1.9277, -18.176, 9.6337, -6.36, -3.1089],
                    "tool_vector_actual": [0.2995, 0.22674, 0.40698, 0.10349, -0.046248, 0.075082],
                    "tcp_speed_actual": [0] * 6,
                    "motor_temperatures": [24.2, 24.9, 24.9, 28, 28, 29],
                    "controller_timer": 0.063487,
                    "test_value": 8,
                    "digital_coding": None,
                    "I_control": None,
                    "safety_mode": None,
                },
            )
        ],
    ),
    "cb2_primary_state_1254.bin": (
        "primary",
        [
            (
                RobotState,
                {
                    "sizes": {0: 29, 1: 251, 4: 53, 5: 225, 9: 53, 3: 64, 2: 37, 6: 469, 7: 61, 8: 7},
                    "robot_mode_data.timestamp": 461632,
                    "robot_mode_data.robot_mode": 0,
                    "joint_data.joint_modes": (253,) * 6,
                    "kinematics_info.dh_a": [0, -0.425, -0.39225, 0, 0, 0],
                    "kinematics_info.dh_d": [0.089159, 0, 0, 0.10915, 0.09465, 0.0823],
                    "kinematics_info.dh_alpha": [PI / 2, 0, 0, PI / 2, -PI / 2, 0],
                    "configuration_data.masterboard_version": 5,
                    "configuration_data.controller_box_type": 2,
                    "configuration_data.robot_type": 1,
                    "configuration_data.robot_sub_type": 1,
                    "configuration_data.motor_type": [2] * 6,
                    "configuration_data.reserved": None,
                    "configuration_data.dh_a": [0, -0.425, -0.39225, 0, 0, 0],
                    "configuration_data.dh_d": [0.089159, 0, 0, 0.10915, 0.09465, 0.0823],
                    "masterboard_data.robot_voltage_48V": 48.3,
                    "masterboard_data.master_safety_state": 8,
                    "masterboard_data.master_on_off_state": 2,
                    "masterboard_data.is_euromap_installed": False,
                    "tool_data.tool_voltage_48V": 45.3,
                    "additional_info.freedrive_button_pressed": False,
                    "additional_info.freedrive_button_enabled": True,
                    "safety_data": None,
                    "laser_pointer": None,
                },
            )
        ],
    ),
    "cb2_old_state_465.bin": (
        "secondary",
        [
            (
                RobotState,
                {
                    "sizes": {0: 29, 1: 251, 4: 53, 5: 29, 3: 61, 2: 37},
                    "robot_mode_data.robot_mode": 0,
                    "laser_pointer.pointer": [1000, 1000, 1000],
                    "kinematics_info": None,
                    "masterboard_data.is_euromap_installed": None,
                    "masterboard_data.master_safety_state": None,
                    "force_mode_data": None,
                    "additional_info": None,
                },
            )
        ],
    ),
    "eseries_secondary_state_716.bin": (
        "secondary",
        [
            (
                RobotState,
                {
                    "sizes": {0: 47, 1: 251, 4: 101, 9: 53, 3: 75, 2: 37, 7: 61, 8: 9, 10: 43, 11: 26, 12: 8},
                    "robot_mode_data.is_robot_connected": True,
                    "robot_mode_data.is_program_running": False,
                    "robot_mode_data.robot_mode": 7,
                    "robot_mode_data.control_mode": 0,
                    "robot_mode_data.speed_scaling": 0.0,
                    "joint_data.q_actual[0]": 0.12321250481647548,
                    "joint_data.q_actual[1]": -1.5601252688133753,
                    "joint_data.q_actual[5]": 0.34937358852940126,
                    "joint_data.T_micro": [0] * 6,
                    "cartesian_info.X": 0.31732700100421085,
                    "cartesian_info.Y": -0.09411600004958906,
                    "cartesian_info.Rx": -1.915016,
                    "masterboard_data.digital_input_bits": 0,
                    "masterboard_data.digital_output_bits": 0,
                    "masterboard_data.robot_voltage_48V": 48,
                    "additional_info.freedrive_button_enabled": True,
                    "additional_info.reserved": 1,
                    "safety_data.elbow_sphere_radius": 0.1,
                    "tool_mode_info.digital_output_0_mode": 1,
                    "kinematics_info": None,
                    "configuration_data": None,
                },
            )
        ],
    ),
    "ursim_5.8_primary_state_1386.bin": (
        "primary",
        [
            (
                RobotState,
                {
                    "sizes": {
                        0: 47,
                        1: 251,
                        4: 101,
                        5: 225,
                        9: 53,
                        3: 75,
                        2: 37,
                        6: 445,
                        7: 61,
                        8: 9,
                        10: 43,
                        11: 26,
                        12: 8,
                    },
                    "joint_data.q_actual": [-1.6007, -1.7271, -2.203, -0.808, 1.5951, -0.031],
                    "kinematics_info.checksum": [0xFFFFFFFF] * 6,
                    "kinematics_info.dh_a": [0, -0.425, -0.3922, 0, 0, 0],
                    "kinematics_info.dh_d": [0.1625, 0, 0, 0.1333, 0.0997, 0.0996],
                    "kinematics_info.dh_alpha": [PI / 2, 0, 0, PI / 2, -PI / 2, 0],
                    "kinematics_info.dh_theta": [0] * 6,
                    "kinematics_info.calibration_status": 0,
                    "configuration_data.masterboard_version": 6,
                    "configuration_data.controller_box_type": 4,
                    "configuration_data.robot_type": 1,
                    "configuration_data.robot_sub_type": 3,
                    "configuration_data.motor_type": None,
                    "safety_data.elbow_sphere_radius": 0.13,
                    "tool_communication_info.is_enabled": False,
                    "tool_communication_info.baud_rate": 115200,
                    "tool_communication_info.parity": 0,
                    "tool_communication_info.stop_bits": 1,
                    "tool_communication_info.rx_idle_chars": 1.5,
                    "tool_communication_info.tx_idle_chars": 3.5,
                    "tool_mode_info.output_mode": 0,
                    "tool_mode_info.digital_output_0_mode": 1,
                    "tool_mode_info.digital_output_1_mode": 1,
                    "singularity_info": None,
                },
            )
        ],
    ),
    "urcl_5.24_version_message.bin": (
        "primary",
        [
            (
                VersionMessage,
                {"project_name": "URControl", "major": 5, "minor": 24, "bugfix": 0, "build": 0, "timestamp": 0}
                | {"build_date": "04-10-2025, 00:25:33", "svn_revision": None, "source": -2, "message_type": 3},
            )
        ],
    ),
    "urcl_key_message.bin": (
        "primary",
        [(KeyMessage, {"code": 0, "argument": 0, "title": "PROGRAM_XXX_STARTED", "text": "textmsg", "timestamp": 0})],
    ),
    "urcl_safety_mode_message.bin": (
        "primary",
        [(SafetyModeMessage, {"code": 0, "argument": 0, "safety_mode": 3, "data_type": 0, "data": 1})],
    ),
    "cb3_3.10_connect_head.bin": (
        "primary",
        [
            (VersionMessage, {"major": 3, "minor": 10, "bugfix": 0, "build": 0, "build_date": "03-05-2019, 06:39:00"}),
            message_12(510, 259),
            (SafetyComplianceTolerances, {"tolerances": SAFETY_TOLERANCES}),
        ],
    ),
    "eseries_5.12_connect_head.bin": (
        "primary",
        [
            (VersionMessage, {"major": 5, "minor": 12, "bugfix": 2, "build": 0, "build_date": "28-06-2022, 11:30:43"}),
            message_12(0, 0),
        ],
    ),
    "ursim_5.4_key_message_48.bin": (
        "primary",
        [
            (
                KeyMessage,
                {"code": 0, "argument": 0, "title": "PROGRAM_XXX_STOPPED", "text": "silly"}
                | {"source": -3, "timestamp": 0x3DF7E0D50},
            )
        ],
    ),
    "ursim_5.4_program_state_type25_16.bin": (
        "primary",
        [(ProgramStateMessage, {"message_type": 1, "start_index": 0, "payload": b"", "timestamp": NO_TIME})],
    ),
    "ursim_5.4_modbus_info_type5_9.bin": (
        "primary",
        [(OtherPackage, {"type": PackageType.MODBUS_INFO, "payload": bytes(4)})],
    ),
    "ursim_5.4_runtime_exception_50.bin": (
        "primary",
        [(RuntimeExceptionMessage, {"line": 2, "column": 1, "text": "syntax_error_on_line:2:end:", "source": -3})],
    ),
}

# For each file: its interface, its complete packets, and the offset and declared size of the truncated packet.
CUT_OFF: dict[str, tuple[Interface, list[tuple[type[State], dict[str, Any]]], int, int]] = {
    "cb2_rt_stream_1460.bin": (
        "realtime",
        [(RealtimeState, {"time": 951.592, "joint_modes": (253,) * 6})],
        812,
        812,
    ),
    "cb3_3.3_connect_head_200.bin": ("primary", [VERSION_3_3, message_12(489, 239)], 80, 1306),
    "eseries_5.11.11_connect_head.bin": ("primary", [VERSION_5_11, message_12(0, 0)], 79, 1471),
    "ursim_5.4_primary_connect_head_160.bin": ("primary", [VERSION_5_4, message_12(0, 0)], 79, 181),
    "ursim_5.4_state_head_13.bin": ("primary", [], 0, 716),
}

# Each of these files has a separate test below: two files declare a wrong size, and one starts inside a message.
ODD = {"urcl_runtime_exception_message.bin", "urcl_error_code_message.bin", "ursim_5.4_text_message_fragment.bin"}


def value_of(state: object, name: str) -> Any:
    """Return a value of a state by its path, such as ``"joint_data.q_actual[0]"``."""
    name, _, index = name.partition("[")
    for part in name.split("."):
        state = getattr(state, part)
    return state[int(index[:-1])] if index else state  # type: ignore[index]


def check(states: list[Any], expected: list[tuple[type[State], dict[str, Any]]]) -> None:
    assert [type(state) for state in states] == [cls for cls, _ in expected]
    for state, (_, values) in zip(states, expected, strict=True):
        for name, value in values.items():
            actual = value_of(state, name)
            if isinstance(actual, np.ndarray) or (isinstance(value, float) and actual is not None):
                # The reference prints five digits, the manifest prints all digits.
                assert np.shape(actual) == np.shape(value), name
                assert np.allclose(actual, value, rtol=5e-5, atol=1e-12), (name, actual, value)
            else:
                assert actual == value, name


def pieces(data: bytes, size: int) -> Iterator[bytes]:
    for at in range(0, len(data), size):
        yield data[at : at + size]


def session(interface: Interface) -> RealtimeProtocol | PrimaryProtocol:
    return RealtimeProtocol() if interface == "realtime" else PrimaryProtocol()


def manifest(captures: Path) -> list[dict[str, str]]:
    with (captures / "MANIFEST.csv").open(newline="", encoding="utf-8") as file:
        return [row for row in csv.DictReader(file) if not row["interface"].startswith("30004")]


def test_every_capture_is_listed_once(captures: Path) -> None:
    rows = manifest(captures)
    listed = {row["file"] for row in rows}
    assert listed == {*COMPLETE, *CUT_OFF, *ODD}
    assert len(COMPLETE) + len(CUT_OFF) + len(ODD) == len(listed)
    rtde = {path.name for path in captures.glob("*.bin") if path.name.startswith("urcl_rtde_")}
    assert {path.name for path in captures.glob("*.bin")} == listed | rtde
    for row in rows:
        assert len((captures / row["file"]).read_bytes()) == int(row["length"])
        ports = {"realtime": "30003", "primary": "30001", "secondary": "30002"}
        interface = (COMPLETE.get(row["file"]) or CUT_OFF.get(row["file"]) or ("primary",))[0]
        # Two captures come from the secondary port, which sends fewer packets than the primary port.
        assert ports[interface] in row["interface"] or ports["secondary"] in row["interface"]


@pytest.mark.parametrize("name", COMPLETE)
def test_complete_packets_have_known_values(captures: Path, name: str) -> None:
    interface, expected = COMPLETE[name]
    data = (captures / name).read_bytes()
    states = decode(data, interface)
    check(states, expected)
    assert b"".join(map(bytes, states)) == data
    # Every byte belongs to a known field, even in sub-packages.
    for state in states:
        assert state.tail == b""
        for part in state.packages if isinstance(state, RobotState) else ():
            assert part.tail == b""
            assert type(part) is not urlink.packets.UnknownSubPackage
    for size in (1, 7, len(data)):
        one = session(interface)
        frames = [frame for piece in pieces(data, size) for frame in one.framer.feed(piece)]
        assert [one.decode(frame) for frame in frames] == states
        assert (one.framer.skipped, one.framer.rest) == (0, b"")


@pytest.mark.parametrize("name", CUT_OFF)
def test_truncated_packet_raises_and_stays_buffered_in_stream(captures: Path, name: str) -> None:
    interface, expected, offset, declared = CUT_OFF[name]
    data = (captures / name).read_bytes()
    with pytest.raises(PacketError, match="cut off") as caught:
        decode(data, interface)
    error = caught.value
    assert error.packet == ("RealtimeState" if interface == "realtime" else "package")
    assert (error.expected, error.actual, error.offset) == (declared, len(data) - offset, offset)
    for fact in (str(declared), str(len(data) - offset), str(offset)):
        assert fact in str(error)
    check(decode(data[:offset], interface), expected)
    one = session(interface)
    frames = [frame for piece in pieces(data, 11) for frame in one.framer.feed(piece)]
    check([one.decode(frame) for frame in frames], expected)
    assert (one.framer.skipped, one.framer.rest) == (0, data[offset:])


def test_truncated_packet_is_completed_by_later_bytes(captures: Path) -> None:
    stream = (captures / "cb2_rt_stream_1460.bin").read_bytes()
    one = RealtimeProtocol()
    (frame,) = one.framer.feed(stream)
    (second,) = one.framer.feed(frame[648:])  # the missing end is taken from the previous packet
    # These are consecutive times of a 125 Hz controller.
    assert one.decode(second).time - one.decode(frame).time == pytest.approx(0.008, abs=1e-9)
    assert frame == (captures / "cb2_rt_812.bin").read_bytes()


def test_first_sub_packages_of_truncated_states_are_decoded(captures: Path) -> None:
    data = (captures / "cb3_3.3_connect_head_200.bin").read_bytes()
    mode = RobotModeData.LAYOUTS.decode(data[85 : 85 + 46], Firmware(3, 3, 1))
    assert mode.to_dict() == {
        "timestamp": 0x0174154BC0,
        "is_robot_connected": True,
        "is_robot_enabled": True,
        "is_power_on": True,
        "is_emergency_stopped": False,
        "is_protective_stopped": False,
        "is_program_running": False,
        "is_program_paused": False,
        "robot_mode": "RUNNING",
        "control_mode": "POSITION",
        "target_speed_fraction": 1.0,
        "speed_scaling": 1.0,
        "target_speed_fraction_limit": 1.0,
    }
    data = (captures / "eseries_5.11.11_connect_head.bin").read_bytes()
    mode = RobotModeData.LAYOUTS.decode(data[84 : 84 + 47], Firmware(5, 11, 11))
    assert (mode.robot_mode, mode.speed_scaling, mode.reserved) == (7, 0.0, 0)
    joints = urlink.packets.JointData.LAYOUTS.decode(data[131 : 131 + 251], Firmware(5, 11, 11))
    assert joints.joint_modes == (253,) * 6
    assert np.abs(joints.q_actual - joints.q_target).max() < 1e-3


def test_runtime_exception_with_size_two_bytes_too_small(captures: Path) -> None:
    data = (captures / "urcl_runtime_exception_message.bin").read_bytes()
    assert (len(data), data[3]) == (59, 57)
    # The declared size is used. The remaining two bytes are not a packet, so they are an error.
    with pytest.raises(PacketError, match="cut off") as caught:
        decode(data, "primary")
    assert (caught.value.offset, caught.value.expected, caught.value.actual) == (57, 5, 2)
    check(
        decode(data[:57], "primary"),
        [(RuntimeExceptionMessage, {"line": 3, "column": 1, "text": "compile_error_name_not_found:txtms"})],
    )
    framer = PrimaryProtocol().framer
    assert framer.feed(data) == [data[:57]]
    assert framer.rest == b"g:"
    # With its real size, the message has the contents that the manifest lists.
    check(
        decode(b"\x00\x00\x00\x3b" + data[4:], "primary"),
        [(RuntimeExceptionMessage, {"line": 3, "column": 1, "text": "compile_error_name_not_found:txtmsg:"})],
    )


def test_error_code_template_with_size_six_bytes_too_small(captures: Path) -> None:
    data = (captures / "urcl_error_code_message.bin").read_bytes()
    assert (len(data), data[3]) == (38, 32)
    with pytest.raises(PacketError, match="no packet of the primary interface") as caught:
        decode(data, "primary")
    assert caught.value.offset == 32
    # 32 bytes are too short for the report level and the data that every controller since 3.0 sends.
    with pytest.raises(PacketError, match=r"RobotCommMessage of firmware 5\.8.*expected 35 bytes, got 32"):
        decode(data[:32], "primary", "5.8")
    one = PrimaryProtocol()
    assert one.framer.feed(data) == [data[:32]]
    assert one.framer.skipped + len(one.framer.rest) == 6
    (state,) = decode(b"\x00\x00\x00\x26" + data[4:], "primary", "5.8")
    assert isinstance(state, urlink.packets.RobotCommMessage)
    assert (state.code, state.argument, state.report_level, state.data_type) == (0, 0, 0, 0)


def test_fragment_that_starts_inside_a_message(captures: Path) -> None:
    data = (captures / "ursim_5.4_text_message_fragment.bin").read_bytes()
    with pytest.raises(PacketError, match="no packet of the primary interface starts with 00 00 03 d0") as caught:
        decode(data, "primary")
    assert (caught.value.packet, caught.value.offset) == ("package", 0)
    # A stream searches for a robot state or message. The 16-byte package after the fragment is neither: it is skipped.
    one = PrimaryProtocol()
    assert one.framer.feed(data) == []
    assert one.framer.skipped + len(one.framer.rest) == 63
    state = (captures / "eseries_secondary_state_716.bin").read_bytes()
    assert one.framer.feed(state) == [state]
    assert one.framer.skipped == 63
    # The package itself is complete; one byte of the next package follows it.
    (update,) = decode(data[46:62], "primary")
    assert isinstance(update, ProgramStateMessage)


@pytest.mark.parametrize(
    ("name", "packages", "inferred", "version"),
    [
        ("ursim_5.8_primary_state_1386.bin", 13, "5.4", "5.8"),
        ("cb2_primary_state_1254.bin", 10, "1.8", "1.8"),
        ("eseries_secondary_state_716.bin", 11, "5.4", "5.4"),
        ("cb2_old_state_465.bin", 6, "1.5", "1.5"),
    ],
)
def test_states_contain_all_sub_packages(captures: Path, name: str, packages: int, inferred: str, version: str) -> None:
    data = (captures / name).read_bytes()
    (state,) = decode(data, "primary")
    assert isinstance(state, RobotState)
    assert len(state.packages) == packages
    assert len({type(part) for part in state.packages}) == packages
    assert 5 + sum(len(bytes(part)) for part in state) == len(data)
    assert b"".join(map(bytes, state)) == data[5:]
    # The inferred firmware is the oldest one with these sizes. Decoding with the given firmware has the same result.
    assert infer(state.sizes) == Firmware.parse(inferred)
    (decoded,) = decode(data, "primary", version)
    assert decoded == state
    assert decoded.to_dict() == state.to_dict()


def test_checksums_of_the_captures_agree(captures: Path) -> None:
    """According to the reference, the reserved field of the masterboard is the safety checksum."""
    for name in ("eseries_secondary_state_716.bin", "ursim_5.8_primary_state_1386.bin"):
        (state,) = decode((captures / name).read_bytes(), "primary")
        assert isinstance(state, RobotState)
        assert state.masterboard_data is not None
        assert state.safety_data is not None
        assert state.masterboard_data.reserved_checksum == state.safety_data.checksum != 0


@pytest.mark.parametrize(
    ("name", "shorter"), [("ursim_5.8_primary_state_1386.bin", "RobotModeData"), ("cb2_rt_812.bin", "RealtimeState")]
)
def test_packet_shorter_than_given_firmware_raises(captures: Path, name: str, shorter: str) -> None:
    interface, _ = COMPLETE[name]
    data = (captures / name).read_bytes()
    firmware = "5.10"
    if interface == "primary":  # shorten the first sub-package to 46 bytes, as 3.4 sends it
        data = data[:5] + b"\x00\x00\x00\x2e\x00" + data[10:51] + data[52:]
        data = len(data).to_bytes(4, "big") + data[4:]
    with pytest.raises(PacketError) as caught:
        decode(data, interface, firmware)
    error = caught.value
    assert (error.packet, error.version) == (shorter, "5.10")
    assert (error.expected, error.actual) == ((47, 46) if interface == "primary" else (1220, 812))
    assert error.offset == (5 if interface == "primary" else 812)
