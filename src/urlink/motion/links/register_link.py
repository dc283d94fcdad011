"""Link to a program over input registers of the robot. The program needs no connection to this computer.

The messages are the same as those of a reverse link, with one register for each number. RTDE transmits the registers to
the robot, and all values of one RTDE package take effect in the same cycle.

A program that buffers points writes its reports to output registers, which RTDE transmits in each cycle. RTDE is
designed to transmit the registers of one cycle together. Assumption: if a program writes several registers in one
cycle, RTDE never transmits only some of the new values. `link="reverse"` does not need this assumption.
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
from ...script.messages import LARGEST, MESSAGE_SIZE, read_message

#: Number of the first float register and of the first integer register for set-points. The last twelve float registers
#: and the last four integer registers are used. So the other registers with numbers of 24 or more remain free for
#: users, and the registers below 24 remain free for fieldbuses. The registers with numbers of 24 or more need firmware
#: 3.9 or later on CB3, or 5.3 or later on e-Series.
_FIRST_FLOAT, _FIRST_INTEGER = 36, 44
#: RTDE inputs that a link for set-points writes: positions and speeds, the date and the number of the message, the
#: command, and the token.
SETPOINT_INPUTS = tuple(
    [f"input_double_register_{_FIRST_FLOAT + i}" for i in range(12)]
    + [f"input_int_register_{_FIRST_INTEGER + i}" for i in range(4)]
)
#: Numbers of the first registers for points: float input, integer input and integer output. The registers are below
#: those for set-points, because another motion of this robot may have claimed the registers for set-points. Integer
#: inputs 24 to 29 are left to users, and so are integer outputs below 30 and above 36. The exception is output 47,
#: which contains the start permission of a program by default.
_POINT_FLOAT, _POINT_INTEGER, _POINT_OUTPUT = 24, 30, 30
#: RTDE inputs that a link for points writes: the integers of a message, the date and the number of the message, the
#: token, and the speeds and accelerations.
POINT_INPUTS = tuple(
    [f"input_int_register_{_POINT_INTEGER + i}" for i in range(14)]
    + [f"input_double_register_{_POINT_FLOAT + i}" for i in range(12)]
)
#: RTDE outputs that contain a report, and the token of the program that wrote this report.
POINT_OUTPUTS = tuple(f"output_int_register_{_POINT_OUTPUT + i}" for i in range(REPORTED + 1))
#: Longest time in s without outputs. After this time, the state of the program is unknown.
_SILENCE = 1.0
#: Number of integers in the message of a point: command, epoch, number, length, degree, and six positions.
_WHOLE = 11
_MESSAGE, _REPORT = struct.Struct(f">{MESSAGE + 1}i"), struct.Struct(f">{REPORTED}i")


class InputClaim(Protocol):
    """Claimed RTDE inputs."""

    def _write(self, values: Mapping[str, float]) -> None:
        """Write the values together, without waiting; raise `LinkError` if this fails."""


L = TypeVar("L")


class RegisterPort(Generic[L]):
    """Factory of register links.

    The registers are claimed for the first link, and released when the robot is closed.

    Args:
        claim: Function that claims RTDE inputs by their names; may raise `LinkError`.
        timeout: Longest time to wait while another thread claims the registers, in s.
        names: Names of the inputs.
        make: Function that makes a link from the claimed inputs.
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
        """Return the link for the next program.

        The first call claims the registers, and may have to connect to RTDE.

        Raises:
            InputInUse: If another client or a fieldbus has reserved one of the registers.
            LinkError: If RTDE cannot be used.
        """
        # A controller assigns a register to only one connection. If two threads claimed the registers at the same time,
        # the second claim would fail. Use `alone()`, because a signal handler may get here while it interrupts the main
        # thread in the middle of the claim.
        otherwise = f"the registers of a link are still being claimed after {self._timeout:g} s"
        with alone(self._claiming, self._timeout, otherwise):
            if self._inputs is None:
                self._inputs = self._claim(self._names)
            return self._make(self._inputs)


def _random_token() -> int:
    """Return a random token other than 0, because a register that was never written contains 0."""
    return random.SystemRandom().randrange(1, TOKENS)


