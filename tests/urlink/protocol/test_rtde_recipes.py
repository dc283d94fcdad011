"""RTDE recipes: the table of variables, and layouts that are made from names and types at run time."""

from __future__ import annotations

import copy
import pickle
import struct
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from linkcore.clock import Stamp
from linkcore.errors import BadValue, PacketError
from linkcore.wire.framing import Framer
from tests import real_captures
from tests.fakes.rtde import RequestBoundary
from tests.oracle import parse
from tests.urlink.protocol.rtde_material import recipes, recordings
from urlink.protocol.enums import JointMode, RobotMode
from urlink.protocol.firmware import Firmware
from urlink.protocol.rtde.packets import (
    DataPackage,
    InputsReply,
    OutputsReply,
    Protocol,
    ProtocolReply,
    RtdeBoundary,
    RtdeMessage,
    decode_reply,
    decode_request,
    split_names,
)
from urlink.protocol.rtde.recipes import Outputs, Recipe
from urlink.protocol.rtde.variables import IN_USE, INPUTS, NOT_FOUND, OUTPUTS, TYPES


def recipe_of(names: str, number: int | None = 1) -> Recipe:
    return Recipe(names.split(), [OUTPUTS[name].type for name in names.split()], number)


def same(one: Any, other: Any) -> bool:
    """Whether two values are equal in every bit, even for NaN."""
    if isinstance(one, np.ndarray):
        return np.array(other, one.dtype).tobytes() == one.tobytes()
    if isinstance(one, float):
        return struct.pack("d", one) == struct.pack("d", other)
    return list(one) == list(other) if isinstance(one, tuple) else bool(one == other)


def test_table_of_variables_is_complete() -> None:
    assert (len(OUTPUTS), len(INPUTS)) == (406, 175)
    for table in (OUTPUTS, INPUTS):
        assert all(name == variable.name and variable.type in TYPES for name, variable in table.items())
        assert all(variable.doc and variable.evidence for variable in table.values())
        assert all((variable.since is None) == (variable.evidence == "unverified") for variable in table.values())
    # Variables of both tables are inputs that are read back, so their types are equal.
    assert all(OUTPUTS[name].type == INPUTS[name].type for name in OUTPUTS.keys() & INPUTS.keys())


@pytest.mark.parametrize(
    ("name", "present", "absent"),
    [
        ("actual_q", ["3.3", "5.0", "10.7"], ["1.8", "3.2"]),
        ("output_int_register_24", ["3.9", "5.3"], ["3.8", "5.2"]),
        ("payload", ["3.11", "5.5.1", "10.7"], ["3.10", "5.5"]),
        ("actual_current_as_torque", ["5.23", "10.11"], ["3.15", "5.22", "10.10"]),
        ("ft_raw_wrench", ["5.9", "10.7"], ["3.15", "5.8"]),
        ("control_step", ["3.3", "5.25"], ["1.8"]),
    ],
)
def test_variable_exists_in_listed_firmware(name: str, present: list[str], absent: list[str]) -> None:
    assert all(OUTPUTS[name].is_in(Firmware.parse(version)) for version in present)
    assert not any(OUTPUTS[name].is_in(Firmware.parse(version)) for version in absent)


def test_package_of_ur_client_library_is_decoded() -> None:
    """The tests of the UR Client Library use this package of 20 bytes."""
    data = bytes.fromhex("0014 55 01 40d007 0d2b 020c 4a 3ff0000000000000".replace(" ", ""))
    recipe = recipe_of("timestamp target_speed_fraction")
    assert recipe.size == len(data)
    values = recipe.decode(data)
    assert values["target_speed_fraction"] == 1.0
    assert values["timestamp"] == pytest.approx(16412.206, abs=1e-3)
    state: Any = recipe.state_class().LAYOUTS.decode(data)
    assert (state.timestamp, state.target_speed_fraction) == (values["timestamp"], 1.0)
    assert recipe.encode(values) == data
    assert recipe_of("timestamp target_speed_fraction", None).encode(values) == b"\0\x13U" + data[4:]


