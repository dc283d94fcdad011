"""Input registers of the robot as the link to a program: no connection to this computer is needed.

The messages are those of a reverse link, one register for each number. They reach the program by RTDE, which applies a
package as a whole in one cycle.

What a program that holds points reports is in output registers, and comes by RTDE too, with each cycle. That those of
one cycle come together is what RTDE is for; that a program which writes several in one cycle is never seen half-way is
a guess, which `link="reverse"` does not need.
"""

from __future__ import annotations

import random
import struct
import threading
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, Generic, Protocol, TypeVar

from linkcore import clock
from linkcore.errors import ConnectFailed, ConnectionLost
from linkcore.streaming.stream import Stream
from linkcore.threads import alone

from ...script.buffering import MESSAGE, REPORTED, PointRegisters
from ...script.links import TOKENS, InputRegisters
from .messages import LARGEST, MESSAGE_SIZE, read_message

#: Number of the first float register and of the first integer register of set-points: the last twelve and the last four
#: of all are used, so that others from 24 on are left to users, and those below 24 to fieldbuses. From 3.9 and 5.3 on.
_FIRST_FLOAT, _FIRST_INTEGER = 36, 44
#: The RTDE inputs that a link for set-points writes: positions and speeds, the date and the number of the message, what
#: to do, and the token.
SETPOINT_INPUTS = tuple(
    [f"input_double_register_{_FIRST_FLOAT + i}" for i in range(12)]
    + [f"input_int_register_{_FIRST_INTEGER + i}" for i in range(4)]
)
#: Those of points, below the others, which another motion of this robot may have claimed: from 24 on, 24 to 29 of the
#: integers are left to users, and so are outputs below 30 and above 36: in 47 a program finds its start permission.
_POINT_FLOAT, _POINT_INTEGER, _POINT_OUTPUT = 24, 30, 30
#: The RTDE inputs that a link for points writes: whole numbers of a message, its date, its number and the token, and
#: its rates.
POINT_INPUTS = tuple(
    [f"input_int_register_{_POINT_INTEGER + i}" for i in range(14)]
    + [f"input_double_register_{_POINT_FLOAT + i}" for i in range(12)]
)
#: The RTDE outputs with a report, and the token of the program whose report it is.
POINT_OUTPUTS = tuple(f"output_int_register_{_POINT_OUTPUT + i}" for i in range(REPORTED + 1))
#: s without outputs after which nothing is known of the program.
_SILENCE = 1.0
#: How many numbers of a message of a point are whole: what to do, epoch, number, length, degree, and six positions.
_WHOLE = 11
_MESSAGE, _REPORT = struct.Struct(f">{MESSAGE + 1}i"), struct.Struct(f">{REPORTED}i")


class InputClaim(Protocol):
    """RTDE inputs that have been claimed."""

    def _write(self, values: Mapping[str, float]) -> None:
        """Write them together, without waiting; raises `LinkError` if that fails."""


L = TypeVar("L")


class RegisterPort(Generic[L]):
    """Opens register links. The registers are claimed for the first link, and released when the robot is closed.

    Args:
        claim: claims RTDE inputs by their names; may raise `LinkError`.
        timeout: seconds that a claim by another thread is waited for.
        names: what is claimed.
        make: makes a link of it.
    """

    def __init__(
        self,
        claim: Callable[[tuple[str, ...]], InputClaim],
        timeout: float,
        names: tuple[str, ...],
        make: Callable[[InputClaim], L],
    ) -> None:
        self._claim, self._names, self._make = claim, names, make
        self._timeout = timeout
        self._claiming = threading.RLock()
        self._inputs: InputClaim | None = None

    def open(self) -> L:
        """The link of the next program; it may have to connect.

        Raises:
            InputInUse: another client, or a fieldbus, holds one of the registers.
            LinkError: RTDE cannot be used.
        """
        # A controller gives a register to one connection, so to the first of two threads of this robot only. Alone:
        # a signal handler may come here while the main thread, which it keeps, claims them.
        otherwise = f"the registers of a link are still being claimed after {self._timeout:g} s"
        with alone(self._claiming, self._timeout, otherwise):
            if self._inputs is None:
                self._inputs = self._claim(self._names)
            return self._make(self._inputs)


