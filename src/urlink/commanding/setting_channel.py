"""How a setting is sent: by RTDE inputs where they are available, by URScript text otherwise.

An input of RTDE takes effect in the next cycle of the controller, and nothing has to be compiled or run for it. But it
belongs to one client at a time, and a controller may be too old for it, or its port closed. Text can always be sent.
So RTDE is tried for the first setting of a kind on each connection to the robot; where it is refused, text is sent from
then on, until the robot has been connected anew.
"""

from __future__ import annotations

import contextlib
import logging
import math
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, Protocol

from linkcore.clock import monotonic
from linkcore.errors import Closed, ConnectionLost, LinkError
from linkcore.streaming.connection import Connection
from linkcore.text import printable

from .channel import CommandChannel
from .section import Section

#: RTDE inputs of a setting, masks included; called when it is known that the robot runs. None where only text will do.
Values = Callable[[], Mapping[str, Any] | None]

#: Seconds in which a text that was sent may not have been executed yet: an RTDE package would overtake it.
_SETTLED = 0.5

_log = logging.getLogger(__name__)


class BriefInputs(Protocol):
    """RTDE inputs of a robot, which are claimed for as long as settings follow one another."""

    def claim(self, names: tuple[str, ...], *, wait: bool) -> Callable[[Mapping[str, Any]], None] | None:
        """What writes these inputs without waiting; None where that would have to be waited for.

        Raises `LinkError` where they cannot be had.
        """

    def abort(self) -> None:
        """Discard what was written and has not arrived."""


class SettingChannel:
    """Sends settings, which move nothing.

    Args:
        channel: sends text.
        connection: of the robot; whether RTDE is refused is remembered for as long as it lasts.
        section: of the robot.
        inputs: gives those of RTDE; None to send text only.
        clock: seconds that only grow.
    """

    def __init__(
        self,
        channel: CommandChannel,
        connection: Connection,
        section: Section,
        inputs: Callable[[], BriefInputs] | None,
        clock: Callable[[], float] = monotonic,
    ) -> None:
        self._channel = channel
        self._connection = connection
        self._section = section
        self._inputs = inputs
        self._clock = clock
        #: names of inputs -> number of the connection on which they could not be had; () stands for all
        self._refused: dict[tuple[str, ...], int] = {}
        self._sent_text_at = -math.inf

    def send(self, text: str, values: Values | None = None, *, wait: bool = True) -> None:
        """Send a setting.

        Args:
            text: whole lines of URScript.
            values: the same as RTDE inputs; None where there are none.
            wait: for a claim of the inputs, a quarter of a second at most; otherwise they have to be claimed already.

        Raises:
            NotRunning: the robot does not run, or nothing is known of it; nothing was sent.
            RemoteError: it could not be sent.
        """
        if values is not None and self._inputs is not None:
            self._channel.check_running()
            write = self._writer(self._inputs, values, wait)
            if write is not None:
                # Perhaps RTDE was given back just now, or is cut; the next setting claims it anew.
                with contextlib.suppress(ConnectionLost, Closed):
                    self._channel.beside(write)
                    return
            self._sent_text_at = self._clock()
        self._channel.command(text)

    def doubt(self) -> None:
        """What was sent does not show: nothing of it is to arrive later over RTDE, and what follows goes by text."""
        if self._inputs is not None and not self._is_refused(()):
            self._refuse(())
            with contextlib.suppress(LinkError):
                self._inputs().abort()

    def _writer(self, inputs: Callable[[], BriefInputs], values: Values, wait: bool) -> Callable[[], None] | None:
        """What writes a setting to RTDE inputs; None where that cannot be."""
        if self._clock() - self._sent_text_at < _SETTLED or self._is_refused(()):
            return None
        written = values()
        if written is None or self._is_refused(tuple(written)):
            return None
        try:
            write = inputs().claim(tuple(written), wait=wait and self._section.may_wait)
        except LinkError as error:
            # Imported here: RTDE is not needed before the first setting.
            from ..interfaces.rtde.protocol import RtdeRefused

            names = tuple(written) if isinstance(error, RtdeRefused) else ()
            self._refuse(names)
            _log.info("%s: %s by script: %s", self._connection.name, names or "settings", printable(error))
            return None
        return None if write is None else partial(write, written)

    def _is_refused(self, names: tuple[str, ...]) -> bool:
        return self._refused.get(names) == self._connection.counters.connections

    def _refuse(self, names: tuple[str, ...]) -> None:
        self._refused[names] = self._connection.counters.connections
