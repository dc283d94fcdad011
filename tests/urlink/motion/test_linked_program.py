"""Messages to and from a running program, and its ends, on a clock that the test controls."""

from __future__ import annotations

import gc
import time
import weakref
from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import pytest

from linkcore.errors import BadAddress, ConnectFailed, ConnectionLost, LinkError, LocalError
from linkcore.handle import Motion, Phase
from linkcore.streaming.stream import Stream
from linkcore.streaming.subscription import Subscription
from tests.fakes.rehearsal import FOLLOW, TIMEOUT, WAIT, Rehearsal
from tests.waiting import until
from urlink.command.program_time import Pause
from urlink.errors import NotRunning, ProgramStopped, SafetyStop, ToleranceExceeded
from urlink.motion.servo import linked_program
from urlink.motion.servo.linked_program import LinkedProgram
from urlink.motion.servo.setpoints import LinkDialogue
from urlink.protocol.enums import ProgramState, SafetyMode
from urlink.protocol.realtime.packets import RealtimeState
from urlink.script.links import InputRegisters, ReverseSocket
from urlink.script.messages import setpoint

pytestmark = pytest.mark.simulated_time


class States:
    """Stream of the states of a robot that records its subscriptions; `latest` is the newest state that it shows."""

    def __init__(self, stream: Stream[RealtimeState]) -> None:
        self._stream = stream
        self.latest: Any = None
        self.subscriptions: list[Subscription] = []
        self._connection = self

    def subscribe(self, *arguments: Any, **options: Any) -> Subscription:
        self.subscriptions.append(self._stream._connection.subscribe(*arguments, owner=self._stream, **options))
        return self.subscriptions[-1]


class Talk(LinkDialogue):
    """Fake dialogue, its link, and the program that they drive; the test sets their behaviour."""

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
        #: received bytes and time of each call of `step`
        self.steps: list[tuple[bytes, float]] = []
        self.failure: Exception | None = None
        # the link
        self.opened = 0
        self.open_link: Callable[[], Talk] = lambda: self
        self.is_up = False
        self.comes_up = True
        self.polls: list[bool] = []
        self.said: list[bytes] = []
        self.heard = b""
        self.loss: LinkError | None = None
        self.closed: list[bool] = []
        # the program
        self.linked = 0
        self.states = States(robot.realtime)
        context = replace(robot.context, clock=self._clock, realtime=cast(Any, self.states))
        self.life = context.programs.life("talk")
        self.motion = Motion(self.life)

        def on_linked() -> None:
            self.linked += 1

        self.callback = weakref.ref(on_linked)
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(linked_program, "Pause", self._pausing)
            self.program = LinkedProgram(self.life, context, self, self._open, on_linked=on_linked)

    def _pausing(self, name: str, tolerance: float) -> Pause:
        self.pause = Pause(name, tolerance)
        return self.pause

    def _clock(self) -> float:
        self._looks += 1
        return self.now

    def _open(self) -> Talk:
        self.opened += 1
        return self.open_link()

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

    # -- actions of the test ------------------------------------------------------------------------------

    def look(self, seconds: float = 0.0) -> None:
        """Advance both clocks, then wait until a state was processed completely or the motion has ended."""
        self.now += seconds
        self.robot.time += seconds
        looks = self._looks
        self.robot.until(lambda: self._looks >= looks + 2 or self.life.is_over)

    def begin(self) -> Talk:
        """Send the program, start it, and wait until it has received the first message."""
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


def test_program_receives_messages_after_start(talk: Talk) -> None:
    talk.program.begin()
    # It needs no start permission, because without a handle its connection would be refused.
    assert "urlink_cycles" not in talk.robot.uploaded
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


def test_missing_connection_raises_connect_failed(talk: Talk) -> None:
    talk.comes_up = False
    talk.begin().look(5.0)
    assert not talk.motion.done
    talk.look(0.01)
    talk.fails(ConnectFailed, "absent: it did not connect within 5 s")
    assert "stopj" in talk.robot.sent[-1]
    assert [talk.said, talk.closed] == [[], [False]]
    assert talk.linked == 1  # no caller keeps waiting for the link


@pytest.mark.parametrize("is_told", [True, False])
def test_program_has_one_second_to_end_after_the_end_message(talk: Talk, is_told: bool) -> None:
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


def test_no_message_is_sent_after_the_end_message(talk: Talk) -> None:
    """One thread might have composed a message while another thread ends the program."""
    talk.begin()
    talk.program.finish()
    talk.program.say(b"composed before")
    assert talk.said[-1] == b"bye"
    talk.robot.finish()
    talk.motion.wait(TIMEOUT)