def _random_token() -> int:
    """A token that no register holds by itself: one that was never written holds 0."""
    return random.SystemRandom().randrange(1, TOKENS)


class ProgramRegisters:
    """The registers of one program.

    A program reads no message before its token is in its register. The token is written once the program has begun, and
    only while its motion runs. So a program that the controller begins too late finds another token, and ends.

    Args:
        inputs: the claimed inputs.
        names: of all of them, in the order in which they are written.

    Attributes:
        is_up: whether the program has begun, so that messages are written.
    """

    def __init__(self, inputs: InputClaim, names: Sequence[str]) -> None:
        self.is_up = False
        self._inputs, self._names = inputs, names
        self._count = 0
        self._is_closed = False

    def poll(self, has_begun: bool) -> bool:
        """The link is up once the program has begun."""
        self.is_up = has_begun and not self._is_closed
        return self.is_up

    def received(self) -> bytes:
        """No bytes: a program with registers answers by `textmsg` only."""
        return b""

    def _write(self, values: Iterable[float]) -> None:
        if self._is_closed:
            raise ConnectionLost("the registers are not written any more")
        self._inputs._write(dict(zip(self._names, values, strict=True)))

    def absence(self, why: str) -> ConnectFailed:
        """The error for a program that does not read what is written."""
        return ConnectFailed(
            f"the program on the robot does not see what is written into its input registers: {why}. Does another RTDE "
            f"client or a fieldbus write one of {', '.join(self._names)}?"
        )

    def close(self, *, farewell: bool) -> None:
        """Write nothing more; a program that still runs finds no new message, and brakes. Idempotent."""
        self._is_closed, self.is_up = True, False


class RegisterLink(ProgramRegisters):
    """The registers of a program that is led by set-points.

    Args:
        inputs: the claimed inputs.

    Attributes:
        endpoint: the registers and the token, for the program's text.
    """

    def __init__(self, inputs: InputClaim) -> None:
        super().__init__(inputs, SETPOINT_INPUTS)
        self.endpoint = InputRegisters(_FIRST_FLOAT, _FIRST_INTEGER, _random_token())

    def send(self, data: bytes) -> None:
        """Write a dated message.

        Raises:
            LinkError: it could not be written.
        """
        q, qd, mode = read_message(data[:MESSAGE_SIZE])
        self._count = self._count % LARGEST + 1
        self._write((*q, *qd, int.from_bytes(data[MESSAGE_SIZE:], "big"), self._count, mode, self.endpoint.token))


class PointRegisterLink(ProgramRegisters):
    """The registers of a program that holds points, and answers.

    Args:
        inputs: the claimed inputs.
        outputs: returns the newest values of `POINT_OUTPUTS`, as attributes; None if the connection is lost.
        clock: monotonic s.

    Attributes:
        endpoint: the registers and the token, for the program's text.
    """

    def __init__(self, inputs: InputClaim, outputs: Callable[[], Any], clock: Callable[[], float] = clock.now) -> None:
        super().__init__(inputs, POINT_INPUTS)
        self.endpoint = PointRegisters(_POINT_FLOAT, _POINT_INTEGER, _POINT_OUTPUT, _random_token())
        self._outputs, self._clock = outputs, clock
        self._received_at = clock()
        self._last: tuple[int, ...] | None = None

    def send(self, data: bytes) -> None:
        """Write a dated message.

        Raises:
            LinkError: it could not be written.
        """
        numbers = _MESSAGE.unpack(data)
        self._count = self._count % LARGEST + 1
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
        *report, token = (getattr(newest, name) for name in POINT_OUTPUTS)
        if token != self.endpoint.token or tuple(report) == self._last:
            return b""
        self._last = tuple(report)
        return _REPORT.pack(*report)


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
            self._stream = self._outputs(*POINT_OUTPUTS)
        stream = self._stream
        stream.start()
        return PointRegisterLink(inputs, lambda: stream.latest)
