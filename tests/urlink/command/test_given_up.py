"""The life of a program that was given up: every event in every phase, and what the name is afterwards."""

from __future__ import annotations

import pytest

from urlink.command.given_up import TRANSITIONS, GivenUpEvent, GivenUpPhase, GivenUpProgram

#: how each phase is reached
WAYS: dict[GivenUpPhase, tuple[GivenUpEvent, ...]] = {
    GivenUpPhase.NONE: (),
    GivenUpPhase.STOPPING: (GivenUpEvent.GIVE_UP,),
    GivenUpPhase.KEPT: (GivenUpEvent.KEEP,),
    GivenUpPhase.CLEAR: (GivenUpEvent.KEEP, GivenUpEvent.FREE),
}


def given_up(phase: GivenUpPhase) -> GivenUpProgram:
    program = GivenUpProgram()
    for event in WAYS[phase]:
        program.fire(event, "first")
    assert program.phase is phase
    return program


@pytest.mark.parametrize("event", GivenUpEvent)
@pytest.mark.parametrize("phase", GivenUpPhase)
def test_name_is_that_of_the_last_event_unless_there_is_none(phase: GivenUpPhase, event: GivenUpEvent) -> None:
    program = given_up(phase)
    program.fire(event, "second")
    assert program.phase is TRANSITIONS[phase, event]
    assert program.name == (None if program.phase is GivenUpPhase.NONE else "second")
    program = given_up(phase)
    if phase is not GivenUpPhase.NONE:
        program.fire(event)
        assert program.name == (None if program.phase is GivenUpPhase.NONE else "first")


@pytest.mark.parametrize("event", [each for each in GivenUpEvent if each.name not in ("GIVE_UP", "KEEP")])
def test_nothing_is_stopped_when_none_was_given_up(event: GivenUpEvent) -> None:
    program = given_up(GivenUpPhase.NONE)
    program.fire(event)
    assert program.phase is GivenUpPhase.NONE


def test_a_stop_that_is_prevented_again_waits_for_two_more_states() -> None:
    program = given_up(GivenUpPhase.CLEAR)
    program.fire(GivenUpEvent.HINDER)
    assert (program.phase, program.is_kept) == (GivenUpPhase.KEPT, True)


def test_what_has_ended_while_its_stop_was_sent_is_not_stopped_again() -> None:
    program = given_up(GivenUpPhase.KEPT)
    program.fire(GivenUpEvent.END)
    program.fire(GivenUpEvent.DELIVER)
    program.fire(GivenUpEvent.MISS)
    assert (program.phase, program.is_kept) == (GivenUpPhase.NONE, False)
