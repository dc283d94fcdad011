"""Stage 0: what a controller says while it is only listened to and asked."""

from __future__ import annotations

import time

from linkcore.errors import LinkError
from linkcore.net.dialogue import Dialogue
from linkcore.net.http_client import HttpClient
from linkcore.net.transport import TcpTransport

from ..address import RobotAddress
from ..interfaces.dashboard.commands import COMMANDS
from ..interfaces.dashboard.protocol import DashboardProtocol
from ..interfaces.dashboard.robot_api import RobotApi, find
from ..robot import Robot
from ..rtde import OUTPUTS
from .agreement import RTDE_NAMES
from .logbook import Logbook

#: What the dashboard is not asked: it ends the connection, and it would show which arm this is.
_NOT_ASKED = ("quit", "get serial number")
_TIMEOUT = 5.0
#: s between two looks at the clock.
_STEP = 0.01


def listen(robot: Robot, place: RobotAddress, book: Logbook, seconds: float) -> None:
    """Listen to every interface for a time, and ask what changes nothing.

    Args:
        robot: connected within the logbook.
        place: of its ports.
        book: in which it is written down.
        seconds: to listen.
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
    """Wait in short steps; the most by which this thread was woken late, s."""
    until, worst = time.monotonic() + seconds, 0.0
    while (left := until - time.monotonic()) > 0.0:
        due = time.monotonic() + min(left, _STEP)
        time.sleep(min(left, _STEP))
        worst = max(worst, time.monotonic() - due)
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
        assert recipe is not None, "a connection that has been made has its recipe"
        book.note("rtde-names", missing=missing, names=recipe.names, types=recipe.types)
        book.note("rtde", error=None, protocol=1 if recipe.number is None else 2)
    except LinkError as error:
        book.note("rtde-names", missing=(), names=(), types=())
        book.note("rtde", error=str(error), protocol=None)


def _ask(robot: Robot, place: RobotAddress, book: Logbook) -> None:
    """Every question of the dashboard that this firmware has, or as many of them as the Robot API answers."""
    firmware = robot.firmware
    interface = "robot_api" if firmware.is_polyscope_x else "dashboard"
    if interface not in place.ports:
        return
    dialogue = Dialogue(
        TcpTransport(place.host, place.ports[interface], silence=_TIMEOUT), DashboardProtocol, interface, _TIMEOUT
    )
    api = RobotApi(HttpClient(place.host, place.ports[interface]), _TIMEOUT)
    try:
        for command in COMMANDS.values():
            is_there = find(command.name, firmware) if firmware.is_polyscope_x else command.is_on(firmware)
            if not command.only_asks or command.name in _NOT_ASKED or not is_there:
                continue
            reply, problem = "", None
            try:
                if firmware.is_polyscope_x:
                    reply = api.do(command.name, None, firmware)
                else:
                    reply = dialogue.ask(command.name, _TIMEOUT)
            except LinkError as error:
                problem = str(error)
            book.note("dashboard", asked=command.name, reply=reply, error=problem)
    finally:
        dialogue.close()
