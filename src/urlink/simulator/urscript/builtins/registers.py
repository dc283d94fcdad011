"""General-purpose registers, and the watchdog over RTDE inputs (docs/protocols/rtde.md, Releases).

Known: which registers there are since when, and that the action of the watchdog is one of "ignore", "pause" and "stop"
in any case of letters, "pause" where none is given. Guesses: that a register which the firmware does not have, and a
variable that RTDE does not take, are run-time errors; that a frequency of zero ends the watchdog.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal

from linkcore.wire.version import Since

from ...registers import BITS, NUMBERS, Action, Bank
from ..errors import Fault
from ..machine import ScriptThread
from .declaration import Family, boolean, integer, number, string

__all__ = ["FAMILY"]

FAMILY = Family()

_Kind = Literal["boolean", "integer", "float"]

_HAS_UPPER_RANGE = Since("3.9/5.3")
_ACTIONS: dict[str, Action] = {"ignore": "ignore", "pause": "pause", "stop": "stop"}


def _address(thread: ScriptThread, address: Any, kind: _Kind, what: str) -> int:
    """The number of a register that the firmware has."""
    count = BITS if kind == "boolean" else NUMBERS
    if thread.world.firmware not in _HAS_UPPER_RANGE:
        count //= 2
    return integer(address, f"{what}: address", 0, count - 1)


def _read(bank: Bank, kind: _Kind, at: int) -> bool | int | float:
    if kind == "boolean":
        return bool(bank.bits >> at & 1)
    # Tests write numbers of numpy too, which the machine does not take for numbers.
    return int(bank.integers[at]) if kind == "integer" else float(bank.floats[at])


def _reader(name: str, kind: _Kind, *, is_input: bool) -> Callable[..., bool | int | float]:
    def read(thread: ScriptThread, address: Any) -> bool | int | float:
        registers = thread.world.registers
        bank = registers.inputs if is_input else registers.outputs
        return _read(bank, kind, _address(thread, address, kind, name))

    return read


def _writer(name: str, kind: _Kind) -> Callable[..., None]:
    def write(thread: ScriptThread, address: Any, value: Any) -> None:
        bank = thread.world.registers.outputs
        at = _address(thread, address, kind, name)
        if kind == "boolean":
            bank.set_bit(at, boolean(value, f"{name}: value"))
        elif kind == "integer":
            bank.integers[at] = integer(value, f"{name}: value")
        else:
            bank.floats[at] = float(number(value, f"{name}: value"))

    return write


_KINDS: tuple[_Kind, ...] = ("boolean", "integer", "float")

# RTDE has them from 3.4 on; that programs have them from 3.0 on is left open rather than refused.
for _kind in _KINDS:
    for _direction in ("input", "output"):
        _name = f"read_{_direction}_{_kind}_register"
        FAMILY.declare(name=_name, since="3.0")(_reader(_name, _kind, is_input=_direction == "input"))
    _name = f"write_output_{_kind}_register"
    FAMILY.declare(name=_name, since="3.0")(_writer(_name, _kind))


@FAMILY.declare(since="3.0")
def rtde_set_watchdog(thread: ScriptThread, variable_name: Any, min_frequency: Any, action: Any = "pause") -> None:
    """From then on the variable has to come `min_frequency` times a second, or the action is taken."""
    variable = string(variable_name, "rtde_set_watchdog: variable_name")
    frequency = float(number(min_frequency, "rtde_set_watchdog: min_frequency"))
    wanted = _ACTIONS.get(string(action, "rtde_set_watchdog: action").lower())
    if frequency < 0:
        raise Fault("rtde_set_watchdog: min_frequency is not negative")
    if wanted is None:
        raise Fault(f"rtde_set_watchdog: action is 'ignore', 'pause' or 'stop', not '{action}'")
    thread.world.set_watchdog(variable, frequency, wanted)
