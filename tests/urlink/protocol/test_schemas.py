"""Declared layouts compared with the reference: every size, and offsets copied by hand from its tables."""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
import pytest

import urlink
from linkcore.errors import BadValue, BadVersion, PacketError
from linkcore.wire.fields import Mask64, OpenInt
from linkcore.wire.packet import State
from urlink import decode
from urlink.packets import (
    AdditionalInfo,
    CartesianInfo,
    ConfigurationData,
    DigitalBits,
    JointData,
    JointMode,
    MasterboardData,
    PackageType,
    PopupMessage,
    RealtimeState,
    RobotCommMessage,
    RobotMode,
    RobotModeCB2,
    RobotModeData,
    RobotState,
    SafetyMode,
    SubPackage,
    ToolData,
    UnknownSubPackage,
    VersionMessage,
)
from urlink.protocol import enums
from urlink.protocol.firmware import NEWEST, RELEASES, Firmware, Release, infer, release_of
from urlink.protocol.primary import robot_message, robot_state
from urlink.protocol.primary.robot_message import MESSAGES, PACKAGES
from urlink.protocol.primary.robot_state import SUB_PACKAGES
from urlink.protocol.realtime import packets as realtime

CLASSES: list[type[State]] = sorted(
    {
        item
        for module in (realtime, robot_state, robot_message)
        for item in vars(module).values()
        if isinstance(item, type) and issubclass(item, State) and item.FIELDS
    },
    key=lambda cls: cls.__name__,
)


def class_of(kind: int, size: int) -> type[SubPackage]:
    (cls,) = (each for each in SUB_PACKAGES[kind] if size in {layout.size for layout in each.LAYOUTS.all})
    return cls


# -- the release table compared with the layouts


@pytest.mark.parametrize("release", RELEASES, ids=lambda release: str(release.since))
def test_release_table_equals_sizes_of_layouts(release: Release) -> None:
    assert RealtimeState.LAYOUTS.of(release.since).size == release.realtime
    for kind, size in release.state.items():
        assert class_of(kind, size).LAYOUTS.of(release.since).size == size
    # No layout is declared for a release that the table does not list. It is unknown which release was the first to
    # send type 13.
    for kind, classes in SUB_PACKAGES.items():
        for cls in classes:
            try:
                sent = cls.LAYOUTS.of(release.since).size
            except PacketError:
                continue
            assert kind == 13 or release.state.get(kind) == sent, (cls.__name__, sent)


@pytest.mark.parametrize(
    ("version", "realtime", "first", "later"),
    [
        ("1.5", 756, 465, 465),
        ("1.6", 764, None, None),
        ("1.7", 764, 510, 510),
        ("1.8", 812, 1254, 560),
        ("3.0", 1044, None, None),
        ("3.1", 1044, None, None),
        ("3.2", 1060, None, None),
        ("3.3.1", 1060, 1306, None),
        ("3.4", 1060, None, None),
        ("3.5.3", 1108, 1350, None),
        ("3.9", 1108, None, None),
        ("3.10", 1116, 1352, 682),
        ("3.13", 1116, None, None),
        ("3.14", 1140, None, None),
        ("3.15", 1140, None, None),
        ("5.0.5", 1108, 1376, None),
        ("5.3", 1108, None, None),
        ("5.4", 1116, 1386, 716),
        ("5.8", 1116, 1386, 716),
        ("5.9", 1140, None, None),
        ("5.10", 1220, None, None),
        ("5.25.1", 1220, None, None),
        ("10.7", 1220, None, None),
    ],
)
def test_state_sizes_equal_those_of_the_reference(
    version: str, realtime: int, first: int | None, later: int | None
) -> None:
    release = release_of(Firmware.parse(version))
    assert release.realtime == realtime
    assert first is None or release.first_state_size == first
    assert later is None or release.state_size == later
    assert len(bytes(RealtimeState(version))) == realtime


