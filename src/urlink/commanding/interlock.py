"""The decision whether the arm may be moved, without any input or output of its own.

What each stop means is the vendor's; that only NORMAL and REDUCED let an arm be moved is this library's choice: in
RECOVERY an arm is to be led out of a place it may not be in, slowly and by a person at the pendant, and of the
safety modes that no list names nothing is known.
"""

from __future__ import annotations

from typing import Literal, NamedTuple, get_args

from linkcore.errors import BadValue, LinkError

from ..errors import NotEnabled, NotRunning, SafetyStop
from ..interfaces.enums import MasterSafetyState, RobotMode, RobotModeCB2, SafetyMode

__all__ = ["STALE", "Gate", "Policy", "Status"]

#: Whether a person has to call `enable()`: never; once; at first and after every stop.
Policy = Literal["never", "on_startup", "always"]

#: Seconds after which what was heard last is no longer believed.
STALE = 1.0

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
    """What one source says of the robot; None and False where it says nothing."""

    robot_mode: RobotMode | RobotModeCB2 | None = None
    safety_mode: SafetyMode | None = None
    is_emergency_stopped: bool = False
    is_protective_stopped: bool = False
    master_safety_state: MasterSafetyState | None = None

    @property
    def cause(self) -> str | None:
        """The stop that it tells of, in words, or None."""
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

    @property
    def is_running(self) -> bool:
        """It says that the robot runs, or says nothing of it."""
        mode = self.robot_mode
        # As numbers, a running CB3 and a CB2 without power are the same.
        return mode is None or mode == (RobotModeCB2.RUNNING if isinstance(mode, RobotModeCB2) else RobotMode.RUNNING)


class _Source:
    def __init__(self) -> None:
        self.status: Status | None = None
        self.heard = self.lost_at = float("-inf")
        self.lost: str | None = None


class Gate:
    """Open or closed, from what the sources say and from the policy.

    Every source has to be connected, fresh and clear. A stop that any of them tells of closes the gate, and so do a
    robot mode that is not running, a lost connection, and silence: it may have been stopped meanwhile.

    Args:
        policy: "never", "on_startup" or "always".
    """

    def __init__(self, policy: Policy = "never") -> None:
        self.policy = policy
        self._sources: dict[str, _Source] = {}
        self._was_clear = False
        self._started = False  # enabled at least once
        self._armed = False  # enabled since it was closed last

    # -- what is heard ---------------------------------------------------------------------------

    def expect(self, source: str) -> None:
        """From now on this source has to be heard too."""
        self._sources.setdefault(source, _Source())

    def forget(self, source: str) -> None:
        """This source need not be heard after all."""
        self._sources.pop(source, None)

    def hear(self, source: str, status: Status, at: float) -> LinkError | None:
        """A source said something at the time `at`. The error that ends all motions, if that has closed the gate."""
        heard = self._sources.setdefault(source, _Source())
        if at > heard.lost_at:  # else it waited in a queue while its connection was lost
            heard.status, heard.heard, heard.lost = status, at, None
        return self._look(at)

    def lose(self, source: str, why: str, at: float) -> LinkError | None:
        """The connection of a source was lost. The error that ends all motions, if that has closed the gate."""
        heard = self._sources.setdefault(source, _Source())
        back = heard.heard > at, heard.status
        heard.status, heard.lost, heard.lost_at = None, why, at
        closed = self._look(at)
        if back[0]:  # news of the loss came after what was heard on the next connection
            heard.status, heard.lost = back[1], None
            self._look(at)
        return closed

    def look(self, now: float) -> LinkError | None:
        """Time has passed. The error that ends all motions, if the silence has closed the gate."""
        return self._look(now)

    def _look(self, now: float) -> LinkError | None:
        hindrance = self.hindrance(now)
        was_clear, self._was_clear = self._was_clear, hindrance is None
        if hindrance is not None:
            self._armed = False
            if was_clear:
                return hindrance
        return None

    # -- what follows from it ----------------------------------------------------------------------

    def has_word(self, source: str) -> bool:
        """The source has said something, or its connection is lost."""
        heard = self._sources.get(source)
        return heard is not None and (heard.status is not None or heard.lost is not None)

    def has_heard_since(self, since: float) -> bool:
        """Every source has said something after that time."""
        return all(heard.heard > since for heard in self._sources.values())

    def status(self, source: str) -> Status | None:
        """What a source said last on its present connection."""
        heard = self._sources.get(source)
        return None if heard is None else heard.status

    @property
    def statuses(self) -> list[Status]:
        """What each source said last on its present connection, the newest first."""
        heard = sorted(self._sources.values(), key=lambda each: each.heard, reverse=True)
        return [each.status for each in heard if each.status is not None]

    @property
    def cause(self) -> str | None:
        """The stop that holds, in words, or None."""
        return next((cause for heard in self._sources.values() if heard.status and (cause := heard.status.cause)), None)

    def absence(self, now: float) -> NotRunning | None:
        """Why even what moves nothing cannot be sent, or None."""
        if not self._sources:
            return NotRunning("nothing has been heard of the robot yet; nothing was sent")
        for name, heard in self._sources.items():
            if heard.lost is not None:
                return NotRunning(
                    f"the connection to the {name} interface is lost, so nothing is known of the robot: {heard.lost}"
                )
            if heard.status is None:
                return NotRunning(f"nothing has been heard on the {name} interface yet; nothing was sent")
            if now - heard.heard > STALE:
                return NotRunning(
                    f"nothing has been heard on the {name} interface for {now - heard.heard:.1f} s, "
                    "so nothing is known of the robot"
                )
        for heard in self._sources.values():
            if heard.status is not None and not heard.status.is_running:
                mode = heard.status.robot_mode
                return NotRunning(f"the robot does not run: its mode is {'unknown' if mode is None else mode.name}")
        if all(heard.status is None or heard.status.robot_mode is None for heard in self._sources.values()):
            return NotRunning("the robot has not said its mode")
        return None

    def hindrance(self, now: float) -> SafetyStop | NotRunning | None:
        """What keeps the arm from being moved, whether enabled or not; None if all is clear."""
        cause = self.cause
        if cause is not None:
            return SafetyStop(f"the robot is stopped: {cause}", cause)
        return self.absence(now)

    @property
    def is_enabled(self) -> bool:
        """The policy asks for no `enable()` now."""
        return self.policy == "never" or (self._started if self.policy == "on_startup" else self._armed)

    def refusal(self, now: float) -> SafetyStop | NotRunning | None:
        """Why the arm may not be moved; None if it may."""
        hindrance = self.hindrance(now)
        if hindrance is None and not self.is_enabled:
            when = "once" if self.policy == "on_startup" else "at first and after every stop"
            return NotEnabled(
                f"not enabled: with the policy {self.policy!r}, call robot.safety.enable() {when}", "not enabled"
            )
        return hindrance

    # -- what a person does --------------------------------------------------------------------------

    def enable(self, now: float) -> None:
        """Open the gate, if all is clear.

        Raises:
            SafetyStop: a stop holds.
            NotRunning: the robot does not run, or nothing is known of it.
        """
        self._look(now)
        hindrance = self.hindrance(now)
        if hindrance is not None:
            raise hindrance
        self._started = self._armed = True

    @property
    def policy(self) -> Policy:
        """Whether a person has to enable: "never", "on_startup" or "always"."""
        return self._policy

    @policy.setter
    def policy(self, policy: Policy) -> None:
        if policy not in get_args(Policy):
            raise BadValue(f"{policy!r} is no policy; expected one of {', '.join(get_args(Policy))}")
        self._policy: Policy = policy
