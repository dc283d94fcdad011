"""The layouts of one packet class: how each decodes, and the choice among them by version and by size."""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any

from ..errors import PacketError, unraised
from .fields import Field, Header, Shape, Version, parse_version, version_text
from .layout import Layout
from .split import Split, split_indices

if TYPE_CHECKING:
    from ..clock import Stamp
    from .packet import State


class StateLayout(Layout):
    """A layout whose values a packet class gives their types.

    Attributes:
        packet: that class.
        decode: ``decode(data, stamp=None)``: the state in one whole packet, header included. Raises `PacketError`.
        kept: ``kept(data)``: the values that a state keeps, but for those of cells.
    """

    decode: Callable[..., Any]

    def __init__(self, packet: type[State], *args: Any, is_split: bool, **kwargs: Any) -> None:
        super().__init__(packet.__name__, *args, names=tuple(packet.FIELDS), **kwargs)
        self.packet = packet
        self.kept, self._split = self.unpack, None
        self._numbers = self.struct
        if is_split:
            self._split = Split(self.places.values(), self.size)
            self._numbers = self._split.numbers
            self.kept = self._numbers.unpack_from
            at = split_indices(self.fields)
            self.at = [at[name] for name in packet.FIELDS]
        self.reads = [self.places[name].shape.read if name in self.places else None for name in packet.FIELDS]
        self.offsets = [self.places[name].offset if name in self.places else None for name in packet.FIELDS]
        self.decode = self._cell_decoder() if self.of_cells else self._decoder()

    def vectors(self, state: State) -> Any:
        """What the vectors of `state` are items of: its values as one read-only float64 array, or its vectors; kept."""
        # To make one vector takes as long as to make all.
        if self._split is not None:
            made = self._split.vectors(state._data)
        else:
            made = self.unpack(state._data) if self.of_cells else self.as_doubles(state._values)
        state._vectors = made
        return made

    def _cell_decoder(self) -> Callable[..., Any]:
        packet, size, new = self.packet, self.size, object.__new__

        def decode(data: bytes, stamp: Stamp | None = None) -> Any:
            # Nothing is swapped before it is asked for: at 500 Hz, with the caches cold, numpy takes 20 to 30 us for
            # one packet, in the thread that reads, and a subscriber that reads a few numbers needs no array.
            if len(data) < size:
                raise self.too_short(data)
            state = new(packet)
            state._data = data
            state._layout = self
            state._stamp = stamp
            state._values = None
            state._vectors = None
            return state

        return decode

    def _decoder(self) -> Callable[..., Any]:
        packet, unpack, new = self.packet, self.unpack, object.__new__
        unpack_from = None if self._numbers is None else self._numbers.unpack_from

        def decode(data: bytes, stamp: Stamp | None = None) -> Any:
            state = new(packet)
            state._data = data
            state._layout = self
            state._stamp = stamp
            state._vectors = None
            state._values = unpack(data)
            return state

        def decode_with_struct(data: bytes, stamp: Stamp | None = None) -> Any:
            # The same, one call shorter: a robot state has 13 parts.
            state = new(packet)
            state._data = data
            state._layout = self
            state._stamp = stamp
            state._vectors = None
            try:
                state._values = unpack_from(data)  # type: ignore[misc]
            except struct.error:
                raise self.too_short(data) from None
            return state

        return decode if unpack_from is None else decode_with_struct


