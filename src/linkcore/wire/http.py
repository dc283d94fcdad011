"""HTTP/1.1 messages, sans-IO: bytes to requests and responses, and back.

Each connection carries one request and one response (`Connection: close`). A message is
complete with its headers and its body, whose length is given by `Content-Length`, by chunks, or, for a response, by the
end of the connection. Source: RFC 9112. Headers and bodies are bounded, so that no peer can fill the memory.
"""

from __future__ import annotations

import re
from collections.abc import Generator, Mapping
from dataclasses import dataclass, field
from typing import Literal, TypeAlias, TypeVar

from ..errors import BadValue, PacketError

#: Bytes of the start line and headers, and of a body.
LONGEST_HEAD = 1 << 14
LONGEST_BODY = 1 << 20

_T = TypeVar("_T")
#: Waits for more bytes at each `yield`, and returns what it has read.
_Reading: TypeAlias = Generator[None, None, _T]

_END = b"\r\n"
_VERSION = b"HTTP/1."
# Each pattern either matches a field as far as it goes or fails there: none is tried again from another place, so the
# time grows with the length of a line and no faster. Fields are cut out by `partition` and `strip` beforehand.
_REQUEST = re.compile(rb"([A-Z]{1,16}) (\S+) HTTP/1\.[01]")
_RESPONSE = re.compile(rb"HTTP/1\.[01] ([0-9]{3})(?: ([^\r\n]*))?")
_NAME = re.compile(rb"[!#$%&'*+\-.^_`|~0-9A-Za-z]+")
_VALUE = re.compile(rb"[^\r\n\0]*")
_CHUNK = re.compile(rb"[0-9A-Fa-f]{1,8}")
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
    every = {**headers, "Content-Length": str(len(body)), "Connection": "close"}
    lines = [start, *(f"{name}: {value}" for name, value in every.items())]
    for line in lines:
        if not _PLAIN.fullmatch(line):
            raise BadValue(f"{line[:80]!r} cannot be a line of HTTP")
    return "\r\n".join([*lines, "", ""]).encode("ascii") + body


class HttpParser:
    """One message as its bytes come in. The time that it takes is proportional to their number.

    Args:
        kind: what comes: a client's request, or a server's response.
    """

    def __init__(self, kind: Literal["request", "response"]) -> None:
        self._kind = kind
        self._data = bytearray()
        self._body = bytearray()
        self._has_ended = False
        #: bytes that lines may still have: of the head, then of those between the chunks
        self._room = LONGEST_HEAD
        self._reading = self._request() if kind == "request" else self._response()

    def feed(self, data: bytes) -> HttpRequest | HttpResponse | None:
        """The message, once it is whole. What comes after it is thrown away.

        Raises:
            PacketError: this is not such a message, or it is too large.
        """
        self._data += data
        try:
            next(self._reading)
        except StopIteration as end:
            message: HttpRequest | HttpResponse = end.value
            return message
        return None

    def end(self) -> HttpRequest | HttpResponse:
        """The connection has ended, which ends a response that does not give its length.

        Raises:
            PacketError: the message is not whole.
        """
        self._has_ended = True
        message = self.feed(b"")
        if message is None:
            raise self._error("the connection ended in the middle of it")
        return message

    def _error(self, text: str) -> PacketError:
        return PacketError(text, packet=f"HTTP {self._kind}")

    # -- the two kinds; each generator waits for bytes where it yields -----------------------------------

    def _request(self) -> _Reading[HttpRequest]:
        start, headers = yield from self._head(_REQUEST)
        yield from self._message_body(headers, 0)
        return HttpRequest(start[1].decode("ascii"), start[2].decode("latin-1"), headers, bytes(self._body))

    def _response(self) -> _Reading[HttpResponse]:
        while not self._data.startswith(_VERSION):
            if not _VERSION.startswith(self._data):
                raise self._error(f"it begins with {bytes(self._data[:80])!r}")
            yield
        while True:
            start, headers = yield from self._head(_RESPONSE)
            status = int(start[1])
            # An interim response, such as 100 Continue, comes before the one that counts.
            if status >= 200:
                break
        yield from self._message_body(headers, 0 if status in (204, 304) else None)
        return HttpResponse(status, (start[2] or b"").decode("latin-1"), headers, bytes(self._body))

    # -- head and body -----------------------------------------------------------------------------------

    def _head(self, pattern: re.Pattern[bytes]) -> _Reading[tuple[re.Match[bytes], dict[str, str]]]:
        """The start line and the headers."""
        what = f"its headers have more than {LONGEST_HEAD} bytes"
        line = yield from self._line(what)
        start = pattern.fullmatch(line)
        if start is None:
            raise self._error(f"it begins with {line[:80]!r}")
        headers: dict[str, str] = {}
        while line := (yield from self._line(what)):
            key, colon, content = line.partition(b":")
            content = content.strip(b" \t")
            if not colon or not _NAME.fullmatch(key) or not _VALUE.fullmatch(content):
                raise self._error(f"{line[:80]!r} is no header")
            name, value = key.decode("ascii").lower(), content.decode("latin-1")
            if name in headers and headers[name] != value:
                if name == "content-length":
                    raise self._error(f"two lengths of its body: {headers[name]} and {value}")
                value = f"{headers[name]}, {value}"
            headers[name] = value
        return start, headers

    def _message_body(self, headers: Mapping[str, str], otherwise: int | None) -> _Reading[None]:
        """The body; `otherwise` is its length where the headers do not give it, None up to the connection's end."""
        coding, length = headers.get("transfer-encoding"), headers.get("content-length")
        if coding is not None:
            if coding.lower() != "chunked":
                raise self._error(f"its body is coded as {coding[:80]!r}, and only chunks are read")
            yield from self._chunks()
        elif length is not None:
            if not _LENGTH.fullmatch(length) or int(length) > LONGEST_BODY:
                raise self._error(f"its body is {length[:80]!r} bytes long; {LONGEST_BODY} are the most")
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
                raise self._error(f"{line[:80]!r} is no size of a chunk")
            size = int(digits, 16)
            yield from self._take(size)
            if size and (yield from self._line(what)):
                raise self._error("a chunk is longer than it says")
        while (yield from self._line(what)):
            pass  # trailers

    def _line(self, what: str) -> _Reading[bytes]:
        """The next line; `what` is wrong where it is too long."""
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
        """Add the next bytes to the body."""
        if len(self._body) + count > LONGEST_BODY:
            raise self._error(f"its body has more than {LONGEST_BODY} bytes")
        while len(self._data) < count:
            yield
        self._body += self._data[:count]
        del self._data[:count]