@pytest.mark.parametrize("version", ["1.4", "0.9", "2.0", "4.1", "6.1", "9.9"])
def test_unknown_firmware_raises_bad_version(version: str) -> None:
    with pytest.raises(BadVersion, match="unknown firmware"):
        release_of(Firmware.parse(version))
    with pytest.raises(BadVersion):
        decode(b"", "realtime", version)


def test_later_generation_uses_newest_release() -> None:
    assert release_of(Firmware(11, 0)) == RELEASES[-1]


@pytest.mark.parametrize("version", [[5, 11], 5, {"5": "11"}, ("5", "11"), ([5], 11)])
def test_decode_rejects_invalid_versions(version: Any) -> None:
    with pytest.raises(BadVersion, match="is not a firmware"):
        decode(b"", "realtime", version)


@pytest.mark.parametrize("version", [[5, 11], 5, {5: 11, 3: 2}, (5,)])
def test_firmware_parse_rejects_other_types(version: Any) -> None:
    with pytest.raises(BadVersion, match="is not a firmware"):
        Firmware.parse(version)


def test_releases_are_sorted_and_have_evidence() -> None:
    assert [row.since for row in RELEASES] == sorted(row.since for row in RELEASES)
    assert all(row.evidence for row in RELEASES)
    assert max(row.since for row in RELEASES if row.since.major == 5) == NEWEST


# Every size in the reference's table, with its firmware.
SIZES: dict[type[State], dict[str, int]] = {
    RealtimeState: {"1.5": 756, "1.6": 764, "1.8": 812, "3.0": 1044, "3.2": 1060, "3.5": 1108, "3.10": 1116}
    | {"3.14": 1140, "5.0": 1108, "5.4": 1116, "5.9": 1140, "5.10": 1220},
    RobotModeData: {"1.8": 29, "3.1": 38, "3.2": 46, "3.4": 46, "3.5": 47, "5.25": 47},
    JointData: {"1.5": 251, "3.10": 251, "5.25": 251},
    ToolData: {"1.5": 37, "5.25": 37},
    MasterboardData: {"1.5": 61, "1.6": 64, "1.8": 64, "3.0": 72, "3.1": 72, "3.2": 74, "3.9": 74, "3.10": 75}
    | {"5.0": 74, "5.3": 74, "5.4": 75, "5.25": 75},
    CartesianInfo: {"1.8": 53, "3.0": 53, "3.2": 101, "5.25": 101},
    urlink.packets.LaserPointer: {"1.5": 29},
    urlink.packets.KinematicsInfo: {"1.8": 225, "5.25": 225},
    ConfigurationData: {"1.8": 469, "3.0": 445, "5.24": 445, "5.25.1": 449},
    urlink.packets.ForceModeData: {"1.7": 61, "5.25": 61},
    AdditionalInfo: {"1.7": 10, "1.8": 7, "3.1": 7, "3.3": 8, "3.9": 8, "3.10": 9, "5.3": 8, "5.4": 9},
    urlink.packets.CalibrationData: {"1.8": 53, "5.25": 53},
    urlink.packets.SafetyData: {"3.5": 43, "5.25": 43},
    urlink.packets.ToolCommunicationInfo: {"5.0": 26},
    urlink.packets.ToolModeInfo: {"5.2": 8},
    urlink.packets.SingularityInfo: {"5.25": 7},
    urlink.packets.SafetyComplianceTolerances: {"3.10": 181, "5.4": 181},
    urlink.packets.UnnamedMessage12: {"3.3": 24},
    urlink.packets.SafetyModeMessage: {"5.8": 32},
}


@pytest.mark.parametrize("cls", SIZES, ids=lambda cls: cls.__name__)
def test_packet_sizes_equal_those_of_the_reference(cls: type[State]) -> None:
    for version, size in SIZES[cls].items():
        state: Any = cls(version)
        assert len(bytes(state)) == cls.LAYOUTS.of(version).size == size
        assert int.from_bytes(bytes(state)[:4], "big") == size
        assert cls.dtype(version).itemsize == size


