"""Simulated vacuum gripper of Robotiq: variables, pressure and gripped object.

The following is assumed:

- The vacuum changes at a constant rate, 100 kPa/s, and stops at the requested vacuum.
- Without an object, the suction cups reach no vacuum. The gripper stops after the timeout of the object, and reports
  fault 6.
- An object counts as gripped at the minimum vacuum. The gripper keeps the vacuum until it is released or reset.
- In automatic mode, a grip uses 60 and 40 kPa.
- After a release, the object status is unknown (0).
"""

from __future__ import annotations

from collections.abc import Callable

from urlink.protocol.gripper.protocol import READABLE
from urlink.protocol.gripper.vacuum import AMBIENT, VACUUM_WRITABLE

from .mounted_gripper import UrcapGripper

#: Rate at which the vacuum changes, in kPa/s.
_RATE = 100.0
#: Vacuum and minimum of the automatic mode, in kPa.
_AUTOMATIC = 60.0, 40.0
#: Values of `OBJ`.
_UNKNOWN, _AT_MINIMUM, _AT_REQUEST, _NO_OBJECT = range(4)
#: Values of `FLT`: no object in time, and not activated.
_TIMED_OUT, _NOT_ACTIVATED = 6, 7


class SimulatedVacuumGripper(UrcapGripper):
    """Vacuum gripper of a simulated controller. Initially, it is reset, and there is no object at its suction cups.

    Args:
        clock: Function that returns the time of the controller, in s.

    Attributes:
        registers: Values that clients have set, by name.
        is_connected: Whether the gripper is connected to the controller. If not, the reply to a query is `?`.
        fault: Fault number (`FLT`). It can be set; an activation of the gripper clears it.
    """

    def __init__(self, clock: Callable[[], float]) -> None:
        super().__init__(clock, VACUUM_WRITABLE, READABLE)
        self._vacuum = 0.0
        self._is_sealed = False
        self._result = _UNKNOWN
        #: Time for which the gripper has been sucking without an object, in s.
        self._searching = 0.0

    # -- for tests -------------------------------------------------------------------------------------

    def place(self) -> None:
        """Put an object at the suction cups."""
        with self._lock:
            self._advance()
            self._is_sealed = True

    def take_away(self) -> None:
        """Remove the object. The vacuum is then lost."""
        with self._lock:
            self._advance()
            self._is_sealed, self._vacuum = False, min(self._vacuum, 0.0)

    # -- status ----------------------------------------------------------------------------------------

    @property
    def vacuum(self) -> float:
        """Vacuum at the suction cups, in kPa below the ambient pressure."""
        with self._lock:
            self._advance()
            return self._vacuum

    @property
    def holds_object(self) -> bool:
        """Whether the gripper holds an object."""
        with self._lock:
            self._advance()
            return self._result in (_AT_MINIMUM, _AT_REQUEST)

    def _read(self, name: str) -> int:
        shown = self.registers | {
            "POS": min(max(round(AMBIENT - self._vacuum), 0), 255),
            "PRE": self.registers["POS"],
            "STA": 3 if self.registers["ACT"] else 0,
            "OBJ": self._result,
            "FLT": self.fault,
            "COU": 0,
        }
        return shown[name]

    def _write(self, values: dict[str, int]) -> None:
        was_on, request = self.registers["ACT"], (self.registers["POS"], self.registers["GTO"])
        self.registers.update(values)
        if not self.registers["ACT"] or not was_on:
            self.fault, self._result, self._searching = 0, _UNKNOWN, 0.0
            if not self.registers["ACT"] and self.registers["GTO"] and "GTO" in values:
                self.fault = _NOT_ACTIVATED
        elif (self.registers["POS"], self.registers["GTO"]) != request or "POS" in values:
            self._result, self._searching = _UNKNOWN, 0.0
            if self.fault == _TIMED_OUT:
                self.fault = 0

    # -- its pump --------------------------------------------------------------------------------------

    def _advance(self) -> None:
        """Advance the pressure to the current time of the controller."""
        seconds = self._elapsed()
        is_on = self.registers["ACT"] and self.registers["GTO"]
        wanted = AMBIENT - self.registers["POS"]
        if not is_on or wanted <= 0:
            # The pump is off, or blows the object off: the pressure returns to the ambient pressure.
            self._vacuum = max(self._vacuum - _RATE * seconds, 0.0)
            if self._vacuum == 0.0:
                self._result = _UNKNOWN
            return
        vacuum, minimum = (
            (float(wanted), float(AMBIENT - self.registers["FOR"])) if self.registers["MOD"] else _AUTOMATIC
        )
        if not self._is_sealed:
            self._searching += seconds
            if self._searching >= self.registers["SPE"] / 10.0:
                self._result, self.fault = _NO_OBJECT, self.fault or _TIMED_OUT
            return
        if self._result != _NO_OBJECT:
            self._vacuum = min(self._vacuum + _RATE * seconds, vacuum)
            if self._vacuum >= minimum:
                self._result = _AT_REQUEST if self._vacuum >= vacuum else _AT_MINIMUM
