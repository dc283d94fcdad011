"""Life cycle of an abandoned program: every event in every phase, and the name afterwards."""

from __future__ import annotations

import pytest

from urlink.command.given_up import TRANSITIONS, GivenUpEvent, GivenUpPhase, GivenUpProgram

#: Events that lead to each phase.
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
def test_event_changes_phase_and_name_as_in_the_table(phase: GivenUpPhase, event: GivenUpEvent) -> None:
    program = given_up(phase)
    program.fire(event, "second")
    assert program.phase is TRANSITIONS[phase, event]
    assert program.name == (None if program.phase is GivenUpPhase.NONE else "second")
    program = given_up(phase)
    if phase is not GivenUpPhase.NONE:
        program.fire(event)
        assert program.name == (None if program.phase is GivenUpPhase.NONE else "first")


@pytest.mark.parametrize("event", [each for each in GivenUpEvent if each.name not in ("GIVE_UP", "KEEP")])
def test_event_without_abandoned_program_changes_nothing(event: GivenUpEvent) -> None:
    program = given_up(GivenUpPhase.NONE)
    program.fire(event)
    assert program.phase is GivenUpPhase.NONE


def test_hinder_event_changes_phase_clear_to_kept() -> None:
    program = given_up(GivenUpPhase.CLEAR)
    program.fire(GivenUpEvent.HINDER)
    assert (program.phase, program.is_kept) == (GivenUpPhase.KEPT, True)


def test_program_that_ends_while_its_stop_is_sent_is_forgotten() -> None:
    program = given_up(GivenUpPhase.KEPT)
    program.fire(GivenUpEvent.END)
    program.fire(GivenUpEvent.DELIVER)
    program.fire(GivenUpEvent.MISS)
    assert (program.phase, program.is_kept) == (GivenUpPhase.NONE, False)