@pytest.mark.parametrize(
    ("version", "size"), [("1.6", 76), ("1.8", 76), ("3.0", 88), ("3.2", 90), ("3.10", 91), ("5.4", 91)]
)
def test_euromap_block_follows_its_flag(version: str, size: int) -> None:
    board = MasterboardData(
        version,
        is_euromap_installed=True,
        euromap_input_bits=0x01020304,
        euromap_output_bits=5,
        euromap_voltage_24V=24,
        euromap_current=2,
        **({} if version < "3" else {"safety_mode": 1, "reserved_checksum": 0xA1B2C3D4}),
    )
    data = bytes(board)
    assert len(data) == size
    if version < "3":
        # The flag follows 16-bit inputs and outputs, ranges, doubles and domains, four floats and two safety bytes.
        assert data[63:] == struct.pack(">BiihH", 1, 0x01020304, 5, 24, 2)
    else:
        assert data[67:84] == struct.pack(">BIIff", 1, 0x01020304, 5, 24.0, 2.0)
        assert data[84:88] == bytes.fromhex("a1b2c3d4")
    for firmware in (Firmware.parse(version), None):
        again = MasterboardData.LAYOUTS.decode(data, firmware)
        assert again == board
        assert again.to_dict() == board.to_dict()
    assert (board.euromap_voltage_24V, board.euromap_current, board.tail) == (24, 2, b"")
    assert MasterboardData(version, is_euromap_installed=False, euromap_current=2).euromap_current is None


# -- offsets, copied by hand from the tables of the reference

SHARED = {"time": 4, "q_target": 12, "qd_target": 60, "qdd_target": 108, "I_target": 156, "M_target": 204}
SHARED |= {"q_actual": 252, "qd_actual": 300, "I_actual": 348, "digital_input_bits": 684, "motor_temperatures": 692}
SHARED |= {"controller_timer": 740, "test_value": 748}
CB2 = SHARED | {"tool_accelerometer": 396, "unused": 420, "tcp_force": 540, "tool_vector_actual": 588}
CB2 |= {"tcp_speed_actual": 636, "robot_mode": 756, "joint_modes": 764}
CB3 = SHARED | {"I_control": 396, "tool_vector_actual": 444, "tcp_speed_actual": 492, "tcp_force": 540}
CB3 |= {"tool_vector_target": 588, "tcp_speed_target": 636, "robot_mode": 756, "joint_modes": 764, "safety_mode": 812}
CB3 |= {"reserved_a": 820, "tool_accelerometer": 868, "reserved_b": 892, "speed_scaling": 940}
CB3 |= {"linear_momentum_norm": 948, "reserved_c": 956, "reserved_d": 964, "V_main": 972, "V_robot": 980}
CB3 |= {"I_robot": 988, "V_actual": 996}
LATER = {"digital_output_bits": 1044, "program_state": 1052, "elbow_position": 1060, "elbow_velocity": 1084}
LATER |= {"safety_status": 1108, "reserved_e": 1116, "payload_mass": 1140, "payload_cog": 1148, "payload_inertia": 1172}


@pytest.mark.parametrize(
    ("version", "expected"),
    [
        ("1.5", {name: offset for name, offset in CB2.items() if offset < 756}),
        ("1.7", {name: offset for name, offset in CB2.items() if offset < 764}),
        ("1.8", CB2),
        ("3.0", CB3),
        ("3.4", CB3 | {name: offset for name, offset in LATER.items() if offset < 1060}),
        ("3.9", CB3 | {name: offset for name, offset in LATER.items() if offset < 1108}),
        ("5.4", CB3 | {name: offset for name, offset in LATER.items() if offset < 1116}),
        ("3.15", CB3 | {name: offset for name, offset in LATER.items() if offset < 1140}),
        ("5.10", CB3 | LATER),
    ],
)
def test_realtime_fields_have_expected_offsets(version: str, expected: dict[str, int]) -> None:
    layout = RealtimeState.LAYOUTS.of(version)
    assert {name: place.offset for name, place in layout.places.items()} == expected
    # Check the bytes as well as the declaration: write each field at its offset and read it back.
    for name, offset in expected.items():
        count = layout.places[name].count
        raw = layout.places[name].shape is Mask64
        data = bytearray(layout.size)
        wanted = [float(n + 1) for n in range(count or 1)]
        data[offset : offset + 8 * (count or 1)] = struct.pack(
            ">Q" if raw else f">{len(wanted)}d", *map(int if raw else float, wanted)
        )
        state = layout.decode(bytes(data))
        value = getattr(state, name)
        assert list(value) == wanted if count else value == wanted[0]
        for other in RealtimeState.FIELDS.keys() - {name}:
            still = getattr(state, other)
            assert still is None or not np.any(still), (name, other)
    assert {name for name in RealtimeState.FIELDS if getattr(layout.decode(bytes(layout.size)), name) is None} == (
        RealtimeState.FIELDS.keys() - expected.keys()
    )