def test_messages_of_program_after_the_end_message_are_ignored(talk: Talk) -> None:
    talk.begin()
    talk.program.finish()
    talk.robot.text("urlink: nothing to go to")
    talk.robot.text("urlink: the link ended")
    talk.robot.finish()
    talk.motion.wait(TIMEOUT)


def test_program_without_an_end_message_is_stopped(robot: Rehearsal) -> None:
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


def test_lost_connection_without_reason_fails_after_a_second(talk: Talk) -> None:
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
    # The program is lost and brakes on its own, so it can receive no message.
    assert b"bye" not in talk.said
    assert not any("stopj" in text for text in talk.robot.sent)


def test_safety_stop_is_reported_instead_of_a_lost_connection(talk: Talk) -> None:
    talk.begin()
    talk.loss = ConnectionLost("reset")
    talk.look()
    talk.robot.state(safety=SafetyMode.PROTECTIVE_STOP)
    talk.fails(SafetyStop, "protective stop")


def test_loss_is_reported_if_program_ends_afterwards(talk: Talk) -> None:
    talk.begin()
    talk.loss = ConnectionLost("reset")
    talk.look()
    talk.robot.finish()
    talk.fails(ConnectionLost, "reset")


def test_early_program_end_raises_program_stopped(talk: Talk) -> None:
    talk.begin()
    talk.robot.finish()
    talk.fails(ProgramStopped, "the program of talk ended unexpectedly")


def test_linked_dialogue_can_continue_after_its_program_ended(robot: Rehearsal) -> None:
    talk = Talk(robot, survives_its_program=True).begin()
    talk.heard = b"never mind"
    robot.finish()
    robot.until(lambda: talk.concluded)
    talk.look()
    said = len(talk.said)
    talk.look(1.0)
    assert not talk.motion.done
    # The program can no longer receive or send messages, but the states still count.
    assert talk.steps[-1] == (b"", 1001.0)
    assert len(talk.said) == said
    talk.is_over = True
    talk.look()
    talk.motion.wait(TIMEOUT)
    assert talk.motion.phase is Phase.DONE


@pytest.mark.parametrize("failure", [ToleranceExceeded("off"), ZeroDivisionError("off")])
def test_failing_dialogue_fails_motion(talk: Talk, failure: Exception) -> None:
    talk.begin()
    talk.failure = failure
    (subscription,) = talk.states.subscriptions
    talk.look()
    talk.fails(type(failure), "off")
    assert talk.said[-1] == b"bye"
    # The subscription counts an unexpected error, but not an error of the library.
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
def test_message_of_program_determines_error(talk: Talk, text: str, error: type[Exception], message: str) -> None:
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
def test_motion_fails_when_its_link_is_unavailable(
    talk: Talk, open_link: Callable[[], Talk], raised: type[BaseException], error: type[Exception]
) -> None:
    talk.open_link = open_link
    with pytest.raises(raised):
        talk.program.begin()
    assert isinstance(talk.motion.error, error)
    assert [talk.robot.sent, talk.linked, talk.closed] == [[], 1, []]


def test_safety_stop_prevents_start(talk: Talk) -> None:
    talk.robot.state(safety=SafetyMode.PROTECTIVE_STOP)
    until(lambda: talk.robot.safety.cause)
    with pytest.raises(SafetyStop):
        talk.program.begin()
    assert [talk.opened, talk.robot.sent, talk.linked] == [0, [], 1]


def test_unsent_program_fails_motion(talk: Talk) -> None:
    talk.robot.slow.refusal = ConnectionLost("not sent")
    with pytest.raises(ConnectionLost, match="not sent"):
        talk.program.begin()
    talk.fails(ConnectionLost, "not sent")
    steps = len(talk.steps)
    talk.robot.show()
    assert len(talk.steps) == steps


def test_robot_lost_before_start_fails_motion(talk: Talk) -> None:
    """The link is closed, so a program that starts later cannot connect, and moves nothing."""
    talk.program.begin()
    talk.robot.fast.put(ConnectionLost("pulled"))
    talk.fails(NotRunning, "pulled; it moves nothing if it begins later")


def test_end_does_not_wait_for_reader_thread(talk: Talk, monkeypatch: pytest.MonkeyPatch) -> None:
    """The thread that ends the motion might be the thread of the states, or might block it."""
    waited: list[float] = []
    talk.begin()
    monkeypatch.setattr(talk.states.subscriptions[0], "close", waited.append)
    talk.motion.cancel()
    assert waited == [0]


def test_disabled_arm_can_be_stopped(talk: Talk) -> None:
    talk.begin().robot.safety.policy = "always"
    talk.motion.cancel()
    assert talk.said[-1] == b"bye"


