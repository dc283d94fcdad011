"""Faults at given times: as text for a command line, and the schedule of one controller."""

from __future__ import annotations

import logging
import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from linkcore.errors import BadValue, LocalError
from urlink.arm.models import Model

from ..state import firmware_for
from .faults import FAULTS, Faults, checked_seconds

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
        at = checked_seconds(float(when))
    except ValueError:
        raise BadValue(f"{text!r}: {when!r} is not a number of seconds") from None
    name, equals, argument = what.partition("=")
    if name not in FAULTS:
        raise BadValue(f"{text!r}: no fault is called {name!r}; there are {', '.join(FAULTS)}")
    takes = FAULTS[name]
    if takes is None:
        if equals:
            raise BadValue(f"{text!r}: {name} takes no argument")
        return ScheduledFault(name, (), at)
    if not equals:
        if not takes.is_optional:
            raise BadValue(f"{text!r}: {name} needs {takes.meaning}, as in {name}=...@{when}")
        return ScheduledFault(name, (), at)
    try:
        value = takes.read(argument)
    except (ValueError, LocalError) as error:
        raise BadValue(f"{text!r}: {argument!r} does not do as {takes.meaning} ({error})") from None
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
