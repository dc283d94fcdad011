"""What clients say and are told, without a socket."""

from __future__ import annotations

import pytest

from rhdlink.smrcl.dialogue import MOST_COMMANDS, ClientDialogue
from rhdlink.smrcl.recipients import Session
from tests.rhdlink.smrcl.bench import Bench

PROFILES = pytest.mark.parametrize("profile", ["sound", "mrc"])


class Talk:
    """A dialogue with a client."""

    def __init__(self, profile: str = "sound") -> None:
        self.bench = Bench("velomega", profile)
        self.dialogue: ClientDialogue = self.bench.controller.serve()
        self.client = self.dialogue.connect()
        self.bench.run(cycles=25)

    def say(self, *lines: str, client: Session | None = None) -> list[str]:
        """Send lines in one cycle; what is answered in that cycle."""
        who = client or self.client
        who.receive("".join(f"{line}\n" for line in lines).encode("latin-1"))
        self.bench.cycle()
        return who.take().decode("latin-1").splitlines()

    def go_on(self, cycles: int) -> list[str]:
        """What the client is told within some cycles."""
        self.bench.run(cycles=cycles)
        return self.client.take().decode("latin-1").splitlines()


@PROFILES
def test_a_command_is_queued_started_and_ended(profile: str) -> None:
    talk = Talk(profile)
    assert talk.say("fwd 0.05", "wait 0.1", "a = 2", "nonsense") == [f"ID{number} queued" for number in (1, 2, 3, 4)]
    talk.go_on(300)
    told = [talk.say("getevent 0")[0] for _ in range(6)]
    assert told == [
        *("ID1 started", "ID1 stopcond 0.000000", "ID2 started", "ID2 stopcond 0.000000"),
        *("ID3 assignment", "ID4 syntaxerror"),
    ]
    assert talk.say("getevent 0") == ["eventtimeout"]
    assert talk.dialogue.failures[-1].text == "nonsense"


def test_what_cannot_be_computed_ends_its_command_only() -> None:
    talk = Talk("mrc")
    talk.say('set "odowidth" 0', "drivetopoint 1e200 0 0 0", "b = 5")
    talk.go_on(20)
    (failure,) = talk.dialogue.failures
    assert (failure.line, failure.column) == (1, 1)
    assert failure.reason.startswith("the motion cannot be computed: ")
    assert talk.say("eval b") == ["5.000000 "]
    assert talk.bench.speeds[-1] == (0.0, 0.0)


def test_a_watch_and_the_stop_input_end_no_dialogue() -> None:
    talk = Talk()
    talk.say('array "q" 2', "b = 0", 'addwatch "w" 1 : (q[b] > 1)', "b = 5")
    talk.go_on(20)
    talk.say('routeinput "mrc" "mrccontrol" "stop" "odox"', "fwd 0.5")
    talk.go_on(300)
    assert [failure.reason for failure in talk.dialogue.failures] == [
        'watch "w": index 5 is beyond q, which has values q[0] to q[1]',
        "the input stop of mrccontrol is not 0",
    ]
    assert talk.say("eval b") == ["5.000000 "]
    assert talk.bench.speeds[-1] == (0.0, 0.0)


@PROFILES
def test_ends_of_lines_may_be_of_any_kind(profile: str) -> None:
    talk = Talk(profile)
    talk.client.receive(b"eval 1\r\neval 2\n\reval 3\reval 4\n\n\neval ")
    talk.client.receive(b"5\n")
    assert talk.say() == [f"{number}.000000 " for number in (1, 2, 3, 4, 5)]


@PROFILES
def test_an_event_is_waited_for(profile: str) -> None:
    talk = Talk(profile)
    assert talk.say("getevent 0.1") == []
    assert talk.go_on(9) == []
    assert talk.go_on(1) == ["eventtimeout"]
    assert talk.say("getevent 5", 'putevent "x"') == ["ID1 queued", "userevent x"]


