"""Functions for the general-purpose registers, and for the watchdogs of RTDE inputs.

Registers are values that programs share with fieldbuses and RTDE clients. It is known which registers each firmware has
(docs/protocols/rtde.md, Releases). The action of a watchdog is "ignore", "pause" or "stop", in upper or lower case; the
default is "pause". Three things are assumed. The use of a register that the firmware lacks is a run-time error. A
watchdog for a variable that is not an RTDE input is a run-time error too. A frequency of zero removes the watchdog.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal, get_args

from linkcore.wire.fields import Since

from ...registers import BITS, NUMBERS, Action
from ..errors import Fault
from ..machine import ScriptThread
from .declaration import boolean, declare, integer, number, string

_Kind = Literal["boolean", "integer", "float"]

_HAS_UPPER_RANGE = Since("3.9/5.3")
_ACTIONS: dict[str, Action] = {"ignore": "ignore", "pause": "pause", "stop": "stop"}


def _address(thread: ScriptThread, address: Any, kind: _Kind, what: str) -> int:
    """Return the number of a register, after checking that the firmware has this register."""
    count = BITS if kind == "boolean" else NUMBERS
    if thread.world.firmware not in _HAS_UPPER_RANGE:
        count //= 2
    return integer(address, f"{what}: address", 0, count - 1)


def _reader(name: str, kind: _Kind, *, is_input: bool) -> Callable[..., bool | int | float]:
    def read(thread: ScriptThread, address: Any) -> bool | int | float:
        registers = thread.world.registers
        bank = registers.inputs if is_input else registers.outputs
        at = _address(thread, address, kind, name)
        if kind == "boolean":
            return bool(bank.bits >> at & 1)
        # Convert the value, because tests also write numpy numbers, which the machine does not accept as numbers.
        return int(bank.integers[at]) if kind == "integer" else float(bank.floats[at])

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


# RTDE has had the registers since 3.4. It is unknown whether programs can use them in older firmware, so the functions
# are allowed since 3.0.
for _kind in get_args(_Kind):
    for _direction in ("input", "output"):
        _name = f"read_{_direction}_{_kind}_register"
        declare(name=_name, since="3.0")(_reader(_name, _kind, is_input=_direction == "input"))
    _name = f"write_output_{_kind}_register"
    declare(name=_name, since="3.0")(_writer(_name, _kind))


@declare(since="3.0")
def rtde_set_watchdog(thread: ScriptThread, variable_name: Any, min_frequency: Any, action: Any = "pause") -> None:
    """Set a watchdog: if the variable does not arrive `min_frequency` times per second, the action is executed."""
    variable = string(variable_name, "rtde_set_watchdog: variable_name")
    frequency = float(number(min_frequency, "rtde_set_watchdog: min_frequency"))
    wanted = _ACTIONS.get(string(action, "rtde_set_watchdog: action").lower())
    if frequency < 0:
        raise Fault("rtde_set_watchdog: min_frequency must not be negative")
    if wanted is None:
        raise Fault(f"rtde_set_watchdog: action is '{action}'; expected 'ignore', 'pause' or 'stop'")
    thread.world.set_watchdog(variable, frequency, wanted)
