"""Checks of what was answered: the names of RTDE, the words of the dashboard or the Robot API."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from linkcore.errors import PacketError

from ..interfaces.dashboard.commands import COMMANDS
from ..interfaces.dashboard.protocol import parse_robot_mode, parse_safety_mode, parse_truth
from ..interfaces.rtde.packets import StartReply
from ..rtde import OUTPUTS
from .evidence import Evidence
from .requirements import Check, Measured, NotTried, counted

#: What backs a release in the table of variables, where a controller that lacks one contradicts it.
_BACKED = ("vendor", "drivers")


def _names(evidence: Evidence) -> Measured:
    firmware, said = evidence.firmware, evidence.last("rtde-names")
    if firmware is None or said is None:
        raise NotTried("this firmware has no RTDE, or it was not asked")
    missing = set(said["missing"])
    lacking = [OUTPUTS[name] for name in OUTPUTS if name in missing and OUTPUTS[name].is_in(firmware)]
    wrong = [f"{each.name} is not there" for each in lacking if each.evidence in _BACKED]
    guessed = [each.name for each in lacking if each.evidence not in _BACKED]
    more = [name for name, v in OUTPUTS.items() if name not in missing and not v.is_in(firmware)]
    for name, type in zip(said["names"], said["types"], strict=True):
        if name in OUTPUTS and type != OUTPUTS[name].type:
            wrong.append(f"{name} is of the type {type}; expected {OUTPUTS[name].type}")
    seen = f"{len(OUTPUTS) - len(missing)} of {len(OUTPUTS)} outputs are there"
    seen += f"; there sooner than was known: {', '.join(more)}" if more else ""
    seen += f"; not there, of which nobody knew: {', '.join(guessed)}" if guessed else ""
    return counted(wrong, seen)


def _protocol(evidence: Evidence) -> Measured:
    if evidence.last("rtde-names") is None:
        raise NotTried("this firmware has no RTDE, or it was not asked")
    error = (evidence.last("rtde") or {}).get("error")
    if error:
        return Measured(1.0, str(error))
    others = [packet for _, packet in evidence.rtde.others]
    wrong = [str(packet) for packet in others if isinstance(packet, Exception)]
    wrong += ["the start was refused" for packet in others if isinstance(packet, StartReply) and not packet.accepted]
    if (evidence.last("rtde") or {}).get("protocol") == 1:
        wrong.append("protocol 2 was refused")
    if not evidence.rtde.states:
        wrong.append("no data package came")
    return counted(wrong, f"protocol 2, {len(evidence.rtde.states)} data packages")


def _words(evidence: Evidence) -> Measured:
    asked = evidence.said("dashboard")
    if not asked:
        raise NotTried("this firmware has no dashboard, or it was not asked")
    wrong = []
    for _, _, said in asked:
        name, reply, error = said["asked"], said["reply"], said["error"]
        if error:
            wrong.append(f"{name}: {error}")
        elif name in COMMANDS and COMMANDS[name].match(reply) is None:
            wrong.append(f"{name}: {reply[:80]!r}")
    return counted(wrong, f"{len(asked)} questions were answered as expected")


def _dashboard_modes(evidence: Evidence) -> Measured:
    answers = {said["asked"]: said["reply"] for _, _, said in evidence.said("dashboard") if not said["error"]}
    # Later stages run programs.
    states = evidence.primary.states[: np.searchsorted(evidence.primary.arrivals, evidence.stage(0)[1])]
    if not answers or not states or evidence.firmware is None:
        raise NotTried("there is no dashboard, or no robot state")
    modes, board = states[-1].robot_mode_data, states[-1].masterboard_data
    wrong, tried = [], []
    for name, reply in answers.items():
        try:
            if name == "robotmode":
                there, here = parse_robot_mode(reply, evidence.firmware.is_cb2).name, modes.robot_mode.name
            elif name == "safetymode" and board.safety_mode is not None:
                there, here = parse_safety_mode(name, reply).name, board.safety_mode.name
            elif name == "running":
                there, here = str(parse_truth(name, reply)), str(modes.is_program_running)
            else:
                continue
        except PacketError as error:
            wrong.append(f"{name}: {error}")
            continue
        tried.append(name)
        if there != here:
            wrong.append(f"{name}: {there} by the dashboard, and {here} by the robot state")
    if not tried and not wrong:
        raise NotTried("the dashboard names no mode")
    return counted(wrong, f"the same: {', '.join(tried)}")


ANSWERS: Mapping[str, Check] = {
    "rtde-names": _names,
    "rtde-protocol": _protocol,
    "dashboard-words": _words,
    "dashboard-modes": _dashboard_modes,
}
