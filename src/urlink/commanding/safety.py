"""`robot.safety`: what the robot says of its safety, and the gate between every motion and the arm."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from typing import Any, cast

from linkcore.errors import BadValue, LinkError, LinkTimeout
from linkcore.streaming.events import ConnectionEvent, ConnectionState
from linkcore.streaming.stream import Stream
from linkcore.streaming.subscription import Subscription
from linkcore.wire.packet import State

from ..errors import SafetyStop
from ..interfaces.enums import RobotMode, RobotModeCB2, SafetyMode
from ..interfaces.primary.robot_message import SafetyModeMessage
from ..interfaces.primary.robot_state import RobotState
from ..interfaces.realtime.packets import RealtimeState
from ..urscript.text import checked
from .interlock import STALE, Gate, Policy, Status

__all__ = ["Safety"]

_log = logging.getLogger(__name__)

#: Seconds that a source has for its first word.
_FIRST_WORD = 2.0
#: Seconds within which every source that speaks at all speaks again: the primary interface does ten times a second.
_NEXT_WORD = 0.25


class Safety:
    """The gate between motions and the arm, kept up to date by the robot's own streams.

    It listens from its first use on: to the primary interface at 10 Hz, and from the first motion on to the
    real-time interface too, so that a stop is heard within a cycle or two. Nothing here switches a stop off or
    resets one: that is for a person at the robot, or for `robot.dashboard`.

    Args:
        primary: makes the primary stream.
        realtime: makes the real-time stream.
        policy: whether a person has to call `enable()`: "never" (the gate opens by itself as soon as all is clear),
            "on_startup" (once, by itself afterwards) or "always" (at first, and again after every stop, lost
            connection, silence or power off).
    """

    def __init__(
        self,
        primary: Callable[[], Stream[RobotState]],
        realtime: Callable[[], Stream[RealtimeState]],
        policy: Policy = "never",
    ) -> None:
        self._streams: dict[str, Callable[[], Stream[Any]]] = {"primary": primary, "realtime": realtime}
        self._gate = Gate(policy)
        #: Held while the gate is asked and something is sent, and while it changes.
        self.lock = threading.RLock()
        self._changed = threading.Condition(self.lock)
        self._attending = threading.Lock()
        self._subscriptions: dict[str, list[Subscription]] = {}
        self._callbacks: dict[object, Callable[[LinkError], object]] = {}

    # -- what users ask ------------------------------------------------------------------------------

    @property
    def mode(self) -> SafetyMode | None:
        """The safety mode as heard last; None if it is not known, and on CB2, which does not say it."""
        return next((each.safety_mode for each in self._statuses() if each.safety_mode is not None), None)

    @property
    def robot_mode(self) -> RobotMode | RobotModeCB2 | None:
        """The robot mode as heard last, in the numbers of the generation; None if it is not known."""
        return next((each.robot_mode for each in self._statuses() if each.robot_mode is not None), None)

    @property
    def cause(self) -> str | None:
        """The stop that holds, such as "protective stop"; None if there is none."""
        self.attend()
        return self._gate.cause

    @property
    def hindrance(self) -> LinkError | None:
        """What a motion would be refused with at this moment, or None."""
        self.attend()
        with self.lock:
            return self._gate.refusal(time.monotonic())

    @property
    def is_enabled(self) -> bool:
        """A motion would be let through at this moment."""
        return self.hindrance is None

    @property
    def policy(self) -> Policy:
        """Whether a person has to call `enable()`: "never", "on_startup" or "always".

        Raises:
            BadValue: set to anything else.
        """
        return self._gate.policy

    @policy.setter
    def policy(self, policy: Policy) -> None:
        with self._changed:
            self._gate.policy = policy
            self._changed.notify_all()

    def enable(self) -> None:
        """Let motions through, as the policy asks for. Without effect if they already are.

        Raises:
            SafetyStop: a stop still holds.
            NotRunning: the robot does not run, or nothing is known of it.
            RemoteError: the robot cannot be reached.
        """
        self.attend()
        self.reconsider(moves=True)
        with self._changed:
            self._gate.enable(time.monotonic())
            self._changed.notify_all()

    def wait_until_clear(self, timeout: float = 60.0) -> None:
        """Wait until no stop holds and the robot runs; whether it is enabled is not asked.

        Raises:
            BadValue: `timeout` is no number of seconds.
            LinkTimeout: it still was not so after `timeout` seconds; says what hinders.
        """
        self._wait(self._gate.hindrance, timeout)

    def wait_enabled(self, timeout: float = 60.0) -> None:
        """Wait until motions are let through.

        Raises:
            BadValue: `timeout` is no number of seconds.
            LinkTimeout: they still were not after `timeout` seconds; says what hinders.
        """
        self._wait(self._gate.refusal, timeout)

    def on_stop(self, callback: Callable[[LinkError], object]) -> Callable[[], None]:
        """Call back at once when a stop arrives, with the error that motions end with.

        That is a `SafetyStop`, or `NotRunning` where the robot stopped running or can no longer be heard. It is
        called from the thread that reads, before anything else is done with the news: be quick.

        Returns:
            what takes the callback away again.

        Raises:
            BadValue: nothing that can be called.
        """
        if not callable(callback):
            raise BadValue(f"{callback!r} cannot be called back")
        key = object()
        with self.lock:
            self._callbacks[key] = callback

        def remove() -> None:
            with self.lock:
                self._callbacks.pop(key, None)

        return remove

    # -- what the outlet asks ------------------------------------------------------------------------

    def admit(self, brakes: bool = False) -> None:
        """The gate itself; asked with `lock` held.

        Args:
            brakes: what is to be sent can only bring the arm to rest, so nobody has to enable it.

        Raises:
            SafetyStop: a stop holds; NotEnabled if only `enable()` is missing.
            NotRunning: the robot does not run, or nothing is known of it.
        """
        with self.lock:
            now = time.monotonic()
            refusal = self._gate.hindrance(now) if brakes else self._gate.refusal(now)
            if refusal is not None:
                raise refusal

    def admit_command(self) -> None:
        """As `admit`, for what moves nothing: a stop does not matter as long as the robot runs.

        Raises:
            NotRunning: it does not, or nothing is known of it.
        """
        with self.lock:
            absence = self._gate.absence(time.monotonic())
            if absence is not None:
                raise absence

    def attend(self, closely: bool = False) -> None:
        """Listen, if not done yet, and wait for the first word; `closely` on the real-time interface too.

        Raises:
            RemoteError: the first connection could not be made.
            Closed: the robot was closed.
        """
        for name in ("primary", "realtime") if closely else ("primary",):
            if name not in self._subscriptions:
                self._listen(name)
            with self._changed:
                self._changed.wait_for(lambda name=name: self._gate.has_word(name), _FIRST_WORD)  # type: ignore[misc]
                # Only now: a source that has just been asked must not close a gate that was open.
                self._gate.expect(name)

    def reconsider(self, moves: bool) -> None:
        """Where something hinders, wait for the next word of every source: the last one may be overtaken.

        Who has just switched the arm on, and was told so by the dashboard, need not wait himself.
        """
        hindrance = self._gate.hindrance if moves else self._gate.absence
        with self._changed:
            began = time.monotonic()
            if hindrance(began) is not None:
                self._changed.wait_for(
                    lambda: hindrance(time.monotonic()) is None or self._gate.has_heard_since(began), _NEXT_WORD
                )

    def wait_for_stop(self, timeout: float) -> LinkError | None:
        """The stop that holds, or the first to be heard of within `timeout` seconds; else None.

        Raises:
            BadValue: `timeout` is no number of seconds.
        """
        timeout = checked(timeout, "timeout", 0.0)
        with self._changed:
            self._changed.wait_for(lambda: self._gate.hindrance(time.monotonic()), timeout)
            return self._gate.hindrance(time.monotonic())

    def close(self, timeout: float = 1.0) -> None:
        """Listen no more, within `timeout` seconds, and let nothing through."""
        until = time.monotonic() + timeout
        with self._attending:
            listened = dict(self._subscriptions)
        for name, subscriptions in listened.items():
            for subscription in subscriptions:
                subscription.close(max(until - time.monotonic(), 0.0))
            self._tell(lambda name=name: self._gate.lose(name, "closed here", time.monotonic()))  # type: ignore[misc]

    # -- what is heard -------------------------------------------------------------------------------

    def _listen(self, name: str) -> None:
        with self._attending:
            if name in self._subscriptions:
                return
            stream = self._streams[name]()
            is_vain = False

            def on_event(event: ConnectionEvent) -> None:
                if event.state not in (ConnectionState.CONNECTING, ConnectionState.CONNECTED):
                    why, at = str(event.error or "closed"), event.received.monotonic
                    self._tell(lambda: None if is_vain else self._gate.lose(name, why, at))
                if event.state in (ConnectionState.IDLE, ConnectionState.CLOSED):  # given up: listen anew if asked
                    with self._attending:
                        self._subscriptions.pop(name, None)

            def on_silence(seconds: float) -> None:
                self._tell(lambda: self._gate.look(time.monotonic()))

            hear = self._hear_primary if name == "primary" else self._hear_realtime
            kind: type = State if name == "primary" else RealtimeState
            subscriptions: list[Subscription] = []
            try:
                # The deadline is a little late: by then the gate finds that the last word is too old.
                subscriptions.append(stream.subscribe(hear, kind, deadline=1.05 * STALE, on_deadline=on_silence))
                subscriptions.append(stream.subscribe(on_event, ConnectionEvent))
            except BaseException:
                for subscription in subscriptions:
                    subscription.close(0)  # its callback may be waiting for us
                with self.lock:
                    is_vain = True
                    self._gate.forget(name)
                raise
            self._subscriptions[name] = subscriptions
            if stream.connection is not ConnectionState.CONNECTED:
                self._tell(lambda: self._gate.lose(name, "not connected at present", time.monotonic()))

    def _hear_primary(self, packet: State) -> None:
        at = packet.received.monotonic if packet.received is not None else time.monotonic()
        before = self._gate.status("primary")
        if isinstance(packet, RobotState):
            mode, board = packet.robot_mode_data, packet.masterboard_data
            if mode is None:
                return
            status = Status(
                mode.robot_mode,
                board.safety_mode if board is not None else None,
                mode.is_emergency_stopped,
                mode.is_protective_stopped,
                board.master_safety_state if board is not None else None,
            )
        elif isinstance(packet, SafetyModeMessage) and before is not None:
            status = before._replace(safety_mode=packet.safety_mode)
        else:
            return
        self._tell(lambda: self._gate.hear("primary", status, at))

    def _hear_realtime(self, state: RealtimeState) -> None:
        at = state.received.monotonic if state.received is not None else time.monotonic()
        status = Status(state.robot_mode, state.safety_mode)
        self._tell(lambda: self._gate.hear("realtime", status, at))

    def _tell(self, observe: Callable[[], LinkError | None]) -> None:
        with self._changed:
            stopped = observe()
            self._changed.notify_all()
            callbacks = list(self._callbacks.values()) if stopped is not None else []
        # Without the lock: a callback may wait for a lock whose holder asks the gate.
        for callback in callbacks:
            try:
                callback(cast(LinkError, stopped))
            except Exception:
                _log.exception("a callback of on_stop raised; the others are called all the same")

    def _statuses(self) -> list[Status]:
        self.attend()
        with self.lock:
            return self._gate.statuses

    @property
    def _is_connected(self) -> bool:
        """What is listened to is connected; the gate hears of a loss a moment later than others may."""
        return all(self._streams[name]().connection is ConnectionState.CONNECTED for name in list(self._subscriptions))

    def _wait(self, hindrance: Callable[[float], SafetyStop | LinkError | None], timeout: float) -> None:
        timeout = checked(timeout, "timeout", 0.0)
        self.attend()
        with self._changed:
            if not self._changed.wait_for(lambda: self._is_connected and hindrance(time.monotonic()) is None, timeout):
                raise LinkTimeout(f"not within {timeout:g} s: {hindrance(time.monotonic())}")

    def __repr__(self) -> str:
        with self.lock:
            refusal = self._gate.refusal(time.monotonic())
        return f"<Safety policy={self.policy!r}: {refusal or 'enabled'}>"
