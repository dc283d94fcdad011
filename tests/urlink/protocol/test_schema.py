"""Construct schemas for users: round trips of packets of every firmware, and rejected packets."""

from __future__ import annotations

from typing import Any

import construct
import pytest

import urlink
from linkcore.wire.packet import State
from tests.real_captures import folder
from urlink import BadValue, BadVersion, PacketError, schema
from urlink.packets import RealtimeState, RobotState
from urlink.protocol.firmware import RELEASES
from urlink.protocol.primary.robot_message import MESSAGES, PACKAGES
from urlink.protocol.primary.robot_state import SUB_PACKAGES
from urlink.protocol.rtde.packets import REPLIES, REQUESTS
from urlink.protocol.rtde.recipes import Recipe

FIRMWARES = [str(release.since) for release in RELEASES]
#: Text that is necessary to distinguish a layout from an older one.
TEXTS: dict[type[State], dict[str, str]] = {urlink.packets.VersionMessage: {"build_date": "Jan 01 2020, 00:00:00"}}
CLASSES: list[type[State]] = [
    RealtimeState,
    *(each for kinds in SUB_PACKAGES.values() for each in kinds),
    *MESSAGES.values(),
    *PACKAGES.values(),
]


@pytest.mark.parametrize("firmware", FIRMWARES)
def test_packets_of_every_firmware_are_parsed_and_rebuilt(firmware: str) -> None:
    for cls in CLASSES:
        try:
            packet = bytes(cls(firmware, **TEXTS.get(cls, {})))
        except PacketError:
            with pytest.raises(PacketError, match="does not send it"):
                schema(cls, firmware)
            continue
        made = schema(cls, firmware)
        parsed = made.parse(packet)
        assert made.build(parsed) == packet, cls
        for name in cls.LAYOUTS.of(firmware).places:
            if cls.FIELDS[name].interleave is None:
                assert name in parsed, (cls, name)
        with pytest.raises(construct.ConstructError):
            made.parse(packet[:-1])
        longer = (int.from_bytes(packet[:4], "big") + 8).to_bytes(4, "big") + packet[4:] + bytes(8)
        if not cls.LAYOUTS.of(firmware).has_text:
            with pytest.raises(construct.ConstructError):
                made.parse(longer)


def test_packet_of_other_firmware_or_type_is_rejected() -> None:
    with pytest.raises(construct.ConstError, match=r"size\n.*expected 1220 but parsed 1060"):
        schema(RealtimeState, "5.11").parse(bytes(RealtimeState("3.4")))
    calibration = bytes(urlink.packets.CalibrationData("5.11"))
    with pytest.raises(construct.ConstError, match="type"):
        schema(urlink.packets.CalibrationData, "5.11").parse(calibration[:4] + b"\7" + calibration[5:])
    with pytest.raises(construct.ConstError, match="message_type"):
        schema(urlink.packets.RequestValueMessage).parse(bytes(urlink.packets.KeyMessage("5.11")))


def test_joint_data_are_parsed_joint_by_joint() -> None:
    packet = bytes(urlink.packets.JointData("5.11", q_actual=[1, 2, 3, 4, 5, 6]))
    parsed = schema(urlink.packets.JointData, "5.11").parse(packet)
    assert [joint.q_actual for joint in parsed.joint] == [1, 2, 3, 4, 5, 6]


@pytest.mark.parametrize("has_block", [False, True])
def test_optional_block_depends_on_its_flag(has_block: bool) -> None:
    given: dict[str, Any] = {"is_euromap_installed": has_block}
    if has_block:
        given["euromap_voltage_24V"] = 24.0
    packet = bytes(urlink.packets.MasterboardData("5.11", **given))
    made = schema(urlink.packets.MasterboardData, "5.11")
    parsed = made.parse(packet)
    assert parsed.euromap_voltage_24V == (24.0 if has_block else None)
    assert made.build(parsed) == packet


@pytest.mark.parametrize("firmware", FIRMWARES)
def test_robot_state_is_a_sequence_of_sub_packages(firmware: str) -> None:
    parts = []
    for kinds in SUB_PACKAGES.values():
        for cls in kinds:
            try:
                parts.append(cls(firmware))
            except PacketError:
                continue
    packet = bytes(RobotState(*parts))
    made = schema(RobotState, firmware)
    parsed = made.parse(packet)
    assert [each.type for each in parsed.packages] == [bytes(part)[4] for part in parts]
    assert made.build(parsed) == packet
    unknown = packet[5:] + b"\0\0\0\7\x63ab"
    whole = (5 + len(unknown)).to_bytes(4, "big") + b"\x10" + unknown
    assert made.parse(whole).packages[-1].fields == b"ab"
    broken = whole[:-7] + b"\0\0\0\7\0ab"  # two bytes are too short for robot mode data
    with pytest.raises(construct.TerminatedError):
        made.parse(broken)


