"""Robot Raconteur nodes, and the robots that they serve."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping
from typing import Any

import RobotRaconteur as RR
import RobotRaconteurCompanion as RRC

from urlink import BadAddress, Robot

from .service import RATE, RobotService

__all__ = ["PORT", "open_node", "register", "serve"]

#: Default TCP port.
PORT = 58651


@contextlib.contextmanager
def open_node(name: str = "urlink.robots", port: int = PORT, *, announce: bool = True) -> Iterator[tuple[Any, int]]:
    """Open a node with the standard types, which listens at a TCP port.

    The node is shut down when the context ends.

    Args:
        name: Name of the node.
        port: TCP port to listen at; 0 for a free port.
        announce: Whether to announce the node by multicast.

    Yields:
        The node and its port.

    Raises:
        BadAddress: If the port is in use.
    """
    node = RR.RobotRaconteurNode()
    node.SetNodeName(name)
    node.Init()
    transport = RR.TcpTransport(node)
    try:
        try:
            transport.StartServer(port)
        except Exception as error:  # Robot Raconteur raises no specific class
            raise BadAddress(f"port {port}: {error}") from error
        if announce:
            transport.EnableNodeAnnounce()
        node.RegisterTransport(transport)
        RRC.RegisterStdRobDefServiceTypes(node)
        yield node, int(transport.GetListenPort())
    finally:
        node.Shutdown()


def register(node: Any, name: str, robot: Robot, rate: float = RATE, watchdog: float = 0.1) -> RobotService:
    """Serve a robot in a node, under its name.

    It is served until the service is closed and the node closes it. For arguments and errors, see `RobotService`.
    """
    service = RobotService(node, name, robot, rate, watchdog)
    context = node.RegisterService(name, "com.robotraconteur.robotics.robot.Robot", service)
    context.SetServiceAttributes({"urlink.address": RR.VarValue(robot.address, "string")})
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
    """Serve robots until the context ends, each at ``rr+tcp://HOST:PORT?service=NAME``.

    Args:
        robots: Robots by name.
        name, port, announce: See `open_node`.
        rate, watchdog: See `RobotService`.

    Yields:
        The TCP port.

    Raises:
        BadAddress: If the port is in use.
        LinkError: If a robot cannot be reached.
    """
    with open_node(name, port, announce=announce) as (node, listening), contextlib.ExitStack() as stack:
        for each, robot in robots.items():
            service = register(node, each, robot, rate, watchdog)
            stack.callback(node.CloseService, each)
            stack.callback(service.close)
        yield listening
