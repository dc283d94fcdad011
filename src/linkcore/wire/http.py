"""HTTP/1.1 messages: conversion of bytes to requests and responses, and back. This module uses no sockets (sans-IO).

Each connection carries one request and one response (`Connection: close`). A message consists of its headers and its
body. The length of the body is given by `Content-Length`, by chunks, or, for a response, by the end of the connection.
Source: RFC 9112. The sizes of headers and bodies are limited, so that a peer cannot fill the memory.
"""

from __future__ import annotations

import re
from collections.abc import Generator, Mapping
from dataclasses import dataclass, field
from typing import Literal, TypeAlias, TypeVar

from ..errors import BadValue, PacketError

#: Maximum number of bytes of the start line and the headers together, and of a body.
LONGEST_HEAD = 1 << 14
LONGEST_BODY = 1 << 20

_T = TypeVar("_T")
#: Generator that waits for more bytes at each `yield`, and returns the parsed part of the message.
_Reading: TypeAlias = Generator[None, None, _T]

_END = b"\r\n"
_VERSION = b"HTTP/1."
# Each pattern either matches a field or fails without backtracking to another position. So the time is proportional to
# the length of a line. `partition` and `strip` have already separated the fields.
_REQUEST = re.compile(rb"([A-Z]{1,16}) (\S+) HTTP/1\.[01]")
_RESPONSE = re.compile(rb"HTTP/1\.[01] ([0-9]{3})(?: ([^\r\n]*))?")
_NAME = re.compile(rb"[!#$%&'*+\-.^_`|~0-9A-Za-z]+")
_VALUE = re.compile(rb"[^\r\n\0]*")
_CHUNK = re.compile(rb"[0-9A-Fa-f]{1,8}")
_LENGTH = re.compile(r"[0-9]{1,12}")
#: Allowed characters of a start line or a header that is sent.
_PLAIN = re.compile(r"[\x21-\x7e][\x20-\x7e]*")


@dataclass(frozen=True)
class HttpRequest:
    """Request of a client.

    Attributes:
        method: Method, such as "GET".
        target: Path and query.
        headers: Name in lower case -> value.
        body: Bytes of the body.
    """

    method: str
    target: str
    headers: Mapping[str, str] = field(default_factory=dict)
    body: bytes = b""

    def encode(self, host: str) -> bytes:
        """Return the bytes on the wire, for a server of this name.

        Raises:
            BadValue: If the target or a header contains an invalid character.
        """
        return _encoded(f"{self.method} {self.target} HTTP/1.1", {"Host": host, **self.headers}, self.body)


@dataclass(frozen=True)
class HttpResponse:
    """Response of a server.

    Attributes:
        status: Status code, such as 200.
        reason: Text of the status.
        headers: Name in lower case -> value.
        body: Bytes of the body.
    """

    status: int
    reason: str = ""
    headers: Mapping[str, str] = field(default_factory=dict)
    body: bytes = b""

    def encode(self) -> bytes:
        """Return the bytes on the wire.

        Raises:
            BadValue: If the reason or a header contains an invalid character.
        """
        return _encoded(f"HTTP/1.1 {self.status:03d} {self.reason}".rstrip(), self.headers, self.body)


def _encoded(start: str, headers: Mapping[str, str], body: bytes) -> bytes:
    every = {**headers, "Content-Length": str(len(body)), "Connection": "close"}
    lines = [start, *(f"{name}: {value}" for name, value in every.items())]
    for line in lines:
        if not _PLAIN.fullmatch(line):
            raise BadValue(f"{line[:80]!r} is not a valid line of HTTP; expected printable ASCII characters")
    return "\r\n".join([*lines, "", ""]).encode("ascii") + body


