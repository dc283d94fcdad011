"""Checks of the motion of the wrist in stage 2, from the packets of the real-time interface."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from urlink.tools import Estimate, parameters

from .arrivals import moments
from .evidence import Evidence
from .moving import FOLLOWED, SPEED, WATCHDOG, WRIST
from .obedience import HELD_UP, held_up, outcome, span, unless_held_up
from .requirements import Check, Measured, NotTried
from .swings import contradictions

#: Speed in rad/s below which the wrist is at rest.
_STANDS = 2e-3
#: Largest part of the lag, in s, that the gain of the step (300) can cause: 2 / gain, as the simulator assumes.
_OF_GAIN = 2.0 / 300.0
#: Time in s without a packet or a set-point after which a stream may have starved. The value is half of the default
#: watchdog of a stream, because delays add up.
_STARVING = 0.05


class _Moved:
    """Motion of the wrist during a step: controller's time, arrival, positions and target speeds."""

    def __init__(self, evidence: Evidence, step: str) -> None:
        begin, end = span(evidence, step)
        self.said = outcome(evidence, step)
        # A motion is aborted if this computer or the network delays its set-points. In the step `frozen`, this is
        # intended.
        self.messages = _messages(evidence, begin, end)
        gap = max(held_up(evidence, step), float(np.diff([*self.messages, end]).max()) if self.messages else 0.0)
        if self.error and step != "frozen" and gap > _STARVING:
            raise NotTried(
                f"for {gap * 1e3:.0f} ms, no data was received from the controller or sent to it; {self.error}"
            )
        packets = evidence.realtime
        there = (packets.arrived >= begin) & (packets.arrived <= end)
        q, qd = packets.column(lambda state: state.q_actual), packets.column(lambda state: state.qd_target)
        if q is None or qd is None or not there.any():
            raise NotTried("no packet of the real-time interface arrived")
        self.time, self.arrived = moments("realtime", packets)[there], packets.arrived[there]
        self.q, self.speed = q[there], np.abs(qd[there][:, WRIST])
        self.told = {note.said["event"]: note.at for note in evidence.said(step) if begin <= note.at <= end}

    @property
    def error(self) -> str:
        """Error of the step; "" if there is none."""
        return self.said.get("error") or ""

    @property
    def answered(self) -> float:
        """Number of set-points divided by the number of states in the same time; 1 if no set-points were sent."""
        if not self.messages:
            return 1.0
        there = (self.arrived >= self.messages[0]) & (self.arrived <= self.messages[-1])
        return len(self.messages) / max(int(there.sum()), 1)

    def far(self) -> float:
        """Return the largest distance of a joint from the goal at the end, in rad."""
        return float(np.abs(self.q[-1] - np.array(self.said["goal"])).max())

    def stood(self) -> tuple[float, float]:
        """Return the time until the wrist was at rest, and its time at rest, in s of the clock of the controller."""
        after = self.arrived >= self.told["told"]
        some = after & (self.arrived <= self.told.get("undone", math.inf))
        if not some.any():
            raise NotTried("no packet of the real-time interface arrived after the command")
        moving = np.flatnonzero(some & (self.speed > _STANDS))
        first = int(np.argmax(after))
        last = int(moving[-1]) if len(moving) else first
        end = int(np.flatnonzero(some)[-1])
        return float(self.time[last] - self.time[first]), float(self.time[end] - self.time[last])


def _messages(evidence: Evidence, begin: float, end: float) -> list[float]:
    """Return the times of set-points that were sent to a program, in s."""
    chunks = (at for wire in evidence.wires if wire.is_sent and wire.interface == "reverse" for at, _ in wire.chunks)
    return sorted(at.monotonic for at in chunks if begin <= at.monotonic <= end)


def _moving(evidence: Evidence) -> tuple[Mapping[str, Any], NDArray[np.float64]]:
    said = evidence.last("moving")
    if said is None or said.get("skipped"):
        raise NotTried("the stage did not begin" if said is None else said["skipped"])
    at, end = evidence.said("moving")[-1].at, evidence.stage(2)[1]
    q = evidence.realtime.between(at, end).column(lambda state: state.q_actual)
    if q is None:
        raise NotTried("no packet of the real-time interface arrived")
    return said, np.abs(q - np.array(said["start"]))


def _box(evidence: Evidence) -> Measured:
    _, away = _moving(evidence)
    guard = evidence.last("guard")
    stopped = "" if guard is None else f"; the guard has stopped the arm: {guard['why']}"
    return Measured(float(away.max()), f"{math.degrees(away.max()):.2f} degrees{stopped}")


def _others(evidence: Evidence) -> Measured:
    _, away = _moving(evidence)
    still = np.delete(away, WRIST, axis=1).max(axis=0)
    return Measured(float(still.max()), f"joint {int(still.argmax()) + 1} by {still.max() * 1e6:.0f} µrad")


