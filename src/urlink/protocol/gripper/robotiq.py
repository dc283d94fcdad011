"""Connection to the URCap of Robotiq (port 63352), which all grippers of Robotiq share: variables and activation."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import ClassVar, Protocol, TypeVar

from linkcore import clock
from linkcore.arguments import check_seconds
from linkcore.errors import RemoteError
from linkcore.names import StrictAttributes
from linkcore.net.dialogue import Dialogue
from linkcore.net.transport import TcpTransport
from linkcore.net.undo import PendingUndos, Undo

from ..ports import service_of
from .protocol import GripperProtocol, get_line, set_line, value_of
from .reading import read_until

T = TypeVar("T")

#: Variables that reset a gripper.
RESET: Mapping[str, int] = {"ACT": 0, "ATR": 0}

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


class HasFault(Protocol):
    """State of a gripper that contains the number of its fault."""

    @property
    def fault(self) -> int:
        """Number of the fault; 0 for none."""


S = TypeVar("S", bound=HasFault)


class RobotiqGripper(StrictAttributes):
    """Common part of the grippers of Robotiq. For the arguments, see `Gripper`."""

    #: Numbers of `FLT` that are results of a command, and not faults.
    _RESULTS: ClassVar[Mapping[int, str]] = {}

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

    def _activate(self, again: bool, timeout: float, reset: Mapping[str, int] = RESET) -> None:
        until = clock.now() + check_seconds(timeout, "timeout", positive=True, finite=True)
        if self._get("STA") == 3 and not self._get("FLT") and not again:
            return
        self._set(set_line(reset), moves=False)
        self._await(lambda: (self._get("ACT"), self._get("STA")) == (0, 0), until, timeout, "it was not reset")
        self._set(set_line({"ACT": 1}), moves=False)
        self._await(lambda: self._get("STA") == 3, until, timeout, "it was not activated")

    def _get(self, name: str) -> int:
        value = value_of(name, self._dialogue.ask(get_line(name), self._timeout))
        if value is None:
            raise GripperFault(f"the URCap at {self._name} is running, but no gripper is connected to the controller")
        return value

    def _set(self, line: str, moves: bool) -> None:
        undo = Undo(self._connect, partial(_stop, self._timeout)) if moves else None
        with self._undos.command("gripper", self._timeout, undo) as given_up:
            reply = self._dialogue.ask(line, self._timeout, given_up=given_up)
        if reply.casefold() != "ack":
            raise GripperFault(f"the gripper did not execute {line!r}, and answered {reply[:80]!r}")

    def _request(self, line: str, position: int, unsent: str) -> None:
        """Send a line that sets a position, and wait until the gripper has accepted it."""
        if self._get("STA") != 3:
            raise GripperFault(f"the gripper is not activated, so {unsent} was sent; call activate() first", 7)
        self._set(line, moves=True)
        # The gripper accepts the request some milliseconds later. Until then, it reports the result of the last one.
        until = clock.now() + self._timeout
        self._await(lambda: self._get("PRE") == position, until, self._timeout, "the request was not accepted")

    def _await(
        self,
        read: Callable[[], T],
        until: float,
        timeout: float,
        otherwise: str,
        is_done: Callable[[T], object] = bool,
    ) -> T:
        failure = f"the gripper at {self._name}: {otherwise} within {timeout:g} s"
        return read_until(read, is_done, until, failure)

    def _checked(self, status: S) -> S:
        if status.fault and status.fault not in self._RESULTS:
            what = FAULTS.get(status.fault, "unknown fault")
            raise GripperFault(f"the gripper has fault {status.fault}: {what}", status.fault)
        return status

    def _disconnect(self) -> None:
        """Disconnect permanently."""
        if self._shares_undos:
            self._undos.close(self)
        self._dialogue.close()

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self._name}>"


def _stop(timeout: float, dialogue: Dialogue, is_wanted: Callable[[], bool]) -> None:
    """Undo a motion of the fingers, or a grip."""
    for line in (get_line("STA"), set_line({"GTO": 0})):  # the first line only makes contact
        if is_wanted():
            dialogue.ask(line, timeout)