class HttpParser:
    """Parser of one message that arrives in parts.

    Its time is proportional to the number of bytes.

    Args:
        kind: Kind of the message: the request of a client, or the response of a server.
    """

    def __init__(self, kind: Literal["request", "response"]) -> None:
        self._kind = kind
        self._data = bytearray()
        self._body = bytearray()
        self._has_ended = False
        #: Number of bytes that further lines may have: first lines of the head, then lines between the chunks.
        self._room = LONGEST_HEAD
        self._reading = self._request() if kind == "request" else self._response()

    def feed(self, data: bytes) -> HttpRequest | HttpResponse | None:
        """Return the message when it is complete, or else None.

        Bytes after the message are discarded.

        Raises:
            PacketError: If this is not such a message, or if it is too large.
        """
        self._data += data
        try:
            next(self._reading)
        except StopIteration as end:
            message: HttpRequest | HttpResponse = end.value
            return message
        return None

    def end(self) -> HttpRequest | HttpResponse:
        """Return the message when the connection has ended, which is also the end of a response without a length.

        Raises:
            PacketError: If the message is not complete.
        """
        self._has_ended = True
        message = self.feed(b"")
        if message is None:
            raise self._error("the connection ended before the message was complete")
        return message

    def _error(self, text: str) -> PacketError:
        return PacketError(text, packet=f"HTTP {self._kind}")

    # -- the two kinds; each generator waits for bytes when it yields ------------------------------------

    def _request(self) -> _Reading[HttpRequest]:
        start, headers = yield from self._head(_REQUEST)
        yield from self._message_body(headers, 0)
        return HttpRequest(start[1].decode("ascii"), start[2].decode("latin-1"), headers, bytes(self._body))

    def _response(self) -> _Reading[HttpResponse]:
        while not self._data.startswith(_VERSION):
            if not _VERSION.startswith(self._data):
                raise self._error(f"it begins with {bytes(self._data[:80])!r}; expected 'HTTP/1.1' and a status")
            yield
        while True:
            start, headers = yield from self._head(_RESPONSE)
            status = int(start[1])
            # An interim response, such as 100 Continue, comes before the final response.
            if status >= 200:
                break
        yield from self._message_body(headers, 0 if status in (204, 304) else None)
        return HttpResponse(status, (start[2] or b"").decode("latin-1"), headers, bytes(self._body))

    # -- head and body -----------------------------------------------------------------------------------

    def _head(self, pattern: re.Pattern[bytes]) -> _Reading[tuple[re.Match[bytes], dict[str, str]]]:
        """Read the start line and the headers."""
        what = f"its headers have more than {LONGEST_HEAD} bytes"
        line = yield from self._line(what)
        start = pattern.fullmatch(line)
        if start is None:
            raise self._error(f"it begins with {line[:80]!r}, which is not a valid first line of HTTP/1.1")
        headers: dict[str, str] = {}
        while line := (yield from self._line(what)):
            key, colon, content = line.partition(b":")
            content = content.strip(b" \t")
            if not colon or not _NAME.fullmatch(key) or not _VALUE.fullmatch(content):
                raise self._error(f"{line[:80]!r} is not a header; expected 'name: value'")
            name, value = key.decode("ascii").lower(), content.decode("latin-1")
            if name in headers and headers[name] != value:
                if name == "content-length":
                    raise self._error(f"conflicting Content-Length headers: {headers[name]} and {value}")
                value = f"{headers[name]}, {value}"
            headers[name] = value
        return start, headers

    def _message_body(self, headers: Mapping[str, str], otherwise: int | None) -> _Reading[None]:
        """Read the body.

        `otherwise` is its length if the headers do not give it; None reads to the end of the connection.
        """
        coding, length = headers.get("transfer-encoding"), headers.get("content-length")
        if coding is not None:
            if coding.lower() != "chunked":
                raise self._error(f"unsupported Transfer-Encoding {coding[:80]!r}; only 'chunked' is supported")
            yield from self._chunks()
        elif length is not None:
            if not _LENGTH.fullmatch(length) or int(length) > LONGEST_BODY:
                raise self._error(f"its Content-Length is {length[:80]!r}; expected at most {LONGEST_BODY} bytes")
            yield from self._take(int(length))
        elif otherwise is not None:
            yield from self._take(otherwise)
        else:
            while not self._has_ended:
                yield from self._take(len(self._data))
                yield

    def _chunks(self) -> _Reading[None]:
        what = f"the lines between its chunks have more than {LONGEST_BODY} bytes"
        self._room = LONGEST_BODY
        size = -1
        while size:
            line = yield from self._line(what)
            digits = line.partition(b";")[0].rstrip(b" \t")
            if not _CHUNK.fullmatch(digits):
                raise self._error(f"{line[:80]!r} is not the size of a chunk; expected hexadecimal digits")
            size = int(digits, 16)
            yield from self._take(size)
            if size and (yield from self._line(what)):
                raise self._error("a chunk is longer than its size")
        while (yield from self._line(what)):
            pass  # trailers

    def _line(self, what: str) -> _Reading[bytes]:
        """Read the next line; `what` is the error message if it is too long."""
        searched = 0
        while (end := self._data.find(_END, searched)) < 0 and len(self._data) <= self._room:
            searched = max(len(self._data) - 1, 0)
            yield
        self._room -= end + len(_END)
        if end < 0 or self._room < 0:
            raise self._error(what)
        line = bytes(self._data[:end])
        del self._data[: end + len(_END)]
        return line

    def _take(self, count: int) -> _Reading[None]:
        """Add the next `count` bytes to the body."""
        if len(self._body) + count > LONGEST_BODY:
            raise self._error(f"its body has more than {LONGEST_BODY} bytes")
        while len(self._data) < count:
            yield
        self._body += self._data[:count]
        del self._data[:count]