def _arrives(evidence: Evidence) -> Measured:
    moved = _Moved(evidence, "move")
    if moved.error:
        return Measured(math.inf, moved.error)
    found = Measured(moved.far(), f"{moved.far() * 1e6:.0f} µrad from the goal")
    return unless_held_up(evidence, "move", found, 1e-3)


def _scales(evidence: Evidence) -> Measured:
    said, _ = _moving(evidence)
    moved = _Moved(evidence, "move")
    if moved.error:
        return Measured(math.inf, moved.error)
    wanted, most = SPEED * said["slider"], float(moved.speed.max())
    seen = f"{most:.4f} rad/s; expected {wanted:.4f} rad/s, which is {SPEED} rad/s at {said['slider']:.0%}"
    return unless_held_up(evidence, "move", Measured(abs(most / wanted - 1.0), seen), 0.1)


def _stops(step: str) -> Check:
    def check(evidence: Evidence) -> Measured:
        found = stopped(_Moved(evidence, step))
        # The step `frozen` delays this computer on purpose.
        return found if step == "frozen" else unless_held_up(evidence, step, found, 0.3)

    def stopped(moved: _Moved) -> Measured:
        if "told" not in moved.told:
            return Measured(math.inf, moved.error or "the wrist did not begin to move")
        if step not in ("starved", "frozen") and moved.error:
            return Measured(math.inf, moved.error)
        took, stood = moved.stood()
        after = ""
        if step in ("starved", "frozen"):
            took -= WATCHDOG
            after = f" after the watchdog of {WATCHDOG} s"
        if stood <= 0.1:
            return Measured(math.inf, f"the wrist still moved {took:.2f} s{after}")
        if "undone" in moved.told and moved.far() > 2e-3:
            return Measured(math.inf, f"the wrist did not continue to its goal, and is {moved.far():.4f} rad away")
        if step == "protective-stop" and not moved.said.get("ended"):
            return Measured(math.inf, "the motion did not fail with SafetyStop")
        return Measured(max(took, 0.0), f"at rest after {took * 1e3:+.0f} ms{after}")

    return check


def _follow(evidence: Evidence) -> Measured:
    worst, seen = 0.0, []
    for step in ("follow-100", "follow-50", "follow-10"):
        moved = _Moved(evidence, step)
        if moved.error:
            return Measured(math.inf, f"{step}: {moved.error}")
        going = np.flatnonzero(moved.speed > 0.02 * float(moved.speed.max()))
        took = float(moved.time[going[-1]] - moved.time[going[0]])
        wanted = FOLLOWED / moved.said["slider"]
        worst = max(worst, abs(took / wanted - 1.0))
        if abs(took / wanted - 1.0) > 0.1 and ((gap := held_up(evidence, step)) > HELD_UP or moved.answered < 0.9):
            raise NotTried(f"nothing arrived for {gap * 1e3:.0f} ms; {moved.answered:.0%} of the states were answered")
        seen.append(f"{moved.said['slider']:.0%}: {took:.2f} s of {wanted:g} s")
    return Measured(worst, ", ".join(seen))


def _lag(evidence: Evidence) -> Measured:
    moved = _Moved(evidence, "servo-lag")
    if moved.error:
        return Measured(math.inf, moved.error)
    lag = float(moved.said["lag"])
    assumed = parameters()["servoj_lag_of_lookahead", ""]
    cycle, lookahead = 1.0 / (evidence.firmware.rate if evidence.firmware is not None else 500), moved.said["lookahead"]
    # A set-point takes effect one or two cycles after it was sent. The gain adds a part that is not published.
    low, high = (lag - 2.0 * cycle - _OF_GAIN) / lookahead, (lag - cycle) / lookahead
    seen = f"{lag * 1e3:.1f} ms: {low:.2f} to {high:.2f} of the look-ahead time, the rest for cycles and the gain"
    refuted = contradictions([(assumed, Estimate(0.5 * (low + high), low, high))])
    if refuted and moved.answered < 0.9:
        raise NotTried(f"{moved.answered:.0%} of the states were answered: {seen}")
    return Measured(lag, seen, refuted)


WRIST_CHECKS: Mapping[str, Check] = {
    "box": _box,
    "other-joints": _others,
    "move-arrives": _arrives,
    "slider-scales": _scales,
    "cancel": _stops("cancel"),
    "follow-scales": _follow,
    "servo-lag": _lag,
    "pause": _stops("pause"),
    "slider-zero": _stops("slider-zero"),
    "stop": _stops("stop"),
    "starved": _stops("starved"),
    "frozen": _stops("frozen"),
    "protective-stop": _stops("protective-stop"),
}
