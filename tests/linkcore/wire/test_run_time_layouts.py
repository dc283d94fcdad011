"""Layouts that are known only at run time, from names and types that the peer sends, as in RTDE."""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from linkcore.errors import PacketError
from linkcore.wire.fields import (
    Coded,
    Field,
    Float64b,
    Header,
    Int8ub,
    Int16ub,
    Int32sb,
    Int32ub,
    Int64ub,
    Shape,
)
from linkcore.wire.layout import Layout
from linkcore.wire.packet import State, packet, wire
from tests.oracle import parse

#: Header with the size, the type of the package, and the number of the recipe.
HEADER = Header(size=Int16ub, type=Int8ub, recipe=Int8ub)

#: Shapes by the vendor's names of the types.
TYPES: dict[str, Shape] = {
    "BOOL": Coded(Int8ub, bool),
    "UINT8": Int8ub,
    "UINT32": Int32ub,
    "UINT64": Int64ub,
    "INT32": Int32sb,
    "DOUBLE": Float64b,
    "VECTOR3D": Float64b[3],
    "VECTOR6D": Float64b[6],
    "VECTOR6INT32": Int32sb[6],
    "VECTOR6UINT32": Int32ub[6],
}


def layout_of(recipe: dict[str, str]) -> Layout:
    fields = [Field(name, TYPES[kind]) for name, kind in recipe.items()]
    return Layout("DataPackage", [(field, field.shape) for field in fields], HEADER, constants={"type": ord("U")})


def class_of(recipe: dict[str, str]) -> type[State]:
    body = {name: wire(TYPES[kind]) for name, kind in recipe.items()}
    return packet(header=HEADER, type=ord("U"), recipe=1)(type("DataPackage", (State,), body))


recipes = st.lists(st.sampled_from(sorted(TYPES)), max_size=40).map(
    lambda kinds: {f"output_{number}": kind for number, kind in enumerate(kinds)}
)


def same(one: Any, other: Any) -> bool:
    """Whether two values are equal in every bit, including NaN."""
    if isinstance(one, np.ndarray):
        return np.array(other, one.dtype).tobytes() == one.tobytes()
    if isinstance(one, float):
        return struct.pack("d", one) == struct.pack("d", other)
    return bool(one == other)


def test_run_time_layout_reads_handwritten_bytes() -> None:
    layout = layout_of({"timestamp": "DOUBLE", "actual_q": "VECTOR6D", "runtime_state": "UINT32"})
    assert layout.size == 4 + 8 + 48 + 4
    data = struct.pack(">HBBd6dI", 64, ord("U"), 1, 12.5, *range(6), 2)
    values = layout.unpack(data)
    assert values[layout.places["timestamp"].at] == 12.5
    assert values[layout.places["actual_q"].at] == (0.0, 1.0, 2.0, 3.0, 4.0, 5.0)
    assert values[layout.places["runtime_state"].at] == 2
    assert layout.encode({"timestamp": 12.5, "actual_q": range(6), "runtime_state": 2})[4:] == data[4:]
    state: Any = class_of({"timestamp": "DOUBLE", "actual_q": "VECTOR6D", "is_on": "BOOL"}).LAYOUTS.decode(
        struct.pack(">HBBd6d?", 61, ord("U"), 1, 12.5, *range(6), True)
    )
    assert (state.timestamp, state.actual_q.tolist(), state.is_on) == (12.5, [0, 1, 2, 3, 4, 5], True)
    with pytest.raises(PacketError, match="the packet is too short") as caught:
        layout.unpack(data[:-1])
    assert (caught.value.packet, caught.value.expected, caught.value.actual) == ("DataPackage", 64, 63)


@pytest.mark.property
@given(recipe=recipes, data=st.data())
def test_run_time_layout_decodes_like_construct(recipe: dict[str, str], data: st.DataObject) -> None:
    layout = layout_of(recipe)
    raw = data.draw(st.binary(min_size=layout.size, max_size=layout.size + 3))
    slowly = parse(layout, raw)
    values = layout.unpack(raw)
    state = class_of(recipe).LAYOUTS.decode(raw)
    assert list(slowly) == list(recipe)
    for name, value in slowly.items():
        place = layout.places[name]
        taken = values[place.at]
        if place.shape.read is not None:
            taken = place.shape.read(taken)
        assert same(taken, value) or same(np.array(taken), value)
        assert same(getattr(state, name), value)
    assert state.tail == raw[layout.size :]
    if "BOOL" not in recipe.values():  # True is written as 1, whatever byte it was read from
        assert layout.encode(slowly)[HEADER.width :] == raw[HEADER.width : layout.size]
