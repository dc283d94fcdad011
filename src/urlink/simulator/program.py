"""One program that was sent to the controller and that the arm follows while it runs.

In every cycle the program's threads run first, then the drive makes the targets of what they have commanded. When the
program is over the drive brakes what still moves, and holds.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from .drive import Drive, LimitViolation
from .messages import popup_message, text_message
from .motion import Setpoint
from .sockets import ProgramSockets
from .urscript import Execution, Script

if TYPE_CHECKING:
    from urlink.firmware import Firmware
    from urlink.models import Model

    from .controller import Controller
    from .signals import Signals

__all__ = ["Program", "ProgramWorld"]


class ProgramWorld:
    """The controller as one of its programs sees it: the `World` of `urlink.simulator.urscript`.

    Args:
        drive: what the program moves the arm with; None for a secondary program, which may only ask whether it moves.
    """

    def __init__(self, controller: Controller, drive: Drive | None = None) -> None:
        self._controller = controller
        self._drive = drive
        self.sockets = ProgramSockets(controller.allows)
        self.period = 1.0 / controller.firmware.rate

    @property
    def drive(self) -> Drive:
        if self._drive is None:
            return Drive(self._controller.model, self._controller.arm.setpoint)
        return self._drive

    @property
    def firmware(self) -> Firmware:
        return self._controller.firmware

    @property
    def model(self) -> Model:
        return self._controller.model

    @property
    def cycle(self) -> int:
        return self._controller.cycle

    @property
    def signals(self) -> Signals:
        return self._controller.signals

    @property
    def flags(self) -> list[bool]:
        return self._controller.flags

    @property
    def q_actual(self) -> Sequence[float]:
        return self._controller.arm.q_actual

    @property
    def qd_actual(self) -> Sequence[float]:
        return self._controller.arm.sample.qd_actual

    @property
    def q_target(self) -> Sequence[float]:
        return self._controller.arm.setpoint.q

    @property
    def qd_target(self) -> Sequence[float]:
        return self._controller.arm.setpoint.qd

    @property
    def pose_actual(self) -> Sequence[float]:
        return self._controller.arm.sample.pose_actual

    @property
    def pose_target(self) -> Sequence[float]:
        return self._controller.arm.sample.pose_target

    @property
    def speed_actual(self) -> Sequence[float]:
        return self._controller.arm.sample.speed_actual

    @property
    def force(self) -> Sequence[float]:
        return self._controller.arm.sample.force

    @property
    def torques(self) -> Sequence[float]:
        return self._controller.arm.sample.M_target

    @property
    def tcp(self) -> Sequence[float]:
        return self._controller.arm.tcp

    def set_tcp(self, pose: Sequence[float]) -> None:
        self._controller.arm.tcp = list(pose)
        if self._drive is not None:
            # A movement may follow in the same cycle.
            self._drive.tcp = pose

    @property
    def payload(self) -> float:
        return self._controller.arm.payload

    @property
    def payload_cog(self) -> Sequence[float]:
        return self._controller.arm.payload_cog

    def set_payload(self, mass: float, cog: Sequence[float] | None, inertia: Sequence[float] | None) -> None:
        arm = self._controller.arm
        arm.payload = mass
        if cog is not None:
            arm.payload_cog = tuple(cog)
        if inertia is not None:
            arm.payload_inertia = tuple(inertia)

    def set_gravity(self, vector: Sequence[float]) -> None:
        """Without effect: the simulated arm stands upright."""

    def text_message(self, text: str) -> None:
        self._controller.mention(lambda: text_message(self._controller, text))

    def popup(self, text: str, title: str, is_warning: bool, is_error: bool, is_blocking: bool) -> None:
        controller = self._controller
        controller.pendant.popup = text
        controller.mention(lambda: popup_message(controller, text, title, is_warning, is_error, is_blocking))

    @property
    def has_popup(self) -> bool:
        return self._controller.pendant.popup is not None

    def protective_stop(self, reason: str) -> None:
        self._controller.stop_for(reason)


class Program:
    """A program that runs, as a `Motion` that the arm follows.

    Attributes:
        name: of the program.
        is_program: it is not over.
        drive: makes its targets.
    """

    def __init__(self, controller: Controller, script: Script, on_end: Callable[[Program], object]) -> None:
        self.name = script.name
        self.is_program = True
        self._controller = controller
        self._on_end = on_end
        # It takes over from what moved the arm before, at its speed.
        self.drive = Drive(controller.model, controller.arm.setpoint)
        self._world = ProgramWorld(controller, self.drive)
        self.execution = Execution(script, self._world)

    def start(self, q: Sequence[float]) -> None:
        """Go on from rest at six joint positions in rad, to which the arm has braked meanwhile."""
        self.drive.start(q)

    def advance(self, seconds: float) -> Setpoint:
        """The targets one cycle of that many seconds later."""
        drive, controller = self.drive, self._controller
        drive.speed_fraction = controller.speed_fraction
        if self.is_program:
            drive.tcp = controller.arm.tcp
            self.execution.advance()
            if self.execution.is_over:
                self.end()
        try:
            return drive.advance(seconds)
        except LimitViolation as violation:
            controller.stop_for(violation.reason)
            return drive.setpoint

    def end(self) -> None:
        """Stop it, if it is not over by itself."""
        if self.is_program:
            self.is_program = False
            self.execution.stop()
            self._world.sockets.close_all()
            self._on_end(self)
