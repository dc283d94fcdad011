"""A program that is talked to while it runs: what is said when, and what ends it, on a clock that the test has."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace

import pytest

from linkcore.errors import BadAddress, ConnectFailed, ConnectionLost, LinkError, LocalError
from linkcore.handle import Motion, Phase
from tests.fakes.rehearsal import FOLLOW, TIMEOUT, WAIT, Rehearsal
from tests.waiting import until
from urlink.errors import NotRunning, ProgramStopped, SafetyStop, ToleranceExceeded
from urlink.motion.links.messages import setpoint
from urlink.motion.servo.linked_program import LinkedProgram
from urlink.motion.servo.setpoints import LinkDialogue
from urlink.protocol.enums import ProgramState, SafetyMode
from urlink.protocol.realtime.packets import RealtimeState
from urlink.script.links import InputRegisters, ReverseSocket

pytestmark = pytest.mark.simulated_time


class Talk(LinkDialogue):
    """A dialogue, its link, and the program that they lead; each does as the test has set it."""

    endpoint = ReverseSocket("10.0.0.1", 50001, 7)

    def __init__(self, robot: Rehearsal, *, farewell: bytes = b"bye", survives_its_program: bool = False) -> None:
        self.robot = robot
        self.now = 1000.0
        self._looks = 0
        # the dialogue
        self.farewell = farewell
        self.survives_its_program = survives_its_program
        self.is_over = False
        self.answer = b"message"
        self.concluded = 0
        #: what it was told with each state: what came, and when
        self.steps: list[tuple[bytes, float]] = []
        self.failure: Exception | None = None
        # the link
        self.opened = 0
        self.is_up = False
        self.comes_up = True
        self.polls: list[bool] = []
        self.said: list[bytes] = []
        self.heard = b""
        self.loss: LinkError | None = None
        self.closed: list[bool] = []
        # the program
        self.linked = 0
        context = replace(robot.motion._context, clock=self._clock)
        self.life = context.programs.life("talk")
        self.motion = Motion(self.life)
        self.program = LinkedProgram(self.life, context, self, self._open, on_linked=self._on_linked)

    def _clock(self) -> float:
        self._looks += 1
        return self.now

    def _open(self) -> Talk:
        self.opened += 1
        return self

    def _on_linked(self) -> None:
        self.linked += 1

    # -- as a dialogue -----------------------------------------------------------------------------------

    def body(self, link: ReverseSocket | InputRegisters) -> list[str]:
        assert link == self.endpoint
        return ["sync()"]

    def step(self, received: bytes, state: RealtimeState, now: float) -> bytes:
        self.steps.append((received, now))
        if self.failure is not None:
            raise self.failure
        return self.answer

    def conclude(self) -> None:
        self.concluded += 1

    # -- as a link ---------------------------------------------------------------------------------------

    def poll(self, has_begun: bool) -> bool:
        self.polls.append(has_begun)
        self.is_up = has_begun and self.comes_up
        return self.is_up

    def send(self, data: bytes) -> None:
        if self.loss is not None:
            raise self.loss
        self.said.append(data[:-4] if self.farewell else data)  # without its date

    def received(self) -> bytes:
        if self.loss is not None:
            raise self.loss
        return self.heard

    def absence(self, why: str) -> LinkError:
        return ConnectFailed(f"absent: {why}")

    def close(self, *, farewell: bool) -> None:
        self.closed.append(farewell)

    # -- what the test does ------------------------------------------------------------------------------

    def look(self, seconds: float = 0.0) -> None:
        """States come so much later on both clocks, of which one has been seen to its end, or it is over."""
        self.now += seconds
        self.robot.time += seconds
        looks = self._looks
        self.robot.until(lambda: self._looks >= looks + 2 or self.life.is_over)

    def begin(self) -> Talk:
        """It is sent, it begins, and it has been told the first message."""
        self.program.begin()
        self.robot.begin()
        if self.comes_up:
            self.robot.until(lambda: self.linked)
        return self

    def fails(self, error: type[Exception], message: str) -> None:
        with pytest.raises(error, match=message):
            self.motion.wait(TIMEOUT)
        assert self.motion.phase is Phase.FAILED
        until(lambda: self.closed)


@pytest.fixture
def talk(robot: Rehearsal) -> Talk:
    return Talk(robot)


def test_is_told_something_once_it_has_begun(talk: Talk) -> None:
    talk.program.begin()
    assert "urlink_cycles" not in talk.robot.uploaded  # it asks for nothing: nobody would take its connection
    talk.look()
    assert talk.polls
    assert not any(talk.polls)
    assert [talk.linked, talk.steps, talk.said] == [0, [], []]
    talk.heard = b"token"
    talk.robot.begin()
    talk.robot.until(lambda: talk.linked)
    assert talk.said[0] == b"message"
    assert talk.steps[0] == (b"token", 1000.0)
    talk.answer = b""
    talk.look()
    said = len(talk.said)
    talk.look(1.0)
    assert talk.steps[-1] == (b"token", 1001.0)
    assert len(talk.said) == said
    talk.motion.cancel()
    assert talk.said[said:] == [b"bye"]
    assert talk.closed == [True]


def test_one_that_does_not_come(talk: Talk) -> None:
    talk.comes_up = False
    talk.begin().look(5.0)
    assert not talk.motion.done
    talk.look(0.01)
    talk.fails(ConnectFailed, "absent: it did not connect within 5 s")
    assert "stopj" in talk.robot.sent[-1]
    assert [talk.said, talk.closed] == [[], [False]]
    assert talk.linked == 1  # nobody is left waiting for it


@pytest.mark.parametrize("is_told", [True, False])
def test_has_a_second_to_end_once_it_was_told_to(talk: Talk, is_told: bool) -> None:
    talk.begin().look(3.0)
    assert not talk.program.is_finishing
    talk.is_over = True
    talk.robot.until(lambda: talk.program.is_finishing)
    talk.program.finish()
    talk.look(0.5)
    assert not talk.motion.done
    assert talk.said.count(b"bye") == 1
    if is_told:
        talk.robot.finish()
    else:
        talk.look(0.6)
    talk.motion.wait(TIMEOUT)
    assert talk.motion.phase is Phase.DONE
    assert talk.closed == [True]


def test_the_farewell_is_the_last_message(talk: Talk) -> None:
    """Of two threads one may have composed a message while the other ends the program."""
    talk.begin()
    talk.program.finish()
    talk.program.say(b"composed before")
    assert talk.said[-1] == b"bye"
    talk.robot.finish()
    talk.motion.wait(TIMEOUT)


def test_what_it_says_at_its_end_does_not_count(talk: Talk) -> None:
    talk.begin()
    talk.program.finish()
    talk.robot.text("urlink: nothing to go to")
    talk.robot.text("urlink: the link ended")
    talk.robot.finish()
    talk.motion.wait(TIMEOUT)


def test_one_that_needs_no_farewell(robot: Rehearsal) -> None:
    talk = Talk(robot, farewell=b"").begin()
    talk.program.finish()
    assert b"" not in talk.said
    robot.finish()
    talk.motion.wait(TIMEOUT)
    assert talk.closed == [False]
    other = Talk(robot, farewell=b"").begin()
    other.motion.cancel()
    assert "stopj" in robot.sent[-1]
    assert [b"" in other.said, other.closed] == [False, [False]]


def test_the_reason_of_a_loss_has_a_second_to_come(talk: Talk) -> None:
    talk.begin()
    talk.loss = ConnectionLost("first")
    talk.look()
    talk.loss = None
    talk.program.lose(ConnectionLost("second"))
    talk.look(1.0)
    assert not talk.motion.done
    steps = len(talk.steps)
    talk.look(0.01)
    talk.fails(ConnectionLost, r"^the connection of the program on the robot was lost; it brakes on its own: first$")
    assert len(talk.steps) == steps
    # It is gone, and brakes by itself: there is nobody to tell.
    assert b"bye" not in talk.said
    assert not any("stopj" in text for text in talk.robot.sent)


def test_a_stop_is_the_reason_of_a_loss(talk: Talk) -> None:
    talk.begin()
    talk.loss = ConnectionLost("reset")
    talk.look()
    talk.robot.state(safety=SafetyMode.PROTECTIVE_STOP)
    talk.fails(SafetyStop, "protective stop")


def test_an_end_after_a_loss_is_the_loss(talk: Talk) -> None:
    talk.begin()
    talk.loss = ConnectionLost("reset")
    talk.look()
    talk.robot.finish()
    talk.fails(ConnectionLost, "reset")


def test_an_end_before_its_time(talk: Talk) -> None:
    talk.begin()
    talk.robot.finish()
    talk.fails(ProgramStopped, "the program of talk ended unexpectedly")


def test_one_that_goes_on_after_its_program(robot: Rehearsal) -> None:
    talk = Talk(robot, survives_its_program=True).begin()
    talk.heard = b"never mind"
    robot.finish()
    robot.until(lambda: talk.concluded)
    talk.look()
    said = len(talk.said)
    talk.look(1.0)
    assert not talk.motion.done
    # Nobody is there any more to hear or be told something, but the states still count.
    assert talk.steps[-1] == (b"", 1001.0)
    assert len(talk.said) == said
    talk.is_over = True
    talk.look()
    talk.motion.wait(TIMEOUT)
    assert talk.motion.phase is Phase.DONE


@pytest.mark.parametrize("failure", [ToleranceExceeded("off"), ZeroDivisionError("off")])
def test_a_dialogue_that_cannot_go_on(talk: Talk, failure: Exception) -> None:
    talk.begin()
    talk.failure = failure
    subscription = talk.program._subscription
    assert subscription is not None
    talk.look()
    talk.fails(type(failure), "off")
    assert talk.said[-1] == b"bye"
    # A mistake of ours is one that the subscription tells of.
    until(lambda: subscription.stats.raised == isinstance(failure, ZeroDivisionError))


@pytest.mark.parametrize(
    ("text", "error", "message"),
    [
        ("urlink: cannot connect", ConnectFailed, "absent: it reported that it was refused"),
        ("urlink: the link ended", ConnectionLost, "reported that its connection ended"),
        (
            "urlink: nothing to go to",
            ConnectionLost,
            r"reached the program on the robot in time; .*pass a larger watchdog=",
        ),
        ("urlink: the first point is too far away", ToleranceExceeded, "first point is too far away"),
    ],
)
def test_what_ends_it_is_what_it_says(talk: Talk, text: str, error: type[Exception], message: str) -> None:
    talk.begin()
    talk.robot.text("urlink: good morning")
    talk.robot.text(text)
    talk.fails(error, message)


def interrupted() -> Talk:
    raise KeyboardInterrupt


def taken() -> Talk:
    raise BadAddress("taken")


@pytest.mark.parametrize(
    ("open_link", "raised", "error"), [(taken, BadAddress, BadAddress), (interrupted, KeyboardInterrupt, LocalError)]
)
def test_a_link_that_cannot_be_had(
    talk: Talk, open_link: Callable[[], Talk], raised: type[BaseException], error: type[Exception]
) -> None:
    talk.program._open_link = open_link
    with pytest.raises(raised):
        talk.program.begin()
    assert isinstance(talk.motion.error, error)
    assert [talk.robot.sent, talk.linked, talk.closed] == [[], 1, []]


def test_an_arm_that_may_not_be_moved(talk: Talk) -> None:
    talk.robot.state(safety=SafetyMode.PROTECTIVE_STOP)
    until(lambda: talk.robot.safety.cause)
    with pytest.raises(SafetyStop):
        talk.program.begin()
    assert [talk.opened, talk.robot.sent, talk.linked] == [0, [], 1]


def test_a_program_that_cannot_be_sent(talk: Talk) -> None:
    talk.robot.slow.refusal = ConnectionLost("not sent")
    with pytest.raises(ConnectionLost, match="not sent"):
        talk.program.begin()
    talk.fails(ConnectionLost, "not sent")
    steps = len(talk.steps)
    talk.robot.show()
    assert len(talk.steps) == steps


def test_a_robot_that_is_lost_before_it_began(talk: Talk) -> None:
    """Its link is closed, so a program that the controller begins later finds nobody, and moves nothing."""
    talk.program.begin()
    talk.robot.fast.put(ConnectionLost("pulled"))
    talk.fails(NotRunning, "pulled; it moves nothing if it begins later")


def test_its_end_waits_for_no_thread(talk: Talk, monkeypatch: pytest.MonkeyPatch) -> None:
    """Who ends it may be the thread of the states, or hold up the one that is."""
    waited: list[float] = []
    talk.begin()
    monkeypatch.setattr(talk.program._subscription, "close", waited.append)
    talk.motion.cancel()
    assert waited == [0]


def test_an_arm_that_nobody_enables_any_more_can_be_stopped(talk: Talk) -> None:
    talk.begin().robot.safety.policy = "always"
    talk.motion.cancel()
    assert talk.said[-1] == b"bye"


def test_nothing_is_said_after_its_end(talk: Talk) -> None:
    talk.begin()
    talk.robot.vanish()
    talk.robot.until(lambda: talk.motion.done)
    said = len(talk.said)
    with pytest.raises(ProgramStopped):
        talk.program.say(b"late")
    talk.robot.show()
    assert len(talk.said) == said


def test_each_message_says_in_which_cycle_and_how_many_pauses_there_were(
    talk: Talk, monkeypatch: pytest.MonkeyPatch
) -> None:
    talk.answer = setpoint([0.0] * 6, [0.0] * 6)
    sent: list[bytes] = []
    monkeypatch.setattr(talk, "send", sent.append)
    talk.begin()
    assert sent[0][-4:] == bytes(4)
    for pauses in range(3):
        talk.program._pause.count = pauses
        before = int.from_bytes(sent[-1][-4:], "big")
        talk.look(0.1)
        date = int.from_bytes(sent[-1][-4:], "big")
        assert 0.1 / talk.robot.cycle <= date - before < 0.1 / talk.robot.cycle + 10  # states come meanwhile
        assert int.from_bytes(sent[-1][-8:-4], "big") == (WAIT + pauses if pauses else FOLLOW)


@pytest.mark.parametrize(
    ("silence", "says"), [(0.0, True), (0.125, True), (0.126, False), (0.25, False), (0.251, None)]
)
def test_what_a_loop_sends_after_a_silence(talk: Talk, silence: float, says: bool | None) -> None:
    """Read at once, after a controller has hung, it would be where the arm has to go with all its speed.

    So it is not sent after the time of the watchdog, and after twice that time the motion is over.
    """
    talk.begin()
    said = len(talk.said)
    talk.program._seen = talk.now - silence
    if says is None:
        with pytest.raises(
            ConnectionLost, match=r"no state for 0\.25 s, more than twice watchdog=0\.125 s, .*larger watchdog="
        ):
            talk.program.feed(b"mine", 0.125)
        talk.fails(ConnectionLost, "brakes on its own")
        assert talk.said[said:] == [b"bye"]
    else:
        talk.program.feed(b"mine", 0.125)
        assert talk.said[said:] == ([b"mine"] if says else [])


def test_a_program_that_is_paused_is_sent_nothing_by_a_loop(talk: Talk) -> None:
    talk.begin()
    said = len(talk.said)
    talk.program._pause.holds = True
    talk.program._seen = talk.now
    talk.program.feed(b"mine", 0.125)
    assert len(talk.said) == said


@pytest.mark.parametrize("state", [ProgramState.PAUSING, ProgramState.PAUSED, ProgramState.PLAYING])
def test_is_paused_by_a_state_that_was_not_looked_at_yet(talk: Talk, state: ProgramState) -> None:
    """A loop of the user may have it before the thread that answers states."""
    context, found = talk.program._context, []
    for latest, holds in ((None, False), (SimpleNamespace(program_state=state), False), (None, True)):
        talk.program._context = replace(context, realtime=SimpleNamespace(latest=latest))  # type: ignore[arg-type]
        talk.program._pause.holds = holds
        found.append(talk.program.is_paused)
    assert found == [False, state is not ProgramState.PLAYING, True]


def test_after_a_pause_the_dialogue_goes_on_once(talk: Talk, monkeypatch: pytest.MonkeyPatch) -> None:
    resumed: list[float] = []
    monkeypatch.setattr(talk, "resume", lambda state: resumed.append(len(talk.steps)))
    talk.begin()
    talk.program._pause.is_over = True
    talk.look()
    talk.look()
    assert len(resumed) == 1
    assert not talk.program._pause.is_over


def test_who_waited_until_it_was_linked_is_let_go_of_at_its_end(talk: Talk) -> None:
    """It refers to the handle, and this to the program."""
    talk.begin().motion.cancel()
    linked = talk.linked
    talk.program._on_linked()
    assert talk.linked == linked
