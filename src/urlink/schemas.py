"""`schema`: what a firmware puts on the wire, as a construct schema."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from linkcore.errors import BadValue, PacketError
from linkcore.wire.packet import State

from .firmware import Firmware, known_firmware
from .interfaces.headers import PACKAGE
from .interfaces.primary.robot_state import SUB_PACKAGES, RobotState
from .interfaces.rtde.packets import HEADER
from .interfaces.rtde.recipes import DATA_HEADER, Recipe

if TYPE_CHECKING:
    from construct import Construct


def schema(packet: type[State] | Recipe, version: str | Firmware | None = None) -> Construct[Any, Any]:
    """The construct schema of one packet, as a firmware sends it: it parses, builds and checks sizes.

    Made of the declaration from which the decoder, the simulator and the tables of layouts are derived. construct
    is imported with the first call. Use `decode` where speed counts: it is more than 50 times as fast.

    ``parse`` takes one whole packet, or a stream that begins with one. It raises `construct.ConstructError` where the
    size in the header is not that of the layout, where there are fewer bytes than that, and where the type is another
    packet's. Vectors are lists, codes their enums; what a controller sends joint by joint is a list of structs.
    ``build`` takes the same names, and fills in size and type.

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

    if isinstance(packet, Recipe):
        return packet_schema(packet.layout)
    if packet is RobotState:
        return _robot_state(version)
    if not (isinstance(packet, type) and issubclass(packet, State) and hasattr(packet, "LAYOUTS")):
        raise BadValue(f"{packet!r} is no class of packets, such as RealtimeState, nor a recipe of RTDE")
    return packet_schema(packet.LAYOUTS.of(_version_of(packet, version), dict.fromkeys(packet.LAYOUTS.blocks, True)))


def _version_of(packet: type[State], version: str | Firmware | None) -> str | Firmware | None:
    """The version by which the packet has its layouts; one of a controller's software has to be known."""
    if version is not None and packet.LAYOUTS.of().header not in (HEADER, DATA_HEADER):
        return known_firmware(version)
    return version


def _robot_state(version: str | Firmware | None) -> Any:
    """A package whose body is sub-packages of any number and order; one of an unknown type is its bytes."""
    import construct

    from linkcore.wire.schema import checked_fields, sized

    fields: dict[int, Any] = {}
    for kind, classes in SUB_PACKAGES.items():
        for each in classes:  # of two with the same number, a version sends one
            try:
                layout = each.LAYOUTS.of(_version_of(each, version), dict.fromkeys(each.LAYOUTS.blocks, True))
            except PacketError:
                continue
            fields.setdefault(kind, construct.Struct(*checked_fields(layout), construct.Terminated))
    kind = construct.Int8ub
    part = construct.Struct(
        "type" / kind, "fields" / construct.Switch(construct.this.type, fields, construct.GreedyBytes)
    )
    # A sub-package that fits no layout ends the row, and what is left of the package is an error.
    parts = construct.Struct(
        "type" / construct.Const(16, kind),
        "packages" / construct.GreedyRange(sized(PACKAGE, part)),
        construct.Terminated,
    )
    return sized(PACKAGE, parts)
