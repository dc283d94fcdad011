"""Decoding of packets without a robot or a thread.

`decode`: bytes to typed states. `schema`: what a firmware puts on the wire, as a construct schema.
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
    try:
        version = None if firmware is None else _known(firmware)
    except TypeError:  # cannot be hashed, or compared with versions
        raise BadVersion(f"{firmware!r} is not a firmware; expected something like '5.11'") from None
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
                raise PacketError("cut off", packet=name, expected=need, actual=end - at)
            if not size:
                begin = data[at : at + 8].hex(" ")
                raise PacketError(f"no packet of the {interface} interface begins with {begin}", packet=name)
            states.append(decode_frame(data[at : at + size]))
        except PacketError as error:
            shown = None if version is None else str(version)
            raise altered(error, version=shown, offset=at + error.offset) from None
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
    decode_state = partial(RealtimeState.LAYOUTS.decode, version=version)

    def decode_frame(frame: bytes) -> RealtimeState:
        state: RealtimeState = decode_state(frame)
        check_explained(state, 0, len(state.tail))
        return state

    return decode_frame


@lru_cache
def _package_decoder(version: Firmware | None) -> PackageDecoder:
    """One that is kept, since it learns how the packages of a size are cut; its counters are not used."""
    return PackageDecoder(version)


def schema(packet: type[State] | Recipe, version: str | Firmware | None = None) -> Construct[Any, Any]:
    """The construct schema of one packet, as a firmware sends it: it parses, builds and checks sizes.

    Made of the declaration from which the decoder, the simulator and the tables of layouts are derived. construct
    is imported with the first call. Use `decode` where speed counts: it is more than 50 times as fast.

    ``parse`` takes one whole packet, or a stream that begins with one. It raises `construct.ConstructError` where the
    size in the header is not that of the layout, where there are fewer bytes than that, and where the type is another
    packet's. Vectors are lists, codes their enums; what a controller sends joint by joint is a list of structs.
    ``build`` takes the same names, and fills in size and type. ``print`` shows the fields with offsets, types and
    units.

    Args:
        packet: a packet class, such as `RealtimeState` or `JointData`; `RobotState`, whose `packages` have a `type` and
            `fields` each; or the `recipe` of a stream of RTDE.
        version: of the controller's software, such as "5.11"; None for the newest. Packets of RTDE go by the version of
            the protocol, "1.0" or "2.0", instead, and a recipe by nothing.

    Raises:
        BadVersion: `version` is not a version, or nothing is known about it.
        PacketError: that version does not send the packet.
        BadValue: `packet` is nothing that has a layout.

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
        raise BadValue(f"{packet!r} is no class of packets, such as RealtimeState, nor a recipe of RTDE")
    # Packets of RTDE have their layouts by the version of the protocol.
    if version is not None and packet.LAYOUTS.of().header not in (HEADER, DATA_HEADER):
        version = known_firmware(version)
    return packet_schema(_layout(packet, version))


def _layout(packet: type[State], version: str | Firmware | None) -> Layout:
    """With its block, if it has one."""
    return packet.LAYOUTS.of(version, dict.fromkeys(packet.LAYOUTS.blocks, True))


def _robot_state(version: Firmware | None) -> Any:
    """A package whose body is sub-packages of any number and order; one of an unknown type is its bytes."""
    import construct

    from linkcore.wire.schema import checked_fields, sized
    from linkcore.wire.schema_text import PacketStruct

    fields: dict[int, Any] = {}
    for kind, classes in SUB_PACKAGES.items():
        for each in classes:  # of two with the same number, a version sends one
            try:
                layout = _layout(each, version)
            except PacketError:
                continue
            fields.setdefault(kind, PacketStruct(each.__name__, *checked_fields(layout), construct.Terminated))
    kind = construct.Int8ub
    part = construct.Struct(
        "type" / kind, "fields" / construct.Switch(construct.this.type, fields, construct.GreedyBytes)
    )
    # A sub-package that fits no layout ends the row, and what is left of the package is an error.
    parts = construct.Struct(
        "type" / construct.Const(ROBOT_STATE, kind),
        "packages" / construct.GreedyRange(sized("sub-package", PACKAGE, part)),
        construct.Terminated,
    )
    return sized("RobotState", PACKAGE, parts)
