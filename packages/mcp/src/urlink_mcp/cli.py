"""Command line of `urlink serve mcp`."""

from __future__ import annotations

import argparse
import contextlib
import os
import threading
from collections.abc import Iterator, Mapping

from urlink import BadValue, Robot
from urlink.tools import seconds

from .server import PORT, SHORTEST_TOKEN, Server

__all__ = ["add_arguments", "serve"]

#: Environment variable with the token. The command line is not used, because all users of a computer can see it.
_TOKEN = "URLINK_MCP_TOKEN"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the MCP server."""
    parser.description = (
        "Serve robots to an agent over the Model Context Protocol, by default over standard input and output. Without "
        "--allow, all tools only read. With --allow, a person must consent to each motion, except to a stop."
    )
    parser.add_argument(
        "--http",
        type=int,
        nargs="?",
        const=PORT,
        metavar="PORT",
        help=f"serve over HTTP at 127.0.0.1 instead (default port: {PORT}); the environment variable {_TOKEN} holds "
        f"the token of the clients, at least {SHORTEST_TOKEN} characters",
    )
    parser.add_argument(
        "--allow", action="store_true", help="offer tools that move the arm; needs --limits (default: only read)"
    )
    parser.add_argument("--points", metavar="FILE", help="file with taught points")
    parser.add_argument(
        "--consent-time", type=seconds, default=30.0, metavar="S", help="seconds to answer a question (default: 30)"
    )
    parser.add_argument(
        "--motion-time", type=seconds, default=60.0, metavar="S", help="stop a motion after S seconds (default: 60)"
    )
    parser.add_argument("--log", metavar="FILE", help="append each request to this file, as JSON lines")


@contextlib.contextmanager
def serve(robots: Mapping[str, Robot], args: argparse.Namespace) -> Iterator[threading.Event]:
    """Serve the robots until the context ends. The event is set when the client has closed standard input.

    Raises:
        BadValue: If the options do not fit together.
    """
    if args.allow and getattr(args, "read_only", False):
        raise BadValue("--allow and --read-only contradict each other; give only one of them")
    if args.allow and getattr(args, "limits", None) is None:
        raise BadValue("--allow needs limits of the session; add --limits FILE, or --limits teaching")
    if args.allow and getattr(args, "require_enable", "never") != "never":
        raise BadValue(
            "--require-enable needs a client that enables motions, which agents must not do; leave it out, because "
            "each motion needs the consent of a person"
        )
    token = os.environ.get(_TOKEN)
    if args.http is not None and not token:
        raise BadValue(
            f"--http needs a token in the environment variable {_TOKEN}; python -c 'import secrets; "
            "print(secrets.token_urlsafe())' makes one"
        )
    with Server(
        robots,
        port=args.http,
        token=token,
        allow=args.allow,
        consent_time=args.consent_time,
        motion_time=args.motion_time,
        log=args.log,
    ) as server:
        yield server.ended
