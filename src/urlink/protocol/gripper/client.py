"""`robot.gripper`: a Robotiq gripper over the port of its URCap (63352)."""

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

#: Seconds between two looks at a gripper that moves.
_POLL = 0.02
#: m; how far the fingers of the 2F-85 open.
_STROKE = 0.085

#: The codes of `FLT`. From memory of the maker's manual, not verified.
FAULTS = {
    5: "the action is delayed: the activation has to be completed first",
    7: "the gripper has to be activated first",
    8: "too hot",
    9: "no communication for a second",
    10: "supply voltage too low",
    11: "automatic release in progress",
    12: "internal fault",
    13: "activation failed: something is in the way of the fingers",
    14: "overcurrent",
    15: "automatic release completed",
}


class GripperFault(RemoteError):
    """The gripper is not there, not activated, or has a fault, and did not carry out a command.

    Attributes:
        fault: number of the fault; 0 where it is not the gripper's own.
    """

    __module__ = "urlink"  # where users import it from, and what a traceback shows

    def __init__(self, text: str, fault: int = 0) -> None:
        super().__init__(text, fault)
        self.fault = fault

    def __str__(self) -> str:
        return str(self.args[0])


class ObjectStatus(OpenInt):
    """What stopped the fingers, if anything did."""

    MOVING = 0
    STOPPED_OPENING = 1
    STOPPED_CLOSING = 2
    AT_REQUEST = 3


class GripperStatus(NamedTuple):
    """The state of a gripper.

    Attributes:
        is_active: it has been activated.
        position: of the fingers, 0 (open) to 255 (closed).
        requested: the position that it goes to, or went to.
        object: what stopped the fingers, if anything did.
        fault: number of the fault, see `FAULTS`; 0 for none.
    """

    is_active: bool
    position: int
    requested: int
    object: ObjectStatus
    fault: int

    @property
    def is_moving(self) -> bool:
        """The fingers are on their way."""
        return self.object == ObjectStatus.MOVING

    @property
    def object_detected(self) -> bool:
        """Something stopped the fingers before they were where they should be."""
        return self.object in (ObjectStatus.STOPPED_OPENING, ObjectStatus.STOPPED_CLOSING)

    def opening(self, stroke: float = _STROKE) -> float:
        """How far the fingers are apart, m, if `position` is linear from `stroke` at 0 to nothing at 255.

        Args:
            stroke: m between the open fingers; 0.085 for a 2F-85, 0.14 for a 2F-140. Real ones end some counts before 0
                and 255.
        """
        return stroke * (1.0 - self.position / 255.0)


