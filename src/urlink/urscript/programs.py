"""The programs of one command, as text: the lines within their ``def``, for the firmware that is to run them."""

from __future__ import annotations

import re
from collections.abc import Sequence

from ..firmware import Firmware
from .text import number, pose, quoted, vector

_SEGMENT = "urlink: segment "


def move_joints(
    q: Sequence[float], speed: float, acceleration: float, time: float | None = None, blend: float = 0.0
) -> list[str]:
    """Move the joints to `q` (6, rad), at most so fast (rad/s, rad/s²), or in `time` seconds."""
    return [f"movej({vector(q, what='q')}, {_how(speed, acceleration, time, blend)})"]


def move_linear(
    target: Sequence[float], speed: float, acceleration: float, time: float | None = None, blend: float = 0.0
) -> list[str]:
    """Move the tool in a straight line to a pose (m, rad), at most so fast (m/s, m/s²), or in `time` seconds."""
    return [f"movel({pose(target)}, {_how(speed, acceleration, time, blend)})"]


def move_circular(
    via: Sequence[float], to: Sequence[float], speed: float, acceleration: float, blend: float = 0.0
) -> list[str]:
    """Move the tool along the circle through one pose to another (m, rad), at most so fast (m/s, m/s²)."""
    return [f"movec({pose(via, 'via')}, {pose(to, 'to')}, {_how(speed, acceleration, None, blend)})"]


def _how(speed: float, acceleration: float, time: float | None, blend: float) -> str:
    figures = f"a={number(acceleration, 'acceleration')}, v={number(speed, 'speed')}"
    if time is not None:
        figures += f", t={number(time, 'time')}"
    return f"{figures}, r={number(blend, 'blend')}" if blend else figures


def segment(index: int) -> str:
    """The `textmsg` before movement `index` of a path; after a blend it is executed as the blend begins.

    A `textmsg` takes no time. That it does not end a blend, as no statement does that takes none, is how the vendor's
    own programs look, which set outputs between blended waypoints.
    """
    return f"textmsg({quoted(f'{_SEGMENT}{index}')})"


def segment_of(text: str) -> int | None:
    """Which movement a line of text announces; None if it is another text."""
    found = re.fullmatch(rf"{_SEGMENT}(\d{{1,4}})", text)
    return int(found[1]) if found else None


def speed_joints(firmware: Firmware, qd: Sequence[float], acceleration: float, duration: float) -> list[str]:
    """Turn the joints at `qd` (6, rad/s) for `duration` seconds, then brake."""
    return _speed(firmware, "speedj", vector(qd, what="qd"), acceleration, duration, "stopj")


def speed_linear(firmware: Firmware, xd: Sequence[float], acceleration: float, duration: float) -> list[str]:
    """Move the tool at `xd` (6, m/s and rad/s) for `duration` seconds, then brake."""
    return _speed(firmware, "speedl", vector(xd, what="xd"), acceleration, duration, "stopl")


def _speed(
    firmware: Firmware, function: str, speeds: str, acceleration: float, duration: float, brake: str
) -> list[str]:
    a, t = number(acceleration, "acceleration"), number(duration, "duration")
    timed = [f"{function}({speeds}, {a}, {t})"]
    untimed = [f"{function}({speeds}, {a})", f"sleep({t})"]
    return [*(timed if takes_duration(firmware) else untimed), f"{brake}({a})"]


def takes_duration(firmware: Firmware) -> bool:
    """Whether ``speedj`` and ``speedl`` take a time.

    In 3.1 and 3.2 they do not: they return once the speed is reached, and keep it (docs/protocols/urscript.md,
    Differences).
    """
    return not (3, 1) <= firmware[:2] < (3, 3)


def interpreter_mode() -> list[str]:
    """Take statements of clients until one of them ends it."""
    return ["interpreter_mode()"]


def stop(acceleration: float) -> list[str]:
    """Brake all joints with so many rad/s²."""
    return [f"stopj({number(acceleration, 'acceleration')})"]
