"""Command line of `urlink serve prometheus`."""

from __future__ import annotations

import argparse
import contextlib
from collections.abc import Iterator, Mapping

from urlink import Robot

from .metrics import RobotCollector
from .server import HOST, PORT, serve_metrics

__all__ = ["add_arguments", "serve"]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the HTTP server."""
    parser.description = "Serve metrics of robots at http://HOST:PORT/metrics, for Prometheus to scrape. It only reads."
    parser.add_argument(
        "--listen", default=HOST, metavar="HOST", help=f"address to listen at (default: {HOST}, this computer only)"
    )
    parser.add_argument("--port", type=int, default=PORT, metavar="N", help=f"port to listen at (default: {PORT})")


@contextlib.contextmanager
def serve(robots: Mapping[str, Robot], args: argparse.Namespace) -> Iterator[None]:
    """Serve the metrics of the robots until the context ends."""
    with contextlib.closing(RobotCollector(robots)) as collector, serve_metrics(collector, args.listen, args.port):
        yield
