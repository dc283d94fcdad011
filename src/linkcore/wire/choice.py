"""The layouts of one packet, and the choice among them by version and by size."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from typing import Any, Generic, TypeVar

from ..errors import PacketError
from .fields import Field, Shape, Version, parse_version, version_text
from .layout import Layout

L = TypeVar("L", bound=Layout)


class Layouts(Generic[L]):
    """Every distinct order of fields that some version sends, each lowered once, when the first of them is asked for.

    Args:
        name: of the packet, for errors.
        fields: name -> declaration, in declared order.
        lower: makes a layout: first version, fields with their shapes, whether the optional block is in it.
        reorder: ``((3, 0), names)``: versions before 3.0 send the fields in this other order.

    Attributes:
        blocks: names of the fields that say whether the optional block is sent.
    """

    def __init__(
        self,
        name: str,
        fields: Mapping[str, Field],
        lower: Callable[[Version, list[tuple[Field, Shape]], bool], L],
        reorder: tuple[Version, Sequence[str]] | None = None,
    ) -> None:
        self._name = name
        self._fields = fields
        self._lower = lower
        self._reorder = reorder
        self.blocks = {field.block for field in fields.values() if field.block is not None}
        self._chosen: dict[tuple[Version, bool], L] = {}  # what `of` has found

    @cached_property
    def all(self) -> tuple[L, ...]:
        """Every distinct layout, oldest first."""
        return tuple(dict.fromkeys(self._by_version.values()))

    @cached_property
    def _by_version(self) -> dict[tuple[Version, bool], L]:
        """The layout from each version on at which something changes, without and with the block."""
        steps = {step for field in self._fields.values() for step in field.steps}
        if self._reorder is not None:
            steps.add(self._reorder[0])
        known: dict[Any, L] = {}
        found = {}
        for version in sorted(steps) or [(0, 0)]:
            for has_block in (False, True) if self.blocks else (False,):
                fields = self._sent(version, has_block)
                if not fields and self._fields:
                    continue
                key = tuple((field.name, id(shape)) for field, shape in fields)
                if key not in known:
                    known[key] = self._lower(version, fields, has_block)
                found[version, has_block] = known[key]
        return found

    def _sent(self, version: Version, has_block: bool) -> list[tuple[Field, Shape]]:
        order: Sequence[str] = list(self._fields)
        if self._reorder is not None and version < self._reorder[0]:
            order = self._reorder[1]
        shapes = ((field, field.shape_in(version)) for field in map(self._fields.__getitem__, order))
        return [(field, shape) for field, shape in shapes if shape is not None and (has_block or field.block is None)]

    def of(self, version: str | Version | None = None, values: Mapping[str, Any] | None = None) -> L:
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

    def fitting(self, size: int, version: Version | None = None) -> list[L]:
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