@pytest.mark.parametrize("version", ["1.0", "2.0"])
@pytest.mark.parametrize("table", [REQUESTS, REPLIES], ids=["requests", "replies"])
def test_rtde_schemas_depend_on_protocol_version(table: dict[int, type[State]], version: str) -> None:
    for kind, cls in table.items():
        made = schema(cls, version)
        packet = bytes(cls(version))
        assert packet[2] == kind
        assert made.build(made.parse(packet)) == packet


def test_rtde_recipe_has_schema_of_its_data_packages() -> None:
    recipe = Recipe(["timestamp", "actual_q", "robot_mode"], ["DOUBLE", "VECTOR6D", "INT32"], 3)
    made = schema(recipe)
    packet = recipe.encode({"timestamp": 1.5, "actual_q": [1, 2, 3, 4, 5, 6], "robot_mode": 7})
    parsed = made.parse(packet)
    assert (parsed.recipe, parsed.timestamp, list(parsed.actual_q)) == (3, 1.5, [1, 2, 3, 4, 5, 6])
    assert made.build(parsed) == packet
    with pytest.raises(construct.ConstError, match="recipe"):
        made.parse(packet[:3] + b"\4" + packet[4:])


def test_schema_rejects_other_classes_and_versions() -> None:
    with pytest.raises(BadValue, match="has no layout; expected a packet class"):
        schema(int)  # type: ignore[arg-type]
    with pytest.raises(BadVersion):
        schema(RealtimeState, "five")
    with pytest.raises(PacketError, match="does not send it"):
        schema(urlink.packets.SafetyComplianceTolerances, "3.4")


@pytest.mark.captures("ur")
def test_recorded_packets_are_parsed_and_rebuilt() -> None:
    for name, cls, firmware in (
        ("cb2_rt_812.bin", RealtimeState, "1.8"),
        ("cb2_primary_state_1254.bin", RobotState, "1.8"),
        ("eseries_secondary_state_716.bin", RobotState, "5.4"),
        ("urcl_5.24_version_message.bin", urlink.packets.VersionMessage, "5.24"),
        ("urcl_key_message.bin", urlink.packets.KeyMessage, "5.11"),
    ):
        packet = (folder("ur") / name).read_bytes()
        made = schema(cls, firmware)
        assert made.build(made.parse(packet)) == packet, name


def test_printed_schema_shows_fields_offsets_and_types() -> None:
    made = schema(RealtimeState, "5.11")
    assert isinstance(made, construct.Struct)
    lines = str(made).splitlines()
    assert lines[0] == f"RealtimeState, {made.sizeof()} bytes"
    assert lines[1].split() == ["offset", "field", "type", "unit"]
    rows = {line.split()[1]: line.split() for line in lines[2:]}
    assert rows["size"] == ["0", "size", "Int32sb", "=", "1220"]
    for name, place in RealtimeState.LAYOUTS.of("5.11").places.items():
        assert rows[name][0] == str(place.offset)
    assert rows["q_actual"] == ["252", "q_actual", "Float64b[6]", "rad"]


def test_printed_schema_shows_variable_parts() -> None:
    made = str(schema(RobotState, "5.11"))
    assert made.startswith("RobotState, size varies")
    assert "1: JointData" in made
    assert "T_motor" in made
    block = str(schema(urlink.packets.MasterboardData, "5.11"))
    assert any(line.split()[:4] == ["euromap_voltage_24V", "Float32b,", "if", "sent"] for line in block.splitlines())
    joints = str(schema(urlink.packets.JointData, "5.11")).splitlines()
    assert any(line.split()[1:] == ["joint", "Struct[6]"] for line in joints)


@pytest.mark.parametrize("cls", CLASSES)
def test_each_schema_prints_every_field(cls: type[State]) -> None:
    text = str(schema(cls))
    assert text.startswith(cls.__name__)
    for name in cls.LAYOUTS.of(None, dict.fromkeys(cls.LAYOUTS.blocks, True)).places:
        assert f" {name} " in f"{text} ".replace("\n", " "), name
