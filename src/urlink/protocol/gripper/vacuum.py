"""Client for the vacuum grippers of Robotiq (EPick, AirPick), over the port of their URCap (63352).

The lines and variables are those of the Robotiq fingers. The meanings of the values are from public clients:

- port 63352: Automation-Research-Team/aist_robotiq (EPick), and a port of the URCap's functions `rq_vacuum_grip` and
  `rq_vacuum_release` for the AirPick;
- the registers behind the variables: PickNikRobotics/ros2_epick_gripper (`default_driver.cpp`): a pressure of 100 is
  the ambient pressure, and one step is 1 kPa.

They were read, and not run.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple

from linkcore import clock
from linkcore.arguments import check_number, check_seconds, check_wait
from linkcore.errors import BadValue
from linkcore.wire.fields import OpenInt

from .protocol import WRITABLE, set_line
from .robotiq import RESET, RobotiqGripper

#: Variables of a vacuum gripper that can be set: name -> maximum value. `MOD` is 0 for automatic, 1 for advanced mode.
VACUUM_WRITABLE: Mapping[str, int] = {**WRITABLE, "MOD": 1}
#: Value of a pressure variable at ambient pressure. One step is 1 kPa.
AMBIENT = 100
#: Value of `POS` that releases the object by blowing.
RELEASE = 255
#: Faults that are results of a grip: a porous object, and no object in time. Source: ros2_epick_gripper.
RESULTS = {3: "the object is porous", 6: "no object was gripped in time"}

#: Variables that reset the gripper, so that it does not repeat the last grip when it is activated.
_RESET = {**RESET, "GTO": 0}
#: Largest vacuum in kPa at which an object counts as released (assumed).
_RELEASED = 5.0


class SuctionStatus(OpenInt):
    """Result of a grip: not known yet, an object at the minimum or at the requested vacuum, or no object."""

    UNKNOWN = 0
    OBJECT_AT_MINIMUM = 1
    OBJECT_AT_REQUEST = 2
    NO_OBJECT = 3


class VacuumStatus(NamedTuple):
    """State of a vacuum gripper.

    Attributes:
        is_active: Whether the gripper is activated.
        vacuum: Vacuum at the suction cups, in kPa below the ambient pressure; negative while the gripper blows.
        requested: Vacuum of the current or last request, in kPa; negative for a release.
        object: Result of the grip.
        fault: Number of the fault; 0 for none.
    """

    is_active: bool
    vacuum: float
    requested: float
    object: SuctionStatus
    fault: int

    @property
    def object_detected(self) -> bool:
        """Whether the gripper holds an object."""
        return self.object in (SuctionStatus.OBJECT_AT_MINIMUM, SuctionStatus.OBJECT_AT_REQUEST)


def grip_values(vacuum: float, minimum: float, object_timeout: float) -> dict[str, int]:
    """Return the variables of a grip.

    Raises:
        BadValue: If a value is out of range, or `minimum` exceeds `vacuum`.

    >>> grip_values(60.0, 40.0, 3.0)
    {'MOD': 1, 'POS': 40, 'FOR': 60, 'SPE': 30, 'GTO': 1}
    """
    vacuum = check_number(vacuum, "vacuum", 1.0, 100.0, "kPa", "a vacuum gripper")
    minimum = check_number(minimum, "minimum", 1.0, 100.0, "kPa", "a vacuum gripper")
    if minimum > vacuum:
        raise BadValue(f"minimum={minimum:g} kPa exceeds vacuum={vacuum:g} kPa; expected a smaller or equal vacuum")
    seconds = check_number(object_timeout, "object_timeout", 0.1, 25.5, "s", "a vacuum gripper")
    return {
        "MOD": 1,
        "POS": AMBIENT - round(vacuum),
        "FOR": AMBIENT - round(minimum),
        "SPE": round(10.0 * seconds),
        "GTO": 1,
    }


def vacuum_of(pressure: int) -> float:
    """Return the vacuum in kPa for the value of a pressure variable.

    >>> vacuum_of(40), vacuum_of(255)
    (60.0, -155.0)
    """
    return float(AMBIENT - pressure)


class VacuumGripper(RobotiqGripper):
    """Robotiq vacuum gripper (EPick, AirPick) whose URCap runs on the controller. It connects when it is first used.

    Threads may share it; they take turns. The gripper is not interlocked: it works regardless of what the arm does,
    even during a stop.

    **If no reply arrives, the gripper might still execute the command.** If the command grips or releases, urlink stops
    the gripper at the first contact, before it sends any other command. An object might fall then.

    All methods that contact the gripper raise the errors of `Gripper`. For the arguments, see `Gripper` too.
    """

    _RESULTS = RESULTS

    def activate(self, *, again: bool = False, timeout: float = 15.0) -> VacuumStatus:
        """Activate the gripper, and wait until it is active.

        A gripper that is active and has no fault is not activated again, unless `again` is true.

        Args:
            again: Whether to activate a gripper that is already active. It might drop its object.
            timeout: Maximum time for the whole activation, in seconds.

        Raises:
            LinkTimeout: If the gripper is not active in time.
        """
        self._activate(again, timeout, _RESET)
        return self.status()

    def deactivate(self) -> None:
        """Reset the gripper. It drops its object, and does not grip until it is activated again."""
        self._set(set_line(_RESET), moves=False)

    def grip(
        self,
        vacuum: float = 60.0,
        *,
        minimum: float = 40.0,
        object_timeout: float = 3.0,
        wait: bool | float = True,
    ) -> VacuumStatus:
        """Grip an object.

        Args:
            vacuum: Vacuum that the gripper builds up, in kPa below the ambient pressure, 1 to 100.
            minimum: Vacuum at which an object counts as gripped, and below which the gripper sucks again, in kPa.
            object_timeout: Time after which the gripper stops if there is no object, in s, 0.1 to 25.5.
            wait: Whether to wait for the result: True for up to 60 s, a number for that many seconds. With False,
                return immediately.

        Returns:
            Status after the wait. With `wait`, its `object_detected` shows whether the gripper holds an object.

        Raises:
            LinkTimeout: If there is no result in time. The gripper might still suck.
        """
        seconds = check_wait(wait)
        self._command(grip_values(vacuum, minimum, object_timeout))
        return self.wait(seconds) if seconds else self.status()

    def release(self, *, wait: bool | float = True) -> VacuumStatus:
        """Release the object by blowing.

        Args:
            wait: Whether to wait until the vacuum has gone: True for up to 60 s, a number for that many seconds. With
                False, return immediately.

        Raises:
            LinkTimeout: If the object is not released in time.
        """
        seconds = check_wait(wait)
        self._command({"MOD": 0, "POS": RELEASE, "FOR": 0, "SPE": 255, "GTO": 1})
        if not seconds:
            return self.status()
        return self._await_status(
            lambda status: status.vacuum <= _RELEASED and not status.object_detected,
            seconds,
            "the object was not released",
        )

    def stop(self) -> None:
        """Stop the vacuum generator. An object might fall."""
        self._set(set_line({"GTO": 0}), moves=False)

    def wait(self, timeout: float = 60.0) -> VacuumStatus:
        """Wait for the result of a grip.

        Raises:
            LinkTimeout: If there is no result in time. The gripper might still suck.
        """
        seconds = check_seconds(timeout, "timeout", finite=True)
        return self._await_status(
            lambda status: status.object != SuctionStatus.UNKNOWN, seconds, "no result of the grip"
        )

    # -- state -----------------------------------------------------------------------------------------

    def status(self) -> VacuumStatus:
        """Return the current state."""
        # With this order, a result belongs to the reported request.
        state, requested, found, pressure, fault = map(self._get, ("STA", "PRE", "OBJ", "POS", "FLT"))
        return VacuumStatus(state == 3, vacuum_of(pressure), vacuum_of(requested), SuctionStatus(found), fault)

    def vacuum(self) -> float:
        """Return the vacuum at the suction cups, in kPa below the ambient pressure."""
        return vacuum_of(self._get("POS"))

    def object_detected(self) -> bool:
        """Return whether the gripper holds an object."""
        return self.status().object_detected

    # -- variables -------------------------------------------------------------------------------------

    def get(self, name: str) -> int:
        """Return a variable of the gripper by its name, such as "MOD", if no method reads it."""
        return self._get(name)

    def set(self, /, **values: int) -> None:
        """Set variables of the gripper at once, such as ``set(MOD=0)``, if no method sets them."""
        self._set(set_line(values, VACUUM_WRITABLE), moves="POS" in values or values.get("GTO") == 1)

    # -- internal --------------------------------------------------------------------------------------

    def _command(self, values: dict[str, int]) -> None:
        self._request(set_line(values, VACUUM_WRITABLE), values["POS"], "nothing")

    def _await_status(self, condition: Callable[[VacuumStatus], bool], seconds: float, otherwise: str) -> VacuumStatus:
        until = clock.now() + seconds
        return self._await(lambda: self._checked(self.status()), until, seconds, otherwise, condition)
