"""The general-purpose registers, and the watchdogs of programs over what arrives by RTDE.

Fieldbuses, RTDE clients and programs share the registers (docs/protocols/rtde.md, Releases): inputs are written from
outside and read by programs, outputs are written by programs. 0 to 23 are meant for fieldbuses and PLCs, 24 to 47 for
RTDE clients; the latter came with 3.9 and 5.3.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

__all__ = ["BITS", "NUMBERS", "Action", "Bank", "Registers", "Watchdogs"]

#: Boolean registers, and registers of each kind of number.
BITS, NUMBERS = 128, 48


class Bank:
    """The registers of one direction.

    Attributes:
        bits: bit `n` is boolean register `n`.
        integers: of 32 bits.
        floats: of double precision.
    """

    def __init__(self) -> None:
        self.bits = 0
        self.integers = [0] * NUMBERS
        self.floats = [0.0] * NUMBERS

    def set_bit(self, number: int, on: bool) -> None:
        """Write one boolean register."""
        self.bits = self.bits | 1 << number if on else self.bits & ~(1 << number)


class Registers:
    """All registers of a controller.

    Attributes:
        inputs: what fieldbuses and RTDE clients write.
        outputs: what programs write.
    """

    def __init__(self) -> None:
        self.inputs = Bank()
        self.outputs = Bank()


Action = Literal["ignore", "pause", "stop"]


@dataclass
class _Watchdog:
    """The watchdog of one variable: reset by each data package that contains it, whatever its value."""

    cycles: float
    action: Action
    fed: int


class Watchdogs:
    """The watchdogs that a program has set by `rtde_set_watchdog`. They end with the program."""

    def __init__(self) -> None:
        self._dogs: dict[str, _Watchdog] = {}

    def set(self, variable: str, cycles: float, action: Action, now: int) -> None:
        """Watch a variable from now on: it must come once in `cycles`. Infinity ends the watchdog."""
        if math.isinf(cycles):
            self._dogs.pop(variable, None)
        else:
            self._dogs[variable] = _Watchdog(cycles, action, now)

    def feed(self, variables: Iterable[str], now: int) -> None:
        """Note a data package with these variables in this cycle."""
        if self._dogs:
            for variable in variables:
                dog = self._dogs.get(variable)
                if dog is not None:
                    dog.fed = now

    def restart(self, now: int) -> None:
        """Give all variables their full time again from this cycle on."""
        for dog in self._dogs.values():
            dog.fed = now

    def expired(self, now: int) -> Action | None:
        """The action for a late variable: "stop" before "pause"; None if none is late."""
        late = {dog.action for dog in self._dogs.values() if now - dog.fed > dog.cycles}
        return "stop" if "stop" in late else "pause" if "pause" in late else None

    def clear(self) -> None:
        """Remove all watchdogs: the program is over."""
        self._dogs.clear()