@PROFILES
def test_expressions_are_answered_while_the_robot_moves(profile: str) -> None:
    talk = Talk(profile)
    talk.say("fwd 1 : ($odox > 0.3)")
    talk.go_on(50)
    (answer,) = talk.say("eval $odox > 0 ; 1+1")
    assert answer == "1.000000 2.000000 "
    assert talk.say("eval nosuch", "eval", "eval 1 +", "evaluate", "eval a = 1") == ["syntaxerror"] * 5
    talk.say('setvar "$odox" 5', 'setvar "nosuch" 5')
    assert talk.go_on(3) == []
    assert talk.say("eval $odox > 5") == ["1.000000 "]


@PROFILES
def test_plans_are_kept_run_and_deleted(profile: str) -> None:
    talk = Talk(profile)
    plan = [
        "beginplan p",
        "plan   n = 0",
        'plan label "a"',
        "plan n = n + 1",
        'plan if (n < 3) "a"',
        "plan wait 0.02",
        "endplan",
    ]
    assert talk.say(*plan) == ["ok"] * 7
    assert talk.say("runplan p") == ["ID1 queued"]
    talk.go_on(10)
    assert talk.say("eval n") == ["3.000000 "]
    assert talk.say("deleteplan p", "runplan p") == ["ok", "ID2 queued"]
    assert [talk.say("getevent 0")[0] for _ in range(3)] == ["ID1 started", "ID1 stopcond 0.000000", "ID2 assignment"]


@PROFILES
def test_there_is_room_for_ten_plans(profile: str) -> None:
    talk = Talk(profile)
    assert talk.say(*(f"beginplan {number}" for number in range(11))) == ["ok"] * 10 + [
        "error there are 10 plans already"
    ]
    assert talk.say("plan fwd 1")[0].startswith("error")


@PROFILES
def test_a_goto_from_a_client_stays_out_of_old_plans(profile: str) -> None:
    talk = Talk(profile)
    talk.say("beginplan p", 'plan label "a"', "plan wait 0.02", "endplan", "runplan p")
    talk.go_on(20)
    talk.say('goto "a"', "return")
    told = [talk.say("getevent 0")[0] for _ in range(4)]
    assert told[2:] == ["ID2 syntaxerror", "ID3 syntaxerror"]


@PROFILES
def test_too_many_commands_are_refused(profile: str) -> None:
    talk = Talk(profile)
    talk.say("drive")
    answers: list[str] = []
    for _ in range(6):
        answers += talk.say(*["fwd 1"] * 80)
    answers += talk.go_on(3)
    assert answers.count(f"ID{MOST_COMMANDS + 1} queued") == 1
    assert answers[-1] == "ID481 refused"
    assert len(talk.dialogue.queue) == MOST_COMMANDS


def test_flushing_stops_the_robot() -> None:
    for profile, stands in (("sound", True), ("mrc", False)):
        talk = Talk(profile)
        talk.say("drive", "fwd 1")
        talk.go_on(50)
        assert talk.say("flushcmds") == ["ID1 flushed"]
        talk.go_on(20)
        assert (talk.bench.speeds[-1][0] == 0.0) == stands
        assert len(talk.dialogue.queue) == 0


def test_a_client_that_is_lost_stops_what_it_began() -> None:
    for profile, stands in (("sound", True), ("mrc", False)):
        talk = Talk(profile)
        other = talk.dialogue.connect()
        talk.say("drive", "fwd 1")
        talk.say("wait 0.1", client=other)
        talk.go_on(50)
        talk.dialogue.disconnect(talk.client)
        talk.bench.run(cycles=20)
        assert (talk.bench.speeds[-1][0] == 0.0) == stands
        assert (talk.say("getevent 0", client=other) == ["ID1 started"]) == stands


