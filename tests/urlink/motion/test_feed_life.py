"""Life of a stream of points: the events of each phase, and whether points can be sent in it."""

from __future__ import annotations

import pytest

from urlink.motion.stream.feed_life import TRANSITIONS, FeedEvent, FeedLife, FeedPhase


@pytest.mark.parametrize("event", FeedEvent)
@pytest.mark.parametrize("phase", FeedPhase)
def test_feed_event_outside_transition_table_raises(phase: FeedPhase, event: FeedEvent) -> None:
    life = FeedLife()
    life.phase = phase
    if (phase, event) in TRANSITIONS:
        life.fire(event)
        assert life.phase is TRANSITIONS[phase, event]
    else:
        with pytest.raises(RuntimeError, match=f"'{event.value}' cannot happen while it is {phase.value}"):
            life.fire(event)
        assert life.phase is phase


def test_every_phase_of_a_feed_can_be_reached() -> None:
    reached, waiting = {FeedPhase.STARTING}, [FeedPhase.STARTING]
    while waiting:
        phase = waiting.pop()
        after = {end for (begin, _), end in TRANSITIONS.items() if begin is phase} - reached
        reached |= after
        waiting += after
    assert reached == set(FeedPhase)


def test_refused_replacement_keeps_stream_cleared() -> None:
    life = FeedLife()
    for event in (FeedEvent.REST, FeedEvent.RESUME, FeedEvent.ACCEPT, FeedEvent.CLEAR, FeedEvent.REPLACE):
        life.fire(event)
    assert (life.is_open, life.is_cut) == (True, True)
    life.fire(FeedEvent.REFUSE)
    assert (life.phase, life.is_cut) == (FeedPhase.CLEARED, False)
    life.fire(FeedEvent.CLOSE)
    assert not life.is_open
