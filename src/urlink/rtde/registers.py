"""General-purpose registers of a controller by number: `robot.registers`."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

from linkcore.arguments import check_whole
from linkcore.errors import BadValue
from linkcore.names import StrictAttributes

from .claims import Claims
from .outputs import OutputStream

#: First number of the upper range, and total number of registers, of each kind.
_RANGES = {"bit": (64, 128), "int": (24, 48), "double": (24, 48)}

#: Packages per second for reading registers; fewer if a simulated controller executes fewer cycles.
FREQUENCY = 125.0


class Registers(StrictAttributes):
    """General-purpose registers of a controller, by number; `robot.registers`.

    A program on the controller and a client exchange values through them. A client writes input registers, which the
    program reads with `read_input_integer_register(n)`. The program writes output registers with
    `write_output_integer_register(n, value)`, which a client reads. The numbers are the same as in URScript.

    The first write of a register claims it until the robot is closed, so no other client can write it. Bits 64 to 127,
    and integers and floats 24 to 47, are for clients such as urlink. Lower registers are for fieldbuses and PLCs, and
    are used only on request (`Rtde.registers`).
    """

    def __init__(
        self,
        claimed: Callable[[], Claims],
        outputs: Callable[..., OutputStream[Any]],
        timeout: float,
        *,
        frequency: float = FREQUENCY,
        lower: bool,
    ) -> None:
        self._claimed = claimed
        self._outputs = outputs
        self._timeout = timeout
        self._frequency = frequency
        self._lower = lower
        self._streams: dict[str, OutputStream[Any]] = {}
        self._lock = threading.RLock()  # re-entrant, for signal handlers

    # -- input registers, which a program on the controller reads --------------------------------------

    def write_bit(self, number: int, value: bool) -> None:
        """Write an input bit, 64 to 127. Lower bits can only be written 32 at a time, with `Rtde.inputs`.

        Raises:
            BadValue: If the register does not exist, or the value is invalid. Nothing is sent.
            InputInUse: If another client holds the register.
            RemoteError, Closed: If the controller cannot be reached.
        """
        check_whole(number, "number", 64, 127)
        self._claimed().write({f"input_bit_register_{number}": value})

    def write_integer(self, number: int, value: int) -> None:
        """Write a 32-bit integer input register; see `write_bit`."""
        self._claimed().write({f"input_int_register_{self._checked(number, 'int')}": value})

    def write_float(self, number: int, value: float) -> None:
        """Write a float input register; see `write_bit`."""
        self._claimed().write({f"input_double_register_{self._checked(number, 'double')}": value})

    # -- output registers, which a program on the controller writes ------------------------------------

    def read_bit(self, number: int) -> bool:
        """Return the value of an output bit in the newest package, which is up to one cycle old.

        The end of a program is reported on another connection. A value that the program writes at its end might arrive
        one package later.

        Raises:
            BadValue: If the register does not exist.
            LinkTimeout: If no package arrives in time.
            RemoteError, Closed: If the controller cannot be reached.
        """
        number = self._checked(number, "bit")
        if number >= 64:
            return bool(self._read("bit", f"output_bit_register_{number}"))
        low = number // 32 * 32
        return bool(self._read("words", f"output_bit_registers{low}_to_{low + 31}") >> (number - low) & 1)

    def read_integer(self, number: int) -> int:
        """Return the newest value of an integer output register; see `read_bit`."""
        return int(self._read("int", f"output_int_register_{self._checked(number, 'int')}"))

    def read_float(self, number: int) -> float:
        """Return the newest value of a float output register; see `read_bit`."""
        return float(self._read("double", f"output_double_register_{self._checked(number, 'double')}"))

    def _checked(self, number: int, kind: str) -> int:
        upper, end = _RANGES[kind]
        check_whole(number, "number", 0, end - 1)
        if number < upper and not self._lower:
            raise BadValue(
                f"number={number}; expected {upper} to {end - 1}, because lower registers are for fieldbuses and PLCs "
                "(robot.rtde.registers(lower=True) has them)"
            )
        return number

    def _read(self, kind: str, name: str) -> Any:
        """Return the newest value of an output register. All registers of one kind share a connection."""
        with self._lock:
            stream = self._streams.get(kind)
            is_new = stream is None
            if stream is None:
                if kind == "words":
                    names = tuple(f"output_bit_registers{low}_to_{low + 31}" for low in (0, 32))
                else:
                    upper, end = _RANGES[kind]
                    first = upper if kind == "bit" or not self._lower else 0
                    names = tuple(f"output_{kind}_register_{number}" for number in range(first, end))
                stream = self._streams[kind] = self._outputs(*names, frequency=self._frequency)
        # `wait` connects a new stream, so that its first package is not missed.
        state = (None if is_new else stream.latest) or stream.wait(self._timeout)
        return getattr(state, name)

    def __repr__(self) -> str:
        return f"<Registers {'of all numbers' if self._lower else 'of the upper range'}>"
