"""Command line of `urlink serve zenoh`."""

from __future__ import annotations

import argparse
import contextlib
from collections.abc import Iterator, Mapping
from typing import get_args

from urlink import Robot

from .keys import PREFIX
from .server import Server
from .session import Mode, open_session

__all__ = ["add_arguments", "serve"]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the Zenoh session and of publishing."""
    parser.description = (
        "Serve robots over Zenoh. Without an endpoint, programs find each other by multicast; "
        "in a fleet, connect each program to a router."
    )
    parser.add_argument(
        "--connect",
        action="append",
        default=[],
        metavar="ENDPOINT",
        help="connect to this router or peer, e.g. tcp/fleet.local:7447",
    )
    parser.add_argument(
        "--listen",
        action="append",
        default=[],
        metavar="ENDPOINT",
        help="listen at this endpoint, e.g. tcp/0.0.0.0:7447",
    )
    parser.add_argument(
        "--mode", choices=get_args(Mode), help="mode of the session (default: client with --connect, else peer)"
    )
    parser.add_argument("--config", metavar="FILE", help="read the configuration of Zenoh from this file")
    parser.add_argument("--prefix", default=PREFIX, metavar="KEY", help=f"first part of all keys (default: {PREFIX})")
    parser.add_argument("--rate", type=float, metavar="HZ", help="maximum real-time packets per second (default: all)")
    parser.add_argument(
        "--status-rate", type=float, default=10.0, metavar="HZ", help="status messages per second (default: 10)"
    )


@contextlib.contextmanager
def serve(robots: Mapping[str, Robot], args: argparse.Namespace) -> Iterator[None]:
    """Serve the robots until the context ends."""
    session = open_session(args.connect, args.listen, mode=args.mode, config=args.config)
    options = {"prefix": args.prefix, "rate": args.rate, "status_rate": args.status_rate, "watchdog": args.watchdog}
    with session, Server(session, robots, **options):
        yield
