"""Nodes of Robot Raconteur, and robots in them."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping
from typing import Any

import RobotRaconteur as RR
import RobotRaconteurCompanion as RRC

from urlink import BadAddress, Robot

from .service import RATE, RobotService

__all__ = ["PORT", "open_node", "register", "serve"]

#: The TCP port, where no other is chosen.
PORT = 58651


@contextlib.contextmanager
def open_node(name: str = "urlink.robots", port: int = PORT, *, announce: bool = True) -> Iterator[tuple[Any, int]]:
    """A node that listens at a TCP port, with the standard types; it is shut down when the context ends.

    Args:
        name: of the node.
        port: to listen at; 0 for a free one.
        announce: let others find it by multicast.

    Yields:
        the node, and its port.

    Raises:
        BadAddress: the port is taken.
    """
    node = RR.RobotRaconteurNode()
    node.SetNodeName(name)
    node.Init()
    transport = RR.TcpTransport(node)
    try:
        try:
            transport.StartServer(port)
        except Exception as error:  # it raises no class of its own
            raise BadAddress(f"port {port}: {error}") from error
        if announce:
            transport.EnableNodeAnnounce()
        node.RegisterTransport(transport)
        RRC.RegisterStdRobDefServiceTypes(node)
        yield node, int(transport.GetListenPort())
    finally:
        node.Shutdown()


def register(node: Any, name: str, robot: Robot, rate: float = RATE, watchdog: float = 0.1) -> RobotService:
    """Serve a robot in a node, under its name, until the service is closed and the node closes it.

    Args and errors: see `RobotService`.
    """
    service = RobotService(node, name, robot, rate, watchdog)
    context = node.RegisterService(name, "com.robotraconteur.robotics.robot.Robot", service)
    context.SetServiceAttributes({"urlink.session.address": RR.VarValue(robot.address, "string")})
    return service


@contextlib.contextmanager
def serve(
    robots: Mapping[str, Robot],
    *,
    name: str = "urlink.robots",
    port: int = PORT,
    announce: bool = True,
    rate: float = RATE,
    watchdog: float = 0.1,
) -> Iterator[int]:
    """Serve robots, by name, as long as the context lasts: ``rr+tcp://HOST:PORT?service=NAME``.

    Args:
        robots: name -> robot.
        name, port, announce: see `open_node`.
        rate, watchdog: see `RobotService`.

    Yields:
        the TCP port.

    Raises:
        BadAddress: the port is taken.
        LinkError: a robot cannot be reached.
    """
    with open_node(name, port, announce=announce) as (node, listening), contextlib.ExitStack() as stack:
        for each, robot in robots.items():
            service = register(node, each, robot, rate, watchdog)
            stack.callback(node.CloseService, each)
            stack.callback(service.close)
        yield listening