def test_joints_are_sent_one_by_one() -> None:
    blocks = [struct.pack(">3d4fB", n, n + 10, n + 20, n + 30, n + 40, n + 50, n + 60, 250 + n) for n in range(6)]
    state = JointData.LAYOUTS.decode(struct.pack(">iB", 251, 1) + b"".join(blocks))
    names = ("q_actual", "q_target", "qd_actual", "I_actual", "V_actual", "T_motor", "T_micro")
    for first, name in enumerate(names):
        assert getattr(state, name).tolist() == [first * 10 + n for n in range(6)]
        assert getattr(state, name).dtype == np.float64
    assert state.joint_modes == (250, 251, 252, 253, 254, 255)
    assert state.joint_modes[3] is JointMode.RUNNING


@pytest.mark.parametrize(
    ("cls", "version", "offsets"),
    [
        (
            RobotModeData,
            "1.8",
            {"timestamp": 5, "is_robot_connected": 13, "robot_mode": 20, "target_speed_fraction": 21},
        ),
        (
            RobotModeData,
            "5.4",
            {"is_program_paused": 19, "robot_mode": 20, "control_mode": 21, "target_speed_fraction": 22}
            | {"speed_scaling": 30, "target_speed_fraction_limit": 38, "reserved": 46},
        ),
        (ToolData, "5.4", {"analog_input_2": 7, "tool_voltage_48V": 23, "tool_output_voltage": 27, "tool_mode": 36}),
        (
            MasterboardData,
            "5.4",
            {"digital_input_bits": 5, "digital_output_bits": 9, "analog_input_0": 15, "analog_output_0": 33}
            | {"masterboard_temperature": 49, "robot_voltage_48V": 53, "safety_mode": 65, "is_euromap_installed": 67}
            | {"reserved_checksum": 68, "operational_mode_selector_input": 72, "reserved": 74},
        ),
        (MasterboardData, "1.8", {"digital_output_bits": 7, "analog_input_0": 11, "master_safety_state": 61}),
        (CartesianInfo, "3.2", {"X": 5, "Rz": 45, "tcp_offset_X": 53, "tcp_offset_Rz": 93}),
        (
            urlink.packets.KinematicsInfo,
            "5.4",
            {"checksum": 5, "dh_theta": 29, "dh_a": 77, "dh_d": 125, "calibration_status": 221},
        ),
        (
            ConfigurationData,
            "1.8",
            {"joint_min_limit": 5, "joint_max_limit": 13, "joint_max_speed": 101, "v_joint_default": 197}
            | {"eq_radius": 229, "dh_a": 237, "dh_theta": 381, "masterboard_version": 429, "motor_type": 445},
        ),
        (ConfigurationData, "5.25", {"robot_type": 437, "robot_sub_type": 441, "reserved": 445}),
        (urlink.packets.ForceModeData, "5.4", {"Fx": 5, "robot_dexterity": 53}),
        (AdditionalInfo, "1.7", {"ctrl_bits": 5, "teach_button": 9}),
        (AdditionalInfo, "5.4", {"freedrive_button_pressed": 5, "io_enabled_freedrive": 7, "reserved": 8}),
        (
            urlink.packets.SafetyData,
            "5.4",
            {"checksum": 5, "reserved": 9, "elbow_sphere_centre": 11, "elbow_sphere_radius": 35},
        ),
        (
            urlink.packets.ToolCommunicationInfo,
            "5.4",
            {"is_enabled": 5, "baud_rate": 6, "stop_bits": 14, "tx_idle_chars": 22},
        ),
        (
            urlink.packets.SafetyModeMessage,
            "5.4",
            {"timestamp": 5, "source": 13, "code": 15, "safety_mode": 23, "data": 28},
        ),
    ],
)
def test_field_offsets_in_sub_packages_equal_the_reference(
    cls: type[State], version: str, offsets: dict[str, int]
) -> None:
    places = cls.LAYOUTS.of(version).places
    assert {name: places[name].offset for name in offsets} == offsets


