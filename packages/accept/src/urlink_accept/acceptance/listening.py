"""Stage 0: listen to a controller, send only queries, and check the answers of the controller.

The answers are the variables of RTDE, and the replies of the dashboard or the Robot API.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from linkcore import clock
from urlink import LinkError, PacketError, Robot
from urlink.rtde import OUTPUTS
from urlink.tools import (
    COMMANDS,
    RobotAddress,
    StartReply,
    TcpTransport,
    parse_robot_mode,
    parse_safety_mode,
    parse_truth,
)

from .agreement import RTDE_NAMES
from .dashboards import answers
from .evidence import Evidence
from .logbook import Logbook
from .requirements import Check, Measured, NotTried, counted

#: Queries that are not sent to the dashboard: one ends the connection, the other would identify the arm.
_NOT_ASKED = ("quit", "get serial number")
_TIMEOUT = 5.0
#: Interval between checks of the clock, in s.
_STEP = 0.01
#: Kinds of evidence for the first release of a variable. With such evidence, a controller without the variable is
#: wrong. With other evidence, the table of variables might be wrong.
_BACKED = ("vendor", "drivers")


def listen(robot: Robot, place: RobotAddress, book: Logbook, seconds: float) -> None:
    """Listen to every interface for a time, and send queries that change nothing.

    Args:
        robot: Robot that was connected while the logbook was open.
        place: Address with its ports.
        book: Logbook to write to.
        seconds: Time to listen, in s.
    """
    _connect_to_each(robot, place, book)
    for name in ("realtime", "primary", "secondary"):
        try:
            getattr(robot, name).start()
        except LinkError as error:
            book.note("stream", name=name, error=str(error))
    if _has_rtde(robot):
        _start_rtde(robot, book)
    _ask(robot, place, book)
    book.note("listening")
    book.note("woken", worst=_wait(seconds))


def _wait(seconds: float) -> float:
    """Wait in short steps; return the largest wake-up delay of this thread, in s."""
    until, worst = clock.now() + seconds, 0.0
    while (left := until - clock.now()) > 0.0:
        due = clock.now() + min(left, _STEP)
        clock.sleep(min(left, _STEP))
        worst = max(worst, clock.now() - due)
    return worst


def _has_rtde(robot: Robot) -> bool:
    return OUTPUTS["timestamp"].is_in(robot.firmware)


def _connect_to_each(robot: Robot, place: RobotAddress, book: Logbook) -> None:
    names = ["primary", "secondary", "realtime"] + (["rtde"] if _has_rtde(robot) else [])
    names += ["robot_api" if robot.firmware.is_polyscope_x else "dashboard"]
    for name in names:
        if name not in place.ports or (name == "robot_api" and robot.firmware < (10, 11)):
            continue
        transport = TcpTransport(place.host, place.ports[name], silence=_TIMEOUT)
        error = None
        try:
            transport.open(_TIMEOUT)
        except LinkError as failure:
            error = str(failure)
        finally:
            transport.abort()
        book.note("port", name=name, error=error)


def _start_rtde(robot: Robot, book: Logbook) -> None:
    try:
        missing = robot.rtde.missing()
        stream = robot.rtde.outputs(*RTDE_NAMES, missing="leave_out")
        stream.start()
        recipe = stream.recipe
        assert recipe is not None, "an established connection has its recipe"
        book.note("rtde-names", missing=missing, names=recipe.names, types=recipe.types)
        book.note("rtde", error=None, protocol=1 if recipe.number is None else 2)
    except LinkError as error:
        book.note("rtde-names", missing=(), names=(), types=())
        book.note("rtde", error=str(error), protocol=None)


def _ask(robot: Robot, place: RobotAddress, book: Logbook) -> None:
    """Send every query of the dashboard that this firmware has, or that the Robot API can answer."""
    names = [each.name for each in COMMANDS.values() if each.only_asks and each.name not in _NOT_ASKED]
    for asked, reply, error in answers(robot, place, names):
        book.note("dashboard", asked=asked, reply=reply, error=error)


# -- checks ----------------------------------------------------------------------------------------


def _names(evidence: Evidence) -> Measured:
    firmware, said = evidence.firmware, evidence.last("rtde-names")
    if firmware is None or said is None:
        raise NotTried("this firmware has no RTDE, or RTDE was not queried")
    missing = set(said["missing"])
    lacking = [OUTPUTS[name] for name in OUTPUTS if name in missing and OUTPUTS[name].is_in(firmware)]
    wrong = [f"{each.name} is missing" for each in lacking if each.evidence in _BACKED]
    guessed = [each.name for each in lacking if each.evidence not in _BACKED]
    more = [name for name, v in OUTPUTS.items() if name not in missing and not v.is_in(firmware)]
    for name, type in zip(said["names"], said["types"], strict=True):
        if name in OUTPUTS and type != OUTPUTS[name].type:
            wrong.append(f"{name} has the type {type}; expected {OUTPUTS[name].type}")
    seen = f"{len(OUTPUTS) - len(missing)} of {len(OUTPUTS)} outputs exist"
    seen += f"; earlier than known: {', '.join(more)}" if more else ""
    seen += f"; missing, with unknown release: {', '.join(guessed)}" if guessed else ""
    return counted(wrong, seen)


def _protocol(evidence: Evidence) -> Measured:
    said = evidence.last("rtde")
    if said is None:
        raise NotTried("this firmware has no RTDE, or RTDE was not queried")
    if said["error"]:
        return Measured(1.0, said["error"])
    others = [packet for _, packet in evidence.rtde.others]
    wrong = [str(packet) for packet in others if isinstance(packet, Exception)]
    wrong += ["the start was refused" for packet in others if isinstance(packet, StartReply) and not packet.accepted]
    if said["protocol"] == 1:
        wrong.append("protocol 2 was refused")
    if not evidence.rtde.states:
        wrong.append("no data package arrived")
    return counted(wrong, f"protocol 2, {len(evidence.rtde.states)} data packages")


def _words(evidence: Evidence) -> Measured:
    asked = evidence.said("dashboard")
    if not asked:
        raise NotTried("this firmware has no dashboard, or it was not queried")
    wrong = []
    for _, _, said in asked:
        name, reply, error = said["asked"], said["reply"], said["error"]
        if error:
            wrong.append(f"{name}: {error}")
        elif name in COMMANDS and COMMANDS[name].match(reply) is None:
            wrong.append(f"{name}: {reply[:80]!r}")
    return counted(wrong, f"{len(asked)} queries were answered as expected")


def _dashboard_modes(evidence: Evidence) -> Measured:
    answers = {said["asked"]: said["reply"] for _, _, said in evidence.said("dashboard") if not said["error"]}
    # Use only states of stage 0, because later stages run programs.
    states = evidence.primary.between(-math.inf, evidence.stage(0)[1]).states
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
            wrong.append(f"{name}: {there} according to the dashboard, but {here} according to the robot state")
    if not tried and not wrong:
        raise NotTried("the dashboard reports no mode")
    return counted(wrong, f"the same: {', '.join(tried)}")


ANSWERS: Mapping[str, Check] = {
    "rtde-names": _names,
    "rtde-protocol": _protocol,
    "dashboard-words": _words,
    "dashboard-modes": _dashboard_modes,
}
