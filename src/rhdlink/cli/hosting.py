"""Options of a host, and functions that run it until it ends, for the commands `serve` and `turtle`."""

from __future__ import annotations

import argparse
from dataclasses import fields, replace
from typing import TYPE_CHECKING, Any, get_args

from linkcore.cli.options import Row, argument, seconds
from linkcore.cli.terminal import Interruption

from ..host.host import Host
from ..host.service import Resend
from ..wire.decoder import Limits
from ..wire.schema import WIDTHS
from .options import tell

if TYPE_CHECKING:
    from ..mqtt.simulated import SimulatedRobobot


def service_arguments(args: argparse.Namespace, limits: Limits) -> dict[str, Any]:
    """Return the arguments of `Host` that were given, and the limits. Missing limits are taken from `limits`."""
    # `turtle` has no option for the address.
    names = ("port", "address", "width", "resend", "client_timeout", "inactivity_timeout")
    given = {name: value for name in names if (value := getattr(args, name, None)) is not None}
    return {**given, "limits": replace(limits, **dict(args.limit))}


_LIMITS = tuple(field.name for field in fields(Limits))


def _limit(text: str) -> tuple[str, int]:
    """Parse one limit of the command line."""
    name, _, number = text.partition("=")
    if name not in _LIMITS or not number.isdecimal() or int(number) < 1:
        raise argparse.ArgumentTypeError(
            f"{text!r} is not a limit; expected NAME=N, with NAME one of {', '.join(_LIMITS)}"
        )
    return name, int(number)


def service_options(default: str) -> tuple[Row, ...]:
    """Return the options of a host. `default` is the source of default values, for the help texts."""
    return (
        argument(
            "--width",
            type=int,
            choices=WIDTHS,
            help="32-bit words of a time stamp, as the clients expect: 4 for 64-bit builds of the original's "
            f"ordinary sources, which would otherwise decode garbage (default: {default}2)",
        ),
        argument(
            "--resend",
            choices=get_args(Resend),
            help="variables in a reply: variables set since the last reply, or all that were ever set "
            f"(default: {default}changed)",
        ),
        argument(
            "--client-timeout",
            type=seconds,
            metavar="S",
            help=f"maximum seconds to complete a request or to read a reply (default: {default}5)",
        ),
        argument(
            "--inactivity-timeout",
            type=seconds,
            metavar="S",
            help=f"seconds without a request after which a reader may lose its slot (default: {default}10)",
        ),
        argument(
            "--limit",
            action="append",
            default=[],
            type=_limit,
            metavar="NAME=N",
            help=f"largest request of a client: {', '.join(_LIMITS)} (in bytes); can be repeated",
        ),
    )


def run_until_told(
    robot: Host | SimulatedRobobot, what: str, duration: float | None, interruption: Interruption
) -> None:
    """Run a host or a simulated robot until Ctrl-C, SIGTERM, its own end or the end of `duration`.

    The address is printed on stdout when clients can connect.
    """
    with robot:
        tell(f"{what}; Ctrl-C ends it; connect to")
        print(robot.address, flush=True)
        interruption.end_after(duration)
        while not robot.wait(0.0) and not interruption.wait(0.1):
            pass


def serve_until_told(host: Host, what: str, duration: float | None) -> int:
    """Serve as in `run_until_told`, and print statistics at the end. Return the exit status.

    Raises:
        PluginFailed: If a critical plugin fails.
        BadAddress: If the port is not available.
    """
    with Interruption() as interruption:
        run_until_told(host, what, duration, interruption)
        stats = host.stats
        tell(
            f"{stats.ticks} ticks, late by {1e3 * stats.late_median:.3f} ms (median) and {1e3 * stats.late_p99:.3f} ms "
            f"(99th percentile), {stats.overruns} overruns; {stats.refused_writes} writes refused, "
            f"{stats.bad_clients} clients disconnected because of invalid data"
        )
        if stats.failed_plugins:
            tell(f"failed plugins: {', '.join(stats.failed_plugins)}")
    return interruption.status
