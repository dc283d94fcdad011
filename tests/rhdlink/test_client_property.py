"""Whatever a server sends, the client returns a value or raises a documented error."""

from __future__ import annotations

import itertools
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager, suppress

import pytest
from hypothesis import given
from hypothesis import strategies as st

from linkcore.clock import Stamp
from linkcore.errors import ConnectionLost, LinkError, LinkTimeout
from rhdlink import Variables
from rhdlink.variables.database import Database
from rhdlink.wire.messages import SymbolRow

HANDSHAKE = Database(read=[SymbolRow("tick", 1), SymbolRow("line", 8)], write=[SymbolRow("speed", 1)]).encode_handshake(
    "w"
)


class Says:
    """Transport that returns one of the given chunks for each receive, and no data after the last."""

    name = "says"

    def __init__(self, *chunks: bytes) -> None:
        self._chunks = deque(chunks)
        self.sent = b""
        self.is_open = False

    def open(self, timeout: float) -> None:
        self.is_open = True

    def receive(self, timeout: float | None = None) -> tuple[bytes, Stamp]:
        if not self.is_open:
            raise ConnectionLost("closed here")
        if not self._chunks:
            raise LinkTimeout("nothing more")
        return self._chunks.popleft(), Stamp.now()

    def receive_waiting(self) -> tuple[bytes, Stamp] | None:
        if not self.is_open:
            raise ConnectionLost("closed here")
        return (self._chunks.popleft(), Stamp.now()) if len(self._chunks) % 3 == 1 else None

    def send(self, data: bytes, timeout: float) -> None:
        if not self.is_open:
            raise ConnectionLost("closed here")
        self.sent += data

    def abort(self) -> None:
        self.is_open = False

    close = abort


@contextmanager
def connected(*chunks: bytes) -> Iterator[tuple[Variables, Says]]:
    with Variables() as robot:
        transport = Says(*chunks)
        options = {"access": "w", "fallback": None, "width": None, "limits": None}
        robot._connect("says", transport, options, 1.0, "discard")
        yield robot, transport


pieces = st.sampled_from(
    [b"aw", b"tw", b"tr", b"dw", b"dr", b"ee", b"\0\0\0\0", b"\0\0\0\1", b"\0\0\0\2", b"dr\0\0\0\0ee", HANDSHAKE]
) | st.binary(min_size=1, max_size=12)


@pytest.mark.property
@given(st.lists(pieces, max_size=20))
def test_any_handshake_is_decoded_or_raises_a_link_error(chunks: list[bytes]) -> None:
    with suppress(LinkError), connected(*chunks) as (robot, _):
        # Encoding the decoded handshake must reproduce the received bytes; the last byte carries no information.
        again = robot._known().database.encode_handshake("w", robot.width)
        assert b"".join(chunks).startswith(again[:-1])


@pytest.mark.property
@given(st.lists(pieces, max_size=20))
def test_any_bytes_after_a_handshake_keep_or_end_the_link(chunks: list[bytes]) -> None:
    with connected(HANDSHAKE, *chunks) as (robot, transport):
        for number in itertools.count():
            robot["speed"] = number
            try:
                robot.sync()
            except LinkTimeout:
                assert transport.is_open
                break
            except LinkError:
                assert not transport.is_open
                break
        # At most one request is unanswered: there is one before each reply, and one before the timeout.
        assert transport.sent.count(b"rw") <= number + 1
        assert robot["line"].shape == (8,)
