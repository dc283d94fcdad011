"""General-purpose registers, watchdogs over inputs, and the claims of RTDE inputs.

Fieldbuses, RTDE clients and programs share the registers (docs/protocols/rtde.md, Releases). Inputs are written from
outside and read by programs; outputs are written by programs. Registers 0 to 23 are meant for fieldbuses and PLCs, and
24 to 47 for RTDE clients. The upper half was added in 3.9 and 5.3.

One client holds an input, in as many of its recipes as it likes, until its connection ends (docs/protocols/rtde.md,
Rules). A fieldbus that is enabled in the installation holds inputs too.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable
from dataclasses import dataclass
from typing import Literal

from linkcore.names import StrictAttributes

#: Number of boolean registers, and of registers of each kind of number.
BITS, NUMBERS = 128, 48


class Bank:
    """The registers of one direction.

    Attributes:
        bits: Boolean registers: bit `n` is register `n`.
        integers: Integer registers, 32 bits each.
        floats: Floating-point registers, double precision.
    """

    def __init__(self) -> None:
        self.bits = 0
        self.integers = [0] * NUMBERS
        self.floats = [0.0] * NUMBERS

    def set_bit(self, number: int, on: bool) -> None:
        """Write one boolean register."""
        self.bits = self.bits | 1 << number if on else self.bits & ~(1 << number)


class RegisterBanks(StrictAttributes):
    """All registers of a controller.

    Attributes:
        inputs: Registers that fieldbuses and RTDE clients write.
        outputs: Registers that programs write.
    """

    def __init__(self) -> None:
        self.inputs = Bank()
        self.outputs = Bank()


Action = Literal["ignore", "pause", "stop"]


@dataclass
class _Watchdog:
    """Watchdog of one variable. A data package with the variable resets it, whatever its value."""

    cycles: float
    action: Action
    fed: int


class Watchdogs:
    """The watchdogs that a program has set with `rtde_set_watchdog`. They end with the program."""

    def __init__(self) -> None:
        self._dogs: dict[str, _Watchdog] = {}

    def set(self, variable: str, cycles: float, action: Action, now: int) -> None:
        """Watch a variable: it must arrive once in `cycles`. Infinity removes the watchdog."""
        if math.isinf(cycles):
            self._dogs.pop(variable, None)
        else:
            self._dogs[variable] = _Watchdog(cycles, action, now)

    def feed(self, variables: Collection[str], now: int) -> None:
        """Record that a data package with these variables arrived in this cycle."""
        # Usually there is no watchdog, but a client sends many variables, so iterate over the watchdogs.
        for variable, dog in self._dogs.items():
            if variable in variables:
                dog.fed = now

    def restart(self, now: int) -> None:
        """Restart the full time of all variables, from this cycle."""
        for dog in self._dogs.values():
            dog.fed = now

    def expired(self, now: int) -> Action | None:
        """Return the action for a late variable, "stop" before "pause"; None if none is late."""
        late = {dog.action for dog in self._dogs.values() if now - dog.fed > dog.cycles}
        return "stop" if "stop" in late else "pause" if "pause" in late else None

    def clear(self) -> None:
        """Remove all watchdogs, because the program has ended."""
        self._dogs.clear()


# A report to the vendor's Python client states that EtherNet/IP reserves the lower half of both kinds. That PROFINET
# does the same is assumed. The effect on the boolean registers is unknown; here they stay free.
_LOWER = frozenset(f"input_{kind}_register_{number}" for kind in ("int", "double") for number in range(24))

#: Fieldbus -> inputs that it reserves.
FIELDBUSES = {"EtherNet/IP": _LOWER, "PROFINET": _LOWER}


class InputClaims:
    """The inputs of one controller and the clients that hold them."""

    def __init__(self) -> None:
        self._owners: dict[str, object] = {}
        # Ended connections, and the last cycle in which their inputs are still held.
        self._stale: dict[object, int] = {}

    def holder(self, name: str, now: int) -> object | None:
        """Return the client that holds an input in this cycle; None if the input is free."""
        owner = self._owners.get(name)
        if owner is not None and self._stale.get(owner, now) < now:
            self.release(owner)
            return None
        return owner

    def claim(self, names: Iterable[str], owner: object) -> None:
        """Claim these inputs, which must be free."""
        self._owners.update(dict.fromkeys(names, owner))

    def release(self, owner: object) -> None:
        """Release all inputs of a client."""
        self._stale.pop(owner, None)
        self._owners = {name: held_by for name, held_by in self._owners.items() if held_by is not owner}

    def go_stale(self, owner: object, until: int) -> None:
        """Keep the inputs of an ended connection held up to that cycle."""
        self._stale[owner] = until
