"""The common part of several commands: the address of a robot, what is said on stderr, and every packet of a stream."""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Iterator, Sequence
from typing import Any, Literal

from linkcore import clock
from linkcore.cli.options import Row, argument, seconds
from linkcore.cli.progress import ProgressBar
from linkcore.errors import LinkTimeout
from linkcore.streaming.connection_life import ConnectionEvent, ConnectionState
from linkcore.streaming.packet_queue import drop_oldest
from linkcore.streaming.stream import Stream
from linkcore.text import printable
from linkcore.wire.cycles import Missing

from ..robot import Robot, connect

_ADDRESS = "a host (192.168.56.101, ur://host?primary=40001), sim://, sim://ur10?firmware=3.4, or replay:///file"

CONNECT_TIMEOUT = argument(
    "--connect-timeout", type=seconds, default=5.0, metavar="S", help="give up connecting after S seconds (5)"
)


def address(nargs: Literal["?"] | None = None) -> tuple[Row, Row]:
    """The address of a robot, which may be left out where `nargs` is "?", and how long to wait for it."""
    return argument("address", metavar="ADDRESS", nargs=nargs, help=_ADDRESS), CONNECT_TIMEOUT


ADDRESS = address()


def interface_of(choices: Sequence[str]) -> Row:
    """Which interface of the controller to read."""
    return argument(
        "--interface", choices=choices, default="realtime", help="interface of the controller to read (realtime)"
    )


#: Packets that are queued at most: half a minute of the fastest interface.
_ROOM = 16384


def connected(args: argparse.Namespace, address: str | None = None, **how: Any) -> Robot:
    """Connect to a robot, and show the progress.

    Args:
        args: The arguments of a command that takes `ADDRESS`.
        address: Address of the robot; None for the one in `args`.
        how: Further arguments of `connect`.

    Raises:
        LinkError: See `connect`.
    """
    address = args.address if address is None else address
    with ProgressBar(f"connecting to {address}", args.quiet):
        return connect(address, timeout=args.connect_timeout, **how)


def tell(text: str) -> None:
    """One line on stderr."""
    print(f"urlink: {printable(text)}", file=sys.stderr)


def agrees(question: str) -> bool:
    """Whether the person at the terminal says yes."""
    print(f"{question} [y/N] ", end="", file=sys.stderr, flush=True)
    return sys.stdin.readline().strip().lower() in ("y", "yes")


class Tap:
    """The packets of class `kind` on a stream; a context manager.

    Raises:
        RemoteError: the stream could not be opened.
    """

    def __init__(self, stream: Stream[Any], kind: type) -> None:
        self._stream = stream
        self._kind = kind
        # A packet that is not read in time is dropped, so the queue is long; a recording waits instead.
        self._queue = stream._connection.open_queue(kind, stream._policy(None, drop_oldest(_ROOM)))
        self._connection = stream.subscribe(_tell_connection, ConnectionEvent)

    def take(self, timeout: float | None = None) -> Sequence[Any] | None:
        """The next packets; none if none came within `timeout` seconds; None when the stream has ended.

        Raises:
            RemoteError: the stream gave up.
        """
        packet = self._queue.next(timeout)
        if packet is not None:
            return list(self._stream._connection.fan_out.expand(self._kind, packet))
        if self._queue.is_over:
            if self._stream.failure is not None:
                raise self._stream.failure
            return None
        return ()

    def packets(self, silence: float | None = None, duration: float | None = None) -> Iterator[Any]:
        """Each packet, until the stream ends, or `duration` seconds are over.

        Raises:
            LinkTimeout: none came for `silence` seconds.
            RemoteError: the stream gave up.
        """
        until = math.inf if duration is None else clock.now() + duration
        while (left := until - clock.now()) > 0.0:
            is_last = left < (math.inf if silence is None else silence)
            packets = self.take(left if is_last else silence)
            if packets is None:
                return
            yield from packets
            if not packets and not is_last:
                raise LinkTimeout(f"no {self._kind.__name__} from {self._stream.name} within {silence:g} s")

    def __enter__(self) -> Tap:
        return self

    def __exit__(self, *exc: object) -> None:
        self._connection.close()  # first, so that closing is not printed as a lost connection
        # Packets that are still queued at the end were not dropped.
        dropped = self._queue.dropped
        self._stream._connection.close_queue(self._queue)
        stats = self._stream.stats
        if dropped:
            tell(f"{dropped} packets were dropped: the output was too slow for them")
        if stats.failed:
            tell(f"{stats.failed} packets could not be decoded")
        if stats.missed:
            missing = Missing(stats.missed, stats.gaps, stats.longest_gap)
            tell(f"{missing.text(stats.received)} by the clock of the controller, which did not send them")
        if stats.duplicates:
            tell(f"{stats.duplicates} packets arrived twice, by the clock of the controller")
        if stats.skipped:
            tell(f"{stats.skipped} bytes belonged to no packet")


def _tell_connection(event: ConnectionEvent) -> None:
    if event.state is ConnectionState.LOST:
        tell(f"{event.stream}: connection lost: {event.error}; trying again")
