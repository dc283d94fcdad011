"""General-purpose registers, watchdogs for RTDE inputs, and the RTDE inputs that clients have claimed.

Fieldbuses, RTDE clients and programs share the registers (docs/protocols/rtde.md, Releases). Fieldbuses and RTDE
clients write the input registers, and programs read them. Programs write the output registers. Registers 0 to 23 are
meant for fieldbuses and PLCs, and registers 24 to 47 for RTDE clients. Registers 24 to 47 were added in firmware 3.9
and 5.3.

Only one client can claim an input. This client can use the input in several recipes, and releases it when its
connection ends (docs/protocols/rtde.md, Rules). A fieldbus that is enabled in the installation also reserves inputs.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable
from dataclasses import dataclass
from typing import Literal

from linkcore.names import StrictAttributes

#: Number of boolean registers; number of integer registers, which is also the number of floating-point registers.
BITS, NUMBERS = 128, 48


class Bank:
    """The input registers or the output registers of a controller.

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
    """Watchdog of one variable. Each data package that contains the variable resets it, whatever the value."""

    cycles: float
    action: Action
    fed: int


class Watchdogs:
    """The watchdogs that a program has set with `rtde_set_watchdog`. They are removed when the program ends."""

    def __init__(self) -> None:
        self._dogs: dict[str, _Watchdog] = {}

    def set(self, variable: str, cycles: float, action: Action, now: int) -> None:
        """Set a watchdog: the variable must arrive at least once in `cycles` cycles. Infinity removes the watchdog."""
        if math.isinf(cycles):
            self._dogs.pop(variable, None)
        else:
            self._dogs[variable] = _Watchdog(cycles, action, now)

    def feed(self, variables: Collection[str], now: int) -> None:
        """Record that a data package with these variables arrived in this cycle."""
        # Iterate over the watchdogs: usually there is none, but a client sends many variables.
        for variable, dog in self._dogs.items():
            if variable in variables:
                dog.fed = now

    @property
    def is_empty(self) -> bool:
        """Whether no watchdog is set."""
        return not self._dogs

    def restart(self, now: int) -> None:
        """Restart all watchdogs in this cycle, as if all variables had just arrived."""
        for dog in self._dogs.values():
            dog.fed = now

    def expired(self, now: int) -> Action | None:
        """Return the action for late variables; None if no variable is late. "stop" takes precedence over "pause"."""
        if not self._dogs:
            return None
        late = {dog.action for dog in self._dogs.values() if now - dog.fed > dog.cycles}
        return "stop" if "stop" in late else "pause" if "pause" in late else None

    def clear(self) -> None:
        """Remove all watchdogs, because the program has ended."""
        self._dogs.clear()


# A bug report for the vendor's Python client states that EtherNet/IP reserves the lower half of the integer registers
# and of the floating-point registers. It is assumed that PROFINET does the same. The effect on the boolean registers is
# unknown; in the simulator, they stay free.
_LOWER = frozenset(f"input_{kind}_register_{number}" for kind in ("int", "double") for number in range(24))

#: Name of a fieldbus -> inputs that this fieldbus reserves.
FIELDBUSES = {"EtherNet/IP": _LOWER, "PROFINET": _LOWER}


class InputClaims:
    """The RTDE inputs of one controller, and the clients that have claimed them."""

    def __init__(self) -> None:
        self._owners: dict[str, object] = {}
        # Ended connection -> last cycle in which its inputs are still claimed.
        self._stale: dict[object, int] = {}

    def holder(self, name: str, now: int) -> object | None:
        """Return the client that has claimed this input, as of this cycle; None if the input is free."""
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
        """Keep the inputs of an ended connection claimed until this cycle."""
        self._stale[owner] = until