class StateLayouts:
    """Every distinct order of fields that some version sends, each lowered once, when the first of them is asked for.

    Args:
        packet: the class.
        header, constants, of_cells: as for `Layout`.
        reorder: ``((3, 0), names)``: versions before 3.0 send the fields in this other order.
        is_split: each is taken in two parts; see `linkcore.wire.split`.

    Attributes:
        blocks: names of the fields that say whether the optional block is sent.
    """

    def __init__(
        self,
        packet: type[State],
        header: Header,
        constants: Mapping[str, int],
        reorder: tuple[Version, Sequence[str]] | None,
        *,
        of_cells: bool,
        is_split: bool,
    ) -> None:
        self._name = packet.__name__
        self._fields = packet.FIELDS
        self._lower = partial(
            StateLayout, packet, header=header, constants=constants, of_cells=of_cells, is_split=is_split
        )
        self._reorder = reorder
        self.blocks = {field.block for field in self._fields.values() if field.block is not None}
        self._chosen: dict[tuple[Version, bool], StateLayout] = {}  # what `of` has found
        # (size, version) -> the layouts that fit, and the decoder where these two alone decide
        self._known: dict[tuple[int, Version | None], tuple[list[StateLayout], Callable[..., Any] | None]] = {}

    @cached_property
    def all(self) -> tuple[StateLayout, ...]:
        """Every distinct layout, oldest first."""
        return tuple(dict.fromkeys(self._by_version.values()))

    @cached_property
    def _by_version(self) -> dict[tuple[Version, bool], StateLayout]:
        """The layout from each version on at which something changes, without and with the block."""
        steps = {step for field in self._fields.values() for step in field.steps}
        if self._reorder is not None:
            steps.add(self._reorder[0])
        known: dict[Any, StateLayout] = {}
        found = {}
        for version in sorted(steps) or [(0, 0)]:
            for has_block in (False, True) if self.blocks else (False,):
                fields = self._sent(version, has_block)
                if not fields and self._fields:
                    continue
                key = tuple((field.name, id(shape)) for field, shape in fields)
                if key not in known:
                    known[key] = self._lower(fields, first=version, has_block=has_block)
                found[version, has_block] = known[key]
        return found

    def _sent(self, version: Version, has_block: bool) -> list[tuple[Field, Shape]]:
        order: Sequence[str] = list(self._fields)
        if self._reorder is not None and version < self._reorder[0]:
            order = self._reorder[1]
        shapes = ((field, field.shape_in(version)) for field in map(self._fields.__getitem__, order))
        return [(field, shape) for field, shape in shapes if shape is not None and (has_block or field.block is None)]

    def of(self, version: str | Version | None = None, values: Mapping[str, Any] | None = None) -> StateLayout:
        """The layout that `version` sends, or the newest; with its block if `values` asks for it.

        Raises:
            PacketError: that version does not send this packet.
        """
        has_block = any((values or {}).get(block) for block in self.blocks)
        if version is None:
            return next(layout for layout in reversed(self.all) if layout.has_block == has_block)
        version = parse_version(version)
        found = self._chosen.get((version, has_block))
        if found is None:
            steps = [step for step, block in self._by_version if block == has_block and step <= version]
            if not steps or (self._fields and not self._sent(version, has_block)):
                raise PacketError("not sent by this firmware", packet=self._name, version=version_text(version))
            found = self._chosen[version, has_block] = self._by_version[max(steps), has_block]
        return found

    def fitting(self, size: int, version: Version | None = None) -> list[StateLayout]:
        """The layouts that a packet of `size` bytes can have, best first.

        An exact size wins, then the longest that fits: what is left over is the tail. With a version, its own layout is
        the least that will do, and only layouts that extend it come into question, since a newer release appends. Where
        a release took fields away, its first builds may still send them: an exact size of the same generation will do,
        if it is larger.

        Raises:
            PacketError: the packet is shorter than its version's layout, or than any.
        """
        candidates = list(self.all)
        least = min(layout.size for layout in candidates)
        if version is not None:
            own = [self.of(version)]
            if self.blocks:
                own.append(self.of(version, dict.fromkeys(self.blocks, True)))
            least = own[0].size
            candidates = [
                layout
                for layout in candidates
                if any(layout.fields[: len(mine.fields)] == mine.fields for mine in own)
                or (layout.first[0] == version[0] and layout.size == size > least and not layout.has_text)
            ]
        fits = [layout for layout in candidates if layout.size <= size]
        if not fits:
            raise PacketError(
                "packet too short",
                packet=self._name,
                version=None if version is None else version_text(version),
                expected=least,
                actual=size,
                offset=size,
            )
        return sorted(fits, key=lambda layout: (layout.size == size, layout.size), reverse=True)

    def decode(self, data: bytes, version: Version | None = None, stamp: Stamp | None = None) -> Any:
        """The typed state of one whole packet, header included.

        Raises:
            PacketError: no layout holds it.
        """
        key = (len(data), version)
        known = self._known.get(key)
        if known is None:
            known = self.fitting(*key), self.decoder(*key)
            if len(self._known) < 256:  # lengths come from the wire: keep no more than a few
                self._known[key] = known
        fits, decode = known
        if decode is not None:
            return decode(data, stamp)
        failure: PacketError | None = None
        for layout in fits:
            try:
                state = layout.decode(data, stamp)
            except PacketError as error:
                failure = failure or unraised(error)  # whose traceback would refer to this frame
                continue
            if all(bool(getattr(state, block)) == layout.has_block for block in self.blocks):
                return state
        if failure is not None:
            try:
                raise failure
            finally:
                del failure  # it refers to this frame
        return fits[0].decode(data, stamp)

    def decoder(self, size: int, version: Version | None = None) -> Callable[..., Any] | None:
        """The decoder of packets of this size, or None where their content has to choose.

        Raises:
            PacketError: no layout holds such a packet.
        """
        fits = self.fitting(size, version)
        by_text = fits[0].has_text and len(fits) > 1
        by_block = len({layout.has_block for layout in fits}) > 1
        return None if by_text or by_block else fits[0].decode
