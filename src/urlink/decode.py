"""`decode`: bytes to typed states, no robot, no thread."""

from __future__ import annotations

from typing import Literal, overload

from linkcore.errors import BadValue, PacketError
from linkcore.wire.packet import State

from .firmware import Firmware, release_of
from .interfaces.primary.protocol import PackageBorder, PackageDecoder
from .interfaces.realtime.packets import RealtimeState
from .interfaces.realtime.protocol import RealtimeBorder

__all__ = ["INTERFACES", "Interface", "decode"]

Interface = Literal["realtime", "primary", "secondary"]
INTERFACES: tuple[Interface, ...] = ("realtime", "primary", "secondary")


@overload
def decode(
    data: bytes, interface: Literal["realtime"], firmware: str | Firmware | None = None
) -> list[RealtimeState]: ...
@overload
def decode(data: bytes, interface: Interface, firmware: str | Firmware | None = None) -> list[State]: ...
def decode(
    data: bytes, interface: Interface, firmware: str | Firmware | None = None
) -> list[RealtimeState] | list[State]:
    """Decode one or many whole packets.

    Args:
        data: the bytes, beginning at the border of a packet and ending at one.
        interface: "realtime" (port 30003), "primary" (30001) or "secondary" (30002).
        firmware: the controller's version, such as "5.11"; None works it out from lengths. A packet
            longer than the firmware's layout is decoded as far as it is known, the rest is its tail.

    Returns:
        One state per packet, in order; on the primary interface `RobotState`, robot messages and
        other packages.

    Raises:
        PacketError: the bytes are no such packets, a packet is cut off, or is shorter than the
            firmware's layout; says which, both sizes and the offset in `data`.
        BadVersion: `firmware` is no version, or one that nothing is known about.
        BadValue: no such interface.

    >>> from urlink import RealtimeState
    >>> packet = bytes(RealtimeState("3.4", q_actual=[0, -1.57, 0, -1.57, 0, 0]))
    >>> len(packet), decode(packet, "realtime")[0].q_actual[1].item()
    (1060, -1.57)
    """
    if interface not in INTERFACES:
        raise BadValue(f"no interface {interface!r}; expected one of {', '.join(INTERFACES)}")
    version = None
    if firmware is not None:
        version = Firmware.parse(firmware)
        release_of(version)
    data = bytes(data)
    border: RealtimeBorder | PackageBorder = PackageBorder()
    name = "RealtimeState" if interface == "realtime" else "package"
    decoder = PackageDecoder(version)
    states: list[State] = []
    at = 0
    while at < len(data):
        if interface == "realtime":
            border = RealtimeBorder()  # it learns one length, as one connection has; here there may be several
        if len(data) - at < border.header:
            raise _cut_off(name, version, border.header, len(data) - at, at)
        size = border.size_at(data, at)
        if size == 0:
            raise PacketError(
                f"no packet of the {interface} interface begins with {data[at : at + 8].hex(' ')}",
                packet=name,
                version=None if version is None else str(version),
                offset=at,
            )
        if size > len(data) - at:
            raise _cut_off(name, version, size, len(data) - at, at)
        frame = data[at : at + size]
        try:
            if interface == "realtime":
                states.append(RealtimeState.LAYOUTS.decode(frame, version))
            else:
                states.append(decoder.decode(frame))
        except PacketError as error:
            raise PacketError(
                error.reason,
                packet=error.packet,
                version=None if version is None else str(version),
                expected=error.expected,
                actual=error.actual,
                offset=at + error.offset,
            ) from None
        at += size
    return states


def _cut_off(name: str, version: Firmware | None, expected: int, actual: int, offset: int) -> PacketError:
    return PacketError(
        "cut off",
        packet=name,
        version=None if version is None else str(version),
        expected=expected,
        actual=actual,
        offset=offset,
    )
