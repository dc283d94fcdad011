"""Options of a host, and serving it until it ends: shared by `serve` and `turtle`."""

from __future__ import annotations

import argparse
from dataclasses import fields, replace
from typing import Any, get_args

from linkcore.cli.options import Row, argument, seconds
from linkcore.cli.terminal import Interruption

from ..host.host import Host
from ..host.service import Resend
from ..wire.decoder import Limits
from ..wire.schema import WIDTHS
from .options import tell


def service_arguments(args: argparse.Namespace, limits: Limits) -> dict[str, Any]:
    """The arguments of `Host` that were given, and the limits: those that were not given are those of `limits`."""
    # `turtle` has no option for the address.
    names = ("port", "address", "width", "resend", "client_timeout", "inactivity_timeout")
    given = {name: value for name in names if (value := getattr(args, name, None)) is not None}
    return {**given, "limits": replace(limits, **dict(args.limit))}


_LIMITS = tuple(field.name for field in fields(Limits))


def _limit(text: str) -> tuple[str, int]:
    """One limit, as it is given on the command line."""
    name, _, number = text.partition("=")
    if name not in _LIMITS or not number.isdecimal() or int(number) < 1:
        raise argparse.ArgumentTypeError(f"{text!r}; expected NAME=N, NAME being one of {', '.join(_LIMITS)}")
    return name, int(number)


def service_options(default: str) -> tuple[Row, ...]:
    """The options of a host; `default` says where a value comes from that is not given."""
    return (
        argument(
            "--width",
            type=int,
            choices=WIDTHS,
            help="32-bit words of a time stamp, as the clients have it: 4 if they are 64-bit builds of the original's "
            f"ordinary sources, which would decode garbage ({default}2)",
        ),
        argument(
            "--resend",
            choices=get_args(Resend),
            help=f"variables in a reply: those set since the last one, or all that were ever set ({default}changed)",
        ),
        argument(
            "--client-timeout",
            type=seconds,
            metavar="S",
            help=f"seconds for a request to be complete, or a reply to be read ({default}5)",
        ),
        argument(
            "--inactivity-timeout",
            type=seconds,
            metavar="S",
            help=f"seconds without a request after which a reader may lose its slot ({default}10)",
        ),
        argument(
            "--limit",
            action="append",
            default=[],
            type=_limit,
            metavar="NAME=N",
            help=f"the most that a client may request: {', '.join(_LIMITS)} (in bytes); can be repeated",
        ),
    )


def serve_until_told(host: Host, what: str, duration: float | None) -> int:
    """Serve until Ctrl-C, SIGTERM or the end of `duration`; then stop properly, print statistics, return the status.

    The address is printed on stdout once clients can connect.

    Raises:
        PluginFailed: a critical plugin raised.
        BadAddress: the port cannot be listened on.
    """
    with Interruption() as interruption:
        with host:
            tell(f"{what}; Ctrl-C ends it; connect to")
            print(host.address, flush=True)
            interruption.end_after(duration)
            while not host.wait(0.0) and not interruption.wait(0.1):
                pass
        stats = host.stats
        tell(
            f"{stats.ticks} ticks, late by {1e3 * stats.late_median:.3f} ms (median), {1e3 * stats.late_p99:.3f} ms "
            f"(99 of 100 less), {stats.overruns} overruns; {stats.refused_writes} writes refused, "
            f"{stats.bad_clients} clients closed for what they sent"
        )
        if stats.failed_plugins:
            tell(f"failed plugins: {', '.join(stats.failed_plugins)}")
    return interruption.status
