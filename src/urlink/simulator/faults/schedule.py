"""Scheduled faults: the parser of their text form, and the schedule of a controller."""

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
    """Fault that happens at a given time.

    Attributes:
        name: Name of a method of `Faults`.
        arguments: Arguments of that method.
        at: Time since the controller was made, in s. A reboot does not reset it.
    """

    name: str
    arguments: tuple[Any, ...]
    at: float

    def happen(self, faults: Faults) -> None:
        """Cause the fault now."""
        getattr(faults, self.name)(*self.arguments)


def parse_fault(text: str) -> ScheduledFault:
    """Parse NAME[=ARGUMENT]@SECONDS, such as ``"protective_stop@5"`` or ``"split=100+200@0"``.

    Some arguments are optional, such as the firmware in ``"reboot=5.12@10"``.

    Raises:
        BadValue: If there is no such fault, if the argument is missing, unexpected or cannot be read, or if there is no
            time. The message names the cause.

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
        raise BadValue(f"{text!r}: no fault is called {name!r}; expected one of {', '.join(FAULTS)}")
    takes = FAULTS[name]
    if takes is None:
        if equals:
            raise BadValue(f"{text!r}: {name} takes no argument")
        return ScheduledFault(name, (), at)
    if not equals:
        if not takes.is_optional:
            raise BadValue(f"{text!r}: {name} needs {takes.meaning}; expected {name}=...@{when}")
        return ScheduledFault(name, (), at)
    try:
        value = takes.read(argument)
    except (ValueError, LocalError) as error:
        raise BadValue(f"{text!r}: invalid argument {argument!r}; expected {takes.meaning} ({error})") from None
    return ScheduledFault(name, (value,), at)


def checked(faults: Iterable[str | ScheduledFault], model: Model) -> list[ScheduledFault]:
    """Parse the faults that are given as texts, and check that all faults are possible for this model.

    Raises:
        BadValue: If `parse_fault` cannot read a text, a fault does not exist, or a reboot names firmware that does not
            run on the model.
    """
    parsed = [parse_fault(fault) if isinstance(fault, str) else fault for fault in faults]
    for fault in parsed:
        if fault.name not in FAULTS:
            raise BadValue(f"no fault is called {fault.name!r}; expected one of {', '.join(FAULTS)}")
        if fault.name == "reboot" and fault.arguments and fault.arguments[0] is not None:
            firmware_for(model, fault.arguments[0])
    return parsed


class FaultSchedule:
    """The faults that are scheduled for one controller.

    Args:
        faults: Faults of the controller.
    """

    def __init__(self, faults: Faults) -> None:
        self._do = faults
        self._faults: list[ScheduledFault] = []

    def add(self, faults: Iterable[ScheduledFault]) -> None:
        """Add faults to the schedule."""
        self._faults = sorted([*self._faults, *faults], key=lambda fault: fault.at)

    def next_cycle(self, rate: float) -> int | None:
        """Return the cycle of the next fault; None if there is none."""
        return math.ceil(self._faults[0].at * rate) if self._faults else None

    def advance(self, cycle: int, rate: float) -> None:
        """Cause the faults that are due in this cycle."""
        while self._faults and math.ceil(self._faults[0].at * rate) <= cycle:
            fault = self._faults.pop(0)
            try:
                fault.happen(self._do)
            except LocalError as error:
                # The fault was not parsed from a text, but made with arguments that its method does not accept. The
                # controller must continue.
                _log.warning("%s: could not happen: %s", fault, error)
