"""`robot.safety`: the robot's safety state, and the interlock that every motion has to pass."""

from __future__ import annotations

from collections.abc import Callable

from linkcore.arguments import check_callable, check_number
from linkcore.errors import Closed, LinkError, LinkTimeout
from linkcore.names import StrictAttributes

from ..protocol.enums import RobotMode, RobotModeCB2, SafetyMode
from ..session.connect_options import Policy
from .interlock import Interlock, Status
from .safety_monitor import SafetyMonitor


class Safety(StrictAttributes):
    """The interlock that every motion has to pass, kept up to date from the robot's streams.

    Nothing here resets a stop: that is done by a person at the robot, or by `robot.dashboard`.
    """

    def __init__(self, monitor: SafetyMonitor) -> None:
        self._monitor = monitor

    @property
    def mode(self) -> SafetyMode | None:
        """The safety mode as reported last; None if it is not known, and on CB2, which does not report it."""
        return next((each.safety_mode for each in self._statuses() if each.safety_mode is not None), None)

    @property
    def robot_mode(self) -> RobotMode | RobotModeCB2 | None:
        """The robot mode as reported last, in the numbers of the generation; None if it is not known."""
        return next((each.robot_mode for each in self._statuses() if each.robot_mode is not None), None)

    @property
    def cause(self) -> str | None:
        """The stop that holds, such as "protective stop"; None if there is none."""
        self._monitor.listen()
        with self._monitor.decision() as interlock:
            return interlock.cause

    @property
    def refusal(self) -> LinkError | None:
        """What a motion would be refused with at this moment, or None."""
        self._monitor.listen()
        return self._monitor.refusal_to_begin()

    @property
    def is_enabled(self) -> bool:
        """A motion would be let through at this moment."""
        return self.refusal is None

    @property
    def policy(self) -> Policy:
        """Whether a person has to call `enable()`: "never", "on_startup" or "always".

        A change asks for `enable()` anew.

        Raises:
            BadValue: set to anything else.
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
        """Let motions through, as the policy asks for. Without effect if they already are.

        Raises:
            SafetyStop: a stop still holds.
            NotRunning: the robot does not run, or nothing is known of it.
            RemoteError: the robot cannot be reached.
        """
        self._monitor.listen()
        self._monitor.await_news(moves=True)
        with self._monitor.decision() as interlock:
            interlock.enable(self._monitor.clock())

    def wait_until_clear(self, timeout: float = 60.0) -> None:
        """Wait until no stop holds and the robot runs; whether it is enabled is not asked.

        Raises:
            BadValue: `timeout` is not a number of seconds.
            LocalError: in a callback that was subscribed with ``inline=True``, which would wait for itself.
            LinkTimeout: it still was not so after `timeout` seconds; the message names what prevents it.
            Closed: the robot was closed meanwhile.
        """
        self._wait(lambda interlock: interlock.blocked(self._monitor.clock()), timeout)

    def wait_enabled(self, timeout: float = 60.0) -> None:
        """Wait until motions are let through.

        Raises:
            BadValue, LocalError: as `wait_until_clear`.
            LinkTimeout: they still were not after `timeout` seconds; the message names what prevents it.
        """
        self._wait(lambda interlock: interlock.refusal_to_begin(self._monitor.clock()), timeout)

    def wait_for_stop(self, timeout: float) -> LinkError | None:
        """The stop that holds, or the first to be reported within `timeout` seconds; else None.

        Raises:
            BadValue, LocalError: as `wait_until_clear`.
        """
        timeout = check_number(timeout, "timeout", 0.0)
        self._monitor.listen()
        seen: list[LinkError] = []  # since it may be over before this thread asks again

        def is_stopped(interlock: Interlock) -> bool:
            stop = interlock.blocked(self._monitor.clock())
            if stop is not None:
                seen.append(stop)
            return stop is not None

        self._monitor.wait_for(is_stopped, timeout)
        return seen[0] if seen else None

    def on_stop(self, callback: Callable[[LinkError], object]) -> Callable[[], None]:
        """Call back when a stop arrives, with the error that motions end with.

        That is a `SafetyStop`, or `NotRunning` where the robot stopped running or nothing is received from it any
        more. It is called in the robot's thread for callbacks, and may command the robot and wait. It is not for
        stopping the arm: by then it has stopped.

        Returns:
            what takes the callback away again.

        Raises:
            BadValue: nothing that can be called.
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
            raise LinkTimeout(f"not within {timeout:g} s: {why}")

    def _repr_html_(self) -> str:
        from linkcore.text import html_table  # imported here: importing the library stays cheap

        rows: list[tuple[str, object]] = [
            ("motions", "let through" if self.refusal is None else f"refused: {self.refusal}"),
            ("robot mode", getattr(self.robot_mode, "name", "not known")),
            ("safety mode", getattr(self.mode, "name", "not known")),
            ("stop that holds", self.cause or "none"),
            ("policy", self.policy),
        ]
        return html_table("Safety", (), rows)

    def __repr__(self) -> str:
        return f"<Safety policy={self.policy!r}: {self._monitor.refusal_to_begin() or 'enabled'}>"
