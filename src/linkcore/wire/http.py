"""HTTP/1.1 messages, sans-IO: bytes to requests and responses, and back.

Each connection carries one request and one response (`Connection: close`). A message is
complete with its headers and its body, whose length is given by `Content-Length`, by chunks, or, for a response, by the
end of the connection. Source: RFC 9112. Headers and bodies are bounded, so that no peer can fill the memory.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from ..errors import BadValue, PacketError

__all__ = ["LONGEST_BODY", "LONGEST_HEAD", "HttpParser", "HttpRequest", "HttpResponse"]

#: Bytes of the start line and headers, and of a body.
LONGEST_HEAD = 1 << 14
LONGEST_BODY = 1 << 20

_END = b"\r\n"
_REQUEST = re.compile(rb"([A-Z]{1,16}) (\S+) HTTP/1\.[01]")
_RESPONSE = re.compile(rb"HTTP/1\.[01] ([0-9]{3})(?: ([^\r\n]*))?")
_HEADER = re.compile(rb"([!#$%&'*+\-.^_`|~0-9A-Za-z]+):[ \t]*(.*?)[ \t]*")
_CHUNK = re.compile(rb"([0-9A-Fa-f]{1,8})[ \t]*(?:;.*)?")
_LENGTH = re.compile(r"[0-9]{1,12}")
#: What may stand in a start line or header that is written here.
_PLAIN = re.compile(r"[\x21-\x7e][\x20-\x7e]*")


@dataclass(frozen=True)
class HttpRequest:
    """What a client asks.

    Attributes:
        method: such as "GET".
        target: path and query.
        headers: name in lower case -> value.
        body: bytes.
    """

    method: str
    target: str
    headers: Mapping[str, str] = field(default_factory=dict)
    body: bytes = b""

    def encode(self, host: str) -> bytes:
        """The bytes on the wire, to a server of this name.

        Raises:
            BadValue: the target or a header holds what cannot stand there.
        """
        return _encoded(f"{self.method} {self.target} HTTP/1.1", {"Host": host, **self.headers}, self.body)


@dataclass(frozen=True)
class HttpResponse:
    """What a server answers.

    Attributes:
        status: such as 200.
        reason: words beside it.
        headers: name in lower case -> value.
        body: bytes.
    """

    status: int
    reason: str = ""
    headers: Mapping[str, str] = field(default_factory=dict)
    body: bytes = b""

    def encode(self) -> bytes:
        """The bytes on the wire.

        Raises:
            BadValue: the reason or a header holds what cannot stand there.
        """
        return _encoded(f"HTTP/1.1 {self.status:03d} {self.reason}".rstrip(), self.headers, self.body)


def _encoded(start: str, headers: Mapping[str, str], body: bytes) -> bytes:
    lines = [start]
    lines += [
        f"{name}: {value}"
        for name, value in ({**headers, "Content-Length": str(len(body)), "Connection": "close"}).items()
    ]
    for line in lines:
        if not _PLAIN.fullmatch(line):
            raise BadValue(f"{line[:80]!r} cannot be a line of HTTP")
    return "\r\n".join([*lines, "", ""]).encode("ascii") + body


class HttpParser:
    """One message as its bytes come in.

    Args:
        kind: what comes: a client's request, or a server's response.
    """

    def __init__(self, kind: Literal["request", "response"]) -> None:
        self._kind = kind
        self._data = bytearray()
        self._start: re.Match[bytes] | None = None
        self._headers: dict[str, str] = {}
        self._body = bytearray()
        #: bytes of the body that are to come; None up to the end of the connection
        self._left: int | None = 0
        self._is_chunked = False
        self._is_in_trailer = False

    def feed(self, data: bytes) -> HttpRequest | HttpResponse | None:
        """The message, once it is whole. What comes after it is thrown away.

        Raises:
            PacketError: this is no such message, or it is too large.
        """
        self._data += data
        if self._start is None and not self._head():
            return None
        is_whole = self._chunks() if self._is_chunked else self._plain()
        return self._message() if is_whole else None

    def end(self) -> HttpRequest | HttpResponse:
        """The connection has ended, which ends a response that does not say its length.

        Raises:
            PacketError: the message is not whole.
        """
        if self._start is None or self._is_chunked or self._left is not None:
            raise self._error("the connection ended in the middle of it")
        return self._message()

    def _error(self, text: str) -> PacketError:
        return PacketError(text, packet=f"HTTP {self._kind}")

    # -- its head ------------------------------------------------------------------------------------

    def _head(self) -> bool:
        """Read the start line and the headers, if they are there."""
        pattern = _REQUEST if self._kind == "request" else _RESPONSE
        while True:
            head, end, rest = self._data.partition(_END + _END)
            if len(head) > LONGEST_HEAD:
                raise self._error(f"its headers have more than {LONGEST_HEAD} bytes")
            first, *lines = bytes(head).split(_END)
            if self._kind == "response" and head and not b"HTTP/1.".startswith(head[:7]):
                raise self._error(f"it begins with {bytes(first[:80])!r}")
            if not end and len(head) < 16 and not lines:
                return False  # too few bytes to decide
            start = pattern.fullmatch(first)
            if start is None and (end or lines):
                raise self._error(f"it begins with {first[:80]!r}")
            if not end:
                return False
            assert start is not None
            self._data = rest
            self._headers = self._read_headers(lines)
            # An interim response, such as 100 Continue, comes before the one that counts.
            if self._kind == "request" or start[1][:1] != b"1":
                break
        self._start = start
        self._measure()
        return True

    def _read_headers(self, lines: list[bytes]) -> dict[str, str]:
        headers: dict[str, str] = {}
        for line in lines:
            found = _HEADER.fullmatch(line)
            if found is None:
                raise self._error(f"{line[:80]!r} is no header")
            name, value = found[1].decode("ascii").lower(), found[2].decode("latin-1")
            if name in headers and headers[name] != value:
                if name == "content-length":
                    raise self._error(f"two lengths of its body: {headers[name]} and {value}")
                value = f"{headers[name]}, {value}"
            headers[name] = value
        return headers

    def _measure(self) -> None:
        """Find out where the body ends."""
        coding, length = self._headers.get("transfer-encoding"), self._headers.get("content-length")
        if coding is not None:
            if coding.lower() != "chunked":
                raise self._error(f"its body is coded as {coding[:80]!r}, and only chunks are read")
            self._is_chunked = True
        elif length is not None:
            if not _LENGTH.fullmatch(length) or int(length) > LONGEST_BODY:
                raise self._error(f"its body is {length[:80]!r} bytes long; {LONGEST_BODY} are the most")
            self._left = int(length)
        elif self._kind == "response" and self._status not in (204, 304):
            self._left = None

    @property
    def _status(self) -> int:
        assert self._start is not None
        return int(self._start[1])

    # -- its body ------------------------------------------------------------------------------------

    def _plain(self) -> bool:
        """Take what has come of a body without chunks; True once it is whole."""
        taken = len(self._data) if self._left is None else min(self._left, len(self._data))
        self._take(taken)
        if self._left is None:
            return False
        self._left -= taken
        return not self._left

    def _chunks(self) -> bool:
        """Take the chunks that have come; True after the last."""
        while True:
            if self._left:
                taken = min(self._left, len(self._data))
                self._take(taken)
                self._left -= taken
                if self._left:
                    return False
                # The line end behind the chunk is read as a line of its own.
                self._left = None
            line, end, rest = self._data.partition(_END)
            if len(line) > LONGEST_HEAD:
                raise self._error("a line between its chunks is too long")
            if not end:
                return False
            self._data = rest
            if self._is_in_trailer:
                if not line:
                    return True
            elif self._left is None:
                if line:
                    raise self._error("a chunk is longer than it says")
                self._left = 0
            else:
                size = _CHUNK.fullmatch(bytes(line))
                if size is None:
                    raise self._error(f"{bytes(line[:80])!r} is no size of a chunk")
                self._left = int(size[1], 16)
                self._is_in_trailer = not self._left

    def _take(self, count: int) -> None:
        if len(self._body) + count > LONGEST_BODY:
            raise self._error(f"its body has more than {LONGEST_BODY} bytes")
        self._body += self._data[:count]
        del self._data[:count]

    def _message(self) -> HttpRequest | HttpResponse:
        assert self._start is not None
        first, second = self._start[1], self._start[2] or b""
        if self._kind == "request":
            return HttpRequest(first.decode("ascii"), second.decode("latin-1"), self._headers, bytes(self._body))
        return HttpResponse(int(first), second.decode("latin-1"), self._headers, bytes(self._body))