# -- messages in their older forms


def message(kind: int, payload: bytes) -> bytes:
    return struct.pack(">iBQbB", 15 + len(payload), 20, 0, -2, kind) + payload


def test_version_message_is_decoded_with_and_without_build() -> None:
    old = struct.pack(">B9sBBi", 9, b"URControl", 3, 2, 19293) + b"Oct 01 2015, 10:00:00"
    (state,) = decode(message(3, old), "primary")
    assert isinstance(state, VersionMessage)
    assert (state.major, state.minor, state.svn_revision, state.bugfix) == (3, 2, 19293, None)
    assert state.build_date == "Oct 01 2015, 10:00:00"
    new = struct.pack(">B9sBBii", 9, b"URControl", 5, 11, 1, 108318) + b"11-04-2022, 07:48:21"
    (state,) = decode(message(3, new), "primary")
    assert isinstance(state, VersionMessage)
    assert (state.svn_revision, state.bugfix, state.build, state.build_date) == (
        None,
        1,
        108318,
        "11-04-2022, 07:48:21",
    )


def test_popup_and_report_messages_of_cb2_are_decoded() -> None:
    popup = message(2, b"\x01\x00\x05titletext of the popup")
    (state,) = decode(popup, "primary", "1.8")
    assert isinstance(state, PopupMessage)
    assert (state.is_warning, state.is_error, state.title, state.text) == (True, False, "title", "text of the popup")
    assert (state.request_id, state.is_blocking) == (None, None)
    (state,) = decode(message(2, struct.pack(">IIBBBB5s", 7, 3, 0, 1, 1, 5, b"title") + b"text"), "primary", "5.4")
    assert isinstance(state, PopupMessage)
    assert (state.request_id, state.requested_type, state.title, state.text) == (7, 3, "title", "text")
    assert (state.is_warning, state.is_error, state.is_blocking) == (False, True, True)
    (state,) = decode(message(6, struct.pack(">ii", 4, 1) + b"old text"), "primary", "1.8")
    assert isinstance(state, RobotCommMessage)
    assert (state.code, state.argument, state.report_level, state.text) == (4, 1, None, "old text")
    (state,) = decode(message(6, struct.pack(">iiiII", 4, 1, 2, 4, 0xFF) + b"text"), "primary", "5.4")
    assert isinstance(state, RobotCommMessage)
    assert (state.report_level, state.data_type, state.data, state.text) == (2, 4, 255, "text")


@pytest.mark.parametrize("kind", [4, 8, 11, 13, 14, 99, 255])
def test_unknown_messages_are_kept(kind: int) -> None:
    (state,) = decode(message(kind, b"payload"), "primary")
    assert isinstance(state, urlink.packets.UnknownMessage)
    assert (state.message_type, state.payload, state.source) == (kind, b"payload", -2)


@pytest.mark.parametrize(
    ("kind", "name"), [(5, "MODBUS_INFO"), (22, "HMC_MESSAGE"), (23, "SAFETY_SETUP"), (255, "DISCONNECT")]
)
def test_packages_without_a_layout_are_kept_with_their_type(kind: int, name: str) -> None:
    (state,) = decode(struct.pack(">iB", 9, kind) + b"abcd", "primary")
    assert isinstance(state, urlink.packets.OtherPackage)
    assert state.payload == b"abcd"
    assert state.type is PackageType[name]
    assert state.to_dict() == {"type": name, "payload": "61626364"}
    assert name in str(state)


