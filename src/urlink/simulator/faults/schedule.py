"""Faults at given times: as text for a command line, and the schedule of one controller."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

from linkcore.errors import BadValue, LocalError
from urlink.arm.models import Model
from urlink.protocol.firmware import Firmware

from ..state import firmware_for
from .faults import Faults, checked_seconds, checked_sizes, port_names, request_byte, type_byte

_log = logging.getLogger("urlink.simulator")


@dataclass(frozen=True)
class ScheduledFault:
    """A fault, and the time at which it happens.

    Attributes:
        name: method of `Faults`.
        arguments: of that method.
        at: seconds since the controller was made; a reboot does not reset them.
    """

    name: str
    arguments: tuple[Any, ...]
    at: float

    def happen(self, faults: Faults) -> None:
        """Make it happen now."""
        getattr(faults, self.name)(*self.arguments)


def _number(text: str) -> float:
    return checked_seconds(float(text))


def _size(text: str) -> int:
    return checked_sizes([int(text)])[0]


def _sizes(text: str) -> tuple[int, ...]:
    return checked_sizes([int(part) for part in text.split("+")])


def _request(text: str) -> str:
    request_byte(text)
    return text


#: name -> how its argument is read and what it is, or None where it has none, and whether it can be left out
FAULTS: dict[str, tuple[Callable[[str], Any], str, bool] | None] = {
    "protective_stop": None,
    "safeguard_stop": None,
    "emergency_stop": None,
    "clear": None,
    "power_off": None,
    "power_on": None,
    "reboot": (Firmware.parse, "the firmware to come back with", True),
    "cut": (lambda text: port_names(text)[0], "the port", True),
    "stall": (_number, "seconds", False),
    "split": (_sizes, "sizes of segments, such as 100+200", False),
    "merge": (_size, "packets per segment", False),
    "garbage": (_size, "number of bytes", False),
    "append": (_size, "number of bytes", False),
    "unknown_package": (lambda text: type_byte(int(text)), "the type", True),
    "unknown_sub_package": (lambda text: type_byte(int(text)), "the type", True),
    "rtde_hello": None,
    "rtde_refuse_protocol_2": None,
    "rtde_text_before_reply": (_request, "the letter of the request", True),
    "rtde_text_instead_of_reply": (_request, "the letter of the request", True),
    "rtde_data_before_start": None,
    "rtde_refuse_start": None,
    "rtde_no_data": None,
    "rtde_late_data": (_number, "seconds", False),
    "rtde_stale_inputs": (_number, "seconds", False),
    "rtde_reboot_at_request": (_request, "the letter of the request", True),
    "heal": None,
}


def parse_fault(text: str) -> ScheduledFault:
    """``"protective_stop@5"``, ``"reboot=5.12@10"``, ``"split=100+200@0"``: NAME[=ARGUMENT]@SECONDS.

    Raises:
        BadValue: no such fault, an argument too many, missing or unreadable, or no time. The message says which.

    >>> parse_fault("stall=2.5@10")
    ScheduledFault(name='stall', arguments=(2.5,), at=10.0)
    """
    what, at_sign, when = text.rpartition("@")
    if not at_sign:
        raise BadValue(f"{text!r} has no time; expected NAME[=ARGUMENT]@SECONDS, such as protective_stop@5")
    try:
        at = _number(when)
    except ValueError:
        raise BadValue(f"{text!r}: {when!r} is not a number of seconds") from None
    name, equals, argument = what.partition("=")
    if name not in FAULTS:
        raise BadValue(f"{text!r}: no fault is called {name!r}; there are {', '.join(FAULTS)}")
    kind = FAULTS[name]
    if kind is None:
        if equals:
            raise BadValue(f"{text!r}: {name} takes no argument")
        return ScheduledFault(name, (), at)
    read, meaning, optional = kind
    if not equals:
        if not optional:
            raise BadValue(f"{text!r}: {name} needs {meaning}, as in {name}=...@{when}")
        return ScheduledFault(name, (), at)
    try:
        value = read(argument)
    except (ValueError, LocalError) as error:
        raise BadValue(f"{text!r}: {argument!r} does not do as {meaning} ({error})") from None
    return ScheduledFault(name, (value,), at)


def checked(faults: Iterable[str | ScheduledFault], model: Model) -> list[ScheduledFault]:
    """The faults, with texts parsed, checked for an arm.

    Raises:
        BadValue: a text that `parse_fault` cannot read, no such fault, or a reboot into firmware that does not run on
            the model.
    """
    parsed = [parse_fault(fault) if isinstance(fault, str) else fault for fault in faults]
    for fault in parsed:
        if fault.name not in FAULTS:
            raise BadValue(f"no fault is called {fault.name!r}; there are {', '.join(FAULTS)}")
        if fault.name == "reboot" and fault.arguments and fault.arguments[0] is not None:
            firmware_for(model, fault.arguments[0])
    return parsed


class FaultSchedule:
    """The faults that are to happen to one controller.

    Args:
        faults: makes them happen.
    """

    def __init__(self, faults: Faults) -> None:
        self._do = faults
        self._faults: list[ScheduledFault] = []

    def add(self, faults: Iterable[ScheduledFault]) -> None:
        """Add faults, each at its time."""
        self._faults = sorted([*self._faults, *faults], key=lambda fault: fault.at)

    def next_cycle(self, rate: float) -> int | None:
        """The cycle in which the next one happens; None if there is none."""
        return math.ceil(self._faults[0].at * rate) if self._faults else None

    def advance(self, cycle: int, rate: float) -> None:
        """Make the faults happen that are due in this cycle."""
        while (due := self.next_cycle(rate)) is not None and due <= cycle:
            fault = self._faults.pop(0)
            try:
                fault.happen(self._do)
            except LocalError as error:
                # Made by hand, with arguments that its method does not have; the controller goes on.
                _log.warning("%s did not happen: %s", fault, error)
