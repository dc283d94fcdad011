"""The interlock, sans-IO: decides whether the arm may be moved.

The vendor defines each safety mode. That only NORMAL and REDUCED allow motions is this library's choice: in RECOVERY a
person moves the arm slowly, at the pendant, out of a place where it may not be, and about safety modes that are in no
list nothing is known.
"""

from __future__ import annotations

from typing import NamedTuple, get_args

from linkcore.errors import BadValue, LinkError

from ..errors import NotEnabled, NotRunning, SafetyStop
from ..protocol.enums import MasterSafetyState, RobotMode, RobotModeCB2, SafetyMode
from ..session.connect_options import STALE_AFTER, Policy

_MAY_MOVE = (SafetyMode.NORMAL, SafetyMode.REDUCED)
_CB2_STOPS = {
    RobotModeCB2.SECURITY_STOPPED: "protective stop",
    RobotModeCB2.EMERGENCY_STOPPED: "emergency stop",
    RobotModeCB2.FATAL_ERROR: "fatal error",
    RobotModeCB2.SAFEGUARD_STOP: "safeguard stop",
}
# What a masterboard says while it boots, and the undefined state, are left to the robot mode.
_MASTER_STOPS = {
    MasterSafetyState.FAULT: "fault",
    MasterSafetyState.ROBOT_EMERGENCY_STOP: "emergency stop",
    MasterSafetyState.EXTERNAL_EMERGENCY_STOP: "external emergency stop",
    MasterSafetyState.SAFEGUARD_STOP: "safeguard stop",
}


class Status(NamedTuple):
    """The robot's condition as one interface reports it; None where it does not report it."""

    robot_mode: RobotMode | RobotModeCB2 | None = None
    safety_mode: SafetyMode | None = None
    is_emergency_stopped: bool | None = None
    is_protective_stopped: bool | None = None
    master_safety_state: MasterSafetyState | None = None

    def over(self, before: Status | None) -> Status:
        """What is known after this: what it leaves out is as it was `before` on the same connection."""
        if before is None:
            return self
        return Status._make(old if new is None else new for new, old in zip(self, before, strict=True))

    @property
    def cause(self) -> str | None:
        """The stop that it reports, as text, or None."""
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
        #: why it reports nothing: its connection was lost, or the robot is silent
        self.absence: str | None = None


