"""`robot.safety`: the safety state of the robot, and the interlock that every motion must pass."""

from __future__ import annotations

from collections.abc import Callable

from linkcore.arguments import check_callable, check_number
from linkcore.errors import Closed, LinkError, LinkTimeout
from linkcore.names import StrictAttributes

from ..errors.stop_explanation import StopExplanation
from ..protocol.enums import RobotMode, RobotModeCB2, SafetyMode
from ..session.connect_options import Policy
from .interlock import Interlock, Status
from .safety_monitor import SafetyMonitor


class Safety(StrictAttributes):
    """The interlock that every motion must pass, updated from the robot's streams.

    This class cannot reset a stop. A person at the robot, or `robot.dashboard`, resets it.
    """

    def __init__(self, monitor: SafetyMonitor) -> None:
        self._monitor = monitor

    @property
    def mode(self) -> SafetyMode | None:
        """Last reported safety mode; None if unknown. CB2 does not report it."""
        return next((each.safety_mode for each in self._statuses() if each.safety_mode is not None), None)

    @property
    def robot_mode(self) -> RobotMode | RobotModeCB2 | None:
        """Last reported robot mode, in the numbers of the robot's generation; None if unknown."""
        return next((each.robot_mode for each in self._statuses() if each.robot_mode is not None), None)

    @property
    def cause(self) -> str | None:
        """Name of the active stop, such as "protective stop"; None if no stop is active."""
        self._monitor.listen()
        with self._monitor.decision() as interlock:
            return interlock.cause

    @property
    def refusal(self) -> LinkError | None:
        """Error with which a motion would be refused now; None if it would be permitted."""
        self._monitor.listen()
        return self._monitor.refusal_to_begin()

    @property
    def is_enabled(self) -> bool:
        """Whether a motion would be permitted now."""
        return self.refusal is None

    @property
    def policy(self) -> Policy:
        """Whether a person must call `enable()`: "never", "on_startup" or "always".

        After a change, `enable()` must be called again.

        Raises:
            BadValue: If it is set to any other value.
        """
        with self._monitor.decision() as interlock:
            return interlock.policy

    @policy.setter
    def policy(self, policy: Policy) -> None:
        with self._monitor.decision() as interlock:
            was_enabled = interlock.is_enabled
            interlock.policy = policy
            if was_enabled and not interlock.is_enabled:
                self._monitor.overtake(f"the policy was set to {policy!r}")

    def enable(self) -> None:
        """Permit motions, if the policy requires this call. It has no effect if motions are already permitted.

        Raises:
            SafetyStop: If a stop is still active.
            NotRunning: If the robot is not running, or its state is unknown.
            RemoteError: If the robot cannot be reached.
        """
        self._monitor.listen()
        self._monitor.await_news(moves=True)
        with self._monitor.decision() as interlock:
            interlock.enable(self._monitor.clock())

    def wait_until_clear(self, timeout: float = 60.0) -> None:
        """Wait until no stop is active and the robot is running, whether or not motions are enabled.

        Raises:
            BadValue: If `timeout` is not a number of seconds.
            LocalError: If called in a callback that was subscribed with ``inline=True``, which would wait for itself.
            LinkTimeout: If this takes longer than `timeout` seconds. The message names what blocks motion.
            Closed: If the robot is closed during the wait.
        """
        self._wait(lambda interlock: interlock.blocked(self._monitor.clock()), timeout)

    def wait_enabled(self, timeout: float = 60.0) -> None:
        """Wait until motions are permitted.

        Raises:
            BadValue, LocalError: See `wait_until_clear`.
            LinkTimeout: If this takes longer than `timeout` seconds. The message names what blocks motion.
        """
        self._wait(lambda interlock: interlock.refusal_to_begin(self._monitor.clock()), timeout)

    def wait_for_stop(self, timeout: float) -> LinkError | None:
        """Return the active stop, or the first stop reported within `timeout` seconds; None if there is none.

        Raises:
            BadValue, LocalError: See `wait_until_clear`.
        """
        timeout = check_number(timeout, "timeout", 0.0)
        self._monitor.listen()
        seen: list[LinkError] = []  # because the stop might have ended before this thread checks again

        def is_stopped(interlock: Interlock) -> bool:
            stop = interlock.blocked(self._monitor.clock())
            if stop is not None:
                seen.append(stop)
            return stop is not None

        self._monitor.wait_for(is_stopped, timeout)
        return seen[0] if seen else None

    def explain(self, timeout: float = 1.0) -> StopExplanation | None:
        """Return why the robot stopped, from the data of the last ten seconds; None if it has not stopped.

        This is the active stop, or else the last stop since the connection. Programs that another client has stopped or
        replaced are explained too. Missing data never raise an error; `StopExplanation.missing` lists them.

        The explanation needs the streams `primary` and `realtime`, which the first motion opens. If a stop began before
        they were opened, only its kind is known.

        Args:
            timeout: Maximum wait in seconds for the code that the controller reports after a stop. In a callback that
                was subscribed with ``inline=True``, the call does not wait.

        Raises:
            BadValue: If `timeout` is not a number of seconds.
            RemoteError: If the robot cannot be reached.
            Closed: If the robot was closed.
        """
        timeout = check_number(timeout, "timeout", 0.0)
        monitor = self._monitor
        monitor.listen(closely=True)
        flight = monitor.flight
        if flight is None:
            return None
        with monitor.decision() as interlock:
            interlock.refusal_to_continue()  # notes a stop that was active before the first motion
        if flight.unsettled is not None and monitor.may_wait:
            monitor.wait_for(lambda interlock: flight.unsettled is None, timeout)
        return flight.explain()

    def on_stop(self, callback: Callable[[LinkError], object]) -> Callable[[], None]:
        """Call a function when a stop arrives, with the error that ends the motions.

        The error is a `SafetyStop`, or `NotRunning` if the robot is no longer running or no data arrives from it. The
        function is called in the robot's thread for callbacks, and may command the robot and wait. It does not have to
        stop the arm, which has already stopped by then.

        Returns:
            Function that removes the callback.

        Raises:
            BadValue: If `callback` is not callable.
        """
        check_callable(callback, "callback")
        return self._monitor.on_stop(callback)

    def _statuses(self) -> list[Status]:
        self._monitor.listen()
        with self._monitor.decision() as interlock:
            return interlock.statuses

    def _wait(self, in_the_way: Callable[[Interlock], LinkError | None], timeout: float) -> None:
        timeout = check_number(timeout, "timeout", 0.0)
        monitor = self._monitor
        monitor.listen()
        if not monitor.wait_for(lambda interlock: monitor.is_connected and in_the_way(interlock) is None, timeout):
            if monitor.is_closed:
                raise Closed("the robot was closed")
            with monitor.decision() as interlock:
                why = in_the_way(interlock) or "the connection was just lost"
            raise LinkTimeout(f"the robot was not ready within {timeout:g} s: {why}")

    def _repr_html_(self) -> str:
        from linkcore.text import html_table  # imported here: importing the library stays cheap

        rows: list[tuple[str, object]] = [
            ("motions", "permitted" if self.refusal is None else f"refused: {self.refusal}"),
            ("robot mode", getattr(self.robot_mode, "name", "unknown")),
            ("safety mode", getattr(self.mode, "name", "unknown")),
            ("active stop", self.cause or "none"),
            ("policy", self.policy),
        ]
        return html_table("Safety", (), rows)

    def __repr__(self) -> str:
        return f"<Safety policy={self.policy!r}: {self._monitor.refusal_to_begin() or 'enabled'}>"