def test_state_class_has_types_units_and_values() -> None:
    recipe = recipe_of("timestamp actual_q robot_mode joint_mode output_bit_register_64 actual_digital_input_bits")
    data = recipe.encode(
        {
            "timestamp": 41.5,
            "actual_q": [0, -1, 2, 3, 4, 5],
            "robot_mode": 7,
            "joint_mode": [253] * 6,
            "output_bit_register_64": True,
            "actual_digital_input_bits": 2**63 + 1,
        }
    )
    cls: Any = recipe.state_class()
    state = cls.LAYOUTS.decode(data, None, Stamp(1.0, 2.0))
    assert issubclass(cls, Outputs)
    assert state.robot_mode is RobotMode.RUNNING
    assert state.joint_mode == (JointMode.RUNNING,) * 6
    assert state.output_bit_register_64 is True
    assert state.actual_digital_input_bits == 2**63 + 1
    assert not state.actual_q.flags.writeable
    assert state.to_dict()["robot_mode"] == "RUNNING"
    assert "<td>actual_q</td><td>[0, -1, 2, 3, 4, 5]</td><td>rad</td>" in state._repr_html_()
    many = np.frombuffer(data * 3, cls.dtype())
    assert many["actual_q"][2].tolist() == [0, -1, 2, 3, 4, 5]
    again = pickle.loads(pickle.dumps(state))
    assert (again, again.received, type(again)) == (state, state.received, cls)
    assert copy.deepcopy(state) == state
    assert cls(timestamp=2.0) == cls(timestamp=2.0) != state
    assert recipe_of("timestamp").state_class() is recipe_of("timestamp").state_class()


class Cell(Outputs):
    __slots__ = ()
    timestamp: float


def test_state_class_can_be_subclassed() -> None:
    state = recipe_of("timestamp").state_class(Cell)(timestamp=3.0)
    assert isinstance(state, Cell)
    assert state.timestamp == 3.0
    assert pickle.loads(pickle.dumps(state)) == state


def test_duplicate_name_is_decoded_but_has_no_state_class() -> None:
    recipe = recipe_of("timestamp runtime_state timestamp timestamp")
    data = recipe.encode({"timestamp": 5.0, "runtime_state": 2})
    assert data[4:12] == data[16:24] == data[24:32]
    assert recipe.decode(data) == {"timestamp": 5.0, "runtime_state": 2}
    with pytest.raises(BadValue, match="twice"):
        recipe.state_class()
    with pytest.raises(BadValue, match="speed"):
        recipe.encode({"speed": 1})


def test_invalid_recipe_is_rejected() -> None:
    with pytest.raises(BadValue, match="1 types for 2 names"):
        Recipe(["a", "b"], ["DOUBLE"])
    for bad in (NOT_FOUND, IN_USE, "STRING", "nonsense"):
        with pytest.raises(BadValue, match=f"a has the type {bad}"):
            Recipe(["a"], [bad])
    for number in (0, 256):
        with pytest.raises(BadValue, match="recipe number"):
            Recipe([], [], number)
    assert Recipe(["a", "b"], ["DOUBLE", "BOOL"]).decode(b"\0\x0dU\1" + bytes(8) + b"\2") == {"a": 0.0, "b": True}


def test_mismatched_packages_and_values_are_rejected() -> None:
    recipe = recipe_of("timestamp", 3)
    data = recipe.encode({"timestamp": 1.0})
    for bad in (data[:-1], data + b"\0"):
        with pytest.raises(PacketError, match="its size is not the size of recipe 3: expected 12 bytes"):
            recipe.decode(bad)
    with pytest.raises(PacketError, match="belongs to recipe 4, not 3"):
        recipe.decode(data[:3] + b"\4" + data[4:])
    with pytest.raises(BadValue, match="runtime_state"):
        recipe_of("runtime_state").encode({"runtime_state": -1})
    with pytest.raises(BadValue, match="actual_q: expected 6"):
        recipe_of("actual_q").encode({"actual_q": [1, 2]})