def test_ended_program_receives_no_message(talk: Talk) -> None:
    talk.begin()
    talk.robot.vanish()
    talk.robot.until(lambda: talk.motion.done)
    said = len(talk.said)
    with pytest.raises(ProgramStopped):
        talk.program.say(b"late")
    talk.robot.show()
    assert len(talk.said) == said


def test_messages_contain_cycle_and_number_of_pauses(talk: Talk, monkeypatch: pytest.MonkeyPatch) -> None:
    talk.answer = setpoint([0.0] * 6, [0.0] * 6)
    sent: list[bytes] = []
    monkeypatch.setattr(talk, "send", sent.append)
    talk.begin()
    assert sent[0][-4:] == bytes(4)
    for pauses in range(3):
        talk.pause.count = pauses
        before = int.from_bytes(sent[-1][-4:], "big")
        talk.look(0.1)
        date = int.from_bytes(sent[-1][-4:], "big")
        assert 0.1 / talk.robot.cycle <= date - before < 0.1 / talk.robot.cycle + 10  # states arrive meanwhile
        assert int.from_bytes(sent[-1][-8:-4], "big") == (WAIT + pauses if pauses else FOLLOW)


@pytest.mark.parametrize(
    ("silence", "says"), [(0.0, True), (0.125, True), (0.126, False), (0.25, False), (0.251, None)]
)
def test_loop_messages_are_dropped_after_silence(talk: Talk, silence: float, says: bool | None) -> None:
    """After a controller has hung, it would read them at once, and the arm would move at full speed.

    Therefore, nothing is sent after the time of the watchdog, and after twice that time the motion ends.
    """
    talk.begin()
    time.sleep(0.1)  # simulated time passes only when all states were processed
    said = len(talk.said)
    talk.now += silence
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


def test_loop_messages_are_dropped_during_pause(talk: Talk) -> None:
    talk.begin()
    said = len(talk.said)
    talk.pause.holds = True
    talk.program.feed(b"mine", 0.125)
    assert len(talk.said) == said


@pytest.mark.parametrize("state", [ProgramState.PAUSING, ProgramState.PAUSED, ProgramState.PLAYING])
def test_pause_is_detected_in_a_state_not_processed_yet(talk: Talk, state: ProgramState) -> None:
    """The user's loop might receive a state before the thread that replies to states does."""
    found = []
    for latest, holds in ((None, False), (SimpleNamespace(program_state=state), False), (None, True)):
        talk.states.latest = latest
        talk.pause.holds = holds
        found.append(talk.program.is_paused)
    assert found == [False, state is not ProgramState.PLAYING, True]


def test_dialogue_resumes_once_after_pause(talk: Talk, monkeypatch: pytest.MonkeyPatch) -> None:
    resumed: list[float] = []
    monkeypatch.setattr(talk, "resume", lambda state: resumed.append(len(talk.steps)))
    talk.begin()
    talk.pause.is_over = True
    talk.look()
    talk.look()
    assert len(resumed) == 1
    assert not talk.pause.is_over


def test_link_callback_is_removed_when_the_program_ends(talk: Talk) -> None:
    """The callback refers to the handle, and the handle refers to the program."""
    talk.begin()
    assert talk.callback() is not None
    talk.motion.cancel()
    gc.collect()
    assert talk.callback() is None


def test_steady_state_is_processed_in_place_while_the_loop_sends_the_messages(talk: Talk) -> None:
    talk.begin().look()
    takes, state = talk.program._takes_steady, cast(RealtimeState, talk.robot.realtime.latest)
    link, steps = cast(Any, talk), len(talk.steps)
    assert not takes(link, state)
    assert len(talk.steps) == steps
    talk.is_mute, talk.answer = True, b""
    talk.now += 5.0
    assert takes(link, state)
    assert talk.steps[-1] == (b"", talk.now)
    assert talk.program._seen == talk.now


@pytest.mark.parametrize("what", ["paused", "resumed", "lost", "finishing", "ended"])
def test_thread_processes_a_steady_state_that_may_need_a_message(talk: Talk, what: str) -> None:
    talk.begin().look()
    talk.is_mute, talk.answer = True, b""
    if what == "paused":
        talk.pause.holds = True
    elif what == "resumed":
        talk.pause.is_over = True
    elif what == "lost":
        talk.loss = ConnectionLost("cable")
    elif what == "finishing":
        talk.program.finish()
    else:
        talk.motion.cancel()
    seen = talk.program._seen
    talk.now += 5.0
    assert not talk.program._takes_steady(cast(Any, talk), cast(RealtimeState, talk.robot.realtime.latest))
    assert talk.program._seen == seen
