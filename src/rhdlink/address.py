"""Addresses: where a robot's RHD listens."""

from __future__ import annotations

import os
from typing import NamedTuple
from urllib.parse import urlsplit

from linkcore.errors import BadAddress

#: The port of clients that name none; a server has no default (docs/protocols/rhd.md, Transport).
PORT = 24902


class Address(NamedTuple):
    """A host and a port."""

    host: str
    port: int

    def __str__(self) -> str:
        return f"[{self.host}]:{self.port}" if ":" in self.host else f"{self.host}:{self.port}"


def parse_address(text: object) -> Address:
    """Read an address.

    Raises:
        BadAddress: says what is wrong and what was expected.

    >>> parse_address("smr12:8001")
    Address(host='smr12', port=8001)
    >>> parse_address("rhd://localhost")
    Address(host='localhost', port=24902)
    """
    example = "expected a host and a port, as in localhost:24902"
    if not isinstance(text, str):
        more = "; a recording is played by `rhdlink replay`" if isinstance(text, os.PathLike) else ""
        raise BadAddress(f"{text!r} is no address; {example}{more}")
    stripped = text.strip()
    if not stripped or any(character.isspace() or not character.isprintable() for character in stripped):
        raise BadAddress(f"{text!r} is no address; {example}")
    try:
        parts = urlsplit(stripped if "://" in stripped else f"rhd://{stripped}")
        host, port = parts.hostname, parts.port
    except ValueError as error:  # half a bracket, or a port that is not a number from 1 to 65535
        raise BadAddress(f"{text!r} is no address: {error}; {example}") from None
    if parts.scheme != "rhd":
        raise BadAddress(f"{text!r}: unknown kind {parts.scheme!r}; expected rhd")
    if not host or "@" in parts.netloc or parts.path not in ("", "/") or parts.query or parts.fragment or port == 0:
        raise BadAddress(f"{text!r} is no address; {example}")
    return Address(host, PORT if port is None else port)
