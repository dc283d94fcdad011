"""Input registers of the robot as the link to a program: no connection to this computer is needed.

The messages are those of a reverse link, one register for each number. They reach the program by RTDE,
which applies a package as a whole in one cycle.
"""

from __future__ import annotations

import random
import threading
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Generic, Protocol, TypeVar

from linkcore.errors import ConnectFailed, ConnectionLost, LinkTimeout

from ..urscript.links import TOKENS, InputRegisters
from .setpoints import MESSAGE_SIZE, read_message

#: Number of the first float register and of the first integer register: the last twelve and the last four of all are
#: used, so that others from 24 on are left to users, and those below 24 to fieldbuses. From 3.9 and 5.3 on.
FIRST_FLOAT, FIRST_INTEGER = 36, 44
#: The RTDE inputs that a link writes: positions and speeds of a set-point, the date and the number of the message, what
#: to do, and the token.
NAMES = tuple(
    [f"input_double_register_{FIRST_FLOAT + i}" for i in range(12)]
    + [f"input_int_register_{FIRST_INTEGER + i}" for i in range(4)]
)
#: Largest number of a message, as large as an integer register holds; after it comes 1 again.
_MOST = 0x7FFF_FFFF


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
        self._claiming = threading.Lock()
        self._inputs: InputClaim | None = None

    def open(self) -> L:
        """The link of the next program; it may have to connect.

        Raises:
            InputInUse: another client, or a fieldbus, holds one of the registers.
            LinkError: RTDE cannot be used.
        """
        # A controller gives a register to one connection, so to the first of two threads of this robot only. With a
        # deadline: a signal handler may come here while the main thread, which it keeps, claims them.
        if not self._claiming.acquire(timeout=self._timeout):
            raise LinkTimeout(f"the registers of a link are still being claimed after {self._timeout:g} s")
        try:
            if self._inputs is None:
                self._inputs = self._claim(self._names)
            return self._make(self._inputs)
        finally:
            self._claiming.release()


def random_token() -> int:
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
        super().__init__(inputs, NAMES)
        self.endpoint = InputRegisters(FIRST_FLOAT, FIRST_INTEGER, random_token())

    def send(self, data: bytes) -> None:
        """Write a dated message.

        Raises:
            LinkError: it could not be written.
        """
        q, qd, mode = read_message(data[:MESSAGE_SIZE])
        self._count = self._count % _MOST + 1
        self._write((*q, *qd, int.from_bytes(data[MESSAGE_SIZE:], "big"), self._count, mode, self.endpoint.token))