def test_unknown_sub_packages_are_kept_with_their_type() -> None:
    body = b"".join([struct.pack(">iB", 7, 14) + b"ab", struct.pack(">iB", 6, 99) + b"c", bytes(ToolData())])
    (state,) = decode(struct.pack(">iB", 5 + len(body), 16) + body, "primary", "5.11")
    assert isinstance(state, RobotState)
    assert [type(part) for part in state] == [UnknownSubPackage, UnknownSubPackage, ToolData]
    assert list(state.to_dict()) == ["unknown_sub_package_14", "unknown_sub_package_99", "tool_data"]
    assert state.to_dict()["unknown_sub_package_14"] == {"type": 14, "payload": "6162"}
    assert "type=99" in str(state)
    assert state.tool_data is not None
    assert state.joint_data is None
    # The short kinematics package that is reported when nothing has changed.
    (state,) = decode(struct.pack(">iBiB4s", 14, 16, 9, 5, b"same"), "primary")
    assert isinstance(state, RobotState)
    assert state.kinematics_info is None
    assert state.sizes == {5: 9}


def test_robot_state_dtype_raises() -> None:
    with pytest.raises(BadValue, match="RobotState"):
        RobotState.dtype()


# -- packets with another length, or without a firmware


@pytest.mark.parametrize("release", RELEASES, ids=lambda release: str(release.since))
def test_longer_packet_keeps_tail_and_shorter_packet_raises(release: Release) -> None:
    layout = RealtimeState.LAYOUTS.of(release.since)
    firmware = str(release.since)
    (state,) = decode(layout.encode({"time": 3.5}, b"new cell"), "realtime", firmware)
    known = {each.size for each in RealtimeState.LAYOUTS.all}
    assert state.time == 3.5
    # A later release might append eight bytes; then the layout of that release decodes them.
    assert state.tail == (b"" if release.realtime + 8 in known else b"new cell")
    data = bytearray(layout.encode({"time": 3.5}))[:-8]
    data[:4] = len(data).to_bytes(4, "big")
    with pytest.raises(PacketError) as caught:
        decode(bytes(data), "realtime", firmware)
    error = caught.value
    facts = (error.packet, error.version, error.expected, error.actual, error.offset)
    assert facts == ("RealtimeState", firmware, release.realtime, release.realtime - 8, release.realtime - 8)
    for fact in facts:
        assert str(fact) in str(error)


@pytest.mark.parametrize("release", RELEASES, ids=lambda release: str(release.since))
def test_firmware_is_inferred_from_sizes(release: Release) -> None:
    state = RealtimeState(release.since, time=1.0, q_actual=range(6), tcp_force=range(6))
    (again,) = decode(bytes(state), "realtime")
    assert again.to_dict() == state.to_dict()
    parts = [class_of(kind, size)(release.since) for kind, size in release.state.items()]
    whole = RobotState(*parts)
    assert len(bytes(whole)) == release.first_state_size
    (decoded,) = decode(bytes(whole), "primary")
    assert isinstance(decoded, RobotState)
    assert decoded.sizes == dict(release.state)
    assert decoded.to_dict() == whole.to_dict()
    # The inferred firmware is the oldest release with these sizes.
    inferred = infer(decoded.sizes)
    assert inferred is not None
    assert inferred <= release.since
    same = {kind: size for kind, size in release_of(inferred).state.items() if kind not in (5, 6)}
    assert same == {kind: size for kind, size in release.state.items() if kind not in (5, 6)}


def test_infer_returns_none_for_unknown_sizes() -> None:
    assert infer(RobotState(ToolData()).sizes) is None