class Interlock:
    """Open or closed, from what the sources say and from the policy.

    Every source (primary and real-time interface) has to be connected, fresh and without a stop. A stop that any of
    them reports closes the interlock, and so do a robot mode other than running, a lost connection, and silence: the
    robot may have been stopped meanwhile.

    An old state permits nothing, whatever made it old. Where this process was held up and has states to read, new
    motions are refused until they are read; running motions go on, since only `fall_silent` reports that the robot
    itself is silent.

    Args:
        policy: "never", "on_startup" or "always".
        stale_after: seconds after which the last state is too old to permit a motion.

    Attributes:
        stale_after: the same.
    """

    def __init__(self, policy: Policy = "never", stale_after: float = STALE_AFTER) -> None:
        self.stale_after = stale_after
        self._sources: dict[str, _Source] = {}
        self._was_clear = False
        self._was_enabled = False  # at least once since the policy was set
        self._is_enabled = False  # since it was closed last
        self._policy = _known(policy)

    # -- what is received -----------------------------------------------------------------------

    def expect(self, source: str) -> None:
        """From now on this source has to report too."""
        self._sources.setdefault(source, _Source())

    def forget(self, source: str) -> None:
        """This source need not report after all."""
        self._sources.pop(source, None)
        self._look()

    def report(self, source: str, status: Status, at: float) -> LinkError | None:
        """A source reported something at the time `at`. The error that ends all motions, if that has closed it."""
        known = self._sources.setdefault(source, _Source())
        known.status, known.reported_at, known.absence = status.over(known.status), at, None
        return self._look()

    def amend(self, source: str, status: Status, at: float) -> LinkError | None:
        """As `report`, of what is only a part of its report: without effect before the whole has been received."""
        known = self._sources.get(source)
        return None if known is None or known.status is None else self.report(source, status, at)

    def lose(self, source: str, why: str) -> LinkError | None:
        """The connection of a source was lost. The error that ends all motions, if that has closed it."""
        known = self._sources.setdefault(source, _Source())
        known.status = None
        known.absence = f"the connection to the {source} interface is lost, so nothing is known of the robot: {why}"
        return self._look()

    def fall_silent(self, source: str, seconds: float) -> LinkError | None:
        """The robot has sent nothing for so many seconds, although its source was listened to.

        The error that ends all motions, if that has closed the interlock.
        """
        known = self._sources.get(source)
        if known is not None and known.absence is None:
            known.absence = (
                f"the robot has said nothing on the {source} interface for {seconds:.1f} s, so nothing is known of it"
            )
        return self._look()

    def _look(self) -> LinkError | None:
        refusal = self.refusal_to_continue()
        was_clear, self._was_clear = self._was_clear, refusal is None
        if refusal is not None:
            self._is_enabled = False
            if was_clear:
                return refusal
        return None

    # -- what follows from it ----------------------------------------------------------------------

    def is_expected(self, source: str) -> bool:
        """The source has to report, or has reported already."""
        return source in self._sources

    def has_reported(self, source: str) -> bool:
        """The source has reported, or its connection is lost."""
        known = self._sources.get(source)
        return known is not None and (known.status is not None or known.absence is not None)

    def has_reported_since(self, since: float) -> bool:
        """Every source has reported after that time, and there is one."""
        return bool(self._sources) and all(known.reported_at > since for known in list(self._sources.values()))

    @property
    def statuses(self) -> list[Status]:
        """What each source reported last on its present connection, the newest first."""
        known = sorted(self._sources.values(), key=lambda each: each.reported_at, reverse=True)
        return [each.status for each in known if each.status is not None]

    @property
    def cause(self) -> str | None:
        """The stop that holds, as text, or None."""
        # Each status is read once: a signal handler may close the robot between two reads.
        statuses = [known.status for known in list(self._sources.values())]
        return next((cause for status in statuses if status and (cause := status.cause)), None)

    def absence(self, now: float) -> NotRunning | None:
        """Why even what moves nothing cannot be sent, or None."""
        return self._absence() or self._staleness(now)

    def refusal_to_continue(self) -> SafetyStop | NotRunning | None:
        """Why a running motion may not continue: what has closed the interlock; None if the motion may continue.

        Neither an old state nor a missing `enable` ends a running motion.
        """
        return self._stop() or self._absence()

    def blocked(self, now: float) -> SafetyStop | NotRunning | None:
        """What keeps the arm from being moved, whether enabled or not; None if all is clear."""
        return self.refusal_to_continue() or self._staleness(now)

    def refusal_to_begin(self, now: float) -> SafetyStop | NotRunning | None:
        """Why no new motion may begin; None if one may.

        Each set-point and each statement is asked about like a new motion, because each of them moves the arm.
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
        """The policy asks for no `enable()` now."""
        return self.policy == "never" or (self._was_enabled if self.policy == "on_startup" else self._is_enabled)

    def _stop(self) -> SafetyStop | None:
        cause = self.cause
        return None if cause is None else SafetyStop(f"the robot is stopped: {cause}", cause)

    def _absence(self) -> NotRunning | None:
        if not self._sources:
            return NotRunning("nothing has been received from the robot yet; nothing was sent")
        modes: list[RobotMode | RobotModeCB2] = []
        for name, known in list(self._sources.items()):
            if known.absence is not None:
                return NotRunning(known.absence)
            status = known.status
            if status is None:
                return NotRunning(f"nothing has been received on the {name} interface yet; nothing was sent")
            if status.robot_mode is not None:
                modes.append(status.robot_mode)
        if not modes:
            return NotRunning("the robot has not said its mode")
        for mode in modes:
            # As numbers, a running CB3 and a CB2 without power are the same.
            if mode != (RobotModeCB2.RUNNING if isinstance(mode, RobotModeCB2) else RobotMode.RUNNING):
                return NotRunning(f"the robot does not run: its mode is {mode.name}")
        return None

    def _staleness(self, now: float) -> NotRunning | None:
        for name, known in list(self._sources.items()):
            age = now - known.reported_at
            if age > self.stale_after:
                return NotRunning(
                    f"nothing has been read from the {name} interface for {age:.1f} s, so nothing is known of the "
                    "robot: either it is silent, or this program is held up"
                )
        return None

    # -- what a person does --------------------------------------------------------------------------

    def enable(self, now: float) -> None:
        """Open it, if all is clear.

        Raises:
            SafetyStop: a stop holds.
            NotRunning: the robot does not run, or nothing is known of it.
        """
        raise_if(self.blocked(now))
        self._was_enabled = self._is_enabled = True

    @property
    def policy(self) -> Policy:
        """Whether a person has to enable: "never", "on_startup" or "always".

        A change asks for `enable()` anew, where the new policy asks for it at all.
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
            del error  # it refers to this frame


def _known(policy: Policy) -> Policy:
    if policy not in get_args(Policy):
        raise BadValue(f"{policy!r} is no policy; expected one of {', '.join(get_args(Policy))}")
    return policy
