"""A host in the foreground, for the commands that run one."""

from __future__ import annotations

import time

from linkcore.cli.interruption import Interruption

from ..host import Host
from .options import tell

__all__ = ["serve_until_told"]


def serve_until_told(host: Host, address: str, what: str, duration: float | None) -> Interruption:
    """Serve until Ctrl-C, SIGTERM or the end of `duration`; end in order, and tell how it went.

    The address to connect to is printed on stdout, once it can be connected to. Returned is whether a signal ended it.

    Raises:
        PluginFailed: a critical plugin raised.
        BadAddress: the port cannot be listened on.
    """
    with Interruption() as interruption:
        with host:
            tell(f"{what}; Ctrl-C ends it; connect to")
            print(f"[{address}]:{host.port}" if ":" in address else f"{address}:{host.port}", flush=True)
            until = None if duration is None else time.monotonic() + duration
            while until is None or time.monotonic() < until:
                left = 0.1 if until is None else min(0.1, max(until - time.monotonic(), 0.0))
                if host.wait(0.0) or interruption.wait(left):
                    break
        stats = host.stats
        tell(
            f"{stats.ticks} ticks, late by {1e3 * stats.late_median:.3f} ms (median), {1e3 * stats.late_p99:.3f} ms "
            f"(99 of 100 less), {stats.overruns} overruns; {stats.refused_writes} writes refused, "
            f"{stats.bad_clients} clients closed for what they sent"
        )
        if stats.failed_plugins:
            tell(f"failed plugins: {', '.join(stats.failed_plugins)}")
    return interruption