class ProgramRegisters:
    """Link to one program over registers.

    A program reads no messages until its token is in the token register. urlink writes the token after the program has
    begun, and only while its motion is running. So if the controller starts a program too late, this program finds
    another token, and ends.

    Args:
        inputs: Claimed inputs.
        names: Names of all inputs, in the order of the written values.

    Attributes:
        is_up: Whether the program has begun and the link is not closed, so that messages are written.
    """

    def __init__(self, inputs: InputClaim, names: Sequence[str]) -> None:
        self.is_up = False
        self._inputs, self._names = inputs, names
        self._count = 0
        self._is_closed = False

    def poll(self, has_begun: bool) -> bool:
        """Check whether the link is up. It is up after the program has begun."""
        self.is_up = has_begun and not self._is_closed
        return self.is_up

    def received(self) -> bytes:
        """Return no bytes, because this program cannot send any; it reports only with `textmsg`."""
        return b""

    def _write(self, values: Iterable[float]) -> None:
        if self._is_closed:
            raise ConnectionLost("the registers of this link are no longer written")
        self._inputs._write(dict(zip(self._names, values, strict=True)))

    def absence(self, why: str) -> ConnectFailed:
        """Return the error for a program that does not receive the written values."""
        return ConnectFailed(
            f"the program on the robot does not receive the values of its input registers: {why}. Check whether "
            f"another RTDE client or a fieldbus writes one of {', '.join(self._names)}"
        )

    def close(self, *, farewell: bool) -> None:
        """Stop writing. If the program is still running, it finds no new message, and brakes. Idempotent."""
        self._is_closed, self.is_up = True, False


class RegisterLink(ProgramRegisters):
    """Link over registers to a program that follows set-points.

    Args:
        inputs: Claimed inputs.

    Attributes:
        endpoint: Registers and token, for the program's text.
    """

    def __init__(self, inputs: InputClaim) -> None:
        super().__init__(inputs, SETPOINT_INPUTS)
        self.endpoint = InputRegisters(_FIRST_FLOAT, _FIRST_INTEGER, _random_token())

    def send(self, data: bytes) -> None:
        """Write a dated message.

        Raises:
            LinkError: If the message could not be written.
        """
        q, qd, mode = read_message(data[:MESSAGE_SIZE])
        self._count = self._count % LARGEST + 1
        self._write((*q, *qd, int.from_bytes(data[MESSAGE_SIZE:], "big"), self._count, mode, self.endpoint.token))


class PointRegisterLink(ProgramRegisters):
    """Link over registers to a program that buffers points and sends reports.

    Args:
        inputs: Claimed inputs.
        outputs: Function that returns an object whose attributes are the newest values of `POINT_OUTPUTS`; None if the
            connection is lost.
        clock: Function that returns monotonic time, in s.

    Attributes:
        endpoint: Registers and token, for the program's text.
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
            LinkError: If the message could not be written.
        """
        numbers = _MESSAGE.unpack(data)
        self._count = self._count % LARGEST + 1
        own = (numbers[-1], self._count, self.endpoint.token)
        self._write((*numbers[:_WHOLE], *own, *map(float, numbers[_WHOLE:-1])))

    def received(self) -> bytes:
        """Return the newest report; no bytes if the report has not changed, or if another program wrote it.

        Raises:
            ConnectionLost: If no outputs arrive any more.
        """
        newest, now = self._outputs(), self._clock()
        if newest is None:
            if now - self._received_at > _SILENCE:
                raise ConnectionLost(f"no output registers have arrived for {now - self._received_at:.1f} s")
            return b""
        self._received_at = now
        *report, token = (getattr(newest, name) for name in POINT_OUTPUTS)
        if token != self.endpoint.token or tuple(report) == self._last:
            return b""
        self._last = tuple(report)
        return _REPORT.pack(*report)


class PointLinks:
    """Factory of links to programs that buffer points.

    The output registers are requested with the first link.

    Args:
        outputs: Function that returns a stream of the RTDE outputs with given names.
    """

    def __init__(self, outputs: Callable[..., Stream[Any]]) -> None:
        self._outputs = outputs
        self._stream: Stream[Any] | None = None

    def __call__(self, inputs: InputClaim) -> PointRegisterLink:
        """Return the link of the next program.

        Raises:
            LinkError: If the outputs are not available.
        """
        if self._stream is None:
            self._stream = self._outputs(*POINT_OUTPUTS)
        stream = self._stream
        stream.start()
        return PointRegisterLink(inputs, lambda: stream.latest)
