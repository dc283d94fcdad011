from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from linkcore.errors import BadValue, LocalError
from linkcore.wire.packet import State
from urlink.arm.kinematics import Arm
from urlink.arm.models import MODELS, UnknownModel
from urlink.protocol.enums import JointMode, RobotMode, RobotModeCB2, SafetyMode
from urlink.protocol.firmware import NEWEST, RELEASES, Firmware, Release, infer, release_of
from urlink.protocol.primary.robot_message import (
    NO_TIMESTAMP,
    SafetyComplianceTolerances,
    SafetyModeMessage,
    UnnamedMessage12,
    VersionMessage,
)
from urlink.protocol.primary.robot_state import (
    SUB_PACKAGES,
    CartesianInfo,
    ConfigurationData,
    ForceModeData,
    JointData,
    KinematicsInfo,
    MasterboardData,
    RobotModeData,
    RobotState,
    SubPackage,
)
from urlink.protocol.realtime.packets import RealtimeState
from urlink.simulator import Controller, Demonstration, messages
from urlink.simulator.interfaces.interface import Form
from urlink.simulator.interfaces.primary import _MEASURED, _SHOWN, _UNCHANGING
from urlink.simulator.interfaces.realtime import FIELDS
from urlink.simulator.state import StopCause
from urlink.simulator.urscript import ProgramError


def suits(release: Release, name: str) -> bool:
    if release.since.is_e_series:
        return MODELS[name].generation == "e"
    return MODELS[name].generation == "CB" and not (name == "UR3" and release.since.is_cb2)


COMBINATIONS = [
    pytest.param(release, name, id=f"{name}-{release.since}")
    for release in RELEASES
    for name in MODELS
    if suits(release, name)
]


def parts(state: bytes) -> dict[int, bytes]:
    """Return the bytes of each sub-package by its type, in the order of the package."""
    assert int.from_bytes(state[:4], "big") == len(state)
    assert state[4] == 16
    found = {}
    offset = 5
    while offset < len(state):
        size = int.from_bytes(state[offset : offset + 4], "big")
        assert 5 <= size <= len(state) - offset
        found[state[offset + 4]] = state[offset : offset + size]
        offset += size
    return found


def decoded(part: bytes, firmware: Firmware) -> SubPackage:
    for cls in SUB_PACKAGES[part[4]]:
        for layout in cls.LAYOUTS.all:
            if layout.size == len(part):
                state: SubPackage = cls.LAYOUTS.decode(part, firmware)
                return state
    raise AssertionError(f"no layout of {len(part)} bytes for sub-package {part[4]}")


@pytest.mark.parametrize(("release", "name"), COMBINATIONS)
def test_packets_have_the_sizes_of_their_firmware(release: Release, name: str) -> None:
    controller = Controller(name, release.since, motion=Demonstration())
    controller.step(40)

    packet = controller.realtime_packet()
    assert len(packet) == release.realtime
    state = RealtimeState.LAYOUTS.decode(packet)
    assert state.tail == b""
    assert state.time == 40 / release.since.rate
    mode = RobotModeCB2.RUNNING if release.since.is_cb2 else RobotMode.RUNNING
    assert state.robot_mode == (None if release.since < (1, 6) else mode)

    first, later = controller.state_package(first=True), controller.state_package()
    assert {kind: len(part) for kind, part in parts(first).items()} == release.state
    assert list(parts(first)) == list(release.state)
    assert len(first) == release.first_state_size
    assert list(parts(later)) == [kind for kind in release.state if kind not in release.first_state_only]
    assert len(later) == release.state_size
    subs = [decoded(part, release.since) for part in parts(first).values()]
    assert all(sub.tail == b"" for sub in subs)
    found = infer(RobotState(*subs).sizes)
    # Releases with the same state sizes differ only in their real-time packet.
    assert found is not None
    assert release_of(found).state_size == release.state_size


def fields_of(controller: Controller, kind: int) -> dict[str, Any]:
    """Return the fields of one sub-package of the robot state of this cycle."""
    fields: dict[str, Any] = {}
    for table in (_SHOWN, _UNCHANGING):
        if kind in table:
            fields |= table[kind](controller._state)
    if kind in _MEASURED:
        fields |= _MEASURED[kind](controller._states._measured())
    return fields


@pytest.mark.parametrize(("release", "name"), COMBINATIONS)
def test_packet_forms_encode_the_same_bytes_as_layouts(release: Release, name: str) -> None:
    controller = Controller(name, release.since, motion=Demonstration())
    controller.signals.set_digital_output(3, True)
    controller.signals.set_digital_input(16, True)
    controller.step(77)
    layout = RealtimeState.LAYOUTS.of(release.since)
    packet = controller._realtime.packet()
    assert bytes(packet) == controller.realtime_packet() == layout.encode({name: packet.field(name) for name in FIELDS})
    for kind, part in parts(controller.state_package(first=True)).items():
        fields = fields_of(controller, kind)
        cls: type[State] = type(decoded(part, release.since))
        known = {key: value for key, value in fields.items() if key in cls.FIELDS}
        assert part == cls.LAYOUTS.of(release.since).encode(known), cls.__name__


