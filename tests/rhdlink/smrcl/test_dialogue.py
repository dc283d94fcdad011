"""Dialogue with clients, without sockets."""

from __future__ import annotations

import pytest

from rhdlink.smrcl.dialogue import MOST_COMMANDS, ClientDialogue
from rhdlink.smrcl.recipients import Session
from tests.rhdlink.smrcl.bench import Bench

PROFILES = pytest.mark.parametrize("profile", ["sound", "mrc"])


class Talk:
    """Dialogue with one client on a bench."""

    def __init__(self, profile: str = "sound") -> None:
        self.bench = Bench("velomega", profile)
        self.dialogue: ClientDialogue = self.bench.controller.serve()
        self.client = self.dialogue.connect()
        self.bench.run(cycles=25)

    def exchange(self, *lines: str, client: Session | None = None) -> list[str]:
        """Send lines in one cycle and return the answers of that cycle."""
        who = client or self.client
        who.receive("".join(f"{line}\n" for line in lines).encode("latin-1"))
        self.bench.cycle()
        return who.take().decode("latin-1").splitlines()

    def advance(self, cycles: int) -> list[str]:
        """Run some cycles and return the lines that the client receives."""
        self.bench.run(cycles=cycles)
        return self.client.take().decode("latin-1").splitlines()


@PROFILES
def test_command_is_queued_started_and_ended(profile: str) -> None:
    talk = Talk(profile)
    assert talk.exchange("fwd 0.05", "wait 0.1", "a = 2", "nonsense") == [
        f"ID{number} queued" for number in (1, 2, 3, 4)
    ]
    talk.advance(300)
    events = [talk.exchange("getevent 0")[0] for _ in range(6)]
    assert events == [
        *("ID1 started", "ID1 stopcond 0.000000", "ID2 started", "ID2 stopcond 0.000000"),
        *("ID3 assignment", "ID4 syntaxerror"),
    ]
    assert talk.exchange("getevent 0") == ["eventtimeout"]
    assert talk.dialogue.failures[-1].text == "nonsense"


def test_impossible_motion_fails_but_next_command_runs() -> None:
    talk = Talk("mrc")
    talk.exchange('set "odowidth" 0', "drivetopoint 1e200 0 0 0", "b = 5")
    talk.advance(20)
    (failure,) = talk.dialogue.failures
    assert (failure.line, failure.column) == (1, 1)
    assert failure.reason.startswith("the motion cannot be computed: ")
    assert talk.exchange("eval b") == ["5.000000 "]
    assert talk.bench.speeds[-1] == (0.0, 0.0)


def test_watch_errors_and_stop_input_do_not_end_the_dialogue() -> None:
    talk = Talk()
    talk.exchange('array "q" 2', "b = 0", 'addwatch "w" 1 : (q[b] > 1)', "b = 5")
    talk.advance(20)
    talk.exchange('routeinput "mrc" "mrccontrol" "stop" "odox"', "fwd 0.5")
    talk.advance(300)
    assert [failure.reason for failure in talk.dialogue.failures] == [
        'watch "w": index 5 is beyond q, which has values q[0] to q[1]',
        "the input stop of mrccontrol is not 0",
    ]
    assert talk.exchange("eval b") == ["5.000000 "]
    assert talk.bench.speeds[-1] == (0.0, 0.0)


@PROFILES
def test_lines_may_end_with_any_line_break(profile: str) -> None:
    talk = Talk(profile)
    talk.client.receive(b"eval 1\r\neval 2\n\reval 3\reval 4\n\n\neval ")
    talk.client.receive(b"5\n")
    assert talk.exchange() == [f"{number}.000000 " for number in (1, 2, 3, 4, 5)]


@PROFILES
def test_getevent_waits_for_an_event(profile: str) -> None:
    talk = Talk(profile)
    assert talk.exchange("getevent 0.1") == []
    assert talk.advance(9) == []
    assert talk.advance(1) == ["eventtimeout"]
    assert talk.exchange("getevent 5", 'putevent "x"') == ["ID1 queued", "userevent x"]


@PROFILES
def test_eval_is_answered_while_the_robot_moves(profile: str) -> None:
    talk = Talk(profile)
    talk.exchange("fwd 1 : ($odox > 0.3)")
    talk.advance(50)
    (answer,) = talk.exchange("eval $odox > 0 ; 1+1")
    assert answer == "1.000000 2.000000 "
    assert talk.exchange("eval nosuch", "eval", "eval 1 +", "evaluate", "eval a = 1") == ["syntaxerror"] * 5
    talk.exchange('setvar "$odox" 5', 'setvar "nosuch" 5')
    assert talk.advance(3) == []
    assert talk.exchange("eval $odox > 5") == ["1.000000 "]


@PROFILES
def test_plans_are_stored_run_and_deleted(profile: str) -> None:
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
    assert talk.exchange(*plan) == ["ok"] * 7
    assert talk.exchange("runplan p") == ["ID1 queued"]
    talk.advance(10)
    assert talk.exchange("eval n") == ["3.000000 "]
    assert talk.exchange("deleteplan p", "runplan p") == ["ok", "ID2 queued"]
    assert [talk.exchange("getevent 0")[0] for _ in range(3)] == [
        "ID1 started",
        "ID1 stopcond 0.000000",
        "ID2 assignment",
    ]


@PROFILES
def test_number_of_plans_is_limited_to_ten(profile: str) -> None:
    talk = Talk(profile)
    assert talk.exchange(*(f"beginplan {number}" for number in range(11))) == ["ok"] * 10 + [
        "error there are 10 plans already"
    ]
    assert talk.exchange("plan fwd 1")[0].startswith("error")


