"""`urlink serve`: serves robots to a middleware, with adapters from separate packages."""

from __future__ import annotations

import argparse
import contextlib
import re
import threading
from collections.abc import Iterable, Mapping
from typing import Protocol, get_args

from linkcore.cli.options import DURATION, argument, command, seconds
from linkcore.cli.progress import ProgressBar
from linkcore.cli.terminal import Interruption
from linkcore.errors import BadAddress, LocalError
from linkcore.names import plugins

from ..robot import Robot
from ..session.address import RobotAddress, SimulatorAddress, parse_address
from ..session.connect_options import Policy
from .options import CONNECT_TIMEOUT, LIMITS, connected, tell

#: Group of entry points for the adapters of installed distributions.
GROUP = "urlink.serve"

#: Distribution of each adapter of this project, and a short description of the adapter.
_DISTRIBUTIONS = {
    "zenoh": ("urlink-zenoh", "a fleet over Zenoh: states as streams, commands as queries"),
    "rr": ("urlink-rr", "a Robot Raconteur robot service"),
    "ros2": ("urlink-ros2", "a ROS 2 node with topics, services and FollowJointTrajectory"),
    "mqtt": ("urlink-mqtt", "an MQTT broker: status as retained JSON, and commands if allowed"),
    "opcua": ("urlink-opcua", "an OPC UA server: state and registers as variables, methods for programs"),
    "mcp": ("urlink-mcp", "an MCP server for agents: state and stops explained, and motions that a person allows"),
    "prometheus": ("urlink-prometheus", "metrics at an HTTP port: streams, safety, temperatures, programs"),
}


#: Pattern of NAME=ADDRESS, with a name that every middleware accepts for a topic, a key or a node.
_NAME = re.compile(r"([A-Za-z][A-Za-z0-9_]*)=(.+)", re.DOTALL)


class Adapter(Protocol):
    """Interface that every entry point of the group `urlink.serve` must have: a module or another object."""

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Declare the options of this adapter."""

    def serve(self, robots: Mapping[str, Robot], args: argparse.Namespace) -> contextlib.AbstractContextManager[object]:
        """Serve the robots under their names while the context is open. Do not close the robots.

        If the context returns a `threading.Event`, `urlink serve` ends when the event is set. If the options contain
        `points`, the robots are connected with this file of points.
        """


#: Options of every adapter: the robots, and the connection to them.
_OPTIONS = (
    argument(
        "addresses",
        metavar="[NAME=]ADDRESS",
        nargs="+",
        help="address and name of a robot; without NAME, the name is derived from the address",
    ),
    CONNECT_TIMEOUT,
    LIMITS,
    argument("--read-only", action="store_true", help="serve only states, and accept no commands"),
    argument(
        "--require-enable",
        choices=get_args(Policy),
        default="never",
        help="when a person must enable motions: on_startup, or always (also after each stop; default: never)",
    ),
    argument(
        "--watchdog",
        type=seconds,
        default=0.1,
        metavar="S",
        help="brake during a trajectory after S seconds without a set-point, 0.01 to 10 (default: 0.1)",
    ),
    DURATION,
)


@command(
    "serve",
    "serve robots to a middleware",
    argument("kind", metavar="KIND", nargs="?", help="middleware; without it, list all"),
    argument("rest", metavar="[NAME=]ADDRESS ...", nargs=argparse.REMAINDER, help="robots, and options of the adapter"),
)
def run(args: argparse.Namespace) -> int:
    """Serve robots to a middleware. Each adapter is a separate package, so that this package needs no middleware.
    Without KIND, all adapters are listed. The list shows which of them are installed.

    Options after KIND are for the adapter and the connection: `urlink serve KIND --help` lists them. Motions that a
    client requests pass the same interlock as motions of a local program, and end when the client disconnects.

    examples:
      urlink serve
      urlink serve zenoh 192.168.56.101
      urlink serve zenoh left=192.168.56.101 right=192.168.56.102 --connect tcp/fleet.local:7447
      urlink serve -v ros2 arm=sim://ur5e
    """
    installed = plugins(GROUP)
    if args.kind is None:
        print("\n".join(_listed(installed)))
        return 0
    if args.kind not in installed:
        raise LocalError(_missing(args.kind, installed))
    adapter: Adapter = installed[args.kind].load()
    parser = argparse.ArgumentParser(prog=f"urlink serve {args.kind}")
    for row in _OPTIONS:
        row(parser)
    adapter.add_arguments(parser)
    options = parser.parse_args(args.rest, argparse.Namespace(quiet=args.quiet))
    try:
        addresses = named(options.addresses)
    except BadAddress as error:
        parser.error(str(error))
    with Interruption() as interruption, contextlib.ExitStack() as stack:
        robots = {
            name: stack.enter_context(
                connected(
                    options,
                    address,
                    read_only=options.read_only,
                    require_enable=options.require_enable,
                    points=getattr(options, "points", None),
                )
            )
            for name, address in addresses.items()
        }
        with ProgressBar(f"starting {args.kind}", args.quiet):
            ended = stack.enter_context(adapter.serve(robots, options))
        interruption.end_after(options.duration)
        for name, robot in robots.items():
            tell(f"{name}: {robot.model or 'an arm'}, firmware {robot.firmware}, at {robot.address}")
        print(f"serving {', '.join(robots)} over {args.kind}; Ctrl-C ends it", flush=True)
        while not interruption.wait(0.2) and not (isinstance(ended, threading.Event) and ended.is_set()):
            pass
    return interruption.status


def named(texts: Iterable[str]) -> dict[str, str]:
    """Return a dict of names and addresses. An address without a name is named after its host, model or file.

    Raises:
        BadAddress: If a text is not an address, or two robots have the same name.

    >>> named(["left=10.0.0.7", "10.0.0.8", "sim://ur5e?firmware=5.11"])
    {'left': '10.0.0.7', 'ur_10_0_0_8': '10.0.0.8', 'sim_ur5e': 'sim://ur5e?firmware=5.11'}
    """
    found: dict[str, str] = {}
    for text in texts:
        match = _NAME.fullmatch(text)
        name, address = match.groups() if match else ("", text)
        place = parse_address(address)
        if not name:
            if isinstance(place, RobotAddress):
                name = f"ur_{place.host}"
            elif isinstance(place, SimulatorAddress):
                name = "_".join(filter(None, ("sim", place.model)))
            else:
                name = f"run_{place.path.stem}"
            name = re.sub(r"[^A-Za-z0-9]+", "_", name).strip("_")
        if name in found:
            raise BadAddress(f"{found[name]} and {address} have the same name {name}; give a name with NAME={address}")
        found[name] = address
    return found


def _listed(installed: Iterable[str]) -> list[str]:
    lines = [
        f"{name:10} {summary} ({'installed' if name in installed else f'pip install {distribution}'})"
        for name, (distribution, summary) in _DISTRIBUTIONS.items()
    ]
    return lines + [f"{name:10} (installed)" for name in sorted(set(installed) - _DISTRIBUTIONS.keys())]


def _missing(kind: str, installed: Iterable[str]) -> str:
    if kind in _DISTRIBUTIONS:
        return f"no adapter for {kind} is installed; run pip install {_DISTRIBUTIONS[kind][0]}"
    there = ", ".join(sorted({*installed, *_DISTRIBUTIONS}))
    return f"no adapter for {kind!r} is installed; expected one of {there} (`urlink serve` lists them)"
