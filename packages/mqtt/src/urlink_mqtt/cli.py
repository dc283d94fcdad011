"""`urlink serve mqtt`."""

from __future__ import annotations

import argparse
import contextlib
import ipaddress
import os
import re
from collections.abc import Iterator, Mapping

from urlink import BadValue, Robot

from .server import PREFIX, Broker, Server

__all__ = ["add_arguments", "serve"]

#: The variable of the environment that has the password: the command line is seen by all users of a computer.
_PASSWORD = "URLINK_MQTT_PASSWORD"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of MQTT."""
    parser.description = (
        f"Serve robots over MQTT. The password of --user is in the environment: {_PASSWORD}. Whoever may publish to "
        "the broker commands the robots where --allow-commands is given."
    )
    parser.add_argument(
        "--broker",
        type=broker_address,
        default=("localhost", None),
        metavar="HOST[:PORT]",
        help="connect to the broker at HOST (default: localhost)",
    )
    parser.add_argument(
        "--port", type=int, metavar="N", help="connect to port N of the broker (default: 1883, with --tls 8883)"
    )
    parser.add_argument("--user", metavar="NAME", help="by which to log in")
    parser.add_argument("--tls", action="store_true", help="encrypted; the broker's certificate is checked")
    parser.add_argument("--ca", metavar="FILE", help="certificates by which it is checked (those of the system)")
    parser.add_argument("--prefix", default=PREFIX, metavar="TOPIC", help=f"what all topics begin with ({PREFIX})")
    parser.add_argument("--status-rate", type=float, default=5.0, metavar="HZ", help="status messages a second (5)")
    parser.add_argument("--allow-commands", action="store_true", help="take commands; without it all are refused")


def broker_address(text: str) -> tuple[str, int | None]:
    """Host and port of a broker, from ``host``, ``host:port``, ``[::1]:port`` or a bare IPv6 address.

    Raises:
        argparse.ArgumentTypeError: If it is not one of these.

    >>> broker_address("broker.local:1884"), broker_address("::1")
    (('broker.local', 1884), ('::1', None))
    """
    try:
        return str(ipaddress.ip_address(text)), None
    except ValueError:
        pass
    match = re.fullmatch(r"(?:\[([0-9A-Fa-f:.%\w]+)\]|([^\s:/@\[\]]+))(?::(\d{1,5}))?", text, re.ASCII)
    port = 1 if match is None or match[3] is None else int(match[3])
    if match is None or not 0 < port < 65536:
        raise argparse.ArgumentTypeError(f"{text!r} is not the address of a broker; expected HOST or HOST:PORT")
    return match[1] or match[2], None if match[3] is None else port


@contextlib.contextmanager
def serve(robots: Mapping[str, Robot], args: argparse.Namespace) -> Iterator[None]:
    """Serve robots as long as the context lasts.

    Raises:
        BadValue: If two ports of the broker are given.
    """
    host, port = args.broker
    if port is not None and args.port not in (None, port):
        raise BadValue(f"--broker names port {port} and --port names port {args.port}; expected one of them")
    port = args.port if port is None else port
    broker = Broker(host, port, args.user, os.environ.get(_PASSWORD), args.tls or bool(args.ca), args.ca)
    with contextlib.ExitStack() as stack:
        for name, robot in robots.items():
            stack.enter_context(
                Server(
                    robot,
                    name,
                    broker,
                    prefix=args.prefix,
                    status_rate=args.status_rate,
                    allow_commands=args.allow_commands,
                )
            )
        yield
