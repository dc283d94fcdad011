"""Arguments of streams: invalid values raise at once with the expected value. Also the reprs of public objects."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from decimal import Decimal
from fractions import Fraction
from typing import Any

import numpy as np
import pytest

from linkcore.arguments import Default, check_callable, check_number, check_overridden, check_seconds, check_wait
from linkcore.errors import BadValue
from linkcore.net.transport import Finished
from linkcore.streaming.connection import Connection
from linkcore.streaming.connection_life import ConnectionEvent, Traffic
from linkcore.streaming.fanout import FanOut
from linkcore.streaming.packet_queue import block, drop_oldest
from linkcore.streaming.stream import Stream
from linkcore.wire.packet import State
from tests.fakes.link import Count, CountProtocol, ScriptedTransport, counts, scripted

pytestmark = pytest.mark.simulated_time


@pytest.mark.parametrize("value", [-1, -1e-9, math.nan, "1", b"1", None, [], "soon", True, False])
def test_check_seconds_rejects_invalid_values(value: object) -> None:
    with pytest.raises(BadValue, match=r"timeout=.*; expected a number of seconds, 0 or more"):
        check_seconds(value, "timeout")


@pytest.mark.parametrize("value", [0, 0.0, 2, 1e300, math.inf])
def test_check_seconds_accepts_numbers(value: float) -> None:
    assert check_seconds(value, "timeout") == value


def test_check_seconds_rejects_zero_when_positive() -> None:
    with pytest.raises(BadValue, match="deadline=0; expected a positive number"):
        check_seconds(0, "deadline", positive=True)


@pytest.mark.parametrize("value", [1e10, 9.3e9, 1e308, 10**400, math.inf])
@pytest.mark.parametrize("check", [check_wait, lambda value: check_seconds(value, "wait", finite=True)])
def test_check_wait_rejects_waits_beyond_the_system_limit(value: float, check: Callable[[float], float]) -> None:
    with pytest.raises(BadValue, match=r"wait=.*; expected a number of seconds, 0 or more"):
        check(value)


def test_check_wait_accepts_the_longest_wait_of_the_system() -> None:
    assert check_wait(threading.TIMEOUT_MAX) == threading.TIMEOUT_MAX


def test_check_overridden_rejects_values_that_are_not_defaults() -> None:
    check_overridden("time sets the duration", speed=Default(1.05), delay=None)
    with pytest.raises(BadValue, match=r"speed=1\.05 would be ignored, since time sets the duration; omit speed"):
        check_overridden("time sets the duration", speed=1.05)


@pytest.mark.parametrize("value", [True, np.bool_(True), "1", None, 1j, [1]])
def test_check_number_rejects_other_types(value: object) -> None:
    with pytest.raises(BadValue, match="expected a number"):
        check_number(value, "fraction")


@pytest.mark.parametrize("value", [Decimal("0.5"), Fraction(1, 2), np.float32(0.5)])
def test_check_number_returns_a_float(value: Any) -> None:
    checked = check_number(value, "fraction")
    assert type(checked) is float
    assert checked == 0.5


def test_check_callable_rejects_other_objects() -> None:
    check_callable(print, "callback")
    with pytest.raises(BadValue, match="callback=3; expected a function"):
        check_callable(3, "callback")


@pytest.mark.parametrize(
    ("arguments", "options", "says"),
    [
        ((3,), {}, "callback=3; expected a function"),
        ((None,), {}, "callback=None"),
        ((print, 3), {}, "kind=3; expected a class of packets such as Count"),
        ((print, Count(number=1)), {}, "kind=Count"),
        ((print, int), {}, "kind=<class 'int'>; expected a class of packets"),
        ((print,), {"policy": "latest"}, r"policy='latest'; expected latest, drop_oldest\(n\) or block"),
        ((print,), {"policy": drop_oldest}, r"policy=<function drop_oldest.*expected latest"),
        ((print,), {"deadline": 0}, "deadline=0; expected a positive number of seconds"),
        ((print,), {"deadline": "soon"}, "deadline='soon'"),
        ((print,), {"deadline": 1.0, "on_deadline": 3}, "on_deadline=3; expected a function"),
        ((print,), {"on_deadline": print}, "on_deadline was given without a deadline"),
        ((print,), {"policy": block, "inline": True}, "cannot be combined with policy"),
    ],
)
def test_subscribe_errors_name_the_expected_value(
    stream: Stream[Count], transport: ScriptedTransport, arguments: Any, options: Any, says: str
) -> None:
    with pytest.raises(BadValue, match=says):
        stream.subscribe(*arguments, **options)
    assert transport.opened == 0, "the error must come before the stream connects"


def test_every_call_rejects_an_invalid_timeout(stream: Stream[Count], transport: ScriptedTransport) -> None:
    subscription = stream.subscribe(lambda count: None)
    for call in (
        stream.wait,
        stream.join,
        stream.close,
        subscription.close,
        subscription.finish,
        subscription.join,
        lambda timeout: stream.iterate(timeout=timeout),
    ):
        with pytest.raises(BadValue, match="timeout=-1"):
            call(-1)
    with pytest.raises(BadValue, match="policy='latest'"):
        stream.iterate("latest")  # type: ignore[arg-type]


def test_infinite_timeouts_are_accepted(stream: Stream[Count], transport: ScriptedTransport) -> None:
    """Infinity, and times beyond the range of the clocks of the operating system."""
    transport.put(counts(1), Finished())
    subscription = stream.subscribe(lambda count: None, deadline=1e300)
    assert stream.join(math.inf)
    assert subscription.join(1e300)
    assert subscription.finish(math.inf)


class Other(State):
    """State that a stream of `Count` never contains."""


class Near(Count):
    """State that a stream of `Count` could contain."""


def test_of_rejects_packet_classes_of_other_streams(stream: Stream[Count], transport: ScriptedTransport) -> None:
    for use in (stream.of, lambda kind: stream.subscribe(print, kind)):
        with pytest.raises(BadValue, match="script has no packets of class Other; expected one of Count"):
            use(Other)
    for kind in (Count, State, Near, ConnectionEvent, Traffic):
        assert stream.of(kind)
    assert transport.opened == 0


def test_of_accepts_additional_declared_classes(transport: ScriptedTransport) -> None:
    fan_out = FanOut(Count, parts=lambda packet: (), others=(Other,))
    stream = Stream(Connection("script", transport, CountProtocol, fan_out), Count)
    assert stream.of(Other)


# -- objects that users get --------------------------------------------------------------------------------


def test_reprs_show_the_state_of_the_objects(stream: Stream[Count], transport: ScriptedTransport) -> None:
    assert repr(stream) == "<Stream of Count from script: idle, 0 Hz, nothing received>"
    subscription = stream.subscribe(lambda count: None)
    transport.put(counts(1, 2), Finished())
    assert stream.join(10)
    assert repr(stream).startswith("<Stream of Count from script: closed, ")
    assert "2 received, the last 0." in repr(stream)
    assert repr(stream.of(Count)) == "<Feed of Count from script>"
    assert repr(subscription) == "<Subscription script Count: 2 delivered, 0 dropped, 0 raised, 0 waiting>"


def public(held: object) -> set[str]:
    return {name for name in dir(held) if not name.startswith("_")}


def test_dir_lists_public_names_only(stream: Stream[Count], transport: ScriptedTransport) -> None:
    feed = {"history", "iterate", "latest", "plot", "subscribe", "wait", "wait_until"}
    assert public(stream.of(Count)) == feed
    whole = {"close", "connection", "description", "failure", "join", "name", "of", "start", "stats"}
    assert public(stream) == feed | whole
    assert public(stream.subscribe(print)) == {"close", "finish", "join", "name", "stats"}
    with stream.history(1.0) as history:
        assert public(history) == {"array", "close"}


def test_stream_reports_the_name_that_it_was_given(transport: ScriptedTransport) -> None:
    assert scripted(transport, name="left").name == "left"
