"""Addresses of robots: the host and port at which an RHD server listens, or the MQTT broker of a robot."""

from __future__ import annotations

import os
from typing import NamedTuple
from urllib.parse import SplitResult, parse_qsl, urlsplit

from linkcore.errors import BadAddress

#: Default port of clients. A server has no default port (docs/protocols/rhd.md, Transport).
PORT = 24902
#: Default port of a broker.
MQTT_PORT = 1883
_MQTT = "mqtt://"


class Address(NamedTuple):
    """Address of a robot: host and port."""

    host: str
    port: int

    def __str__(self) -> str:
        return f"[{self.host}]:{self.port}" if ":" in self.host else f"{self.host}:{self.port}"


class MqttAddress(NamedTuple):
    """The broker of a robot.

    Attributes:
        host: Host name or address of the broker.
        port: Port of the broker.
        dialect: Name of the dialect of the robot's commands; None to recognise it.
    """

    host: str
    port: int = MQTT_PORT
    dialect: str | None = None

    def __str__(self) -> str:
        dialect = "" if self.dialect is None else f"?dialect={self.dialect}"
        return f"{_MQTT}{Address(self.host, self.port)}{dialect}"


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
    parts, host, port = _split(text, stripped if "://" in stripped else f"rhd://{stripped}", "rhd", example)
    if parts.query:
        raise BadAddress(f"invalid address {text!r}; {example}")
    return Address(host, PORT if port is None else port)


def is_mqtt(text: object) -> bool:
    """Whether an address begins with ``mqtt://``."""
    return isinstance(text, str) and text.strip()[: len(_MQTT)].lower() == _MQTT


def parse_mqtt_address(text: str) -> MqttAddress:
    """Parse the address of a broker.

    Raises:
        BadAddress: If `text` is not such an address. The name of the dialect is not checked here.

    >>> parse_mqtt_address("mqtt://192.168.0.55")
    MqttAddress(host='192.168.0.55', port=1883, dialect=None)
    >>> parse_mqtt_address("mqtt://localhost:1884?dialect=2026").dialect
    '2026'
    """
    example = "expected mqtt://HOST, mqtt://HOST:PORT or mqtt://HOST?dialect=2026"
    if not is_mqtt(text):
        raise BadAddress(f"invalid address {text!r}; {example}")
    parts, host, port = _split(text, text.strip(), "mqtt", example)
    try:
        options = dict(parse_qsl(parts.query, keep_blank_values=True, strict_parsing=True)) if parts.query else {}
    except ValueError as error:
        raise BadAddress(f"invalid address {text!r}: {error}; {example}") from None
    if options.keys() - {"dialect"}:
        raise BadAddress(f"unknown option in address {text!r}; the only option is dialect; {example}")
    return MqttAddress(host, MQTT_PORT if port is None else port, options.get("dialect"))


def _split(text: str, url: str, scheme: str, example: str) -> tuple[SplitResult, str, int | None]:
    """Return the parts of a URL, with its host and port, after checking them.

    Args:
        text: Address as it was passed, for the messages.
        url: The same address with a scheme.
        scheme: Expected scheme.
        example: Expected form, for the messages.

    Raises:
        BadAddress: If the URL has another scheme, no host, an invalid port, or parts that no address has.
    """
    if any(character.isspace() or not character.isprintable() for character in url):
        raise BadAddress(f"invalid address {text!r}; {example}")
    try:
        parts = urlsplit(url)
        host, port = parts.hostname, parts.port
    except ValueError as error:  # an unclosed bracket, or a port that is not a number from 1 to 65535
        raise BadAddress(f"invalid address {text!r}: {error}; {example}") from None
    if parts.scheme != scheme:
        raise BadAddress(f"unknown scheme {parts.scheme!r} in address {text!r}; expected 'rhd' or 'mqtt'")
    if not host or "@" in parts.netloc or parts.path not in ("", "/") or parts.fragment or port == 0:
        raise BadAddress(f"invalid address {text!r}; {example}")
    return parts, host, port
