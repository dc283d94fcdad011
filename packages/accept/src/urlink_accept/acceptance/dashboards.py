"""Queries to the dashboard server, or to the Robot API of PolyScope X."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from urlink import LinkError, Robot
from urlink.tools import (
    COMMANDS,
    DashboardProtocol,
    Dialogue,
    HttpClient,
    RobotAddress,
    RobotApi,
    TcpTransport,
    find,
)

_TIMEOUT = 5.0


def answers(robot: Robot, place: RobotAddress, names: Iterable[str]) -> Iterator[tuple[str, str, str | None]]:
    """Send the queries that this firmware has; yield each name, the reply ("" if there is none) and the error."""
    firmware = robot.firmware
    interface = "robot_api" if firmware.is_polyscope_x else "dashboard"
    if interface not in place.ports:
        return
    transport = TcpTransport(place.host, place.ports[interface], silence=_TIMEOUT)
    dialogue = Dialogue(transport, DashboardProtocol, interface, _TIMEOUT)
    api = RobotApi(HttpClient(place.host, place.ports[interface]), _TIMEOUT)
    try:
        for name in names:
            if not (find(name, firmware) if firmware.is_polyscope_x else COMMANDS[name].is_on(firmware)):
                continue
            try:
                reply = api.do(name, None, firmware) if firmware.is_polyscope_x else dialogue.ask(name, _TIMEOUT)
            except LinkError as error:
                yield name, "", str(error)
            else:
                yield name, reply, None
    finally:
        dialogue.close()
