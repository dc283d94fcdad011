"""`urlink serve mqtt`."""

from __future__ import annotations

import argparse
import contextlib
import os
from collections.abc import Iterator, Mapping

from urlink import Robot

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
    parser.add_argument("--broker", default="localhost", metavar="HOST", help="of the broker (localhost)")
    parser.add_argument("--port", type=int, metavar="N", help="of the broker (1883, with --tls 8883)")
    parser.add_argument("--user", metavar="NAME", help="by which to log in")
    parser.add_argument("--tls", action="store_true", help="encrypted; the broker's certificate is checked")
    parser.add_argument("--ca", metavar="FILE", help="certificates by which it is checked (those of the system)")
    parser.add_argument("--prefix", default=PREFIX, metavar="TOPIC", help=f"what all topics begin with ({PREFIX})")
    parser.add_argument("--status-rate", type=float, default=5.0, metavar="HZ", help="status messages a second (5)")
    parser.add_argument("--allow-commands", action="store_true", help="take commands; without it all are refused")


@contextlib.contextmanager
def serve(robots: Mapping[str, Robot], args: argparse.Namespace) -> Iterator[None]:
    """Serve them as long as the context lasts."""
    broker = Broker(args.broker, args.port, args.user, os.environ.get(_PASSWORD), args.tls or bool(args.ca), args.ca)
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