class Gripper(StrictAttributes):
    """A Robotiq gripper (2F, Hand-E) whose URCap runs on the controller. Connects when it is first used.

    Threads may share it; they take turns. Nothing of it is interlocked: it moves fingers, not the arm, also in a stop.

    **A command whose answer does not come may still be carried out**, when a controller that hung goes on; the error
    says so. Fingers that it moves are stopped at the first contact, and before another command is sent, for the life of
    the process: also by the next `Gripper` or robot of `connect` there.

    All methods that talk to the gripper raise

    - `BadValue` for an unusable argument; nothing has been sent then;
    - `GripperFault` where it has a fault, is not activated, or is not connected to the controller;
    - `ConnectFailed` where no URCap serves it, `ConnectionLost`, `LinkTimeout`, `WrongPeer` and `PacketError` where
      the peer does not answer, or not as a gripper does;
    - `Closed` after the robot was closed.

    Args:
        host: of the controller.
        port: 63352 on a real one.
        timeout: seconds to connect, and for each reply.
        refused: returns a hint for the error where the connection is refused.
        undos: of the commands to this controller; None to share that of everything in this process that commands it.
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
        """Activate it, and wait until it is. **The fingers close and open.** An active gripper is left alone.

        Args:
            again: activate also one that is active, such as after a fault.
            timeout: seconds for all of it.

        Raises:
            LinkTimeout: it was not done in time.
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
        """Reset it: it does nothing until it is activated again."""
        self.set(ACT=0, ATR=0)

    # -- motion ----------------------------------------------------------------------------------------

    def move(self, position: int, *, speed: int = 255, force: int = 128, wait: bool | float = True) -> GripperStatus:
        """Move the fingers.

        Args:
            position: 0 (open) to 255 (closed); `position_of` has it of an opening in metres.
            speed: 0 to 255, of the range of speeds that the gripper has (20 to 150 mm/s for a 2F-85).
            force: 0 to 255, of the range of forces that it has (20 to 235 N for a 2F-85), at which fingers stop at an
                object.
            wait: until they rest: True for up to 60 s, a number for so many seconds; False returns at once.

        Returns:
            what it shows then; with `wait`, `object_detected` says whether something is between the fingers.

        Raises:
            LinkTimeout: they did not rest in time; they may still move.
        """
        seconds = check_wait(wait)
        line = set_line({"POS": position, "SPE": speed, "FOR": force, "GTO": 1})
        if self.get("STA") != 3:
            raise GripperFault("the gripper is not activated, so it was not told to move; call activate() first", 7)
        self._set(line, moves=True)
        # The gripper takes the request over some milliseconds later; until then it shows how the last one ended.
        until = clock.now() + self._timeout
        self._await(lambda: self.get("PRE") == position, until, self._timeout, "it does not take the request over")
        return self.wait(seconds) if seconds else self.status()

    def open(self, *, speed: int = 255, force: int = 128, wait: bool | float = True) -> GripperStatus:
        """`move` to 0."""
        return self.move(0, speed=speed, force=force, wait=wait)

    def close(self, *, speed: int = 255, force: int = 128, wait: bool | float = True) -> GripperStatus:
        """`move` to 255."""
        return self.move(255, speed=speed, force=force, wait=wait)

    def stop(self) -> None:
        """Let the fingers stop where they are."""
        self.set(GTO=0)

    def wait(self, timeout: float = 60.0) -> GripperStatus:
        """Wait until the fingers rest: where they should, or at an object.

        Raises:
            LinkTimeout: they do not in time; they may still move.
        """
        until = clock.now() + check_seconds(timeout, "timeout", finite=True)
        found: list[GripperStatus] = []

        def rests() -> bool:
            found[:] = [self._checked(self.status())]
            return not found[0].is_moving

        self._await(rests, until, timeout, "the fingers do not rest")
        return found[0]

    @staticmethod
    def position_of(opening: float, stroke: float = _STROKE) -> int:
        """The position at which the fingers are so far apart, see `GripperStatus.opening`.

        Raises:
            BadValue: the opening is not from 0 to the stroke.

        >>> Gripper.position_of(0.085), Gripper.position_of(0.0), Gripper.position_of(0.07, stroke=0.14)
        (0, 255, 128)
        """
        if not 0.0 <= opening <= stroke:
            raise BadValue(f"opening={opening!r} m; expected 0 to the stroke of {stroke:g} m")
        return round(255 * (1.0 - opening / stroke))

    # -- what it shows ---------------------------------------------------------------------------------

    def status(self) -> GripperStatus:
        """What it shows now."""
        # Each is a request of its own, and the fingers move on meanwhile. In this order a status at rest is that of the
        # request that it names, and has the position of that rest.
        state, requested, stopped, position, fault = map(self.get, ("STA", "PRE", "OBJ", "POS", "FLT"))
        return GripperStatus(state == 3, position, requested, ObjectStatus(stopped), fault)

    def position(self) -> int:
        """Where the fingers are, 0 (open) to 255 (closed)."""
        return self.get("POS")

    def object_detected(self) -> bool:
        """Something stopped the fingers before they were where they should be."""
        return ObjectStatus(self.get("OBJ")) in (ObjectStatus.STOPPED_OPENING, ObjectStatus.STOPPED_CLOSING)

    # -- its variables ---------------------------------------------------------------------------------

    def get(self, name: str) -> int:
        """One of its variables by name, such as "COU", the motor current; for what has no method here."""
        value = value_of(name, self._dialogue.ask(get_line(name), self._timeout))
        if value is None:
            raise GripperFault(f"the controller serves a gripper at {self._name}, but none is connected to it")
        return value

    def set(self, /, **values: int) -> None:
        """Set its variables by name, such as ``set(ATR=1, ADR=0)``, all at once; for what has no method here."""
        self._set(set_line(values), moves="POS" in values or values.get("GTO") == 1)

    def _set(self, line: str, moves: bool) -> None:
        undo = Undo(self._connect, partial(_stop_fingers, self._timeout)) if moves else None
        with self._undos.command("gripper", self._timeout, undo) as given_up:
            reply = self._dialogue.ask(line, self._timeout, given_up=given_up)
        if reply.casefold() != "ack":
            raise GripperFault(f"{line!r}: the gripper answered {reply[:80]!r}")

    def _checked(self, status: GripperStatus) -> GripperStatus:
        if status.fault:
            what = FAULTS.get(status.fault, "a fault that is not known")
            raise GripperFault(f"the gripper has fault {status.fault}: {what}", status.fault)
        return status

    def _await(self, condition: Callable[[], bool], until: float, timeout: float, otherwise: str) -> None:
        while not condition():
            left = until - clock.now()
            if left <= 0:
                raise LinkTimeout(f"the gripper at {self._name}: {otherwise} within {timeout:g} s")
            clock.sleep(min(_POLL, left))

    def _disconnect(self) -> None:
        """Disconnect for good."""
        if self._shares_undos:
            self._undos.close(self)
        self._dialogue.close()

    def __repr__(self) -> str:
        return f"<Gripper {self._name}>"


def _stop_fingers(timeout: float, dialogue: Dialogue, is_wanted: Callable[[], bool]) -> None:
    """Take a movement back."""
    for line in (get_line("STA"), set_line({"GTO": 0})):  # the first is the contact
        if is_wanted():
            dialogue.ask(line, timeout)