@PROFILES
def test_goto_or_return_of_a_client_is_rejected_as_syntax_error(profile: str) -> None:
    talk = Talk(profile)
    talk.exchange("beginplan p", 'plan label "a"', "plan wait 0.02", "endplan", "runplan p")
    talk.advance(20)
    talk.exchange('goto "a"', "return")
    events = [talk.exchange("getevent 0")[0] for _ in range(4)]
    assert events[2:] == ["ID2 syntaxerror", "ID3 syntaxerror"]


@PROFILES
def test_too_many_commands_are_refused(profile: str) -> None:
    talk = Talk(profile)
    talk.exchange("drive")
    answers: list[str] = []
    for _ in range(6):
        answers += talk.exchange(*["fwd 1"] * 80)
    answers += talk.advance(3)
    assert answers.count(f"ID{MOST_COMMANDS + 1} queued") == 1
    assert answers[-1] == "ID481 refused"
    assert len(talk.dialogue.queue) == MOST_COMMANDS


def test_flushcmds_stops_the_robot_in_the_sound_profile() -> None:
    for profile, stops in (("sound", True), ("mrc", False)):
        talk = Talk(profile)
        talk.exchange("drive", "fwd 1")
        talk.advance(50)
        assert talk.exchange("flushcmds") == ["ID1 flushed"]
        talk.advance(20)
        assert (talk.bench.speeds[-1][0] == 0.0) == stops
        assert len(talk.dialogue.queue) == 0


def test_lost_client_stops_its_commands_in_sound_profile() -> None:
    for profile, stops in (("sound", True), ("mrc", False)):
        talk = Talk(profile)
        other = talk.dialogue.connect()
        talk.exchange("drive", "fwd 1")
        talk.exchange("wait 0.1", client=other)
        talk.advance(50)
        talk.dialogue.disconnect(talk.client)
        talk.bench.run(cycles=20)
        assert (talk.bench.speeds[-1][0] == 0.0) == stops
        assert (talk.exchange("getevent 0", client=other) == ["ID1 started"]) == stops


def test_motion_after_flushcmds_continues_at_current_speed() -> None:
    talk = Talk()
    talk.exchange("drive")
    talk.advance(150)
    talk.exchange("flushcmds", "drive")
    talk.advance(5)
    assert talk.bench.speeds[-1][0] > 0.28


@PROFILES
def test_each_client_has_separate_ids_events_and_format(profile: str) -> None:
    talk = Talk(profile)
    other = talk.dialogue.connect()
    assert talk.exchange('set "xmlon" 1', client=other) == ["ID1 queued", '<cmd id="1" status="started" />']
    assert talk.exchange("wait 0.02") == ["ID1 queued"]
    talk.bench.run(cycles=10)
    assert other.take() == b'<cmd id="1" status="finished" stopcond="0.000000" />\n'
    assert talk.exchange("getevent 0") == ["ID1 started"]
    assert talk.exchange("eval $odox;3*4", client=other) == ['<eval odox="0.000000" *4="12.000000" />']


@PROFILES
def test_stream_sends_variables(profile: str) -> None:
    talk = Talk(profile)
    talk.exchange('stream 4 "$odox" "$cmdtime"')
    lines = talk.advance(20)
    assert len(lines) == 5
    assert all(line.startswith("stream 0.") for line in lines)
    assert talk.exchange('stream 0 "$odox"')[-1].startswith(("stream ", "ID2"))


@PROFILES
def test_fired_watch_is_reported_once(profile: str) -> None:
    talk = Talk(profile)
    talk.exchange('addwatch "far" 1 : ($odox > 0.02)', "fwd 0.1")
    talk.advance(200)
    events = []
    while (event := talk.exchange("getevent 0")[0]) != "eventtimeout":
        events.append(event)
    assert sum(event.startswith("watch far fired ") for event in events) == 1


def test_exit_ends_one_client_or_the_whole_server() -> None:
    talk = Talk("mrc")
    talk.exchange("drive")
    assert talk.exchange("exit") == ["ok"]
    talk.bench.run(cycles=3)
    assert talk.bench.controller.is_finished
    talk = Talk("sound")
    talk.exchange("drive")
    assert talk.exchange("exit") == ["ok"]
    talk.bench.run(cycles=10)
    assert not talk.bench.controller.is_finished
    assert (talk.client.is_closed, talk.bench.speeds[-1]) == (True, (0.0, 0.0))


@PROFILES
def test_misbehaving_client_is_closed(profile: str) -> None:
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
def test_input_of_a_client_is_processed_cycle_by_cycle(profile: str) -> None:
    talk = Talk(profile)
    talk.client.receive(b"\n" * 5000)
    talk.bench.cycle()
    assert talk.client.backlog == 4900


@PROFILES
def test_read_waits_for_its_condition(profile: str) -> None:
    talk = Talk(profile)
    assert talk.exchange('read "well? " : ($cmdtime > 0.1)') == ["ID1 queued", "well? "]
    talk.advance(30)
    assert [talk.exchange("getevent 0")[0] for _ in range(2)] == ["ID1 started", "ID1 stopcond 1.000000"]


def test_read_ends_when_the_same_client_sends_a_line() -> None:
    for profile, is_read in (("sound", True), ("mrc", False)):
        talk = Talk(profile)
        other = talk.dialogue.connect()
        talk.exchange('read "well? "', 'stringcat "$str" "!"')
        assert talk.exchange("eval 1", client=other) == ["1.000000 "]
        answers = talk.exchange("yes")
        talk.advance(5)
        assert answers == ([] if is_read else ["ID3 queued"])
        assert talk.bench.controller.effects.text_buffer == ("yes!" if is_read else "")
