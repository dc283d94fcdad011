"""Client behind `robot.gripper`: a Robotiq gripper, over the port of its URCap (63352)."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

from linkcore import clock
from linkcore.arguments import check_seconds, check_wait
from linkcore.errors import BadValue, LinkTimeout, RemoteError
from linkcore.names import StrictAttributes
from linkcore.net.dialogue import Dialogue
from linkcore.net.transport import TcpTransport
from linkcore.net.undo import PendingUndos, Undo
from linkcore.wire.fields import OpenInt

from ..ports import service_of
from .protocol import GripperProtocol, get_line, set_line, value_of

#: Interval for polling a moving gripper, in seconds.
_POLL = 0.02
#: Stroke of the fingers of the 2F-85, in m.
_STROKE = 0.085

#: Codes of `FLT` (from memory of the maker's manual, not verified).
FAULTS = {
    5: "the action is delayed; the activation must be completed first",
    7: "the gripper must be activated first",
    8: "the gripper is too hot",
    9: "no communication for a second",
    10: "the supply voltage is too low",
    11: "an automatic release is in progress",
    12: "internal fault",
    13: "the activation failed; something is in the way of the fingers",
    14: "overcurrent",
    15: "an automatic release is completed",
}


class GripperFault(RemoteError):
    """Error if the gripper did not execute a command: it is not connected, is not activated, or has a fault.

    Attributes:
        fault: Number of the fault; 0 if the gripper itself reports no fault.
    """

    __module__ = "urlink"  # users import it from this module, and tracebacks show it

    def __init__(self, text: str, fault: int = 0) -> None:
        super().__init__(text, fault)
        self.fault = fault

    def __str__(self) -> str:
        return str(self.args[0])


class ObjectStatus(OpenInt):
    """State of the fingers: moving, at the requested position, or stopped by an object."""

    MOVING = 0
    STOPPED_OPENING = 1
    STOPPED_CLOSING = 2
    AT_REQUEST = 3


class GripperStatus(NamedTuple):
    """State of a gripper.

    Attributes:
        is_active: Whether the gripper is activated.
        position: Position of the fingers, 0 (open) to 255 (closed).
        requested: Position of the current or last request.
        object: State of the fingers, including whether an object stopped them.
        fault: Number of the fault, see `FAULTS`; 0 for none.
    """

    is_active: bool
    position: int
    requested: int
    object: ObjectStatus
    fault: int

    @property
    def is_moving(self) -> bool:
        """Whether the fingers are moving."""
        return self.object == ObjectStatus.MOVING

    @property
    def object_detected(self) -> bool:
        """Whether something stopped the fingers before they reached the requested position."""
        return self.object in (ObjectStatus.STOPPED_OPENING, ObjectStatus.STOPPED_CLOSING)

    def opening(self, stroke: float = _STROKE) -> float:
        """Return the distance between the fingers in m, assumed to be linear from `stroke` at 0 to zero at 255.

        Args:
            stroke: Distance between the open fingers in m: 0.085 for a 2F-85, 0.14 for a 2F-140. Real fingers reach
                their ends some counts before 0 and 255.
        """
        return stroke * (1.0 - self.position / 255.0)


class Gripper(StrictAttributes):
    """Robotiq gripper (2F, Hand-E) whose URCap runs on the controller. It connects when it is first used.

    Threads may share it; they take turns. The gripper is not interlocked: it moves fingers rather than the arm, even
    during a stop.

    **If no reply arrives, the gripper might still execute the command**, for example when a hung controller resumes.
    The error message contains this warning. If the command moves the fingers, urlink stops them at the first contact,
    before it sends any other command. The stop remains pending for the life of the process: the next `Gripper` or robot
    of `connect` at this controller also sends it.

    All methods that contact the gripper raise

    - `BadValue` if an argument is invalid; in this case, nothing is sent;
    - `GripperFault` if the gripper has a fault, is not activated, or is not connected to the controller;
    - `ConnectFailed` if no URCap serves the gripper, and `ConnectionLost`, `LinkTimeout`, `WrongPeer` or `PacketError`
      if the peer does not reply, or does not reply like a gripper;
    - `Closed` after the robot was closed.

    Args:
        host: Host name or address of the controller.
        port: Port number, 63352 on a real controller.
        timeout: Maximum time to connect, and for each reply, in seconds.
        refused: Function that returns a hint for the error if the connection is refused.
        undos: Pending undos of the commands to this controller. If None, use the undos that all objects in this process
            share for the controller.
    """

    def __init__(
        self,
        host: str,
        port: int,
        *,
        timeout: float = 5.0,
        refused: Callable[[], str] = str,
        undos: PendingUndos | None = None,
    ) -> None:
        self._timeout = check_seconds(timeout, "timeout", positive=True, finite=True)

        def dialogue() -> Dialogue:
            transport = TcpTransport(host, port, silence=timeout, refused=refused)
            return Dialogue(transport, GripperProtocol, f"the gripper at {transport.name}", timeout)

        self._connect = dialogue
        self._dialogue = dialogue()
        self._name = f"{host}:{port}"
        self._shares_undos = undos is None
        name = f"the gripper at {self._name}"
        self._undos = PendingUndos.of(service_of(host, port), name, self) if undos is None else undos

    # -- activation ------------------------------------------------------------------------------------

    def activate(self, *, again: bool = False, timeout: float = 15.0) -> GripperStatus:
        """Activate the gripper, and wait until it is active. **The fingers close and open.**

        A gripper that is active and has no fault is not activated again, unless `again` is true.

        Args:
            again: Whether to activate a gripper that is already active.
            timeout: Maximum time for the whole activation, in seconds.

        Raises:
            LinkTimeout: If the gripper is not active in time.
        """
        until = clock.now() + check_seconds(timeout, "timeout", positive=True, finite=True)
        status = self.status()
        if status.is_active and not status.fault and not again:
            return status
        self.set(ACT=0, ATR=0)
        self._await(lambda: (self.get("ACT"), self.get("STA")) == (0, 0), until, timeout, "it was not reset")
        self.set(ACT=1)
        self._await(lambda: self.get("STA") == 3, until, timeout, "it was not activated")
        return self._checked(self.status())

    def deactivate(self) -> None:
        """Reset the gripper. It does not move until it is activated again."""
        self.set(ACT=0, ATR=0)

    # -- motion ----------------------------------------------------------------------------------------

    def move(self, position: int, *, speed: int = 255, force: int = 128, wait: bool | float = True) -> GripperStatus:
        """Move the fingers.

        Args:
            position: Requested position, 0 (open) to 255 (closed). `position_of` converts an opening in metres.
            speed: Speed, 0 to 255, over the speed range of the gripper (20 to 150 mm/s for a 2F-85).
            force: Force at which the fingers stop at an object, 0 to 255, over the force range of the gripper (20 to
                235 N for a 2F-85).
            wait: Whether to wait until the fingers are at rest: True for up to 60 s, a number for that many seconds.
                With False, return immediately.

        Returns:
            Status after the wait. With `wait`, its `object_detected` shows whether an object is between the fingers.

        Raises:
            LinkTimeout: If the fingers are not at rest in time. They might still move.
        """
        seconds = check_wait(wait)
        line = set_line({"POS": position, "SPE": speed, "FOR": force, "GTO": 1})
        if self.get("STA") != 3:
            raise GripperFault("the gripper is not activated, so no motion was sent; call activate() first", 7)
        self._set(line, moves=True)
        # The gripper accepts the request some milliseconds later. Until then, it reports the result of the last one.
        until = clock.now() + self._timeout
        self._await(lambda: self.get("PRE") == position, until, self._timeout, "the request was not accepted")
        return self.wait(seconds) if seconds else self.status()

    def open(self, *, speed: int = 255, force: int = 128, wait: bool | float = True) -> GripperStatus:
        """Open the fingers: `move` to 0."""
        return self.move(0, speed=speed, force=force, wait=wait)

    def close(self, *, speed: int = 255, force: int = 128, wait: bool | float = True) -> GripperStatus:
        """Close the fingers: `move` to 255."""
        return self.move(255, speed=speed, force=force, wait=wait)

    def stop(self) -> None:
        """Stop the fingers at their current position."""
        self.set(GTO=0)

    def wait(self, timeout: float = 60.0) -> GripperStatus:
        """Wait until the fingers are at rest, at the requested position or at an object.

        Raises:
            LinkTimeout: If the fingers are not at rest in time. They might still move.
        """
        until = clock.now() + check_seconds(timeout, "timeout", finite=True)
        found: list[GripperStatus] = []

        def rests() -> bool:
            found[:] = [self._checked(self.status())]
            return not found[0].is_moving

        self._await(rests, until, timeout, "the fingers did not come to rest")
        return found[0]

    @staticmethod
    def position_of(opening: float, stroke: float = _STROKE) -> int:
        """Return the position for an opening in m; see `GripperStatus.opening`.

        Raises:
            BadValue: If the opening is not between 0 and the stroke.

        >>> Gripper.position_of(0.085), Gripper.position_of(0.0)
        (0, 255)
        >>> Gripper.position_of(0.07, stroke=0.14)
        128
        """
        if not 0.0 <= opening <= stroke:
            raise BadValue(f"opening={opening!r} m; expected 0 to the stroke of {stroke:g} m")
        return round(255 * (1.0 - opening / stroke))

    # -- state -----------------------------------------------------------------------------------------

    def status(self) -> GripperStatus:
        """Return the current state."""
        # Each variable is a separate request, and the fingers might move in between. With this order, a status at rest
        # belongs to the reported request, and the position is the position at rest.
        state, requested, stopped, position, fault = map(self.get, ("STA", "PRE", "OBJ", "POS", "FLT"))
        return GripperStatus(state == 3, position, requested, ObjectStatus(stopped), fault)

    def position(self) -> int:
        """Return the position of the fingers, 0 (open) to 255 (closed)."""
        return self.get("POS")

    def object_detected(self) -> bool:
        """Return whether something stopped the fingers before they reached the requested position."""
        return ObjectStatus(self.get("OBJ")) in (ObjectStatus.STOPPED_OPENING, ObjectStatus.STOPPED_CLOSING)

    # -- variables -------------------------------------------------------------------------------------

    def get(self, name: str) -> int:
        """Return a variable of the gripper by its name, such as "COU" (motor current), if no method reads it."""
        value = value_of(name, self._dialogue.ask(get_line(name), self._timeout))
        if value is None:
            raise GripperFault(f"the URCap at {self._name} is running, but no gripper is connected to the controller")
        return value

    def set(self, /, **values: int) -> None:
        """Set variables of the gripper at once, such as ``set(ATR=1, ADR=0)``, if no method sets them."""
        self._set(set_line(values), moves="POS" in values or values.get("GTO") == 1)

    def _set(self, line: str, moves: bool) -> None:
        undo = Undo(self._connect, partial(_stop_fingers, self._timeout)) if moves else None
        with self._undos.command("gripper", self._timeout, undo) as given_up:
            reply = self._dialogue.ask(line, self._timeout, given_up=given_up)
        if reply.casefold() != "ack":
            raise GripperFault(f"the gripper did not execute {line!r}, and answered {reply[:80]!r}")

    def _checked(self, status: GripperStatus) -> GripperStatus:
        if status.fault:
            what = FAULTS.get(status.fault, "unknown fault")
            raise GripperFault(f"the gripper has fault {status.fault}: {what}", status.fault)
        return status

    def _await(self, condition: Callable[[], bool], until: float, timeout: float, otherwise: str) -> None:
        while not condition():
            left = until - clock.now()
            if left <= 0:
                raise LinkTimeout(f"the gripper at {self._name}: {otherwise} within {timeout:g} s")
            clock.sleep(min(_POLL, left))

    def _disconnect(self) -> None:
        """Disconnect permanently."""
        if self._shares_undos:
            self._undos.close(self)
        self._dialogue.close()

    def __repr__(self) -> str:
        return f"<Gripper {self._name}>"


def _stop_fingers(timeout: float, dialogue: Dialogue, is_wanted: Callable[[], bool]) -> None:
    """Undo a motion of the fingers."""
    for line in (get_line("STA"), set_line({"GTO": 0})):  # the first line only makes contact
        if is_wanted():
            dialogue.ask(line, timeout)
