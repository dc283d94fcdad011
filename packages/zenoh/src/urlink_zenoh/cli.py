"""`urlink serve zenoh`."""

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
    """The options of Zenoh, and of what is published."""
    parser.description = (
        "Serve robots over Zenoh. Without an endpoint, others are found by multicast; "
        "in a fleet, let each connect to a router."
    )
    parser.add_argument(
        "--connect", action="append", default=[], metavar="ENDPOINT", help="router or peer: tcp/fleet.local:7447"
    )
    parser.add_argument("--listen", action="append", default=[], metavar="ENDPOINT", help="listen at: tcp/0.0.0.0:7447")
    parser.add_argument("--mode", choices=get_args(Mode), help="of the session (client with --connect, else peer)")
    parser.add_argument("--config", metavar="FILE", help="configuration of Zenoh")
    parser.add_argument("--prefix", default=PREFIX, metavar="KEY", help=f"what all keys begin with ({PREFIX})")
    parser.add_argument("--rate", type=float, metavar="HZ", help="real-time packets a second at most (all)")
    parser.add_argument("--status-rate", type=float, default=10.0, metavar="HZ", help="status messages a second (10)")


@contextlib.contextmanager
def serve(robots: Mapping[str, Robot], args: argparse.Namespace) -> Iterator[None]:
    """Serve them as long as the context lasts."""
    session = open_session(args.connect, args.listen, mode=args.mode, config=args.config)
    options = {"prefix": args.prefix, "rate": args.rate, "status_rate": args.status_rate, "watchdog": args.watchdog}
    with session, Server(session, robots, **options):
        yield
