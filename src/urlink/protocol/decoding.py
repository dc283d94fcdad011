"""Decoding of packets without a connection.

`decode` converts bytes to typed states. `schema` returns the packet layout of a firmware as a construct schema.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache, partial
from typing import TYPE_CHECKING, Any, Literal, overload

from linkcore.errors import BadValue, BadVersion, PacketError, altered
from linkcore.wire.framing import check_explained, is_strict, strictly
from linkcore.wire.packet import State

from .firmware import Firmware, known_firmware
from .headers import PACKAGE, ROBOT_STATE
from .ports import INTERFACES, Interface
from .primary.decoder import PackageDecoder
from .primary.protocol import PackageBoundary
from .primary.robot_state import SUB_PACKAGES, RobotState
from .realtime.packets import RealtimeState
from .realtime.protocol import RealtimeBoundary

if TYPE_CHECKING:
    from construct import Construct

    from linkcore.wire.layout import Layout

    from .rtde.recipes import Recipe


@overload
def decode(
    data: bytes, interface: Literal["realtime"], firmware: str | Firmware | None = None
) -> list[RealtimeState]: ...
@overload
def decode(data: bytes, interface: Interface, firmware: str | Firmware | None = None) -> list[State]: ...
def decode(
    data: bytes, interface: Interface, firmware: str | Firmware | None = None
) -> list[RealtimeState] | list[State]:
    """Decode one or more whole packets.

    With ``URLINK_STRICT=1`` in the environment, tails and unknown types are errors.

    Args:
        data: Bytes of whole packets, one after the other.
        interface: Interface name: "realtime" (port 30003), "primary" (30001) or "secondary" (30002).
        firmware: Firmware version, such as "5.11"; None infers it from the packet sizes. If a packet is longer than the
            layout of the firmware, the known fields are decoded, and the rest becomes the tail.

    Returns:
        One state per packet, in order. The primary interface has `RobotState`, robot messages and other packages.

    Raises:
        PacketError: If the bytes are not packets of the interface, or a packet is cut off or shorter than the layout of
            the firmware. The error has the packet, both sizes and the offset in `data`.
        BadVersion: If `firmware` is not a version, or is unknown.
        BadValue: If the interface does not exist.

    >>> from urlink.packets import RealtimeState
    >>> packet = bytes(RealtimeState("3.4", q_actual=[0, -1.57, 0, -1.57, 0, 0]))
    >>> len(packet), decode(packet, "realtime")[0].q_actual[1].item()
    (1060, -1.57)
    """
    if interface not in INTERFACES:
        raise BadValue(f"unknown interface {interface!r}; expected one of {', '.join(INTERFACES)}")
    try:
        version = None if firmware is None else _known(firmware)
    except TypeError:  # not hashable, or not comparable with versions
        raise BadVersion(f"{firmware!r} is not a firmware version; expected a string such as '5.11'") from None
    data = bytes(data)
    end = len(data)
    boundary: RealtimeBoundary | PackageBoundary
    decode_frame: Callable[[bytes], State]
    if interface == "realtime":
        boundary, name = RealtimeBoundary(), "RealtimeState"
        decode_frame = partial(RealtimeState.LAYOUTS.decode, version=version)
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
                raise PacketError("the packet is cut off", packet=name, expected=need, actual=end - at)
            if not size:
                begin = data[at : at + 8].hex(" ")
                raise PacketError(f"no packet of the {interface} interface starts with {begin}", packet=name)
            states.append(decode_frame(data[at : at + size]))
        except PacketError as error:
            shown = None if version is None else str(version)
            raise altered(error, version=shown, offset=at + error.offset) from None
        at += size
    return states


@lru_cache
def _known(firmware: str | Firmware) -> Firmware:
    """Cached `known_firmware`, because a recording calls it for each packet."""
    return known_firmware(firmware)


def _strict_decoder(interface: Interface, version: Firmware | None) -> Callable[[bytes], State]:
    """Return a decoder that accepts only packets without unknown bytes."""
    if interface != "realtime":
        return strictly(PackageDecoder(version))
    decode_state = partial(RealtimeState.LAYOUTS.decode, version=version)

    def decode_frame(frame: bytes) -> RealtimeState:
        state: RealtimeState = decode_state(frame)
        check_explained(state, 0, len(state.tail))
        return state

    return decode_frame


@lru_cache
def _package_decoder(version: Firmware | None) -> PackageDecoder:
    """Return a cached decoder, which remembers the layouts of package sizes. Its counters are not used."""
    return PackageDecoder(version)


def schema(packet: type[State] | Recipe, version: str | Firmware | None = None) -> Construct[Any, Any]:
    """Return the construct schema of one packet of a firmware. It parses, builds and checks sizes.

    The schema, the decoder, the simulator and the layout tables use the same declaration. The first call imports
    construct. If speed matters, use `decode`: it is more than 50 times as fast.

    ``parse`` accepts one whole packet, or a stream that starts with one. It raises `construct.ConstructError` if the
    size in the header differs from the layout, if bytes are missing, or if the type belongs to another packet. Vectors
    are lists, and codes are their enums. Values that a controller sends joint by joint are a list of structs.
    ``build`` accepts the same names, and fills in the size and the type. ``print`` shows the fields with offsets, types
    and units.

    Args:
        packet: Packet class, such as `RealtimeState` or `JointData`; `RobotState`, whose `packages` have a `type` and
            `fields` each; or the `recipe` of an RTDE stream.
        version: Firmware version, such as "5.11"; None for the newest. For RTDE packets, the version of the protocol,
            "1.0" or "2.0". Ignored for a recipe.

    Raises:
        BadVersion: If `version` is not a version, or is unknown.
        PacketError: If that version does not send the packet.
        BadValue: If `packet` has no layout.

    >>> from urlink import schema
    >>> from urlink.packets import RealtimeState
    >>> realtime = schema(RealtimeState, "5.11")
    >>> realtime.sizeof()
    1220
    >>> realtime.parse(bytes(RealtimeState("5.11", q_actual=[0, -1.5, 0, 0, 0, 0]))).q_actual[1]
    -1.5
    """
    from linkcore.wire.schema import packet_schema

    from .rtde.packets import HEADER
    from .rtde.recipes import DATA_HEADER, Recipe

    if isinstance(packet, Recipe):
        return packet_schema(packet.layout)
    if packet is RobotState:
        return _robot_state(None if version is None else known_firmware(version))
    if not (isinstance(packet, type) and issubclass(packet, State) and hasattr(packet, "LAYOUTS")):
        raise BadValue(f"{packet!r} has no layout; expected a packet class such as RealtimeState, or an RTDE recipe")
    # The layouts of RTDE packets depend on the version of the protocol.
    if version is not None and packet.LAYOUTS.of().header not in (HEADER, DATA_HEADER):
        version = known_firmware(version)
    return packet_schema(_layout(packet, version))


def _layout(packet: type[State], version: str | Firmware | None) -> Layout:
    """Return the layout of a packet, including its optional blocks."""
    return packet.LAYOUTS.of(version, dict.fromkeys(packet.LAYOUTS.blocks, True))


def _robot_state(version: Firmware | None) -> Any:
    """Return the schema of a package with any number of sub-packages, in any order. Unknown types are kept as bytes."""
    import construct

    from linkcore.wire.schema import checked_fields, sized
    from linkcore.wire.schema_text import PacketStruct

    fields: dict[int, Any] = {}
    for kind, classes in SUB_PACKAGES.items():
        for each in classes:  # if two classes have the same number, a version sends only one of them
            try:
                layout = _layout(each, version)
            except PacketError:
                continue
            fields.setdefault(kind, PacketStruct(each.__name__, *checked_fields(layout), construct.Terminated))
    kind = construct.Int8ub
    part = construct.Struct(
        "type" / kind, "fields" / construct.Switch(construct.this.type, fields, construct.GreedyBytes)
    )
    # A sub-package without a matching layout ends the list, and the rest of the package is an error.
    parts = construct.Struct(
        "type" / construct.Const(ROBOT_STATE, kind),
        "packages" / construct.GreedyRange(sized("sub-package", PACKAGE, part)),
        construct.Terminated,
    )
    return sized("RobotState", PACKAGE, parts)
