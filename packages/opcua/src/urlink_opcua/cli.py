"""Command line of `urlink serve opcua`."""

from __future__ import annotations

import argparse
import contextlib
import os
from collections.abc import Iterator, Mapping
from datetime import datetime, timezone

from urlink import BadValue, Robot

from .access import Access, read_certificate, read_private_key
from .server import HOST, PORT, Server

__all__ = ["add_arguments", "serve"]

#: Environment variable with the password. The command line is not used, because all users of a computer can see it.
_PASSWORD = "URLINK_OPCUA_PASSWORD"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the OPC UA server."""
    parser.description = (
        "Serve robots over OPC UA. Everyone who can connect may read, unless --no-anonymous is given. Commands need "
        f"--allow, --certificate, and --trust or --user. The environment variable {_PASSWORD} holds the password."
    )
    parser.add_argument(
        "--listen", default=HOST, metavar="HOST", help=f"address to listen at (default: {HOST}, this computer only)"
    )
    parser.add_argument("--port", type=int, default=PORT, metavar="N", help=f"port to listen at (default: {PORT})")
    parser.add_argument("--rate", type=float, default=10.0, metavar="HZ", help="updates per second (default: 10)")
    parser.add_argument("--allow", action="store_true", help="accept commands (default: refuse all commands)")
    parser.add_argument("--certificate", metavar="FILE", help="certificate of this server, with an RSA key")
    parser.add_argument("--private-key", metavar="FILE", help="private key of --certificate (PEM, not encrypted)")
    parser.add_argument(
        "--trust",
        action="append",
        default=[],
        metavar="FILE",
        help="certificate of a client that may send commands; repeat it for several clients",
    )
    parser.add_argument("--user", metavar="NAME", help="user name with which clients may send commands")
    parser.add_argument("--no-anonymous", action="store_true", help="refuse clients without credentials")


@contextlib.contextmanager
def serve(robots: Mapping[str, Robot], args: argparse.Namespace) -> Iterator[None]:
    """Serve the robots until the context ends.

    Raises:
        BadValue: If the options do not fit together, a file cannot be used, or a certificate is not valid now.
    """
    if args.allow and getattr(args, "read_only", False):
        raise BadValue("--allow and --read-only contradict each other; give only one of them")
    password = os.environ.get(_PASSWORD)
    if args.user and not password:
        raise BadValue(f"--user needs a password; set the environment variable {_PASSWORD}")
    if bool(args.certificate) != bool(args.private_key):
        raise BadValue("--certificate and --private-key belong together; expected both or neither")
    certificate = key = None
    if args.certificate:
        certificate = read_certificate(args.certificate)
        if not certificate.not_valid_before_utc <= datetime.now(timezone.utc) < certificate.not_valid_after_utc:
            raise BadValue(
                f"the certificate {args.certificate} is valid from {certificate.not_valid_before_utc:%Y-%m-%d} to "
                f"{certificate.not_valid_after_utc:%Y-%m-%d}; expected one that is valid now"
            )
        key = read_private_key(args.private_key, certificate)
    access = Access(
        [read_certificate(path) for path in args.trust],
        args.user or None,
        password if args.user else None,
        anonymous=not args.no_anonymous,
    )
    with Server(
        robots,
        host=args.listen,
        port=args.port,
        rate=args.rate,
        allow=args.allow,
        access=access,
        certificate=certificate,
        private_key=key,
    ):
        yield
