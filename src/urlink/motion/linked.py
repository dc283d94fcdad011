"""Motions whose program on the robot keeps a connection to this computer.

No thread is started for them: everything happens when a real-time state arrives, which is once per cycle of the
controller, and so is paced by its clock. Should no state arrive, that is noticed by the deadline of the subscription.
"""

from __future__ import annotations

import contextlib
import threading
import time

from linkcore.errors import ConnectionLost, LinkError, RemoteError
from linkcore.streaming.policy import latest
from linkcore.streaming.subscription import Subscription

from ..commanding.handle import Program, ProgramPhase
from ..errors import ProgramStopped, ToleranceExceeded
from ..interfaces.realtime.packets import RealtimeState
from ..urscript import programs
from .equipment import Equipment
from .handle import Motion, MotionPhase
from .reverse import ReverseLink

__all__ = ["LinkedMotion"]

#: Seconds that the program has to connect.
CONNECT_TIMEOUT = 5.0
#: Seconds without a real-time state after which the robot counts as gone; its program brakes sooner.
_SILENCE = 0.5
#: Seconds after the connection was lost in which the reason may arrive over the other interfaces.
_GRACE = 1.0
#: Seconds that the program has to end once it was told to.
_END_TIMEOUT = 1.0


class LinkedMotion(Motion):
    """A program that connects back, and what is said to it."""

    def __init__(self, name: str, equipment: Equipment) -> None:
        super().__init__(name, equipment)
        self._link: ReverseLink | None = None
        self._program: Program | None = None
        self._subscriptions: list[Subscription] = []
        self._sent = 0.0
        self._lost: tuple[LinkError, float] | None = None
        self._last_word: float | None = None
        self._is_linked = threading.Event()

    # -- what the kinds fill in ------------------------------------------------------------------------

    def _body(self, host: str, port: int) -> list[str]:
        """The lines of the program."""
        raise NotImplementedError

    def _step(self, link: ReverseLink, state: RealtimeState) -> None:
        """A state has come, and the program is connected."""
        raise NotImplementedError

    def _farewell(self) -> bytes:
        """What ends the program; nothing if it ends by itself."""
        return b""

    # -- to be used by them ----------------------------------------------------------------------------

    def _say(self, data: bytes) -> None:
        """Send to the program, through the gate and only while this goes on."""
        self._equipment.outlet.setpoint(lambda: self._transmit(data))

    def _transmit(self, data: bytes) -> None:
        if self._link is not None and not self.done:
            self._link.send(data)

    def _conclude(self) -> None:
        """All is done: let the program end, and then be done."""
        if self._last_word is None:
            self._last_word = time.monotonic()  # before it is said: the program may end before this thread goes on
            if self._farewell():
                self._say(self._farewell())

    # ----------------------------------------------------------------------------------------------------

    def _begin(self) -> None:
        equipment = self._equipment
        self._link = link = ReverseLink(equipment.host, equipment.reverse_host, equipment.reverse_port)
        self._attend(
            equipment.realtime.subscribe(self._on_state, policy=latest, deadline=_SILENCE, on_deadline=self._on_silence)
        )
        self._sent = time.monotonic()
        program = equipment.scripts.start(self._body(*link.address), on_text=self._on_text)
        self._program = program
        program.add_done_callback(self._on_program)

    def _attend(self, subscription: Subscription) -> None:
        """Keep a subscription until this is over."""
        with self._lock:
            is_late = self._phase is not MotionPhase.MOVING
            if not is_late:
                self._subscriptions.append(subscription)
        if is_late:
            subscription.close(0)

    def _on_state(self, state: RealtimeState) -> None:
        link = self._link
        if link is None or self._program is None or self.done:
            return
        try:
            self._look(link, state)
        except LinkError as error:
            self._fail(error, brake=link.is_up)
        except Exception as error:
            # A mistake in here must not leave an arm that nobody guides, nor somebody who waits for ever.
            self._fail(error, brake=True)
            raise

    def _look(self, link: ReverseLink, state: RealtimeState) -> None:
        now = time.monotonic()
        if self._lost is not None:
            if now - self._lost[1] > _GRACE:
                self._fail(self._lost[0])
        elif self._last_word is not None:
            if now - self._last_word > _END_TIMEOUT:
                self._complete()
        elif not link.is_up and not link.poll():
            if now - self._sent > CONNECT_TIMEOUT:
                self._fail(link.absence(f"it has not within {CONNECT_TIMEOUT:g} s"), brake=True)
        else:
            self._is_linked.set()
            try:
                self._step(link, state)
            except ConnectionLost as error:
                self._lose(error)

    def _lose(self, error: LinkError) -> None:
        """The connection is gone. Whatever stopped the program is told over the primary interface, if it can be."""
        lost = ConnectionLost(f"the connection of the program on the robot was lost, so it brakes by itself: {error}")
        self._lost = (lost, time.monotonic())

    def _on_silence(self, seconds: float) -> None:
        if self._program is not None:
            silence = ConnectionLost(f"no state of the robot came for {seconds:.2f} s, so set-points cannot be timed")
            self._fail(self._lost[0] if self._lost is not None else silence, brake=True)

    def _on_text(self, text: str) -> None:
        error: RemoteError
        if text.startswith(programs.NO_CONNECTION):
            assert self._link is not None
            error = self._link.absence("it says that it was refused, or found no way")
        elif text.startswith(programs.LINK_ENDED):
            error = ConnectionLost("the program on the robot says that its connection ended; it brakes by itself")
        elif text.startswith(programs.STARVED):
            error = ConnectionLost("nothing came to the program on the robot in time, so it brakes by itself")
        elif text.startswith(programs.TOO_FAR):
            error = ToleranceExceeded("the program on the robot says that the first point is too far away")
        else:
            return
        if self._last_word is None:
            self._fail(error)

    def _on_program(self, program: Program) -> None:
        if program.phase is ProgramPhase.FINISHED and self._last_word is not None:
            self._complete()
        elif self._lost is not None and program.phase is ProgramPhase.FINISHED:
            self._fail(self._lost[0])
        else:
            self._fail(program.error or ProgramStopped(f"the program of {self.name} ended before its time"))

    def make_way(self) -> None:
        super().make_way()
        # A fixed port is free for the next one only when nobody listens on it; the program will not come any more.
        if self._equipment.reverse_port and self._link is not None and not self._link.is_up:
            self._link.close()

    def _brake(self) -> None:
        link, program = self._link, self._program
        if link is not None and link.is_up and self._farewell():
            self._equipment.outlet.setpoint(lambda: link.send(self._farewell()), brakes=True)
        elif program is not None:
            program.stop()

    def _release(self) -> None:
        self._is_linked.set()
        with self._lock:
            subscriptions, self._subscriptions = self._subscriptions, []
        for subscription in subscriptions:
            # Without waiting: this may be the thread that a callback runs in, and a callback may be slow.
            subscription.close(0)
        if self._link is not None:
            with contextlib.suppress(OSError):
                self._link.close()
