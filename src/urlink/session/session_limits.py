"""`SessionLimits`: limits that one program sets for all commands of its own connection, and their comparison.

The limits are compared on this computer, before a command is sent (`urlink.motion.limited`). They are not a safety
function: other clients, the pendant and the controller do not know them.
"""

from __future__ import annotations

import json
import os
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from linkcore.arguments import check_number
from linkcore.errors import BadValue

from ..arm.vectors import JOINTS, FloatArray
from ..errors import LimitExceeded

#: Kinds of motion that are predicted and compared with the limits before they are sent. They are allowed by default.
CHECKED = (
    "move_joints",
    "move_linear",
    "move_circular",
    "path",
    "speed_joints",
    "speed_linear",
    "follow",
    "servo",
    "stream",
    "jog",
    "until_contact",
)
#: Kinds of motion that depend on forces, so that they cannot be predicted. They are watched while they run.
WATCHED = ("force_mode", "impedance", "torque", "freedrive")
#: Calls whose effect is unknown to urlink. They are sent without a check if they are allowed.
UNCHECKED = ("script.run", "script.send_line", "interpreter.execute", "dashboard.play", "dashboard.send")
#: All names for `SessionLimits.allowed`.
KINDS = (*CHECKED, *WATCHED, *UNCHECKED)

#: Distance in m from the faces of the box at which a predicted position is refused. It covers the distance between two
#: samples of a predicted path, and the lag and the rounding of set-points.
MARGIN = 0.001
#: Fraction by which a predicted speed may exceed its limit, because predictions are computed from samples.
SLACK = 1e-3
#: Largest and smallest accepted speed limits: in m/s and rad/s.
_FASTEST_TOOL, _FASTEST_JOINT, _SLOWEST = 5.0, 7.0, 1e-3
#: Largest distance of a face of the box from the base, in m, and shortest edge of the box, in m.
_FURTHEST, _SHORTEST = 10.0, 0.01
#: Members of a file with limits.
_MEMBERS = ("tool_speed", "joint_speed", "box", "speed_slider", "allowed")

_Corner = tuple[float, float, float]


