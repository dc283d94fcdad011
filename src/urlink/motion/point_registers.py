"""Registers of the robot as the link to a program that holds points: no connection to this computer is needed.

The messages are those of a reverse link, one register for each number, written by RTDE, which applies a package as a
whole in one cycle. What the program reports is in output registers, and comes by RTDE too, with each cycle. That those
of one cycle come together is what RTDE is for; that a program which writes several in one cycle is never seen half-way
is a guess, which `link="reverse"` does not need.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Any

from linkcore.clock import monotonic
from linkcore.errors import ConnectionLost
from linkcore.streaming.stream import Stream

from ..urscript.buffering import MESSAGE, REPORTED, PointRegisters
from .register_link import InputClaim, ProgramRegisters, random_token

#: Registers below those of `urlink.motion.register_link`, which another motion of this robot may have claimed: from 24
#: on, 24 to 29 of the integers are left to users, and so are outputs below 30 and above 36: in 47 a program finds its
#: start permission.
FIRST_FLOAT, FIRST_INTEGER, FIRST_OUTPUT = 24, 30, 30
#: The RTDE inputs that a link writes: whole numbers of a message, its date, its number and the token; and its rates.
INPUTS = tuple(
    [f"input_int_register_{FIRST_INTEGER + i}" for i in range(14)]
    + [f"input_double_register_{FIRST_FLOAT + i}" for i in range(12)]
)
#: The RTDE outputs with a report, and the token of the program whose report it is.
OUTPUTS = tuple(f"output_int_register_{FIRST_OUTPUT + i}" for i in range(REPORTED + 1))
#: s without outputs after which nothing is known of the program.
_SILENCE = 1.0
#: How many numbers of a message are whole: what to do, epoch, number, length, degree, and six positions.
_WHOLE = 11
_MESSAGE, _REPORT = struct.Struct(f">{MESSAGE + 1}i"), struct.Struct(f">{REPORTED}i")
#: Largest number of a message, as large as an integer register holds.
_MOST = 0x7FFF_FFFF


class PointLinks:
    """Makes links; the output registers are asked for with the first.

    Args:
        outputs: a stream of RTDE outputs by their names.
    """

    def __init__(self, outputs: Callable[..., Stream[Any]]) -> None:
        self._outputs = outputs
        self._stream: Stream[Any] | None = None

    def __call__(self, inputs: InputClaim) -> PointRegisterLink:
        """The link of the next program.

        Raises:
            LinkError: the outputs cannot be had.
        """
        if self._stream is None:
            self._stream = self._outputs(*OUTPUTS)
        stream = self._stream
        stream.start()
        return PointRegisterLink(inputs, lambda: stream.latest)


class PointRegisterLink(ProgramRegisters):
    """The registers of a program that holds points, and answers.

    Args:
        inputs: the claimed inputs.
        outputs: returns the newest values of `OUTPUTS`, as attributes; None if the connection is lost.
        clock: monotonic s.

    Attributes:
        endpoint: the registers and the token, for the program's text.
    """

    def __init__(self, inputs: InputClaim, outputs: Callable[[], Any], clock: Callable[[], float] = monotonic) -> None:
        super().__init__(inputs, INPUTS)
        self.endpoint = PointRegisters(FIRST_FLOAT, FIRST_INTEGER, FIRST_OUTPUT, random_token())
        self._outputs, self._clock = outputs, clock
        self._received_at = clock()
        self._last: tuple[int, ...] | None = None

    def send(self, data: bytes) -> None:
        """Write a dated message.

        Raises:
            LinkError: it could not be written.
        """
        numbers = _MESSAGE.unpack(data)
        self._count = min(self._count + 1, _MOST)
        own = (numbers[-1], self._count, self.endpoint.token)
        self._write((*numbers[:_WHOLE], *own, *map(float, numbers[_WHOLE:-1])))

    def received(self) -> bytes:
        """The newest report; nothing if it is the same as before, or that of another program.

        Raises:
            ConnectionLost: the outputs do not come any more.
        """
        newest, now = self._outputs(), self._clock()
        if newest is None:
            if now - self._received_at > _SILENCE:
                raise ConnectionLost(f"the output registers have not come for {now - self._received_at:.1f} s")
            return b""
        self._received_at = now
        *report, token = (getattr(newest, name) for name in OUTPUTS)
        if token != self.endpoint.token or tuple(report) == self._last:
            return b""
        self._last = tuple(report)
        return _REPORT.pack(*report)