def test_a_motion_before_the_flush_goes_over_into_one_behind_it() -> None:
    talk = Talk()
    talk.say("drive")
    talk.go_on(150)
    talk.say("flushcmds", "drive")
    talk.go_on(5)
    assert talk.bench.speeds[-1][0] > 0.28


@PROFILES
def test_each_client_has_its_own_ids_events_and_form(profile: str) -> None:
    talk = Talk(profile)
    other = talk.dialogue.connect()
    assert talk.say('set "xmlon" 1', client=other) == ["ID1 queued", '<cmd id="1" status="started" />']
    assert talk.say("wait 0.02") == ["ID1 queued"]
    talk.bench.run(cycles=10)
    assert other.take() == b'<cmd id="1" status="finished" stopcond="0.000000" />\n'
    assert talk.say("getevent 0") == ["ID1 started"]
    assert talk.say("eval $odox;3*4", client=other) == ['<eval odox="0.000000" *4="12.000000" />']


@PROFILES
def test_variables_are_streamed(profile: str) -> None:
    talk = Talk(profile)
    talk.say('stream 4 "$odox" "$cmdtime"')
    lines = talk.go_on(20)
    assert len(lines) == 5
    assert all(line.startswith("stream 0.") for line in lines)
    assert talk.say('stream 0 "$odox"')[-1].startswith(("stream ", "ID2"))


@PROFILES
def test_watches_and_the_status_of_motion_are_told(profile: str) -> None:
    talk = Talk(profile)
    talk.say('addwatch "far" 1 : ($odox > 0.02)', "fwd 0.1")
    talk.go_on(200)
    told = []
    while (event := talk.say("getevent 0")[0]) != "eventtimeout":
        told.append(event)
    assert sum(event.startswith("watch far fired ") for event in told) == 1


def test_exit_ends_one_client_or_all_of_it() -> None:
    talk = Talk("mrc")
    talk.say("drive")
    assert talk.say("exit") == ["ok"]
    talk.bench.run(cycles=3)
    assert talk.bench.controller.is_finished
    talk = Talk("sound")
    talk.say("drive")
    assert talk.say("exit") == ["ok"]
    talk.bench.run(cycles=10)
    assert not talk.bench.controller.is_finished
    assert (talk.client.is_closed, talk.bench.speeds[-1]) == (True, (0.0, 0.0))


@PROFILES
def test_a_client_that_does_not_behave_is_given_up(profile: str) -> None:
    talk = Talk(profile)
    talk.client.receive(b"x" * 300)
    assert talk.client.is_closed
    assert talk.client.take().startswith(b"error a line has at most 255 characters")
    talk = Talk(profile)
    for _ in range(200):
        talk.client.receive(b"laserscan\n" * 100)
        talk.bench.cycle()
    assert talk.client.is_closed


@PROFILES
def test_what_a_client_sends_at_once_is_taken_cycle_by_cycle(profile: str) -> None:
    talk = Talk(profile)
    talk.client.receive(b"\n" * 5000)
    talk.bench.cycle()
    assert talk.client.backlog == 4900


@PROFILES
def test_a_read_waits_for_its_condition(profile: str) -> None:
    talk = Talk(profile)
    assert talk.say('read "well? " : ($cmdtime > 0.1)') == ["ID1 queued", "well? "]
    talk.go_on(30)
    assert [talk.say("getevent 0")[0] for _ in range(2)] == ["ID1 started", "ID1 stopcond 1.000000"]


def test_a_read_ends_with_a_line_of_its_client() -> None:
    for profile, is_read in (("sound", True), ("mrc", False)):
        talk = Talk(profile)
        other = talk.dialogue.connect()
        talk.say('read "well? "', 'stringcat "$str" "!"')
        assert talk.say("eval 1", client=other) == ["1.000000 "]
        answers = talk.say("yes")
        talk.go_on(5)
        assert answers == ([] if is_read else ["ID3 queued"])
        assert talk.bench.controller.effects.text_buffer == ("yes!" if is_read else "")
