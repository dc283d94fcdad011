"""The primary and secondary interface (30001, 30002, 30011, 30012), sans-IO.

Bytes to robot states, robot messages and the other packages. The version message that a controller sends on connecting
tells the layouts of what follows; until then the sizes do (docs/protocols/primary.md, section Version message).
"""

from __future__ import annotations

import logging
import struct

from linkcore.stamp import Stamp
from linkcore.wire.cycles import MissedCycles
from linkcore.wire.framing import Framer
from linkcore.wire.packet import State

from ...firmware import Firmware
from ..enums import PackageType
from .decoder import PackageDecoder
from .framing import PackageBoundary
from .robot_message import VersionMessage
from .robot_state import RobotModeData

__all__ = ["STATE_PERIODS", "PrimaryProtocol"]

#: Seconds between two robot states.
STATE_PERIODS = (0.1,)

_ROBOT_STATE = int(PackageType.ROBOT_STATE)
_HEAD = struct.Struct(">iB")
_HEAD_AND_TIME = struct.Struct(">iBQ")
#: Type of the sub-package that has the time, and its size on CB2.
_MODES, _CB2_SIZE = 0, RobotModeData.LAYOUTS.all[0].size

_log = logging.getLogger(__name__)


class PrimaryProtocol:
    """Bytes in, typed states out; a new one for each connection.

    Attributes:
        firmware: from the version message of this connection; None before it.
    """

    def __init__(self) -> None:
        self.framer = Framer(PackageBoundary())
        self.cycles: MissedCycles | None = MissedCycles(_moment, STATE_PERIODS)
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


def _moment(frame: bytes) -> float | None:
    """The time of a robot state; None of other packages, and on CB2, which counts something unknown there."""
    at = _HEAD.size if frame[4] == _ROBOT_STATE else len(frame)
    while at + _HEAD_AND_TIME.size <= len(frame):
        size, kind, time = _HEAD_AND_TIME.unpack_from(frame, at)
        if kind == _MODES:
            return time / 1e6 if size > _CB2_SIZE else None
        at += max(size, _HEAD.size)
    return None
