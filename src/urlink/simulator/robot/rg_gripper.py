"""Simulated OnRobot RG2 or RG6: registers, fingers and gripped object.

The registers are those of `urlink.protocol.gripper.onrobot`. The following is assumed:

- The fingers move at a constant speed, 0.1 m/s, and begin to move when the command arrives.
- The fingertip offset is 0.
- A command with an unknown control word is ignored.
- Registers that clients have not written, and that have no meaning here, contain 0.
- A triggered safety circuit stops the fingers.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from linkcore.arguments import check_number
from urlink.protocol.gripper.onrobot import (
    BUSY,
    COMMAND,
    CONTROL,
    COUNT,
    DETECTED,
    FLAGS,
    GRIP,
    LIMITS,
    SAFETY,
    STATUS,
    STOP,
    WIDTH,
    RGModel,
)

from .mounted_gripper import MountedGripper

#: Speed of the fingers, in m/s.
_SPEED = 0.1
#: Control word: move to the width between the fingers, without the fingertip offset.
_GRIP_WITHOUT_OFFSET = 0x0001


class SimulatedRGGripper(MountedGripper):
    """RG2 or RG6 of a simulated controller. Initially, its fingers are open.

    Args:
        model: "rg2" or "rg6".
        clock: Function that returns the time of the controller, in s.

    Attributes:
        model: Model of the gripper.
        fault: Flags of triggered safety switches. It can be set, and 0 means that the power was switched off and on.
        is_connected: Whether the gripper is connected to its Compute Box. If not, the Compute Box rejects requests.
    """

    def __init__(self, model: RGModel, clock: Callable[[], float]) -> None:
        super().__init__(clock)
        self.model = model
        self._command = [0, 0, 0]
        self._stroke = LIMITS[model][0]
        self._width = self._goal = self._stroke
        self._object: float | None = None
        self._is_inside = False
        self._is_moving = self._is_holding = False

    # -- for tests -------------------------------------------------------------------------------------

    def place(self, width: float, *, inside: bool = False) -> None:
        """Put an object between the fingers, so that the fingers stop at it when they close.

        Args:
            width: Width of the object between the fingers, or of the hole in the object, in m.
            inside: Whether the object surrounds the fingers, so that the fingers stop at it when they open.

        Raises:
            BadValue: If the width is negative or exceeds the stroke.
        """
        width = check_number(width, "width", 0.0, self._stroke, "m", f"an {self.model.upper()}")
        with self._lock:
            self._advance()
            self._object, self._is_inside = width, inside
            if (self._width > width) if inside else (self._width < width):
                self._width = width

    def take_away(self) -> None:
        """Remove the object. The fingers then continue to the requested width."""
        with self._lock:
            self._advance()
            self._object = None
            if self._is_holding:
                self._is_holding, self._is_moving = False, True

    # -- status ----------------------------------------------------------------------------------------

    @property
    def width(self) -> float:
        """Distance between the fingertips, in m."""
        with self._lock:
            self._advance()
            return self._width

    @property
    def force(self) -> float:
        """Force of the last command, in N."""
        return self._command[0] / 10.0

    @property
    def holds_object(self) -> bool:
        """Whether the fingers grip an object."""
        with self._lock:
            self._advance()
            return self._is_holding

    def read(self, first: int, count: int) -> list[int]:
        """Return the values of registers."""
        with self._lock:
            self._advance()
            busy, held = BUSY if self._is_moving else 0, DETECTED if self._is_holding else 0
            width = round(self._width * 10_000.0)
            known = {
                **{COMMAND + at: value for at, value in enumerate(self._command)},
                STATUS + FLAGS: busy | held | self.fault & sum(SAFETY),
                # The width with and without the fingertip offset, which is 0.
                STATUS + 9: width,
                STATUS + WIDTH: width,
            }
            return [known.get(address, 0) for address in range(first, first + count)]

    def write(self, first: int, values: Sequence[int]) -> bool:
        """Write registers, and return whether they are those of a command. Others remain unchanged."""
        if not COMMAND <= first <= first + len(values) <= COMMAND + len(self._command):
            return False
        with self._lock:
            self._advance()
            self._command[first : first + len(values)] = values
            if first + len(values) > CONTROL:
                self._obey(self._command[CONTROL])
        return True

    def has(self, first: int, count: int) -> bool:
        """Whether these registers can be read."""
        return first >= COMMAND and (first + count <= COMMAND + 3 or STATUS <= first <= first + count <= STATUS + COUNT)

    def _obey(self, control: int) -> None:
        if control == STOP:
            self._is_moving = False
        elif control in (GRIP, _GRIP_WITHOUT_OFFSET) and not self._is_moving and not self.fault:
            self._goal = min(self._command[1] / 10_000.0, self._stroke)
            self._is_holding, self._is_moving = False, True

    # -- its fingers -----------------------------------------------------------------------------------

    def _advance(self) -> None:
        """Advance the fingers to the current time of the controller."""
        seconds = self._elapsed()
        if self.fault:
            self._is_moving = False
        if not self._is_moving:
            return
        end, is_blocked = self._goal, False
        if self._object is not None:
            end = min(end, self._object) if self._is_inside else max(end, self._object)
            is_blocked = end != self._goal
        step = _SPEED * seconds
        if abs(end - self._width) > step:
            self._width += step if end > self._width else -step
        else:
            self._width, self._is_moving, self._is_holding = end, False, is_blocked
