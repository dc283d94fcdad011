"""The interlock, sans-IO: decides whether the arm may be moved.

The vendor defines each safety mode. Only NORMAL and REDUCED permit motions; this is a choice of this library. In
RECOVERY, a person uses the pendant to move the arm slowly out of a place where it must not be. Nothing is known about
safety modes that are not in any list.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple, get_args

from linkcore.errors import BadValue, LinkError

from ..errors import NotEnabled, NotRunning, SafetyStop
from ..protocol.enums import MasterSafetyState, RobotMode, RobotModeCB2, SafetyMode
from ..session.connect_options import STALE_AFTER, Policy

if TYPE_CHECKING:
    from .flight_recorder import FlightRecorder

_MAY_MOVE = (SafetyMode.NORMAL, SafetyMode.REDUCED)
_CB2_STOPS = {
    RobotModeCB2.SECURITY_STOPPED: "protective stop",
    RobotModeCB2.EMERGENCY_STOPPED: "emergency stop",
    RobotModeCB2.FATAL_ERROR: "fatal error",
    RobotModeCB2.SAFEGUARD_STOP: "safeguard stop",
}
# The states of a booting masterboard and the undefined state are not stops; the robot mode decides in these cases.
_MASTER_STOPS = {
    MasterSafetyState.FAULT: "fault",
    MasterSafetyState.ROBOT_EMERGENCY_STOP: "emergency stop",
    MasterSafetyState.EXTERNAL_EMERGENCY_STOP: "external emergency stop",
    MasterSafetyState.SAFEGUARD_STOP: "safeguard stop",
}


class Status(NamedTuple):
    """Condition of the robot as one interface reports it; None for each value that it does not report."""

    robot_mode: RobotMode | RobotModeCB2 | None = None
    safety_mode: SafetyMode | None = None
    is_emergency_stopped: bool | None = None
    is_protective_stopped: bool | None = None
    master_safety_state: MasterSafetyState | None = None

    def over(self, before: Status | None) -> Status:
        """Return this status, with missing values taken from the status `before` on the same connection."""
        if before is None:
            return self
        return Status._make(old if new is None else new for new, old in zip(self, before, strict=True))

    @property
    def cause(self) -> str | None:
        """Name of the reported stop, or None."""
        if self.safety_mode is not None and self.safety_mode not in _MAY_MOVE:
            name = self.safety_mode.name.replace("_", " ").lower()
            return name if "stop" in name or name in ("violation", "fault") else f"safety mode {name}"
        if self.is_emergency_stopped:
            return "emergency stop"
        if self.is_protective_stopped:
            return "protective stop"
        if isinstance(self.robot_mode, RobotModeCB2) and self.robot_mode in _CB2_STOPS:
            return _CB2_STOPS[self.robot_mode]
        if self.master_safety_state is not None:
            return _MASTER_STOPS.get(self.master_safety_state)
        return None


class _Source:
    def __init__(self) -> None:
        self.status: Status | None = None
        self.reported_at = float("-inf")
        #: Reason why this source reports nothing: its connection was lost, or the robot is silent.
        self.absence: str | None = None


class Interlock:
    """Decides whether motions are permitted, from the reports of the sources and from the policy.

    Every source (primary and real-time interface) must be connected, recent, and report no stop. The interlock closes
    if any of them reports a stop, or a robot mode other than running. It also closes if a connection is lost or the
    robot is silent, because the robot might have been stopped meanwhile.

    An old state never permits a motion, even if only this process was delayed. If the process still has to read states,
    new motions are refused until these states are read. Running motions continue, because only `fall_silent` reports
    that the robot itself is silent.

    Args:
        policy: Enable policy: "never", "on_startup" or "always".
        stale_after: Age, in seconds, above which the last state is too old to permit a motion.

    Attributes:
        stale_after: See the argument `stale_after`.
        flight: Flight recorder, which explains stops; None for none.
    """

    def __init__(self, policy: Policy = "never", stale_after: float = STALE_AFTER) -> None:
        self.stale_after = stale_after
        self.flight: FlightRecorder | None = None
        self._sources: dict[str, _Source] = {}
        self._was_clear = False
        self._was_enabled = False  # at least once since the policy was set
        self._is_enabled = False  # since the interlock was last closed
        self._policy = _known(policy)

    # -- received reports ------------------------------------------------------------------------

    def expect(self, source: str) -> None:
        """Require reports of this source from now on."""
        self._sources.setdefault(source, _Source())

    def forget(self, source: str) -> None:
        """Require no more reports of this source."""
        self._sources.pop(source, None)
        self._look()

    def report(self, source: str, status: Status, at: float) -> LinkError | None:
        """Record a source's report at time `at`. If it closes the interlock, return the error that ends all motions."""
        known = self._sources.setdefault(source, _Source())
        known.status, known.reported_at, known.absence = status.over(known.status), at, None
        return self._look()

    @property
    def is_clear(self) -> bool:
        """Whether no report closes the interlock. The age of the reports, and `enable()`, do not matter."""
        return self._was_clear

    def renew(self, source: str, at: float) -> None:
        """Record that a source reports the same at time `at` as before, while `is_clear` is True."""
        known = self._sources.get(source)
        if known is not None:
            known.reported_at = at

    def amend(self, source: str, status: Status, at: float) -> LinkError | None:
        """Record a part of a report; see `report`. It has no effect before a complete report was received."""
        known = self._sources.get(source)
        return None if known is None or known.status is None else self.report(source, status, at)

    def lose(self, source: str, why: str) -> LinkError | None:
        """Record a lost connection. Return the error that ends all motions, if this closed the interlock."""
        known = self._sources.setdefault(source, _Source())
        known.status = None
        known.absence = f"the connection to the {source} interface is lost, so the robot's state is unknown: {why}"
        return self._look()

    def fall_silent(self, source: str, seconds: float) -> LinkError | None:
        """Record that the robot has sent nothing for `seconds`, although this process was reading.

        Return the error that ends all motions, if this closed the interlock.
        """
        known = self._sources.get(source)
        if known is not None and known.absence is None:
            known.absence = (
                f"nothing arrived on the {source} interface for {seconds:.1f} s, so the robot's state is unknown"
            )
        return self._look()

    def _look(self) -> LinkError | None:
        refusal = self.refusal_to_continue()
        was_clear, self._was_clear = self._was_clear, refusal is None
        flight = self.flight
        if flight is not None and flight.active is not None and not isinstance(refusal, SafetyStop):
            flight.end_stop()
        if refusal is not None:
            self._is_enabled = False
            if was_clear:
                return refusal
        return None

    # -- decisions ---------------------------------------------------------------------------------

    def is_expected(self, source: str) -> bool:
        """Whether this source must report, or has already reported."""
        return source in self._sources

    def has_reported(self, source: str) -> bool:
        """Whether the source has reported, or its connection is lost."""
        known = self._sources.get(source)
        return known is not None and (known.status is not None or known.absence is not None)

    def has_reported_since(self, since: float) -> bool:
        """Whether there is a source, and every source has reported after the time `since`."""
        return bool(self._sources) and all(known.reported_at > since for known in list(self._sources.values()))

    @property
    def statuses(self) -> list[Status]:
        """Last report of each source on its current connection, the newest first."""
        known = sorted(self._sources.values(), key=lambda each: each.reported_at, reverse=True)
        return [each.status for each in known if each.status is not None]

    @property
    def cause(self) -> str | None:
        """Name of the active stop, or None."""
        # Each status is read once: a signal handler might close the robot between two reads.
        statuses = [known.status for known in list(self._sources.values())]
        return next((cause for status in statuses if status and (cause := status.cause)), None)

    def absence(self, now: float) -> NotRunning | None:
        """Return the error that refuses even commands that move nothing, or None."""
        return self._absence() or self._staleness(now)

    def refusal_to_continue(self) -> SafetyStop | NotRunning | None:
        """Return the error that ends a running motion because the interlock is closed, or None.

        Neither an old state nor a missing `enable()` ends a running motion.
        """
        return self._stop() or self._absence()

    def blocked(self, now: float) -> SafetyStop | NotRunning | None:
        """Return the error that blocks motion, whatever the enable policy; None if nothing blocks it."""
        return self.refusal_to_continue() or self._staleness(now)

    def refusal_to_begin(self, now: float) -> SafetyStop | NotRunning | None:
        """Return the error that refuses a new motion, or None.

        Each set-point and each statement is checked like a new motion, because each of them moves the arm.
        """
        blocked = self.blocked(now)
        if blocked is None and not self.is_enabled:
            when = "once" if self.policy == "on_startup" else "at first and after every stop"
            return NotEnabled(
                f"not enabled: with the policy {self.policy!r}, call robot.safety.enable() {when}", "not enabled"
            )
        return blocked

    @property
    def is_enabled(self) -> bool:
        """Whether motions are enabled: the policy does not require a call of `enable()` now."""
        return self.policy == "never" or (self._was_enabled if self.policy == "on_startup" else self._is_enabled)

    def _stop(self) -> SafetyStop | None:
        cause = self.cause
        if cause is None:
            return None
        explain = None if self.flight is None else self.flight.stop(cause).explain
        return SafetyStop(f"the robot is stopped: {cause}", cause, explain)

    def _absence(self) -> NotRunning | None:
        if not self._sources:
            return NotRunning("nothing was received from the robot yet; nothing was sent")
        modes: list[RobotMode | RobotModeCB2] = []
        for name, known in list(self._sources.items()):
            if known.absence is not None:
                return NotRunning(known.absence)
            status = known.status
            if status is None:
                return NotRunning(f"nothing was received on the {name} interface yet; nothing was sent")
            if status.robot_mode is not None:
                modes.append(status.robot_mode)
        if not modes:
            return NotRunning("the robot has not reported its mode yet")
        for mode in modes:
            # A running CB3 and a CB2 without power report the same number.
            if mode != (RobotModeCB2.RUNNING if isinstance(mode, RobotModeCB2) else RobotMode.RUNNING):
                return NotRunning(f"the robot is not running: its mode is {mode.name}")
        return None

    def _staleness(self, now: float) -> NotRunning | None:
        for name, known in list(self._sources.items()):
            age = now - known.reported_at
            if age > self.stale_after:
                return NotRunning(
                    f"nothing was read from the {name} interface for {age:.1f} s, so the robot's state is unknown: "
                    "either the robot is silent, or this program was delayed"
                )
        return None

    # -- enabling ------------------------------------------------------------------------------------

    def enable(self, now: float) -> None:
        """Enable motions, if nothing blocks them.

        Raises:
            SafetyStop: If a stop is active.
            NotRunning: If the robot is not running, or its state is unknown.
        """
        raise_if(self.blocked(now))
        self._was_enabled = self._is_enabled = True

    @property
    def policy(self) -> Policy:
        """Enable policy: "never", "on_startup" or "always".

        After a change, `enable()` must be called again if the new policy requires it at all.
        """
        return self._policy

    @policy.setter
    def policy(self, policy: Policy) -> None:
        if _known(policy) != self._policy:
            self._was_enabled = self._is_enabled = False
        self._policy = policy


def raise_if(error: LinkError | None) -> None:
    """Raise an error, if there is one."""
    if error is not None:
        try:
            raise error
        finally:
            del error  # breaks the reference cycle between the error and this frame


def _known(policy: Policy) -> Policy:
    if policy not in get_args(Policy):
        raise BadValue(f"unknown policy {policy!r}; expected one of {', '.join(get_args(Policy))}")
    return policy
