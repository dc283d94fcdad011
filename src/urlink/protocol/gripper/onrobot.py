"""Client for OnRobot RG2 and RG6: Modbus TCP of the Compute Box that the gripper is connected to.

Registers, units and flags are those of public clients for this gripper: takuya-ki/onrobot-rg (`src/onrobot.py`) and
Osaka-University-Harada-Laboratory/onrobot (`comModbusTcp.py`, which reads the block of 18 registers at 258). They quote
the manufacturer's description of the registers. They were read, and not run.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Literal, NamedTuple, get_args

from linkcore import clock
from linkcore.arguments import check_choice, check_number, check_seconds, check_wait, check_whole
from linkcore.names import StrictAttributes
from linkcore.net.dialogue import Dialogue
from linkcore.net.transport import TcpTransport
from linkcore.net.undo import PendingUndos, Undo

from ..ports import PORTS, service_of
from .modbus_tcp import ModbusTcpProtocol, read_line, rejection, values_of, write_line
from .reading import POLL, read_until
from .robotiq import GripperFault

RGModel = Literal["rg2", "rg6"]

#: Model -> largest width in m, and largest force in N.
LIMITS: Mapping[str, tuple[float, float]] = {"rg2": (0.110, 40.0), "rg6": (0.160, 120.0)}
#: Number of the gripper behind the Compute Box.
UNIT = 65
#: First register of a command: force in 0.1 N, width in 0.1 mm, control.
COMMAND = 0
#: Register of the control word alone.
CONTROL = 2
#: Control words: stop, and move to the width between the fingertips (with the configured fingertip offset).
STOP, GRIP = 0x0008, 0x0010
#: First register of the status, and the number of registers that are read.
STATUS, COUNT = 258, 18
#: Positions in the status: fingertip offset, flags, and width between the fingertips, in 0.1 mm.
OFFSET, FLAGS, WIDTH = 0, 10, 17
#: Flags: a motion is running; an object is gripped.
BUSY, DETECTED = 0x0001, 0x0002
#: Flags of the safety switches -> meaning. Such a gripper does not move until its power was switched off and on.
SAFETY: Mapping[int, str] = {
    0x0008: "safety circuit 1 was triggered",
    0x0020: "safety circuit 2 was triggered",
    0x0040: "a safety switch was pushed during power-on",
}

#: Time in s within which a gripper that accepts a command begins to move. Assumption: public clients wait 0.1 to 0.5 s.
_BEGINS = 0.3
#: Difference in m between a requested width and a width that counts as reached. It is one digit of the register.
_REACHED = 0.0002


class RGStatus(NamedTuple):
    """State of an OnRobot RG2 or RG6.

    Attributes:
        width: Distance between the fingertips, in m.
        fingertip_offset: Configured thickness of the fingertips, in m, which `width` takes into account.
        is_moving: Whether the fingers are moving.
        object_detected: Whether the fingers grip an object, from outside or from inside.
        fault: Flags of triggered safety switches, see `SAFETY`; 0 for none.
    """

    width: float
    fingertip_offset: float
    is_moving: bool
    object_detected: bool
    fault: int


def command_of(model: str, width: float, force: float) -> tuple[int, int, int]:
    """Return the three registers of a command at `COMMAND`.

    Args:
        model: Key of `LIMITS`.
        width: Distance between the fingertips, in m.
        force: Gripping force, in N.

    Raises:
        BadValue: If a value exceeds the limits of the model.

    >>> command_of("rg2", 0.05, 20.0)
    (200, 500, 16)
    """
    widest, strongest = LIMITS[model]
    name = model.upper()
    width = check_number(width, "width", 0.0, widest, "m", f"an {name}")
    force = check_number(force, "force", 0.0, strongest, "N", f"an {name}")
    return round(force * 10.0), round(width * 10_000.0), GRIP


def status_of(registers: Sequence[int]) -> RGStatus:
    """Return the state from the `COUNT` registers at `STATUS`."""
    flags = registers[FLAGS]
    fault = flags & sum(SAFETY)
    width, offset = _signed(registers[WIDTH]) / 10_000.0, _signed(registers[OFFSET]) / 10_000.0
    return RGStatus(width, offset, bool(flags & BUSY), bool(flags & DETECTED), fault)


def _signed(register: int) -> int:
    (value,) = struct.unpack(">h", struct.pack(">H", register))
    return int(value)


class RGGripper(StrictAttributes):
    """OnRobot RG2 or RG6, over the Compute Box. It connects when it is first used.

    Threads may share it; they take turns. The gripper is not interlocked: it moves fingers rather than the arm, even
    during a stop. The gripper needs no activation.

    **If no reply arrives, the gripper might still execute the command.** If the command moves the fingers, urlink stops
    them at the first contact, before it sends any other command to this Compute Box.

    All methods that contact the gripper raise

    - `BadValue` if an argument is invalid; in this case, nothing is sent;
    - `GripperFault` if a safety switch was triggered, or the Compute Box rejects a request, for example because no
      gripper is connected;
    - `ConnectFailed` if no Compute Box is at the address, and `ConnectionLost`, `LinkTimeout`, `WrongPeer` or
      `PacketError` if the peer does not reply, or does not reply like a Compute Box;
    - `Closed` after the robot was closed.

    Args:
        host: Host name or address of the Compute Box.
        port: Port number, 502 on a Compute Box.
        model: "rg2" or "rg6", which decides the limits of width and force.
        unit: Number of the gripper behind the Compute Box, 1 to 247. A Dual Quick Changer has a different number for
            each side.
        timeout: Maximum time to connect, and for each reply, in seconds.
    """

    def __init__(
        self, host: str, port: int = PORTS["onrobot"], *, model: RGModel, unit: int = UNIT, timeout: float = 5.0
    ) -> None:
        check_choice(model, "model", get_args(RGModel))
        check_whole(unit, "unit", 1, 247)
        self._timeout = check_seconds(timeout, "timeout", positive=True, finite=True)
        self._model = model

        def dialogue() -> Dialogue:
            transport = TcpTransport(host, port, silence=timeout, refused=lambda: _NEEDED)
            return Dialogue(transport, partial(ModbusTcpProtocol, unit), f"the gripper at {transport.name}", timeout)

        self._connect = dialogue
        self._dialogue = dialogue()
        self._name = f"{host}:{port}"
        self._undos = PendingUndos.of((service_of(host, port), unit), f"the gripper at {self._name}", self)

    # -- motion ----------------------------------------------------------------------------------------

    def move(self, width: float, *, force: float | None = None, wait: bool | float = True) -> RGStatus:
        """Move the fingers. If they are moving, they are stopped first, because a moving gripper ignores commands.

        Args:
            width: Distance between the fingertips in m: 0 to 0.11 for an RG2, 0 to 0.16 for an RG6.
            force: Force at which the fingers stop at an object, in N: up to 40 for an RG2, up to 120 for an RG6. If
                None, half of the maximum.
            wait: Whether to wait until the fingers are at rest: True for up to 60 s, a number for that many seconds.
                With False, return immediately.

        Returns:
            Status after the wait. With `wait`, its `object_detected` shows whether an object is between the fingers.

        Raises:
            LinkTimeout: If the fingers are not at rest in time. They might still move.
        """
        seconds = check_wait(wait)
        words = command_of(self._model, width, LIMITS[self._model][1] / 2.0 if force is None else force)
        if self._checked(self.status()).is_moving:
            self.stop()
            self.wait(self._timeout)
        self._write(COMMAND, words, moves=True)
        until = clock.now() + _BEGINS
        while not (status := self._checked(self.status())).is_moving and abs(status.width - width) > _REACHED:
            if clock.now() >= until:
                break
            clock.sleep(POLL)
        return self.wait(seconds) if seconds else status

    def open(self, *, force: float | None = None, wait: bool | float = True) -> RGStatus:
        """Open the fingers: `move` to the largest width."""
        return self.move(LIMITS[self._model][0], force=force, wait=wait)

    def close(self, *, force: float | None = None, wait: bool | float = True) -> RGStatus:
        """Close the fingers: `move` to 0."""
        return self.move(0.0, force=force, wait=wait)

    def stop(self) -> None:
        """Stop the fingers at their current position."""
        self._write(CONTROL, (STOP,), moves=False)

    def wait(self, timeout: float = 60.0) -> RGStatus:
        """Wait until the fingers are at rest, at the requested width or at an object.

        Raises:
            LinkTimeout: If the fingers are not at rest in time. They might still move.
        """
        until = clock.now() + check_seconds(timeout, "timeout", finite=True)
        failure = f"the gripper at {self._name}: the fingers did not come to rest within {timeout:g} s"
        return read_until(lambda: self._checked(self.status()), lambda status: not status.is_moving, until, failure)

    # -- state -----------------------------------------------------------------------------------------

    def status(self) -> RGStatus:
        """Return the current state. All its values are from one reply."""
        line = read_line(STATUS, COUNT)
        reply = self._dialogue.ask(line, self._timeout)
        registers = values_of(reply)
        if registers is None:
            raise GripperFault(f"the Compute Box at {self._name} rejected {line!r}: {rejection(reply)}")
        return status_of(registers)

    def width(self) -> float:
        """Return the distance between the fingertips, in m."""
        return self.status().width

    def object_detected(self) -> bool:
        """Return whether the fingers grip an object."""
        return self.status().object_detected

    def _write(self, first: int, words: Sequence[int], moves: bool) -> None:
        line = write_line(first, words)
        undo = Undo(self._connect, partial(_stop_fingers, self._timeout)) if moves else None
        with self._undos.command("gripper", self._timeout, undo) as given_up:
            reply = self._dialogue.ask(line, self._timeout, given_up=given_up)
        if reason := rejection(reply):
            raise GripperFault(f"the Compute Box at {self._name} rejected {line!r}: {reason}")

    def _checked(self, status: RGStatus) -> RGStatus:
        if status.fault:
            causes = ", ".join(text for flag, text in SAFETY.items() if status.fault & flag)
            hint = "switch the gripper's power off and on"
            raise GripperFault(f"the gripper at {self._name} does not move: {causes}; {hint}", status.fault)
        return status

    def _disconnect(self) -> None:
        """Disconnect permanently."""
        self._undos.close(self)
        self._dialogue.close()

    def __repr__(self) -> str:
        return f"<RGGripper {self._model} at {self._name}>"


_NEEDED = "an OnRobot gripper is reached at the address of its Compute Box, whose Modbus TCP server uses port 502"


def _stop_fingers(timeout: float, dialogue: Dialogue, is_wanted: Callable[[], bool]) -> None:
    """Undo a motion of the fingers."""
    for line in (read_line(STATUS, COUNT), write_line(CONTROL, (STOP,))):  # the first line only makes contact
        if is_wanted():
            dialogue.ask(line, timeout)