@dataclass(frozen=True)
class SessionLimits:
    """Limits for all commands of one connection: ``urlink.connect(address, limits=SessionLimits(...))``.

    A command that would exceed a limit raises `LimitExceeded`, and is not sent. The limits are not a safety function:
    see docs/session-limits.md.

    Attributes:
        tool_speed: Largest speed of the TCP, in m/s; None for no limit.
        joint_speed: Largest speed of each joint, in rad/s; None for no limit.
        box: Lowest and highest corner of a box in the base frame, ((x, y, z), (x, y, z)), in m. The TCP has to stay in
            this box. None for no limit.
        speed_slider: Largest fraction to which the session may set the speed slider, 0 to 1; None for no limit.
        allowed: Kinds of motion that are allowed, by the names of the methods of `robot.motion`. By default, all kinds
            that can be predicted are allowed. The watched kinds "force_mode", "impedance", "torque" and "freedrive",
            and the calls "script.run", "script.send_line", "interpreter.execute", "dashboard.play" and
            "dashboard.send" are allowed only if they are listed.

    Raises:
        BadValue: If a limit is out of range, the box is empty, or a kind does not exist.

    >>> SessionLimits(tool_speed=0.25, box=((-0.6, -0.6, 0.05), (0.6, 0.6, 0.9))).tool_speed
    0.25
    """

    tool_speed: float | None = None
    joint_speed: float | None = None
    box: tuple[_Corner, _Corner] | None = None
    speed_slider: float | None = None
    allowed: Collection[str] = CHECKED

    def __post_init__(self) -> None:
        checked: dict[str, object] = {}
        if self.tool_speed is not None:
            checked["tool_speed"] = check_number(self.tool_speed, "tool_speed", _SLOWEST, _FASTEST_TOOL, "m/s")
        if self.joint_speed is not None:
            checked["joint_speed"] = check_number(self.joint_speed, "joint_speed", _SLOWEST, _FASTEST_JOINT, "rad/s")
        if self.speed_slider is not None:
            checked["speed_slider"] = check_number(self.speed_slider, "speed_slider", 0.01, 1.0)
        if self.box is not None:
            checked["box"] = _box(self.box)
        if isinstance(self.allowed, str) or not isinstance(self.allowed, Collection):
            raise BadValue(f"allowed={self.allowed!r}; expected names of kinds, such as ('move_joints', 'jog')")
        for kind in self.allowed:
            if kind not in KINDS:
                raise BadValue(f"allowed contains {kind!r}; expected some of {', '.join(KINDS)}")
        checked["allowed"] = frozenset(self.allowed)
        vars(self).update(checked)  # bypasses the frozen dataclass

    @classmethod
    def teaching(cls, box: tuple[Sequence[float], Sequence[float]] | None = None) -> SessionLimits:
        """Return limits for a teaching lab: slow motions of every predictable kind, and freedrive, but no programs.

        The tool moves at up to 0.25 m/s, which is the reduced speed of ISO 10218-1 for manual operation. Each joint
        turns at up to 1.05 rad/s, the default of `move_joints`. The speed slider is at most 0.5.

        Args:
            box: Box of the TCP; None for no box, because a safe box depends on the cell.

        Raises:
            BadValue: If the box is invalid.
        """
        corners: Any = box
        return cls(tool_speed=0.25, joint_speed=1.05, box=corners, speed_slider=0.5, allowed=(*CHECKED, "freedrive"))

    @classmethod
    def named(cls, text: str) -> SessionLimits:
        """Return the limits for an option of a program: "teaching" for `teaching`, or the path of a file for `load`.

        Raises:
            BadValue: See `load`.
        """
        return cls.teaching() if text == "teaching" else cls.load(text)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> SessionLimits:
        """Read limits from a JSON file: an object with the attributes of this class, all of them optional.

        Raises:
            BadValue: If the file cannot be read, has unknown members, or contains an invalid limit.
        """
        try:
            content = json.loads(Path(path).read_text(encoding="utf-8"))
        except OSError as error:
            raise BadValue(f"cannot read {path}: {error.strerror or error}") from error
        except ValueError as error:
            raise BadValue(f"{path} is not a JSON file: {error}") from None
        if not isinstance(content, dict) or (unknown := content.keys() - set(_MEMBERS)):
            found = "no object" if not isinstance(content, dict) else ", ".join(sorted(unknown))
            raise BadValue(f"{path} contains {found}; expected an object with {', '.join(_MEMBERS)}")
        try:
            return cls(**content)
        except BadValue as error:
            raise BadValue(f"{path}: {error}") from None

    # -- comparisons -----------------------------------------------------------------------------------

    def allow(self, kind: str) -> None:
        """Raise `LimitExceeded` if a kind of command is not allowed. A stop is always allowed."""
        if kind != "stop" and kind not in self.allowed:
            kinds = ", ".join(each for each in KINDS if each in self.allowed) or "no commands"
            raise LimitExceeded("allowed", f"{kind} is not allowed in this session", f"one of: {kinds}")

    def check_slider(self, fraction: float) -> None:
        """Raise `LimitExceeded` if the session may not set the speed slider to this fraction."""
        if self.speed_slider is not None and fraction > self.speed_slider:
            raise LimitExceeded(
                "speed_slider", f"the speed slider would be at {fraction:g}", f"at most {self.speed_slider:g}"
            )

    def check_joint_speeds(self, qd: FloatArray) -> None:
        """Raise `LimitExceeded` if a joint is too fast in one of the rows of `qd`, (n, 6) rad/s."""
        if self.joint_speed is None or not len(qd):
            return
        fastest = np.abs(qd).max(axis=0)
        joint = int(fastest.argmax())
        # The negated comparison is also true for NaN.
        if not fastest[joint] <= self.joint_speed * (1.0 + SLACK):
            raise LimitExceeded(
                "joint_speed",
                f"{JOINTS[joint]} (joint {joint}) would turn at {fastest[joint]:.4g} rad/s",
                f"at most {self.joint_speed:g} rad/s",
            )

    def check_tool_speeds(self, speeds: FloatArray) -> None:
        """Raise `LimitExceeded` if the tool is too fast at one of the `speeds`, (n,) m/s."""
        if self.tool_speed is None or not len(speeds):
            return
        fastest = float(speeds.max())
        if not fastest <= self.tool_speed * (1.0 + SLACK):
            raise LimitExceeded(
                "tool_speed", f"the tool would move at {fastest:.4g} m/s", f"at most {self.tool_speed:g} m/s"
            )

    def check_places(self, places: FloatArray, margin: float = MARGIN) -> None:
        """Raise `LimitExceeded` if the TCP is outside of the box in one of the `places`, (n, 3) m."""
        if self.box is None or not len(places):
            return
        low, high = np.array(self.box)
        beyond = np.maximum(low + margin - places, places - high + margin)
        if not beyond.max() <= 0.0:
            row, axis = np.unravel_index(int(beyond.argmax()), beyond.shape)
            part = "" if len(places) == 1 else f" at {row / (len(places) - 1):.0%} of its path"
            raise LimitExceeded(
                "box",
                f"the tool would be at {'xyz'[axis]} = {places[row, axis]:.4f} m{part}",
                f"{low[axis]:g} to {high[axis]:g} m, with a margin of {margin * 1e3:g} mm",
            )


def _box(box: Any) -> tuple[_Corner, _Corner]:
    try:
        low, high = ([float(each) for each in corner] for corner in box)
        if len(low) != 3 or len(high) != 3:
            raise ValueError
    except (TypeError, ValueError):
        raise BadValue(f"box={box!r}; expected its lowest and highest corner, ((x, y, z), (x, y, z)), in m") from None
    for name, least, most in zip("xyz", low, high, strict=True):
        for value in (least, most):
            check_number(value, f"{name} of the box", -_FURTHEST, _FURTHEST, "m")
        if most - least < _SHORTEST:
            raise BadValue(
                f"the box reaches from {least:g} to {most:g} m along {name}; expected the lowest corner first, and at "
                f"least {_SHORTEST:g} m between both"
            )
    return (low[0], low[1], low[2]), (high[0], high[1], high[2])
