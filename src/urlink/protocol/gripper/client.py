"""Client behind `robot.gripper`: a Robotiq gripper, over the port of its URCap (63352)."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Literal, NamedTuple, cast, overload

from linkcore import clock
from linkcore.arguments import check_seconds, check_wait
from linkcore.errors import BadValue, Closed
from linkcore.net.undo import PendingUndos
from linkcore.wire.fields import OpenInt

from ..ports import PORTS
from .onrobot import RGGripper, RGModel
from .protocol import set_line
from .robotiq import RobotiqGripper
from .vacuum import VacuumGripper

#: Stroke of the fingers of the 2F-85, in m.
_STROKE = 0.085


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


class Gripper(RobotiqGripper):
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
        onrobot_port: Port of a simulated Compute Box at `host`; None if there is none. A call of the gripper uses it if
            no other host is given.
    """

    def __init__(
        self,
        host: str,
        port: int,
        *,
        timeout: float = 5.0,
        refused: Callable[[], str] = str,
        undos: PendingUndos | None = None,
        onrobot_port: int | None = None,
    ) -> None:
        super().__init__(host, port, timeout=timeout, refused=refused, undos=undos)
        self._onrobot = None if onrobot_port is None else (host, onrobot_port)
        # A vacuum gripper of this robot shares the undos, because it uses the same port.
        self._make_vacuum = partial(VacuumGripper, host, port, timeout=timeout, refused=refused, undos=self._undos)
        #: Kind and address -> gripper that a call returned.
        self._others: dict[tuple[object, ...], RGGripper | VacuumGripper] = {}

    # -- other kinds -----------------------------------------------------------------------------------

    @overload
    def __call__(self, kind: Literal["vacuum"]) -> VacuumGripper: ...
    @overload
    def __call__(
        self, kind: RGModel, *, host: str | None = None, port: int = PORTS["onrobot"], unit: int = 65
    ) -> RGGripper: ...
    def __call__(
        self, kind: str, *, host: str | None = None, port: int = PORTS["onrobot"], unit: int = 65
    ) -> RGGripper | VacuumGripper:
        """Return a gripper of another kind. Calls with the same arguments return the same object.

        The gripper is closed together with this one. Nothing is sent before it is used.

        Args:
            kind: "vacuum" for a vacuum gripper of Robotiq, behind the same URCap; "rg2" or "rg6" for one of OnRobot.
            host: Host name or address of OnRobot's Compute Box. Only a simulated controller needs none.
            port: Port of the Compute Box.
            unit: Number of the gripper behind the Compute Box.

        Raises:
            BadValue: If the kind does not exist, or the host of an OnRobot gripper is missing.
            Closed: If the robot was closed.
        """
        key: tuple[object, ...] = (kind,)
        make: Callable[[], RGGripper | VacuumGripper]
        if kind == "vacuum":
            if host is not None:
                raise BadValue(f"host={host!r}; a vacuum gripper is behind the URCap of the controller, so omit host")
            make = self._make_vacuum
        elif kind in ("rg2", "rg6"):
            if host is None:
                if self._onrobot is None:
                    raise BadValue(
                        f"missing host; an {kind.upper()} is reached at the address of its Compute Box, "
                        f"as in robot.gripper({kind!r}, host='192.168.1.1')"
                    )
                host, port = self._onrobot
            key = kind, host, port, unit
            make = partial(RGGripper, host, port, model=cast("RGModel", kind), unit=unit, timeout=self._timeout)
        else:
            raise BadValue(f"kind={kind!r}; expected 'vacuum', 'rg2' or 'rg6', or robot.gripper itself for fingers")
        if self._dialogue.is_closed:
            raise Closed("the gripper was closed")
        known = self._others.get(key)
        return self._others.setdefault(key, make()) if known is None else known

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
        self._activate(again, timeout)
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
        self._request(line, position, "no motion")
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
        return self._await(
            lambda: self._checked(self.status()),
            until,
            timeout,
            "the fingers did not come to rest",
            lambda status: not status.is_moving,
        )

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
        return self._get(name)

    def set(self, /, **values: int) -> None:
        """Set variables of the gripper at once, such as ``set(ATR=1, ADR=0)``, if no method sets them."""
        self._set(set_line(values), moves="POS" in values or values.get("GTO") == 1)

    def _disconnect(self) -> None:
        """Disconnect permanently."""
        for other in [*self._others.values()]:
            other._disconnect()
        super()._disconnect()