def test_decode_returns_several_packets() -> None:
    states = [RealtimeState("3.4", time=1.0), RealtimeState("5.10", time=2.0), RealtimeState("1.8", time=3.0)]
    again = decode(b"".join(map(bytes, states)), "realtime")
    assert again == states
    assert decode(b"", "realtime") == decode(b"", "primary") == []
    with pytest.raises(PacketError) as caught:
        decode(bytes(states[0]) + b"\x00\x00\x00\x01????", "realtime")
    assert caught.value.offset == 1060
    with pytest.raises(BadValue, match="unknown interface 'rtde'"):
        decode(b"", "rtde")  # type: ignore[call-overload]


def test_error_inside_state_names_sub_package_and_offset() -> None:
    good = bytes(ToolData())
    body = good + struct.pack(">iB", 36, 2) + good[5:-1]
    data = bytes(urlink.packets.KeyMessage()) + struct.pack(">iB", 5 + len(body), 16) + body
    with pytest.raises(PacketError, match="in a robot state, the packet is too short") as caught:
        decode(data, "primary")
    error = caught.value
    assert (error.packet, error.expected, error.actual) == ("ToolData", 37, 36)
    assert error.offset == len(data) - 36
    with pytest.raises(PacketError, match="sub-package 2 does not fit"):
        decode(struct.pack(">iBiB", 17, 16, 7, 99) + b"xx" + struct.pack(">iB", 99, 2), "primary")
    with pytest.raises(PacketError, match="the header of a sub-package is cut off"):
        decode(struct.pack(">iBiB", 12, 16, 5, 99) + b"xx", "primary")


# -- digital bits


@pytest.mark.parametrize("coding", ["integer", "double"])
@pytest.mark.parametrize("version", ["1.8", "3.4", "5.10"])
def test_digital_bits_are_decoded_from_integers_and_doubles(version: str, coding: str) -> None:
    mask = int(DigitalBits.STANDARD_0 | DigitalBits.STANDARD_2 | DigitalBits.TOOL_1)
    data = bytearray(bytes(RealtimeState(version)))
    cell = struct.pack(">Q", mask) if coding == "integer" else struct.pack(">d", float(mask))
    data[684:692] = cell
    if version != "1.8":
        data[1044:1052] = cell
    (state,) = decode(bytes(data), "realtime")
    assert state.digital_input_bits == mask
    assert DigitalBits.TOOL_1 in DigitalBits(state.digital_input_bits)
    assert state.digital_output_bits == (None if version == "1.8" else mask)
    assert state.digital_coding == coding


def test_digital_coding_is_none_while_all_inputs_are_off() -> None:
    assert RealtimeState("5.10").digital_coding is None
    assert RealtimeState("5.10", digital_input_bits=5).digital_coding == "integer"


# -- enums and metadata

ENUMS = [
    item
    for item in vars(enums).values()
    if isinstance(item, type) and issubclass(item, OpenInt) and item is not OpenInt
]


def test_twenty_enums_are_found() -> None:
    assert len(ENUMS) == 20


@pytest.mark.parametrize("cls", ENUMS, ids=lambda cls: cls.__name__)
def test_enums_accept_unknown_numbers(cls: type[OpenInt]) -> None:
    for number in (-(2**31), -99, 66, 9999, 2**32 - 1):
        assert cls(number) == number
        assert cls(number).name == f"UNKNOWN_{number}"
    assert len({member.value for member in cls}) == len(cls)


def test_mode_numbers_equal_those_of_the_reference() -> None:
    assert [mode.value for mode in RobotMode] == list(range(-1, 9))
    assert [mode.value for mode in RobotModeCB2] == list(range(11))
    assert (RobotMode(7).name, RobotModeCB2(7).name) == ("RUNNING", "NO_POWER")
    assert {mode.value for mode in SafetyMode} == {*range(1, 21), 22} - {21}
    assert [JointMode(n).name for n in (235, 243, 253, 255)] == ["RESET", "FREEDRIVE", "RUNNING", "IDLE"]
    assert [state.value for state in enums.ProgramState] == list(range(6))
    assert [kind.name for kind in enums.RobotType][:4] == ["UR5", "UR10", "UR3", "UR16"]
    assert DigitalBits(1 << 17) is DigitalBits.TOOL_1
    assert int(DigitalBits(1 << 40)) == 1 << 40  # a bit without a name is kept


