"""`robot.registers`: the general-purpose registers of a controller, by number."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

from linkcore.arguments import check_whole
from linkcore.errors import BadValue
from linkcore.names import StrictAttributes

from .claims import Claims
from .outputs import OutputStream

#: Kind of register -> the first of the upper range, and how many there are.
_RANGES = {"bit": (64, 128), "int": (24, 48), "double": (24, 48)}

#: Packages a second in which the registers are read.
_FREQUENCY = 125.0


class Registers(StrictAttributes):
    """The general-purpose registers of a controller, by number; `robot.registers`.

    They are what a program on the controller and a client send each other. A client writes input registers, which the
    program reads by `read_input_integer_register(n)`; the program writes output registers by
    `write_output_integer_register(n, value)`, which a client reads. The numbers are those of URScript.

    Each register that is written is claimed when it is written for the first time, and kept until the robot is closed,
    so no other client can write it. Bits 64 to 127, integers and floats 24 to 47 are for clients such as this one; the
    lower ones are for fieldbuses and PLCs, and not taken unless asked for (`Rtde.registers`).
    """

    def __init__(
        self,
        claimed: Callable[[], Claims],
        outputs: Callable[..., OutputStream[Any]],
        timeout: float,
        *,
        lower: bool,
    ) -> None:
        self._claimed = claimed
        self._outputs = outputs
        self._timeout = timeout
        self._lower = lower
        self._streams: dict[str, OutputStream[Any]] = {}
        self._lock = threading.RLock()  # re-entrant, for signal handlers

    # -- what a program on the controller reads --------------------------------------------------------

    def write_bit(self, number: int, value: bool) -> None:
        """Write an input bit, 64 to 127; the lower ones can only be written 32 at a time, by `Rtde.inputs`.

        Raises:
            BadValue: no such register, or no such value; nothing was sent.
            InputInUse: another client holds the register.
            RemoteError, Closed: the controller cannot be reached.
        """
        check_whole(number, "number", 64, 127)
        self._claimed().write({f"input_bit_register_{number}": value})

    def write_integer(self, number: int, value: int) -> None:
        """Write an input integer of 32 bits; see `write_bit`."""
        self._claimed().write({f"input_int_register_{self._checked(number, 'int')}": value})

    def write_float(self, number: int, value: float) -> None:
        """Write an input float; see `write_bit`."""
        self._claimed().write({f"input_double_register_{self._checked(number, 'double')}": value})

    # -- what a program on the controller writes -------------------------------------------------------

    def read_bit(self, number: int) -> bool:
        """The value of an output bit in the newest package, which is up to a cycle old.

        That a program is over comes on another connection: what it writes at its end may be in the next package only.

        Raises:
            BadValue: no such register.
            LinkTimeout: nothing came in time.
            RemoteError, Closed: the controller cannot be reached.
        """
        number = self._checked(number, "bit")
        if number >= 64:
            return bool(self._read("bit", f"output_bit_register_{number}"))
        low = number // 32 * 32
        return bool(self._read("words", f"output_bit_registers{low}_to_{low + 31}") >> (number - low) & 1)

    def read_integer(self, number: int) -> int:
        """The newest value of an output integer; see `read_bit`."""
        return int(self._read("int", f"output_int_register_{self._checked(number, 'int')}"))

    def read_float(self, number: int) -> float:
        """The newest value of an output float; see `read_bit`."""
        return float(self._read("double", f"output_double_register_{self._checked(number, 'double')}"))

    def _checked(self, number: int, kind: str) -> int:
        upper, end = _RANGES[kind]
        check_whole(number, "number", 0, end - 1)
        if number < upper and not self._lower:
            raise BadValue(
                f"number={number}; registers below {upper} are for fieldbuses and PLCs, expected {upper} to {end - 1}; "
                "robot.rtde.registers(lower=True) has the others too"
            )
        return number

    def _read(self, kind: str, name: str) -> Any:
        """The newest value of an output register; all of its kind come on one connection."""
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
                stream = self._streams[kind] = self._outputs(*names, frequency=_FREQUENCY)
        # A new stream is connected by waiting, so that its first package is not missed.
        state = (None if is_new else stream.latest) or stream.wait(self._timeout)
        return getattr(state, name)

    def __repr__(self) -> str:
        return f"<Registers {'of all numbers' if self._lower else 'of the upper range'}>"
