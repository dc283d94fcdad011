"""The primary and secondary interface (30001, 30002, 30011, 30012), sans-IO.

Bytes to robot states, robot messages and the other packages. The version message that a controller sends on connecting
tells the layouts of what follows; until then the sizes do (docs/protocols/primary.md, section Version message).
"""

from __future__ import annotations

import logging

from linkcore.stamp import Stamp
from linkcore.wire.framing import Framer
from linkcore.wire.packet import State

from ...firmware import Firmware
from .decoder import PackageDecoder
from .framing import PackageBoundary
from .robot_message import VersionMessage

__all__ = ["PrimaryProtocol"]

_log = logging.getLogger(__name__)


class PrimaryProtocol:
    """Bytes in, typed states out; a new one for each connection.

    Attributes:
        firmware: from the version message of this connection; None before it.
    """

    def __init__(self) -> None:
        self.framer = Framer(PackageBoundary())
        self._decoder = PackageDecoder(notice=_log.warning)
        self.firmware: Firmware | None = None

    @property
    def unknown(self) -> int:
        """Packages, messages and sub-packages of a type that no layout is known for, so far."""
        return self._decoder.unknown

    @property
    def tails(self) -> int:
        """Those that end in bytes which no known layout explains, so far."""
        return self._decoder.tails

    def decode(self, frame: bytes, stamp: Stamp | None = None) -> State:
        """The typed state of one whole package.

        Raises:
            PacketError: a layout that the package, or one of its sub-packages, cannot hold.
        """
        state = self._decoder.decode(frame, stamp)
        if isinstance(state, VersionMessage):
            self.firmware = Firmware(state.major, state.minor, state.bugfix or 0, state.build or 0)
            self._decoder.version = self.firmware
        return state
