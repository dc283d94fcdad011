"""Command line of `urlink serve mqtt`."""

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

#: Environment variable with the password. The command line is not used, because all users of a computer can see it.
_PASSWORD = "URLINK_MQTT_PASSWORD"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the broker and of serving."""
    parser.description = (
        f"Serve robots over MQTT. The environment variable {_PASSWORD} holds the password of --user. With "
        "--allow-commands, anyone who may publish to the broker can command the robots."
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
    parser.add_argument("--user", metavar="NAME", help="log in with this user name")
    parser.add_argument("--tls", action="store_true", help="encrypt, and check the certificate of the broker")
    parser.add_argument(
        "--ca", metavar="FILE", help="certificates for this check (default: the certificates of the system)"
    )
    parser.add_argument(
        "--prefix", default=PREFIX, metavar="TOPIC", help=f"first part of all topics (default: {PREFIX})"
    )
    parser.add_argument(
        "--status-rate", type=float, default=5.0, metavar="HZ", help="status messages per second (default: 5)"
    )
    parser.add_argument("--allow-commands", action="store_true", help="accept commands (default: refuse all commands)")


def broker_address(text: str) -> tuple[str, int | None]:
    """Parse a broker's address: ``host``, ``host:port``, ``[::1]:port`` or an IPv6 address.

    Raises:
        argparse.ArgumentTypeError: If `text` has another form.

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
    """Serve the robots until the context ends.

    Raises:
        BadValue: If two different ports of the broker are given.
    """
    host, port = args.broker
    if port is not None and args.port not in (None, port):
        raise BadValue(f"--broker names port {port} and --port names port {args.port}; give only one of them")
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
