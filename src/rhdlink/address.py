"""Addresses of robots: the host and port at which an RHD server listens."""

from __future__ import annotations

import os
from typing import NamedTuple
from urllib.parse import urlsplit

from linkcore.errors import BadAddress

#: Default port of clients. A server has no default port (docs/protocols/rhd.md, Transport).
PORT = 24902


class Address(NamedTuple):
    """Address of a robot: host and port."""

    host: str
    port: int

    def __str__(self) -> str:
        return f"[{self.host}]:{self.port}" if ":" in self.host else f"{self.host}:{self.port}"


def parse_address(text: object) -> Address:
    """Parse an address.

    Raises:
        BadAddress: If `text` is not an address. The message gives the error and the expected form.

    >>> parse_address("smr12:8001")
    Address(host='smr12', port=8001)
    >>> parse_address("rhd://localhost")
    Address(host='localhost', port=24902)
    """
    example = "expected a host and a port, as in localhost:24902"
    if not isinstance(text, str):
        more = "; to play a recording, use `rhdlink replay`" if isinstance(text, os.PathLike) else ""
        raise BadAddress(f"invalid address {text!r}; {example}{more}")
    stripped = text.strip()
    if not stripped or any(character.isspace() or not character.isprintable() for character in stripped):
        raise BadAddress(f"invalid address {text!r}; {example}")
    try:
        parts = urlsplit(stripped if "://" in stripped else f"rhd://{stripped}")
        host, port = parts.hostname, parts.port
    except ValueError as error:  # an unclosed bracket, or a port that is not a number from 1 to 65535
        raise BadAddress(f"invalid address {text!r}: {error}; {example}") from None
    if parts.scheme != "rhd":
        raise BadAddress(f"unknown scheme {parts.scheme!r} in address {text!r}; expected 'rhd'")
    if not host or "@" in parts.netloc or parts.path not in ("", "/") or parts.query or parts.fragment or port == 0:
        raise BadAddress(f"invalid address {text!r}; {example}")
    return Address(host, PORT if port is None else port)