def test_form_rejects_a_layout_with_text() -> None:
    with pytest.raises(AssertionError, match="VersionMessage has no fixed size"):
        Form(VersionMessage.LAYOUTS.of("5.11"))


def test_realtime_packet_and_robot_state_have_equal_values() -> None:
    controller = Controller("UR10e", "5.11", motion=Demonstration())
    controller.arm.tcp = [0.0, 0.01, 0.1, 0.1, 0.2, 0.3]
    controller.signals.digital_inputs = 0x10102
    controller.signals.digital_outputs = 0x20001
    controller.signals.set_analog_input(1, 3.5)
    controller.step(700)
    now = RealtimeState.LAYOUTS.decode(controller.realtime_packet())
    subs = {
        type(sub): sub
        for sub in (decoded(p, controller.firmware) for p in parts(controller.state_package(True)).values())
    }

    mode, joints = subs[RobotModeData], subs[JointData]
    assert isinstance(mode, RobotModeData)
    assert isinstance(joints, JointData)
    assert mode.timestamp == 1_400_000
    assert now.time == 1.4
    assert mode.is_program_running
    assert not mode.is_protective_stopped
    assert (joints.q_actual == now.q_actual).all()
    assert (joints.q_target == now.q_target).all()
    assert (joints.qd_actual == now.qd_actual).all()
    assert joints.I_actual == pytest.approx(now.I_actual, rel=1e-6)
    assert joints.joint_modes == now.joint_modes == (JointMode.RUNNING,) * 6

    cartesian = subs[CartesianInfo]
    assert isinstance(cartesian, CartesianInfo)
    pose = [cartesian.X, cartesian.Y, cartesian.Z, cartesian.Rx, cartesian.Ry, cartesian.Rz]
    assert pose == now.tool_vector_actual.tolist()
    assert pose == pytest.approx(Arm(controller.model).forward(now.q_actual, controller.arm.tcp), abs=1e-12)
    assert cartesian.tcp_offset_Rz == 0.3

    board = subs[MasterboardData]
    assert isinstance(board, MasterboardData)
    assert board.digital_input_bits == now.digital_input_bits == 0x10102
    assert board.digital_output_bits == now.digital_output_bits == 0x20001
    assert board.analog_input_1 == 3.5
    assert board.safety_mode == now.safety_mode == now.safety_status == SafetyMode.NORMAL

    force = subs[ForceModeData]
    assert isinstance(force, ForceModeData)
    determinant = np.linalg.det(Arm(controller.model).jacobian(now.q_target))
    assert force.robot_dexterity == pytest.approx(determinant**2)


def test_first_state_contains_geometry_and_limits() -> None:
    controller = Controller("UR20", "5.25", motion=Demonstration())
    subs = [decoded(part, NEWEST) for part in parts(controller.state_package(first=True)).values()]
    (chain,) = (sub for sub in subs if isinstance(sub, KinematicsInfo))
    (limits,) = (sub for sub in subs if isinstance(sub, ConfigurationData))
    assert (chain.dh_a == controller.model.dh_a).all()
    assert (chain.dh_d == controller.model.dh_d).all()
    assert (limits.dh_alpha == controller.model.dh_alpha).all()
    assert limits.robot_type == 7
    assert (limits.joint_max_speed > controller.model.max_speed).all()
    assert (limits.joint_max_limit > limits.joint_min_limit).all()


def heads(controller: Controller, port: str) -> list[tuple[int, int]]:
    return [(len(package), package[4]) for package in controller.greeting(port)]


def test_greeting_matches_the_captured_connections() -> None:
    # The sizes come from real captures of 3.3 and 3.10, from a simulated 5.4, and from the secondary port of 5.12.
    assert heads(Controller("UR5", "3.3.1.60"), "secondary") == [(56, 20), (24, 20), (1306, 16)]
    assert heads(Controller("UR10", "3.10"), "primary") == [(55, 20), (24, 20), (181, 24), (1352, 16)]
    assert heads(Controller("UR5e", "5.8"), "primary") == [(55, 20), (24, 20), (181, 24), (1386, 16)]
    assert heads(Controller("UR5e", "5.12"), "secondary_readonly") == [(55, 20), (24, 20), (1386, 16)]
    assert heads(Controller("UR5e", "5.3"), "primary") == [(55, 20), (24, 20), (1384, 16)]
    assert [kind for _, kind in heads(Controller("UR5", "1.8"), "primary")] == [20, 16]
    assert heads(Controller("UR5e", "5.12"), "realtime") == []


