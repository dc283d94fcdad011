"""Command line of `urlink serve rr`."""

from __future__ import annotations

import argparse
import contextlib
import sys
from collections.abc import Iterator, Mapping

from urlink import Robot

from .node import PORT
from .node import serve as serve_robots
from .service import RATE

__all__ = ["add_arguments", "serve"]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the Robot Raconteur node."""
    parser.description = "Serve robots over Robot Raconteur, each as com.robotraconteur.robotics.robot.Robot."
    parser.add_argument(
        "--port", type=int, default=PORT, metavar="N", help=f"TCP port; 0 for a free port (default: {PORT})"
    )
    parser.add_argument(
        "--node-name", default="urlink.robots", metavar="NAME", help="name of the node (default: urlink.robots)"
    )
    parser.add_argument(
        "--rate", type=float, default=RATE, metavar="HZ", help=f"maximum states per second (default: {RATE:g})"
    )
    parser.add_argument("--no-announce", action="store_true", help="do not announce the node by multicast")


@contextlib.contextmanager
def serve(robots: Mapping[str, Robot], args: argparse.Namespace) -> Iterator[None]:
    """Serve the robots until the context ends."""
    with serve_robots(
        robots,
        name=args.node_name,
        port=args.port,
        announce=not args.no_announce,
        rate=args.rate,
        watchdog=args.watchdog,
    ) as port:
        for name in robots:
            print(f"urlink: rr+tcp://localhost:{port}?service={name}", file=sys.stderr)
        yield