def test_robot_modes_depend_on_generation() -> None:
    assert RealtimeState("1.8", robot_mode=0).robot_mode is RobotModeCB2.RUNNING
    assert RealtimeState("3.0", robot_mode=7).robot_mode is RobotMode.RUNNING
    assert RobotModeData("1.8", robot_mode=7).robot_mode is RobotModeCB2.NO_POWER
    assert RobotModeData("5.4", robot_mode=100).robot_mode == 100


def test_unknown_codes_are_decoded_as_unknown_numbers() -> None:
    state = RealtimeState("5.10", robot_mode=99, joint_modes=[1, 2, 3, 4, 5, 6], safety_mode=-7, program_state=1000)
    assert state.joint_modes == (1, 2, 3, 4, 5, 6)
    assert state.to_dict()["robot_mode"] == "UNKNOWN_99"
    data = bytearray(bytes(state))
    data[756:764] = struct.pack(">d", 7.5)
    data[812:820] = struct.pack(">d", float("nan"))
    (state,) = decode(bytes(data), "realtime")
    assert state.robot_mode == -(2**31)
    assert state.safety_mode == -(2**31)


@pytest.mark.parametrize("cls", CLASSES, ids=lambda cls: cls.__name__)
def test_every_field_has_description_and_unit(cls: type[State]) -> None:
    assert cls.__doc__
    for name, field in cls.FIELDS.items():
        assert field.name == name
        assert field.doc, name
        prop = getattr(cls, name)
        assert prop.__doc__ == (f"{field.doc} [{field.unit}]" if field.unit else field.doc)
        # A plain float or a vector is a quantity, which has a unit unless its meaning is unknown.
        unknown = ("unused", "reserved", "test_value", "tolerances", "robot_dexterity", "pointer")
        number = field.shape.number
        if number is not None and number.kind[0] == "f" and field.shape.read is None:
            assert field.unit or name.startswith(unknown), name


def test_every_class_is_reachable_and_public() -> None:
    reachable = {cls for classes in SUB_PACKAGES.values() for cls in classes} | {*MESSAGES.values(), *PACKAGES.values()}
    reachable |= {
        RealtimeState,
        UnknownSubPackage,
        urlink.packets.RobotMessage,
        urlink.packets.UnknownMessage,
        urlink.packets.OtherPackage,
    }
    assert reachable == {*CLASSES}
    for cls in CLASSES:
        assert getattr(urlink.packets, cls.__name__) is cls
        assert cls.__name__ in dir(urlink.packets)
    assert sorted(SUB_PACKAGES) == list(range(14))


def test_every_sub_package_is_an_attribute_of_the_state() -> None:
    for classes in SUB_PACKAGES.values():
        for cls in classes:
            part = cls()
            state = RobotState(part)
            (name,) = state.to_dict()
            assert getattr(state, name) is part
            assert state.get(cls) is part
            empty: Any = RobotState()
            assert getattr(empty, name) is None
            with pytest.raises(AttributeError):
                setattr(empty, name, part)


def test_robot_state_is_dissected_completely() -> None:
    state = RobotState(RobotModeData("5.11"), JointData("5.11"))
    rows = list(state.dissect())
    assert b"".join(row.data for row in rows) == bytes(state)
    at = 0
    for row in rows:
        assert row.offset == at
        at += len(row.data)
    assert [row.name for row in rows[:3]] == ["size", "type", "robot_mode_data.size"]


def test_additional_info_of_firmware_1_7_has_buttons() -> None:
    """The payload is ``00 01 40 07 01``, taken from a 510-byte state whose other bytes are unknown."""
    data = bytes.fromhex("0000000a08 0001400701")
    for version in (None, Firmware(1, 7), Firmware(1, 8)):
        info = AdditionalInfo.LAYOUTS.decode(data, version)
        assert (info.ctrl_bits, info.teach_button, info.freedrive_button_pressed) == (0x00014007, 1, None)
