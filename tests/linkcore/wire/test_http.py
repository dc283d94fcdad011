"""HTTP messages: encoded messages are parsed in any chunks, and all other bytes are rejected."""

from __future__ import annotations

import itertools
from collections.abc import Iterable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from linkcore.errors import BadValue, PacketError
from linkcore.wire.http import LONGEST_BODY, LONGEST_HEAD, HttpParser, HttpRequest, HttpResponse

Message = HttpRequest | HttpResponse


def read(parser: HttpParser, pieces: Iterable[bytes]) -> Message | None:
    found = None
    for piece in pieces:
        assert found is None, "the parser returned a message before its last byte"
        found = parser.feed(piece)
    return found


def cut(data: bytes, places: Iterable[int]) -> list[bytes]:
    edges = [0, *sorted({place % len(data) for place in places} - {0}), len(data)]
    return [data[begin:end] for begin, end in itertools.pairwise(edges)]


words = st.text("abcdefghijklmnop-_/", min_size=1, max_size=10)
headers = st.dictionaries(
    words.map(lambda word: "x-" + word.replace("/", "")), st.text("abc:;= xyz", max_size=20).map(str.strip), max_size=4
)
places = st.lists(st.integers(0, 10_000), max_size=6)


@pytest.mark.property
@given(st.sampled_from(["GET", "PUT", "POST"]), words, headers, st.binary(max_size=300), places)
def test_request_does_not_depend_on_chunking(
    method: str, target: str, fields: dict[str, str], body: bytes, places: list[int]
) -> None:
    data = HttpRequest(method, f"/{target}", fields, body).encode("robot:80")
    found = read(HttpParser("request"), cut(data, places))
    assert isinstance(found, HttpRequest)
    assert (found.method, found.target, found.body) == (method, f"/{target}", body)
    standing = {"host": "robot:80", "content-length": str(len(body)), "connection": "close"}
    assert found.headers == {**fields, **standing}


@pytest.mark.property
@given(
    st.integers(200, 599).filter(lambda status: status not in (204, 304)),
    st.sampled_from(["length", "chunks", "end"]),
    st.lists(st.binary(min_size=1, max_size=60), max_size=5),
    places,
)
def test_response_does_not_depend_on_coding_or_chunking(
    status: int, coding: str, parts: list[bytes], places: list[int]
) -> None:
    body = b"".join(parts)
    if coding == "length":
        data = HttpResponse(status, "So it is", {}, body).encode()
    elif coding == "chunks":
        chunks = b"".join(b"%X;a=b\r\n%s\r\n" % (len(part), part) for part in parts)
        head = b"HTTP/1.1 %d So it is\r\nTransfer-Encoding: chunked\r\n\r\n" % status
        data = head + chunks + b"0\r\nTrailer: x\r\n\r\n"
    else:
        data = b"HTTP/1.0 %d So it is\r\n\r\n" % status + body
    parser = HttpParser("response")
    found = read(parser, cut(data, places)) or parser.end()
    assert isinstance(found, HttpResponse)
    assert (found.status, found.reason, found.body) == (status, "So it is", body)


@pytest.mark.property
@given(st.sampled_from(["request", "response"]), st.binary(max_size=200), places)
def test_arbitrary_bytes_are_a_message_or_a_packet_error(kind: str, data: bytes, places: list[int]) -> None:
    for begin in (b"", b"GET / HTTP/1.1\r\n", b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n"):
        parser = HttpParser("request" if kind == "request" else "response")
        try:
            for piece in cut(begin + data + b" ", places):
                if parser.feed(piece) is not None:
                    return
            parser.end()
        except PacketError:
            pass


def test_interim_response_is_skipped_and_204_has_no_body() -> None:
    data = b"HTTP/1.1 100 Continue\r\n\r\nHTTP/1.1 204 No Content\r\nA: b\r\na: c\r\n\r\n"
    found = HttpParser("response").feed(data)
    assert found == HttpResponse(204, "No Content", {"a": "b, c"}, b"")


@pytest.mark.parametrize(
    ("kind", "data", "error"),
    [
        ("response", b"Connected: Universal Robots Dashboard Server\n", "it begins with b'Connected: Universal Robots"),
        ("response", b"HTTP/1.1 no status\r\n", "it begins with b'HTTP/1.1 no status'"),
        ("request", b"get / HTTP/1.1\r\n\r\n", "it begins with b'get / HTTP/1.1'"),
        ("request", b"GET / HTTP/1.1\r\nno header\r\n\r\n", "b'no header' is not a header"),
        ("request", b"GET / HTTP/1.1\r\nA: " + b"a" * LONGEST_HEAD, "its headers have more than 16384 bytes"),
        (
            "response",
            b"HTTP/1.1 200 OK\r\nContent-Length: 1\r\nContent-Length: 2\r\n\r\n",
            "conflicting Content-Length headers",
        ),
        ("response", b"HTTP/1.1 200 OK\r\nContent-Length: -1\r\n\r\n", "its Content-Length is '-1'"),
        ("response", b"HTTP/1.1 200 OK\r\nContent-Length: %d\r\n\r\n" % (LONGEST_BODY + 1), "at most 1048576 bytes"),
        ("response", b"HTTP/1.1 200 OK\r\n\r\n" + b"x" * (LONGEST_BODY + 1), "its body has more than 1048576"),
        ("response", b"HTTP/1.1 200 OK\r\nTransfer-Encoding: gzip\r\n\r\n", "unsupported Transfer-Encoding 'gzip'"),
        ("response", b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\nx\r\n", "b'x' is not the size of a chunk"),
        ("response", b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n1\r\nab\r\n", "longer than its size"),
        ("response", b"HTTP/1.1 200 OK\r\nContent-Length: 3\r\n\r\nab", None),
    ],
)
def test_invalid_message_raises_packet_error(kind: str, data: bytes, error: str | None) -> None:
    parser = HttpParser("request" if kind == "request" else "response")
    if error is None:
        assert parser.feed(data) is None
        with pytest.raises(PacketError, match="the connection ended before the message was complete"):
            parser.end()
    else:
        with pytest.raises(PacketError, match=error):
            parser.feed(data)


def test_line_break_in_the_target_is_rejected() -> None:
    with pytest.raises(BadValue, match="is not a valid line of HTTP"):
        HttpRequest("GET", "/a b\r\nX: y").encode("robot")


@pytest.mark.parametrize(
    "data",
    [
        b"GET /x HTTP/1.1\r\na:" + b" " * (LONGEST_HEAD - 100) + b"\n\r\n\r\n",
        b"GET /x HTTP/1.1\r\na:" + b" \t" * (LONGEST_HEAD // 2 - 100) + b"\0\r\n\r\n",
        b"GET " + b"/" * (LONGEST_HEAD - 100) + b" HTTP/1.2\r\n\r\n",
    ],
)
def test_ambiguous_http_head_is_rejected_quickly(data: bytes) -> None:
    """A backtracking regular expression would need hours for the first of these heads."""
    with pytest.raises(PacketError):
        HttpParser("request").feed(data)


def test_total_length_of_chunk_lines_is_limited() -> None:
    parser = HttpParser("response")
    parser.feed(b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n")
    chunk = b"1;" + b"x" * 2000 + b"\r\na\r\n"
    with pytest.raises(PacketError, match="the lines between its chunks have more than 1048576 bytes"):
        parser.feed(chunk * 1000)