def test_vectors_at_unaligned_offsets_are_decoded() -> None:
    vectors = [f"v{number}" for number in range(9)]
    # One, four and eight bytes lie between the vectors, so the first three vectors all have different alignments.
    between = {"a": "UINT8", "b": "INT32", "c": "DOUBLE", "d": "VECTOR6INT32", "e": "BOOL"}
    order = ["v0", "a", "v1", "b", "v2", "c", "v3", "d", "v4", "v5", "e", "v6", "v7", "v8"]
    recipe = Recipe(order, [between.get(name, "VECTOR6D") for name in order])
    values: dict[str, Any] = {name: [number + 0.5 * joint for joint in range(6)] for number, name in enumerate(vectors)}
    values |= {"a": 200, "b": -5, "c": 0.25, "d": [1, -2, 3, -4, 5, -6], "e": True}
    package = recipe.encode(values)
    state = recipe.state_class().LAYOUTS.decode(package)
    for name, value in values.items():
        assert np.array_equal(getattr(state, name), value), name
    assert not state.v0.flags.writeable
    assert state == recipe.state_class()(**values)
    with pytest.raises(PacketError, match="too short"):
        recipe.state_class().LAYOUTS.all[0].decode(package[:-1])


@pytest.mark.property
@given(drawn=recipes, number=st.one_of(st.none(), st.integers(1, 255)), data=st.data())
def test_recipe_decodes_like_construct(drawn: dict[str, str], number: int | None, data: st.DataObject) -> None:
    recipe = Recipe(list(drawn), list(drawn.values()), number)
    head = recipe.header.pack(**recipe.constants, size=recipe.size)
    body = data.draw(st.binary(min_size=recipe.size - len(head), max_size=recipe.size - len(head)))
    slowly = parse(recipe.layout, head + body)
    values = recipe.decode(head + body)
    state = recipe.state_class().LAYOUTS.decode(head + body)
    assert list(slowly) == list(values) == list(drawn)
    for name, value in slowly.items():
        assert same(np.array(values[name]), value) or same(values[name], value)
        assert same(getattr(state, name), value)
    if "BOOL" not in drawn.values():  # True is always written as 1, although other values are also read as True
        assert recipe.encode(values) == head + body


@pytest.mark.captures("rtde")
def test_recorded_data_packages_fit_their_recipes() -> None:
    """The recipes of real clients fit the data packages of the same connection, in both directions."""
    outputs = inputs = misfits = 0
    for recording in recordings(real_captures.folder("rtde")):
        requests = Framer(RequestBoundary()).feed(recording.sent)
        # Replies arrive in the order of the requests; the meaning of a request depends on earlier replies.
        unanswered = [frame for frame in requests if frame[2] not in b"MU"]
        protocol: Protocol = 1
        recipe: Recipe | None = None
        claimed: dict[int | None, Recipe] = {}
        for frame in Framer(RtdeBoundary()).feed(recording.received):
            reply: Any = decode_reply(frame, protocol)
            if isinstance(reply, DataPackage):
                # Packages before the reply to the next recipe request still belong to the previous recipe.
                if recipe is not None and reply.recipe == recipe.number:
                    state = recipe.state_class().LAYOUTS.decode(frame)
                    values = recipe.decode(frame)
                    assert all(same(np.array(values[name]), getattr(state, name)) for name in recipe.names)
                    outputs += 1
                continue
            if isinstance(reply, RtdeMessage):
                continue
            request: Any = decode_request(unanswered.pop(0), protocol)
            if isinstance(reply, ProtocolReply):
                protocol = request.wanted if reply.accepted else protocol
            elif isinstance(reply, (OutputsReply, InputsReply)):
                names, types = split_names(request.names), split_names(reply.types)
                assert len(names) == len(types), recording.name
                if isinstance(reply, OutputsReply):
                    recipe = Recipe(names, types, reply.recipe) if set(types) <= TYPES.keys() else None
                elif reply.recipe:
                    claimed[reply.recipe] = Recipe(names, types, reply.recipe, INPUTS)
        for frame in requests:
            package: Any = decode_request(frame, 2)
            if isinstance(package, DataPackage) and package.recipe in claimed:
                try:
                    claimed[package.recipe].decode(frame)
                    inputs += 1
                except PacketError:
                    misfits += 1  # setExternalForceTorque of ur_rtde sends 52 bytes instead of 56
    assert outputs > 1000
    assert inputs > 1000
    assert 0 < misfits < 20
