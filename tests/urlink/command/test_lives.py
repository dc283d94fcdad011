"""What becomes of programs as time passes, on a clock that the test holds."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import pytest

from linkcore.clock import Stamp
from linkcore.errors import Cancelled, Closed, ConnectFailed, ConnectionLost, LinkError, LinkTimeout
from linkcore.handle import Lifecycle, Phase
from linkcore.streaming.connection_life import ConnectionEvent, ConnectionState
from tests.fakes.line import FIRMWARE, STARTED, Programming, Run, Subscriber, give_up, slow
from urlink.errors import CompileError, NotRunning, ProgramStopped, SafetyStop, ScriptFailed
from urlink.protocol.enums import RobotMode, SafetyMode
from urlink.protocol.primary.robot_message import RuntimeExceptionMessage, TextMessage

SEC = "sec blink():\n  set_flag(1, True)\nend"


@pytest.fixture
def desk() -> Programming:
    return Programming()


# -- how it is sent --------------------------------------------------------------------------------------


def test_names_are_short_and_each_program_has_its_own(desk: Programming) -> None:
    names = [desk.motion().program, desk.script("def job():\n  movej(q)\nend").program, desk.motion().program]
    words = [re.fullmatch(r"(.*)_[0-9a-f]{4}_([123])", name) for name in names]
    assert [each and each.groups() for each in words] == [("urlink", "1"), ("job", "2"), ("urlink", "3")]


@pytest.mark.parametrize(("firmware", "count"), [("5.11", 1000), ("3.4", 255)])
def test_each_program_has_a_token_of_its_own(firmware: str, count: int) -> None:
    desk = Programming(firmware=firmware)
    programs = [desk.programs.own([]) for _ in range(count)]
    assert len({each.permission.token for each in programs if each.permission is not None}) == count


@pytest.mark.parametrize(
    ("firmware", "seconds", "cycles"), [("5.11", 2.0, 1000), ("3.4", 2.0, 250), ("5.11", 0.0001, 1)]
)
def test_permission_is_waited_for_in_cycles_of_the_controller(firmware: str, seconds: float, cycles: int) -> None:
    desk = Programming(firmware=firmware, start_timeout=seconds)
    desk.motion()
    assert f"while urlink_cycles < {cycles} and not (" in desk.sent[0]
    desk.motion(asks=False)
    assert "urlink_cycles" not in desk.sent[-1]


def test_what_is_sent_under_a_stop_or_after_the_end_is_not_followed(desk: Programming) -> None:
    desk.primary.tell(slow(SafetyMode.PROTECTIVE_STOP))
    life = desk.programs.life("refused")
    with pytest.raises(SafetyStop):
        desk.programs.start(desk.programs.own(["movej(q)"]), life)
    assert isinstance(life.error, SafetyStop)
    desk.primary.tell(slow())
    ends: list[tuple[Callable[[Lifecycle], object], type[Exception]]] = [
        (lambda life: life.fail(ConnectFailed("gone")), ConnectFailed),
        (lambda life: life.cancel("given up"), Cancelled),
    ]
    for end, error in ends:
        life = desk.programs.life("over")
        end(life)
        with pytest.raises(error):
            desk.programs.start(desk.programs.own(["movej(q)"]), life)
    assert desk.sent == []
    assert desk.programs._runs == {}


def test_an_interrupt_while_it_is_sent_ends_its_life(desk: Programming, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupt(*args: object, **options: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(desk.channel, "motion", interrupt)
    life = desk.programs.life("motion")
    with pytest.raises(KeyboardInterrupt):
        desk.programs.start(desk.programs.own(["movej(q)"]), life)
    assert str(life.error) == "motion was interrupted"


def test_what_only_stops_needs_nobody_to_enable_it(desk: Programming) -> None:
    desk.interlock.policy = "always"
    with pytest.raises(SafetyStop, match="not enabled"):
        desk.motion()
    assert desk.motion(asks=False, is_stop=True).phase is Phase.SENT


class Interrupted(dict[str, Any]):
    """Calls a signal handler after the first thing was put into it."""

    def __init__(self, handler: Callable[[], object]) -> None:
        super().__init__()
        self._handlers = [handler]

    def __setitem__(self, name: str, run: Any) -> None:
        super().__setitem__(name, run)
        while self._handlers:
            self._handlers.pop()()


def test_a_signal_handler_begins_another_before_it_has_left(desk: Programming) -> None:
    """What the handler began came later: what it interrupted must not preempt it."""
    others: list[Run] = []
    desk.programs._runs = Interrupted(lambda: others.append(desk.motion()))
    with pytest.raises(Cancelled, match=r"was preempted by motion urlink_"):
        desk.motion()
    assert len(desk.sent) == 1
    assert desk.programs.current is others[0]._life


@pytest.mark.parametrize("is_beside", [True, False])
def test_what_runs_beside_preempts_nothing(desk: Programming, is_beside: bool) -> None:
    acts: list[Callable[[], Run]] = [lambda: desk.script(SEC), desk.motion]
    handler, interrupted = acts if is_beside else acts[::-1]
    others: list[Run] = []
    desk.programs._runs = Interrupted(lambda: others.append(handler()))
    assert interrupted().phase is others[0].phase is Phase.SENT
    assert len(desk.sent) == 2


# -- how it begins ---------------------------------------------------------------------------------------


def test_it_begins_once_and_is_let_go_on(desk: Programming) -> None:
    run = desk.motion()
    desk.key(STARTED, f" {run.program}\n\0")
    assert run.phase is Phase.RUNNING
    assert len(desk.sent) == 1
    run.says("started")
    assert len(desk.sent) == 2
    assert "urlink_permission" in desk.sent[1]
    run.says("half way")
    desk.primary.tell(TextMessage(FIRMWARE, text="1\n\0"))
    assert run.texts == [f"{run.program} half way", "1"]


@pytest.mark.parametrize("is_over", [True, False])
def test_what_was_given_up_at_the_last_moment_is_not_let_go_on(desk: Programming, is_over: bool) -> None:
    run = desk.motion()
    require = desk.monitor.require

    def meanwhile(is_stop: bool = False) -> None:
        require(is_stop)
        desk.monitor.require = require  # type: ignore[method-assign]
        if is_over:
            run._life.cancel("given up")

    desk.monitor.require = meanwhile  # type: ignore[method-assign]
    run.begins()
    assert len(desk.sent) == (1 if is_over else 2)
    assert run.phase is (Phase.CANCELLED if is_over else Phase.RUNNING)


def test_the_thread_that_hears_does_not_wait_to_let_it_go_on(desk: Programming) -> None:
    run = desk.motion()
    desk.primary.room = 0
    run.begins()
    assert desk.waits == []
    assert "did not accept a text" in run.end


def test_a_program_that_was_not_let_go_on_says_so(desk: Programming) -> None:
    one, two = desk.script(SEC), desk.motion()
    two.begins()
    two.says("was not permitted to go on")
    assert "got no start permission within 5 s, and has ended without moving the arm" in two.end
    assert one.phase is Phase.SENT


@pytest.mark.parametrize(
    ("options", "what_if"),
    [
        ({}, "it moves nothing if it begins later"),
        ({"asks": False}, "if it begins later, it may still move the arm"),
        ({"asks": False, "is_linked": True}, "it moves nothing if it begins later"),
        ({"asks": False, "is_stop": True}, "it moves nothing if it begins later"),
    ],
)
def test_what_does_not_begin_in_time(desk: Programming, options: dict[str, bool], what_if: str) -> None:
    run = desk.motion(**options)
    desk.clock.now += 5.0
    desk.state()
    assert run.phase is Phase.SENT
    desk.state(0.1, runs=True)
    assert isinstance(run.error, LinkTimeout)
    assert "did not begin within 5 s" in run.end
    assert f"the robot mode is RUNNING, a program runs; {what_if}; an e-Series" in run.end


def test_time_counts_from_when_it_left(desk: Programming, monkeypatch: pytest.MonkeyPatch) -> None:
    desk.primary.room = 0

    def make_room() -> None:
        desk.clock.now += 0.2
        desk.primary.room = None

    desk.meanwhile = make_room
    run = desk.motion()
    desk.state(4.9)
    assert run.phase is Phase.SENT
    desk.state(0.2)
    assert "no program runs" in run.end


def test_a_secondary_program_has_to_end_in_time(desk: Programming) -> None:
    run = desk.script(SEC)
    run.begins()
    desk.state(5.1, runs=True)
    assert "did not end within 5 s; no error was reported; the robot mode is RUNNING, a program runs" in run.end
    assert "later" not in run.end


# -- how it ends -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("is_told", [True, False])
def test_its_own_end(desk: Programming, is_told: bool) -> None:
    """Told by a key message, or by the flag in the state, which may rise late and fall late."""
    ends: list[str] = []
    run = desk.script(on_finish=lambda: ends.append("here"))
    if is_told:
        run.begins()
    else:
        run.says("started")
    run.says("finished")
    assert ends == []
    run.stops() if is_told else desk.state()
    assert ends == ["here"]


def test_a_last_word_is_a_first_one_as_well(desk: Programming) -> None:
    """Where the first was not heard, as just after the connection was made again."""
    before, run = desk.script(), desk.script()
    run.says("finished")
    assert run.phase is Phase.RUNNING
    assert isinstance(before.error, Cancelled)
    desk.state()
    assert run.end == "done"


@pytest.mark.parametrize("is_paused", [True, False])
def test_a_program_that_is_paused_goes_on(desk: Programming, is_paused: bool) -> None:
    run = desk.script()
    run.begins()
    desk.key("PROGRAM_XXX_PAUSED", run.program)
    for _ in range(3):
        desk.state(1.0, runs=not is_paused, paused=is_paused)
    assert run.phase is Phase.RUNNING
    desk.state(0.1)
    desk.state(0.2)
    assert run.phase is Phase.RUNNING  # news of what stopped it may be on its way
    desk.state(0.2)
    assert run.end == f"ProgramStopped: {run.name} was stopped early by another client or a person"


@pytest.mark.parametrize("has_keys", [True, False])
def test_a_flag_that_is_down_for_half_a_second_has_been_missed(desk: Programming, has_keys: bool) -> None:
    """Where key messages tell, it only has not risen yet, or for five seconds they were lost."""
    run = desk.script()
    if has_keys:
        desk.key(STARTED, "theirs")
    desk.key("PROGRAM_XXX_PAUSED", "theirs")
    run.says("started")
    for later in (0.5, 0.25, 0.1):  # half a second is not enough; then news of a stop may still be on its way
        desk.state(later)
        assert run.phase is Phase.RUNNING
    desk.state(0.25)
    assert (run.phase is Phase.RUNNING) == has_keys
    desk.state(4.0)
    desk.state(0.4)
    assert run.end == f"ProgramStopped: {run.name} was stopped early by another client or a person"


def test_a_stop_that_is_told_after_the_end(desk: Programming) -> None:
    run = desk.script()
    run.begins()
    desk.clock.now = 0.0
    run.stops()
    desk.state(0.3)
    assert run.phase is Phase.RUNNING
    desk.primary.tell(slow(SafetyMode.PROTECTIVE_STOP))
    assert "protective stop" in run.end


def test_what_ends_under_a_stop_or_without_power_was_stopped_by_it(desk: Programming) -> None:
    run = desk.script()
    run.begins()
    desk.interlock.policy = "always"  # which only asks for a person, and is no cause
    run.stops()
    assert run.phase is Phase.RUNNING
    desk.state(0.4)
    assert isinstance(run.error, ProgramStopped)
    desk.interlock.policy = "never"
    run = desk.script()
    run.begins()
    desk.primary.tell(slow(mode=RobotMode.POWER_OFF))
    assert run.phase is Phase.RUNNING  # a program of the user's own may be paused only
    run.stops()
    assert isinstance(run.error, NotRunning)


@pytest.mark.parametrize("is_told", [True, False])
def test_an_error_is_the_end_within_a_second(desk: Programming, is_told: bool) -> None:
    run = desk.script("a = 1 / 0")
    run.begins()
    desk.exception("division by zero")
    assert run.phase is Phase.RUNNING
    if is_told:
        run.stops()
    else:
        desk.state(1.0, runs=True)
        assert run.phase is Phase.RUNNING
        desk.state(0.1, runs=True)
    assert isinstance(run.error, ScriptFailed)


def test_whom_an_error_is_of(desk: Programming, caplog: pytest.LogCaptureFixture) -> None:
    running = desk.script()
    running.begins()
    desk.exception("syntax_error_on_line:1:")  # of somebody else's text
    assert "the controller reports: 1:1: syntax_error_on_line:1:" in caplog.text
    assert running.phase is Phase.RUNNING
    beside, awaited = desk.script(SEC), desk.script()
    desk.exception("compile_error")
    assert isinstance(awaited.error, CompileError)
    assert (running.phase, beside.phase) == (Phase.RUNNING, Phase.SENT)
    desk.exception("whatever comes before it begins")
    assert isinstance(beside.error, CompileError)
    another = desk.script(SEC)
    another.begins()
    desk.exception("no such output")
    assert isinstance(another.error, ScriptFailed)
    assert running.phase is Phase.RUNNING
    running.says("finished")
    desk.primary.tell(RuntimeExceptionMessage(FIRMWARE, line=1, column=1, text="another"))
    running.stops()
    assert isinstance(running.error, ScriptFailed)


def test_a_program_that_begins_ends_those_before_it(desk: Programming) -> None:
    finished = desk.script()
    finished.begins()
    finished.says("finished")
    beside = desk.script(SEC)
    beside.begins()
    stopped, last = desk.script(), desk.script()
    last.begins()
    assert finished.phase is Phase.DONE
    assert stopped.end == f"Cancelled: {stopped.name} was preempted by {last.name}"
    assert beside.phase is last.phase is Phase.RUNNING
    waits = desk.script()
    desk.key(STARTED, "theirs")
    assert "was replaced by theirs, a program of another client" in last.end
    assert waits.phase is Phase.SENT  # it was sent after theirs, for all that is known
    assert beside.phase is Phase.RUNNING
    waits.begins()
    later = desk.script()
    waits.stops()
    assert waits.end == f"Cancelled: {waits.name} was preempted by {later.name}"
    assert desk.stops == 0  # what preempts it has stopped it


def test_a_secondary_program_that_is_stopped_was_preempted_by_nobody(desk: Programming) -> None:
    beside = desk.script(SEC)
    beside.begins()
    desk.script().begins()
    beside.stops()
    assert beside.phase is Phase.RUNNING
    desk.state(0.4, runs=True)
    assert isinstance(beside.error, ProgramStopped)


@pytest.mark.parametrize("has_begun", [True, False])
def test_a_motion_ends_as_soon_as_the_interlock_closes(desk: Programming, has_begun: bool) -> None:
    for packet in (slow(SafetyMode.PROTECTIVE_STOP), slow(mode=RobotMode.POWER_OFF)):
        motion, stop = desk.motion(), None
        if has_begun:
            motion.begins()
        script = desk.script(SEC)
        desk.primary.tell(packet)
        error = motion.error
        assert script.phase is Phase.SENT
        if isinstance(error, NotRunning):
            later = "it may still move the arm" if has_begun else "it moves nothing if it begins later"
            assert str(error) == f"the robot is not running: its mode is POWER_OFF; {later}"
            stop = error
        else:
            assert isinstance(error, SafetyStop)
        desk.primary.tell(slow())
    assert stop is not None


# -- who asks --------------------------------------------------------------------------------------------


def test_what_runs_now(desk: Programming) -> None:
    current = [desk.programs.current]
    motion = desk.motion()
    current.append(desk.programs.current)
    assert desk.programs.permitted == []
    motion.begins()
    free = desk.motion(asks=False)
    assert desk.programs.permitted == [motion._life, free._life]
    for source in (SEC, "movej(q)"):
        desk.script(source)
        current.append(desk.programs.current)
    # The last is a program of the user's own, which came after it.
    assert current == [None, motion._life, free._life, None]


def test_a_program_that_connects_back_may_move_the_arm_once_it_has_begun(desk: Programming) -> None:
    """A speed that followed it would move the arm also where it is never let in."""
    linked = desk.motion(asks=False, is_linked=True)
    assert desk.programs.permitted == []
    linked.begins()
    assert desk.programs.permitted == [linked._life]


def test_what_is_over_is_not_current_while_it_is_braked(desk: Programming) -> None:
    run = desk.motion(asks=False)
    seen: list[object] = []
    run._life.brake = lambda: seen.extend([desk.programs.current, desk.programs.permitted])
    run.cancel()
    assert seen == [None, []]


def test_only_the_newest_is_stopped(desk: Programming) -> None:
    one = desk.motion()
    two = desk.motion()
    one.cancel()
    assert desk.stops == 0  # the one that was sent after it stops it anyway
    two.cancel()
    assert desk.stops == 1
    desk.programs.stop(two._life)
    assert desk.stops == 1
    desk.interlock.policy = "on_startup"
    three = desk.motion(asks=False, is_stop=True)
    three.cancel()
    assert desk.stops == 2  # nobody has to enable an arm that is to stop


def test_a_stop_that_is_refused_says_so(desk: Programming) -> None:
    script = desk.script()
    script.begins()
    desk.primary.tell(slow(SafetyMode.PROTECTIVE_STOP))
    with pytest.raises(SafetyStop, match="protective stop"):
        desk.programs.stop(script._life)


def test_it_is_known_when_the_last_one_ended(desk: Programming) -> None:
    """A state from before that may show its movement."""
    run = desk.motion()
    run.begins()
    desk.clock.now += 5.0
    run.stops()
    desk.state(0.7)
    assert run.done
    assert desk.programs.ended == desk.clock.now


@pytest.mark.simulated_time
@pytest.mark.parametrize(
    ("begin", "pending"),
    [
        (lambda desk: desk.motion(), ()),
        (lambda desk: desk.motion(is_stop=True), ("play",)),
        (lambda desk: desk.script(SEC), ("play",)),
    ],
)
def test_what_replaces_the_running_program_supersedes_what_was_given_up(
    desk: Programming, begin: Callable[[Programming], Run], pending: tuple[str, ...]
) -> None:
    """It need not be undone any more. Neither a stop nor a program beside replaces it."""

    def undo(client: object, is_wanted: Callable[[], bool]) -> None:
        raise ConnectionLost("it is away")

    undos = desk.channel._undos
    give_up(undos, "play", undo)
    begin(desk)
    assert undos.pending == pending
    undos.close()


def test_what_is_sent_while_a_stop_waits_for_news_is_not_stopped(
    desk: Programming, monkeypatch: pytest.MonkeyPatch
) -> None:
    one, others = desk.motion(), list[Any]()
    prepare = desk.channel._prepare

    def prepare_beside(moves: bool) -> None:
        prepare(moves)
        monkeypatch.setattr(desk.channel, "_prepare", prepare)
        others.append(desk.motion())  # of another thread

    monkeypatch.setattr(desk.channel, "_prepare", prepare_beside)
    one.cancel()
    assert len(others) == 1
    assert desk.stops == 0
    others[0].cancel()
    assert desk.stops == 1


# -- the connection ----------------------------------------------------------------------------------------


def test_what_was_sent_before_a_silence_is_discarded(desk: Programming) -> None:
    """Half a second before it the network may have failed already."""
    desk.programs._listen()
    for before, aborts in ((1.6, 0), (1.4, 1)):
        desk.motion()
        desk.clock.now += before
        for _, hook in desk.primary.watches:
            hook(1.0)
        assert desk.primary.aborts == aborts
        desk.primary.tell(slow())


def test_what_was_sent_over_a_connection_that_is_lost(desk: Programming) -> None:
    script, motion = desk.script(), desk.motion(asks=False)
    for state in (ConnectionState.CONNECTING, ConnectionState.CONNECTED):
        desk.event(desk.primary, state)
    event = ConnectionEvent(
        ConnectionState.LOST, "line", ConnectionLost("pulled"), Stamp(desk.clock.now, desk.clock.now)
    )
    desk.programs.on_event(event)
    assert script.phase is motion.phase is Phase.SENT  # sent after it was lost, over the next one
    desk.clock.now += 0.1
    desk.programs.on_event(event._replace(received=Stamp(desk.clock.now, desk.clock.now)))
    lost = "the connection was lost while {} was running; {}: pulled"
    assert script.end == "ConnectionLost: " + lost.format(script.name, "it moves nothing if it begins later")
    later = "if it begins later, it may still move the arm"
    assert motion.end == "NotRunning: " + lost.format(motion.name, later)
    another = desk.script()
    another.begins()
    desk.clock.now += 0.1
    desk.programs.on_event(event._replace(received=Stamp(desk.clock.now, desk.clock.now), error=None))
    assert another.end.endswith("was running; it may still run")


@pytest.mark.parametrize(("state", "is_left"), [(s, s.name in ("IDLE", "CLOSED")) for s in ConnectionState])
def test_a_connection_that_was_given_up_is_listened_to_anew(
    desk: Programming, state: ConnectionState, is_left: bool
) -> None:
    desk.motion()
    before = len(desk.primary.subscribers)
    desk.programs.on_event(ConnectionEvent(state, "line", None, Stamp(0.0, 0.0)))
    desk.motion()
    assert len(desk.primary.subscribers) == before + (2 if is_left else 0)


def test_what_cannot_be_listened_to_is_not_sent(desk: Programming) -> None:
    subscribe, before = desk.primary.subscribe_inline, len(desk.primary.subscribers)

    def refuse(kind: type, callback: Callable[[Any], object]) -> Subscriber:
        if kind is ConnectionEvent:
            raise ConnectFailed("refused")
        return subscribe(kind, callback)

    desk.primary.subscribe_inline = refuse  # type: ignore[method-assign]
    life = desk.programs.life("motion")
    with pytest.raises(ConnectFailed):
        desk.programs.start(desk.programs.own(["movej(q)"]), life)
    assert len(desk.primary.subscribers) == before
    assert isinstance(life.error, ConnectFailed)
    assert desk.sent == []


@pytest.mark.parametrize("is_detached", [True, False])
@pytest.mark.parametrize("is_motion", [True, False])
def test_close_stops_the_program_unless_it_is_detached(desk: Programming, is_motion: bool, is_detached: bool) -> None:
    before = len(desk.primary.subscribers)
    beside = desk.script(SEC)
    run = desk.motion(is_detached=is_detached) if is_motion else desk.script(is_detached=is_detached)
    run.begins()
    desk.programs.close(0.0)
    assert desk.stops == (not is_detached)
    closed = f"ConnectionLost: the robot was closed while {run.name} was running; it may still "
    cancelled = f"Cancelled: {run.name} was cancelled, since the robot was closed"
    assert run.end.startswith(closed if is_detached else cancelled)
    assert beside.end.startswith(f"ConnectionLost: the robot was closed while {beside.name} was running")
    assert len(desk.primary.subscribers) == before
    life = desk.programs.life("late")
    errors: list[LinkError] = []
    try:
        desk.programs.start(desk.programs.own(["movej(q)"]), life)
    except Closed as error:
        errors.append(error)
    assert [repr(error) for error in errors] == [repr(life.error)]
    desk.programs.close(0.0)


def test_close_rejects_motions_while_it_cancels_others(desk: Programming) -> None:
    """Another thread, or a signal handler, may request one just then; it would go on after the robot is closed."""
    run = desk.motion()
    failures: list[Exception] = []

    def begin() -> None:
        try:
            desk.motion()
        except LinkError as error:
            failures.append(error)

    run._life.on_end(begin)
    before = len(desk.sent)
    desk.programs.close(0.0)
    assert [type(error) for error in failures] == [Closed]
    assert not [text for text in desk.sent[before:] if "stopj" not in text]
    assert desk.programs._runs == {}
