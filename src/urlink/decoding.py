"""`decode`: bytes to typed states, no robot, no thread."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache, partial
from typing import Literal, overload

from linkcore.errors import BadValue, PacketError
from linkcore.wire.framing import check_explained, is_strict, strictly
from linkcore.wire.packet import State

from .firmware import Firmware, known_firmware
from .interfaces.primary.decoder import PackageDecoder
from .interfaces.primary.protocol import PackageBoundary
from .interfaces.realtime.packets import RealtimeState
from .interfaces.realtime.protocol import RealtimeBoundary
from .ports import INTERFACES, Interface


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

    With ``URLINK_STRICT=1`` in the environment, tails and unknown types are errors.

    Args:
        data: the bytes, whole packets, one after the other.
        interface: "realtime" (port 30003), "primary" (30001) or "secondary" (30002).
        firmware: the controller's version, such as "5.11"; None works it out from lengths. A packet
            longer than the firmware's layout is decoded as far as it is known, the rest is its tail.

    Returns:
        One state per packet, in order; on the primary interface `RobotState`, robot messages and
        other packages.

    Raises:
        PacketError: the bytes are not such packets, a packet is cut off, or is shorter than the
            firmware's layout; says which, both sizes and the offset in `data`.
        BadVersion: `firmware` is not a version, or one that nothing is known about.
        BadValue: no such interface.

    >>> from urlink.packets import RealtimeState
    >>> packet = bytes(RealtimeState("3.4", q_actual=[0, -1.57, 0, -1.57, 0, 0]))
    >>> len(packet), decode(packet, "realtime")[0].q_actual[1].item()
    (1060, -1.57)
    """
    if interface not in INTERFACES:
        raise BadValue(f"no interface {interface!r}; expected one of {', '.join(INTERFACES)}")
    version = None if firmware is None else _known(firmware)
    data = bytes(data)
    end = len(data)
    boundary: RealtimeBoundary | PackageBoundary
    decode_frame: Callable[[bytes], State]
    if interface == "realtime":
        boundary, decode_frame, name = RealtimeBoundary(), _realtime_decoder(version), "RealtimeState"
    else:
        boundary, decode_frame, name = PackageBoundary(), _package_decoder(version).decode, "package"
    if is_strict():
        decode_frame = _strict_decoder(interface, version)
    states: list[State] = []
    at = 0
    while at < end:
        size, need = boundary.declared(data, at)
        try:
            if need > end - at:
                raise PacketError("cut off", packet=name, expected=need, actual=end - at)
            if not size:
                begin = data[at : at + 8].hex(" ")
                raise PacketError(f"no packet of the {interface} interface begins with {begin}", packet=name)
            states.append(decode_frame(data[at : at + size]))
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


@lru_cache
def _known(firmware: str | Firmware) -> Firmware:
    """As `known_firmware`, kept: a recording asks for each of its packets."""
    return known_firmware(firmware)


def _strict_decoder(interface: Interface, version: Firmware | None) -> Callable[[bytes], State]:
    """Takes only packets of which every byte is known."""
    if interface != "realtime":
        return strictly(PackageDecoder(version))
    decode_state = _realtime_decoder(version)

    def decode_frame(frame: bytes) -> RealtimeState:
        state = decode_state(frame)
        check_explained(state, 0, len(state.tail))
        return state

    return decode_frame


@lru_cache
def _realtime_decoder(version: Firmware | None) -> Callable[[bytes], RealtimeState]:
    return partial(RealtimeState.LAYOUTS.decode, version=version)


@lru_cache
def _package_decoder(version: Firmware | None) -> PackageDecoder:
    """One that is kept, since it learns how the packages of a size are cut; its counters are not used."""
    return PackageDecoder(version)