def test_version_message_contains_the_firmware() -> None:
    newer = VersionMessage.LAYOUTS.decode(Controller("UR3e", "5.11.2.1042").greeting("primary")[0])
    assert newer.timestamp == NO_TIMESTAMP
    assert (newer.project_name, newer.major, newer.minor, newer.bugfix, newer.build) == ("URControl", 5, 11, 2, 1042)
    older = VersionMessage.LAYOUTS.decode(Controller("UR5", "3.2.19293").greeting("primary")[0])
    assert (older.major, older.minor, older.svn_revision) == (3, 2, 19293)


def test_message_12_and_tolerances_match_the_capture() -> None:
    packages = Controller("UR5e", "5.8").greeting("primary")
    assert packages[1].hex() == "0000001814fffffffffffffffffe0c000000000000000001"
    assert UnnamedMessage12.LAYOUTS.decode(packages[1]).third == 1
    tolerances = SafetyComplianceTolerances.LAYOUTS.decode(packages[2]).tolerances
    assert tolerances[:4].tolist() == [0.15, 25.0, 0.0, 2.0]


def test_primary_interface_reports_a_stop() -> None:
    controller = Controller("UR5e", "5.11", motion=Demonstration())
    controller.faults.protective_stop()
    controller.step()
    report, change = controller.take_messages()
    assert (report[4], report[14]) == (20, 6)
    assert SafetyModeMessage.LAYOUTS.decode(change).safety_mode == SafetyMode.PROTECTIVE_STOP
    controller.step()
    assert controller.take_messages() == []
    controller.faults.clear()
    controller.step()
    (change,) = controller.take_messages()
    assert SafetyModeMessage.LAYOUTS.decode(change).safety_mode == SafetyMode.NORMAL


def test_cb2_has_no_safety_mode_message() -> None:
    controller = Controller("UR5", "1.8", motion=Demonstration())
    controller.faults.emergency_stop()
    controller.step()
    (report,) = controller.take_messages()
    assert report[14] == 6


@pytest.mark.parametrize(
    ("name", "firmware"),
    [("UR5e", "3.14"), ("UR5e", "1.8"), ("UR20", "3.5"), ("UR5", "5.0"), ("UR10", "5.11"), ("UR3", "1.8")],
)
def test_controller_rejects_firmware_of_other_models(name: str, firmware: str) -> None:
    with pytest.raises(BadValue, match=f"{name} does not run firmware {firmware}"):
        Controller(name, firmware)


def test_controller_defaults_for_model_and_firmware() -> None:
    assert Controller("UR5e").firmware == NEWEST
    assert Controller("UR3").firmware == (3, 14, 0, 0)
    assert Controller().model.name == "UR5e"
    assert Controller(firmware="1.8").model.name == "UR5"
    assert Controller("ur16E", "5.9").model.name == "UR16e"


def test_controller_with_wrong_arguments_raises_local_error() -> None:
    with pytest.raises(UnknownModel):
        Controller("UR6")
    with pytest.raises(LocalError, match=r"firmware 2\.0"):
        Controller("UR5", "2.0")
    with pytest.raises(BadValue, match=r"ports=\{'modbus': 0\}; expected 'free'"):
        Controller(ports={"modbus": 0})


# -- completeness of the fields ------------------------------------------------------------------


@pytest.mark.parametrize(("release", "name"), COMBINATIONS)
def test_every_packet_has_a_value_for_each_field(release: Release, name: str) -> None:
    """The check ensures that no field is zero only because the simulator forgot it."""
    controller = Controller(name, release.since)
    RealtimeState.LAYOUTS.of(release.since).check_complete(FIELDS.keys())
    for part in parts(controller.state_package(first=True)).values():
        fields = fields_of(controller, part[4])
        type(decoded(part, release.since))(release.since)._layout.check_complete(fields)


@pytest.mark.parametrize("release", RELEASES, ids=lambda release: str(release.since))
def test_every_message_has_a_value_for_each_field(release: Release) -> None:
    state = Controller("UR5e" if release.since.is_e_series else "UR5", release.since)._state
    # Each call raises `BadValue` if a field has no value.
    messages.greeting(state, "primary")
    for stop in (state.modes.protective_stop, state.modes.emergency_stop):
        stop()
        for cause in (StopCause(), StopCause(by_program=True, reason="because")):
            assert messages.safety_messages(state, cause)
    messages.program_started(state, "name")
    messages.program_stopped(state, "name")
    messages.text_message(state, "text")
    messages.runtime_exception(state, ProgramError(1, 1, "wrong"), is_running=False)
    messages.popup_message(state, "text", "title", False, False, False)


def test_form_rejects_a_first_packet_with_missing_fields() -> None:
    form = Form(RealtimeState.LAYOUTS.of("1.5"))
    with pytest.raises(BadValue, match=r"RealtimeState: no value for time, q_target, .*, unused"):
        form.pack({"qd_target": [0.0] * 6})
