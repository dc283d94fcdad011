"""Checks of the reactions of a controller to commands: settings, programs, claims, connections."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from urlink.packets import ProgramState, TextMessage
from urlink.tools import NO_TIMESTAMP

from .evidence import Evidence
from .requirements import Check, Measured, NotTried, counted
from .standing import BEGIN, END, SLEEP, Told

#: Silence of the real-time interface, in s, above which times are not judged. A time up to the second value, in s, is
#: accepted in spite of such a silence.
HELD_UP, _QUICK = 0.1, 0.05
#: Length in s of the time before a step that the step is compared with, and fraction of missing packets that hides
#: other losses.
_BEFORE, _MISSING = 1.0, 0.05


def span(evidence: Evidence, step: str) -> tuple[float, float]:
    """Return the monotonic start and end times of a step, in s.

    Raises:
        NotTried: If the step was not tried.
    """
    notes = evidence.said(step)
    begins = [note.at for note in notes if note.said.get("event") == "begin"]
    if not begins:
        raise NotTried("the stage ended before this step")
    return begins[-1], notes[-1].at


def held_up(evidence: Evidence, step: str) -> float:
    """Return the longest silence of the real-time interface during a step, in s. A silence explains late results."""
    begin, end = span(evidence, step)
    arrived = evidence.realtime.arrived
    # The time from the last packet to the end of the step also counts as a silence.
    return float(np.diff([begin, *arrived[(arrived >= begin) & (arrived <= end)], end]).max())


def unless_held_up(evidence: Evidence, step: str, found: Measured, most: float) -> Measured:
    """Return the result of a step, unless a delay explains it.

    Raises:
        NotTried: If the result is more than `most`, and this computer or the network was delayed during the step.
    """
    if found.value > most and (silent := held_up(evidence, step)) > HELD_UP:
        raise NotTried(f"for {silent * 1e3:.0f} ms nothing arrived from the controller; {found.seen}")
    return found


def outcome(evidence: Evidence, step: str) -> Told:
    """Return the note at the end of a step.

    Raises:
        NotTried: If the step was not tried, or was interrupted.
    """
    span(evidence, step)
    said = evidence.said(step)[-1].said
    if said.get("event") != "end":
        raise NotTried("the step was interrupted")
    if said.get("skipped"):
        raise NotTried(said["skipped"])
    return said


def _of(step: str, judged: Callable[[Evidence, Told], Measured], *, is_timed: bool = False) -> Check:
    """Return a check of the result of a step.

    Args:
        step: Name of the step.
        judged: Function that converts the note of the step to a measurement.
        is_timed: Whether the check judges a duration. A duration has no meaning if this computer was delayed.
    """

    def check(evidence: Evidence) -> Measured:
        said = outcome(evidence, step)
        if said.get("error"):
            return Measured(math.inf, said["error"])
        found = judged(evidence, said)
        return unless_held_up(evidence, step, found, _QUICK) if is_timed else found

    return check


def _echo(what: str) -> Callable[[Evidence, Told], Measured]:
    def judged(evidence: Evidence, said: Told) -> Measured:
        apart = float(np.abs(np.subtract(said["shown"], said["wanted"])).max())
        return Measured(apart, f"{what}: {_short(said['shown'])} after {_short(said['wanted'])} was set")

    return judged


def _short(value: Any) -> str:
    return str(np.round(value, 6).tolist())


def _registers(evidence: Evidence, said: Told) -> Measured:
    if said["wrong"]:
        return Measured(math.inf, f"{said['register']} did not show {'; '.join(said['wrong'][:3])}")
    least, most = min(said["delays"]), max(said["delays"])
    seen = f"{said['register']}: {least * 1e3:.1f} to {most * 1e3:.1f} ms from writing to reading"
    return Measured(least, seen)


def _claims(evidence: Evidence, said: Told) -> Measured:
    if not said["refused"]:
        return Measured(math.inf, f"{said['register']} was given to a second client while a first client held it")
    if said["freed"] is None:
        return Measured(math.inf, f"{said['register']} was still in use after its client had disconnected")
    held = f"; in use by others: {', '.join(said['held'][:6])}" if said["held"] else "; no input is in use by others"
    return Measured(said["freed"], f"refused while in use, free {said['freed'] * 1e3:.0f} ms after{held}")


def _compile_error(evidence: Evidence, said: Told) -> Measured:
    if not said["told"]:
        return Measured(math.inf, f"no error of a program that cannot be compiled within {said['took']:.1f} s")
    return Measured(said["took"], said["told"])


def _texts_between(evidence: Evidence, step: str) -> list[tuple[float, str, float | None]]:
    begin, end = span(evidence, step)
    return [
        (at, packet.text, None if packet.timestamp == NO_TIMESTAMP else packet.timestamp / 1e6)
        for at, packet in evidence.primary.others
        if isinstance(packet, TextMessage) and begin <= at <= end + 0.5
    ]


def _texts(evidence: Evidence, said: Told) -> Measured:
    expected = [f"{BEGIN} sleep", f"{END} sleep"]
    wrong = [] if said["texts"] == expected else [f"{said['texts']}; expected {expected}"]
    return counted(wrong, "both lines of textmsg arrived, in their order")


def _sleep(evidence: Evidence, said: Told) -> Measured:
    times = {text: (at, stamp) for at, text, stamp in _texts_between(evidence, "sleep")}
    begin, end = f"{BEGIN} sleep", f"{END} sleep"
    if begin not in times or end not in times:
        return Measured(math.inf, "the program did not report when it began and ended")
    (a, first), (b, last) = times[begin], times[end]
    if first is not None and last is not None and last > first:
        took = last - first
        return Measured(abs(took - SLEEP), f"{took:.3f} s by the controller's clock, {b - a:.3f} s here")
    return Measured(abs(b - a - SLEEP), f"{b - a:.3f} s by the clock of this computer")


def _program_state(evidence: Evidence, said: Told) -> Measured:
    begin, end = span(evidence, "sleep")
    modes = [state.robot_mode_data for state in evidence.primary.between(begin, end + 0.5).states]
    shown = [mode for mode in modes if mode is not None and mode.is_program_running]
    wrong = [] if shown else ["no robot state showed that the program ran"]
    states = evidence.realtime.column(lambda state: state.program_state)
    if states is not None:
        during = states[(evidence.realtime.arrived >= begin) & (evidence.realtime.arrived <= end)]
        if not np.any(during == ProgramState.PLAYING):
            wrong.append("program_state of the real-time interface never was PLAYING")
    return counted(wrong, f"shown by {len(shown)} robot states")


def _stop(evidence: Evidence, said: Told) -> Measured:
    if said["took"] is None:
        return Measured(math.inf, "the program still ran after it was stopped")
    return Measured(said["took"], f"{said['took'] * 1e3:.0f} ms from cancel() to a state without a program")


def _reset(evidence: Evidence, said: Told) -> Measured:
    wrong = []
    if not said["began"]:
        wrong.append("the program did not begin")
    elif not said["ended"]:
        wrong.append("the program ended with the connection that had sent it")
    return counted(wrong, f"the program continued; connected again within {said['again'] * 1e3:.0f} ms")


def _silent(evidence: Evidence, said: Told) -> Measured:
    begin, end = span(evidence, "silent-client")
    if evidence.firmware is None:
        raise NotTried("the controller does not report its firmware")
    rate, arrived = evidence.firmware.rate, evidence.realtime.arrived

    def missing(begin: float, end: float) -> tuple[float, str]:
        # Count by the clock of this computer, because packets that wait until the other client reads are late too.
        count, expected = int(np.sum((arrived >= begin) & (arrived < end))), (end - begin) * rate
        return max(1.0 - count / expected, 0.0), f"{count} of {expected:.0f} packets arrived"

    # Packets that were already missing before are not a result of the other client.
    (before, usual), (during, seen) = missing(begin - _BEFORE, begin), missing(begin, end)
    lost = max(during - before, 0.0)
    seen = f"{seen} while another client did not read, and {usual} in the second before"
    if before > _MISSING >= lost:
        raise NotTried(f"packets were already missing without this client: {seen}")
    then = f"the controller closed its connection: {said['closed']}" if said["closed"] else "it could continue to read"
    return Measured(lost, f"{seen}; {then}")


def _local(evidence: Evidence, said: Told) -> Measured:
    if not said["refused"]:
        return Measured(1.0, "a program ran in local control")
    ran = any(text == f"{BEGIN} local" for _, text, _ in _texts_between(evidence, "local"))
    wrong = ["the program sent a text after it was refused"] if ran else []
    return counted(wrong, f"refused: {said['refused']}")


def _stands(evidence: Evidence) -> Measured:
    q = evidence.realtime.between(*evidence.stage(1)).column(lambda state: state.q_actual)
    if q is None:
        raise NotTried("no packet of the real-time interface arrived")
    moved = np.ptp(q, axis=0)
    return Measured(float(moved.max()), f"joint {int(moved.argmax()) + 1} by {moved.max() * 1e6:.0f} µrad")


OBEDIENCE: Mapping[str, Check] = {
    "slider-echo": _of("slider-echo", _echo("the speed slider")),
    "tcp-echo": _of("tcp-echo", _echo("the TCP")),
    "payload-echo": _of("payload-echo", _echo("the payload")),
    "register-echo": _of("register-echo", _registers, is_timed=True),
    "claims": _of("claims", _claims, is_timed=True),
    "compile-error": _of("compile-error", _compile_error, is_timed=True),
    "texts": _of("sleep", _texts),
    "sleep": _of("sleep", _sleep),
    "program-state": _of("sleep", _program_state),
    "stop-program": _of("stop-program", _stop, is_timed=True),
    "reset": _of("reset", _reset),
    "silent-client": _of("silent-client", _silent),
    "local": _of("local", _local),
    "stands": _stands,
}
