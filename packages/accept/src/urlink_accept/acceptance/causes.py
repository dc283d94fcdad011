"""Likely cause of the requirements that are not held, for the top of the page.

One defect of a controller can break many requirements. A requirement comes first in the order if the defect that
breaks it can also break other requirements.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .report import Verdict

#: Requirements, sorted so that the most likely cause comes first, and the beginning of the sentence for each on the
#: page.
_ORDER: Mapping[str, str] = {
    "ports": "An interface cannot be reached",
    "connects-back": "The controller cannot connect back to this computer",
    "primary-bytes": "The primary interface sends bytes that do not decode",
    "secondary-bytes": "The secondary interface sends bytes that do not decode",
    "realtime-bytes": "The real-time interface sends bytes that do not decode",
    "realtime-size": "The real-time interface sends packets of another size",
    "state-size": "The robot state has another layout",
    "rtde-bytes": "RTDE sends bytes that do not decode",
    "rtde-protocol": "RTDE does not work",
    "clock-forward": "The controller's time stands still or goes back",
    "reconnect": "The first state of a new connection is old",
    "values-live": "A measurement is frozen",
    "values-possible": "A field has an impossible value",
    "fields-agree": "Two interfaces differ",
    "kinematics": "Positions and the pose of the tool do not belong together",
    "velocities": "A velocity is not the derivative of its position",
    "tcp-speed": "The speed of the TCP is wrong",
    "accelerometer": "The accelerometer is wrong",
    "gravity": "The target moments are wrong",
    "currents": "The currents are wrong",
    "weight": "The force is wrong",
    "swing-force": "The force is in a wrong frame, or the payload is set wrongly",
    "flags": "A flag contradicts its mode",
    "modes-known": "A mode is unknown",
    "stop-at-rest": "A stop is not shown everywhere",
    "power-off": "The power is shown wrongly",
    "outputs": "A digital output is shown wrongly",
    "inputs": "A digital input is shown wrongly",
    "dashboard-words": "The dashboard gives an unknown answer",
    "dashboard-modes": "The dashboard contradicts the robot state",
    "slider-echo": "The reported speed slider is not the one that was set",
    "slider-scales": "The speed slider does not scale motions as reported",
    "texts": "Messages of programs are lost",
    "latency": "Programs start late, or their messages are lost",
    "program-state": "The running program is shown wrongly",
    "stop-program": "A program is shown as running after it was stopped",
    "realtime-rate": "The rate of the real-time interface is wrong",
    "rtde-rate": "The rate of RTDE is wrong",
    "primary-rate": "The rate of the primary interface is wrong",
    "realtime-missed": "Packets of the real-time interface are lost",
    "rtde-fresh": "RTDE is late",
    "primary-fresh": "The primary interface is late",
    "realtime-jitter": "Packets of the real-time interface arrive in bursts or unevenly",
    "rtde-jitter": "Packets of RTDE arrive in bursts or unevenly",
}
#: Fields with joint positions, and requirements about them. If one of these requirements shows that the positions are
#: wrong, the arm must not move.
_POSITIONS = ("q_actual", "q_target", "actual_q", "target_q")
_ABOUT_POSITIONS = frozenset({"tracking", "kinematics", "realtime-bytes", "realtime-size", "clock-forward"})
_MOST = 3


def likely_causes(verdicts: Sequence[Verdict]) -> list[str]:
    """Return the likely causes, at most three, the most likely one first."""
    broken = {each.requirement.name: each for each in verdicts if each.state == "not held"}
    order = [*(name for name in _ORDER if name in broken), *(name for name in broken if name not in _ORDER)]
    found = []
    for name in order[:_MOST]:
        begin = _ORDER.get(name, broken[name].requirement.what.capitalize())
        found.append(f"{begin}: {broken[name].seen} ({name}).")
    return found


def refuted_positions(verdicts: Sequence[Verdict]) -> str:
    """Return the reason why the joint positions cannot be trusted; "" if there is none."""
    for each in verdicts:
        if each.state != "not held":
            continue
        # Search for the whole name of a field, not for the end of another name, such as tcp_force_q_actual.
        names = any(re.search(rf"(?<!\w){name}(?!\w)", each.seen) for name in _POSITIONS)
        if each.requirement.name in _ABOUT_POSITIONS or (
            names and each.requirement.name in ("fields-agree", "values-possible", "values-live", "velocities")
        ):
            return f"{each.requirement.name} is NOT HELD: {each.seen}"
    return ""
