"""Life cycle of a connection: every event in every phase, and the consequences of the transition table."""

from __future__ import annotations

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from linkcore.errors import ConnectFailed, ConnectionLost, WrongPeer
from linkcore.streaming.connection_life import (
    STATES,
    TRANSITIONS,
    Backoff,
    ConnectionLife,
    ConnectionPhase,
    ConnectionState,
    LifeEvent,
)

#: Events of the reader, which are all events except `USE` and `CLOSE` of users.
READER = tuple(event for event in LifeEvent if event not in (LifeEvent.USE, LifeEvent.CLOSE))


def life(phase: ConnectionPhase = ConnectionPhase.IDLE, waits: int = 2) -> ConnectionLife:
    made = ConnectionLife("script", Backoff(first=0.5, factor=2.0, jitter=0.0, tries=waits))
    made.phase = phase
    return made


@pytest.mark.parametrize(("phase", "event"), list(itertools.product(ConnectionPhase, LifeEvent)))
def test_invalid_transition_raises_and_keeps_the_phase(phase: ConnectionPhase, event: LifeEvent) -> None:
    one = life(phase)
    after = TRANSITIONS.get((phase, event))
    if after is None:
        with pytest.raises(RuntimeError, match=f"script: '{event.value}' cannot happen while it is {phase.value}"):
            one.fire(event)
        assert one.phase is phase
    else:
        assert one.fire(event) is after[1]
        assert one.phase is after[0]


def test_closed_connection_stays_closed() -> None:
    for phase in ConnectionPhase:
        one = life(phase)
        one.fire(LifeEvent.CLOSE)
        assert one.is_closed
        assert one.is_over
        assert STATES[one.phase] is ConnectionState.CLOSED
    for (phase, _), (after, _) in TRANSITIONS.items():
        if phase in (ConnectionPhase.CLOSING, ConnectionPhase.CLOSED):
            assert after in (ConnectionPhase.CLOSING, ConnectionPhase.CLOSED)


@given(st.lists(st.sampled_from(LifeEvent), max_size=40))
@pytest.mark.property
def test_reported_state_equals_current_state(events: list[LifeEvent]) -> None:
    one = life()
    for event in events:
        if (one.phase, event) not in TRANSITIONS:
            continue
        announced = one.fire(event)
        if announced is not None and not one.is_closed:
            assert announced is STATES[one.phase]
        if one.phase is ConnectionPhase.CLOSED:
            assert not any((ConnectionPhase.CLOSED, each) in TRANSITIONS for each in READER)


@given(st.lists(st.sampled_from(READER), max_size=20))
@pytest.mark.property
def test_closing_connection_always_reaches_closed(events: list[LifeEvent]) -> None:
    one = life(ConnectionPhase.CONNECTED)
    one.fire(LifeEvent.CLOSE)
    for event in events:
        if one.phase is ConnectionPhase.CLOSING:
            one.fire(event)
    if one.phase is ConnectionPhase.CLOSING:
        one.fire(LifeEvent.REST)
    assert one.phase is ConnectionPhase.CLOSED


def test_first_connection_is_not_retried_while_a_caller_waits() -> None:
    one = life()
    one.use(is_patient=False, received=0)
    one.fire(LifeEvent.CONNECT)
    assert one.lose(ConnectFailed("refused")) is ConnectionState.LOST
    assert one.retry_after(0) is None
    assert one.end(one.error) is ConnectionState.IDLE
    assert isinstance(one.attempt.failure, ConnectFailed)
    one.fire(LifeEvent.REST)
    one.use(is_patient=True, received=0)
    assert one.error is one.failure is one.attempt.failure is None


def test_reconnection_waits_grow_until_packets_arrive() -> None:
    one = life()
    one.use(is_patient=True, received=3)
    waits = []
    for received in (3, 3, 4, 4, 4):
        one.fire(LifeEvent.CONNECT)
        one.lose(ConnectionLost("gone"))
        waits.append(one.retry_after(received))
    assert waits == [0.5, 1.0, 0.5, 1.0, None]


def test_wrong_peer_is_retried_only_after_it_sent_packets() -> None:
    one = life()
    one.use(is_patient=True, received=0)
    one.fire(LifeEvent.CONNECT)
    one.lose(WrongPeer("a web server"))
    assert one.retry_after(0) is None
    assert one.retry_after(1) == 0.5


def test_end_of_a_recording_is_not_a_failure() -> None:
    one = life(ConnectionPhase.CONNECTED)
    one.attempt.has_opened = True
    assert one.end(None) is ConnectionState.CLOSED
    assert one.is_over
    assert not one.is_closed
    one.fire(LifeEvent.REST)
    assert one.phase is ConnectionPhase.OVER
