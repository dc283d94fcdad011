"""Packet whose bytes are made when they are read; see `linkcore.deferred`."""

from __future__ import annotations

import struct
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np

from ..deferred import Deferred

if TYPE_CHECKING:
    from ..clock import Stamp
    from .layout import Place
    from .state_layouts import StateLayout


class DeferredPacket(Deferred):
    """Packet whose bytes are made when they are read, and whose fields can be read without its bytes.

    Args:
        layout: Layout of the packet.
        head: First bytes of the packet, which a framer needs: its size and its time.
        is_steady: See `Deferred`.
    """

    __slots__ = ("layout",)

    def __init__(self, layout: StateLayout, head: bytes, is_steady: bool) -> None:
        super().__init__(head, is_steady)
        self.layout = layout

    def __len__(self) -> int:
        return self.layout.size

    def field(self, name: str) -> Any:
        """Return the number of one field, or a sequence of its numbers, as they are encoded in the bytes."""
        raise NotImplementedError

    def state(self, stamp: Stamp | None) -> Any:
        """Return the state in this packet."""
        state = object.__new__(self.layout.packet)
        state._data = state._values = self
        state._layout = self.layout
        state._stamp = stamp
        return state

    def numbers(self, name: str) -> tuple[Any, ...]:
        """Return the numbers of one field, as they are decoded from the bytes."""
        place, value = self.layout.places[name], self.field(name)
        form = _form(place)
        return form.unpack(form.pack(value) if place.count is None else form.pack(*value))

    def __getitem__(self, items: slice) -> Any:
        """Return one array of floats, given its items in the array that `StateLayout.swap` would make."""
        array = np.array(self.field(self.layout.arrays[items.start]), np.float64)
        array.flags.writeable = False
        return array


@cache
def _form(place: Place) -> struct.Struct:
    assert place.number is not None, "there is no text"
    return struct.Struct(f">{place.count or 1}{place.number.code}")
