"""Life cycles of programs over time, with a simulated clock."""

from __future__ import annotations

import gc
import re
import weakref
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


# -- sending ---------------------------------------------------------------------------------------------


def test_program_names_are_short_and_unique(desk: Programming) -> None:
    names = [desk.motion().program, desk.script("def job():\n  movej(q)\nend").program, desk.motion().program]
    words = [re.fullmatch(r"(.*)_[0-9a-f]{4}_([123])", name) for name in names]
    assert [each and each.groups() for each in words] == [("urlink", "1"), ("job", "2"), ("urlink", "3")]


@pytest.mark.parametrize(("firmware", "count"), [("5.11", 1000), ("3.4", 255)])
def test_start_tokens_are_unique(firmware: str, count: int) -> None:
    desk = Programming(firmware=firmware)
    programs = [desk.programs.own([]) for _ in range(count)]
    assert len({each.permission.token for each in programs if each.permission is not None}) == count


@pytest.mark.parametrize(
    ("firmware", "seconds", "cycles"), [("5.11", 2.0, 1000), ("3.4", 2.0, 250), ("5.11", 0.0001, 1)]
)
def test_start_timeout_is_converted_to_controller_cycles(firmware: str, seconds: float, cycles: int) -> None:
    desk = Programming(firmware=firmware, start_timeout=seconds)
    desk.motion()
    assert f"while urlink_cycles < {cycles} and not (" in desk.sent[0]
    desk.motion(asks=False)
    assert "urlink_cycles" not in desk.sent[-1]


def test_start_raises_during_a_stop_and_after_the_program_ended(desk: Programming) -> None:
    desk.primary.deliver(slow(SafetyMode.PROTECTIVE_STOP))
    life = desk.programs.life("refused")
    with pytest.raises(SafetyStop):
        desk.programs.start(desk.programs.own(["movej(q)"]), life)
    assert isinstance(life.error, SafetyStop)
    desk.primary.deliver(slow())
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
    ended = weakref.ref(life)
    del life
    gc.collect()
    assert ended() is None


def test_program_ends_when_sending_is_interrupted(desk: Programming, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupt(*args: object, **options: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(desk.channel, "motion", interrupt)
    life = desk.programs.life("motion")
    with pytest.raises(KeyboardInterrupt):
        desk.programs.start(desk.programs.own(["movej(q)"]), life)
    assert str(life.error) == "motion was interrupted"


def test_stop_program_needs_no_enable(desk: Programming) -> None:
    desk.interlock.policy = "always"
    with pytest.raises(SafetyStop, match="not enabled"):
        desk.motion()
    assert desk.motion(asks=False, is_stop=True).phase is Phase.SENT


class Interrupted(dict[str, Any]):
    """Dictionary that calls a signal handler after its first assignment."""

    def __init__(self, handler: Callable[[], object]) -> None:
        super().__init__()
        self._handlers = [handler]

    def __setitem__(self, name: str, run: Any) -> None:
        super().__setitem__(name, run)
        while self._handlers:
            self._handlers.pop()()


def test_motion_of_signal_handler_preempts_interrupted_motion(desk: Programming) -> None:
    """The handler's motion was started later, so the interrupted motion must not preempt it."""
    others: list[Run] = []
    desk.programs._runs = Interrupted(lambda: others.append(desk.motion()))
    with pytest.raises(Cancelled, match=r"was preempted by motion urlink_"):
        desk.motion()
    assert len(desk.sent) == 1
    assert desk.programs.current is others[0].life


@pytest.mark.parametrize("is_beside", [True, False])
def test_secondary_program_preempts_nothing(desk: Programming, is_beside: bool) -> None:
    acts: list[Callable[[], Run]] = [lambda: desk.script(SEC), desk.motion]
    handler, interrupted = acts if is_beside else acts[::-1]
    others: list[Run] = []
    desk.programs._runs = Interrupted(lambda: others.append(handler()))
    assert interrupted().phase is others[0].phase is Phase.SENT
    assert len(desk.sent) == 2


# -- beginning -------------------------------------------------------------------------------------------


def test_program_begins_once_and_gets_permission(desk: Programming) -> None:
    run = desk.motion()
    desk.key(STARTED, f" {run.program}\n\0")
    assert run.phase is Phase.RUNNING
    assert len(desk.sent) == 1
    run.says("started")
    assert len(desk.sent) == 2
    assert "urlink_permission" in desk.sent[1]
    run.says("half way")
    desk.primary.deliver(TextMessage(FIRMWARE, text="1\n\0"))
    assert run.texts == [f"{run.program} half way", "1"]


@pytest.mark.parametrize("is_over", [True, False])
def test_program_cancelled_at_last_moment_gets_no_permission(desk: Programming, is_over: bool) -> None:
    run = desk.motion()
    require = desk.monitor.require

    def meanwhile(is_stop: bool = False) -> None:
        require(is_stop)
        desk.monitor.require = require  # type: ignore[method-assign]
        if is_over:
            run.life.cancel("given up")

    desk.monitor.require = meanwhile  # type: ignore[method-assign]
    run.begins()
    assert len(desk.sent) == (1 if is_over else 2)
    assert run.phase is (Phase.CANCELLED if is_over else Phase.RUNNING)


def test_reader_does_not_wait_to_send_permission(desk: Programming) -> None:
    run = desk.motion()
    desk.primary.room = 0
    run.begins()
    assert desk.waits == []
    assert "did not accept a text" in run.end


def test_program_without_permission_fails_with_timeout(desk: Programming) -> None:
    one, two = desk.script(SEC), desk.motion()
    two.begins()
    two.says("was not permitted to go on")
    assert "got no start permission within 5 s, and has ended without moving the arm" in two.end
    assert one.phase is Phase.SENT


@pytest.mark.parametrize(
    ("options", "what_if"),
    [
        ({}, "it moves nothing if it begins later"),
        ({"asks": False}, "if it begins later, it might still move the arm"),
        ({"asks": False, "is_linked": True}, "it moves nothing if it begins later"),
        ({"asks": False, "is_stop": True}, "it moves nothing if it begins later"),
    ],
)
def test_program_that_does_not_begin_fails_with_timeout(
    desk: Programming, options: dict[str, bool], what_if: str
) -> None:
    run = desk.motion(**options)
    desk.clock.now += 5.0
    desk.state()
    assert run.phase is Phase.SENT
    desk.state(0.1, runs=True)
    assert isinstance(run.error, LinkTimeout)
    assert "did not begin within 5 s" in run.end
    assert f"the robot mode is RUNNING, a program is running; {what_if}; an e-Series" in run.end


def test_start_timeout_counts_from_sending(desk: Programming, monkeypatch: pytest.MonkeyPatch) -> None:
    desk.primary.room = 0

    def make_room() -> None:
        desk.clock.now += 0.2
        desk.primary.room = None

    desk.meanwhile = make_room
    run = desk.motion()
    desk.state(4.9)
    assert run.phase is Phase.SENT
    desk.state(0.2)
    assert "no program is running" in run.end


def test_secondary_program_times_out(desk: Programming) -> None:
    run = desk.script(SEC)
    run.begins()
    desk.state(5.1, runs=True)
    assert "did not end within 5 s; no error was reported; the robot mode is RUNNING, a program is running" in run.end
    assert "later" not in run.end


# -- ending ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("is_told", [True, False])
def test_finished_program_ends_by_key_message_or_flag(desk: Programming, is_told: bool) -> None:
    """The end is reported by a key message, or by the flag in the state, which might be set and cleared late."""
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


def test_program_counts_as_begun_when_its_finish_marker_arrives(desk: Programming) -> None:
    """The start marker might be missed, for example just after a reconnection."""
    before, run = desk.script(), desk.script()
    run.says("finished")
    assert run.phase is Phase.RUNNING
    assert isinstance(before.error, Cancelled)
    desk.state()
    assert run.end == "done"


@pytest.mark.parametrize("is_paused", [True, False])
def test_paused_program_keeps_its_phase(desk: Programming, is_paused: bool) -> None:
    run = desk.script()
    run.begins()
    desk.key("PROGRAM_XXX_PAUSED", run.program)
    for _ in range(3):
        desk.state(1.0, runs=not is_paused, paused=is_paused)
    assert run.phase is Phase.RUNNING
    desk.state(0.1)
    desk.state(0.2)
    assert run.phase is Phase.RUNNING  # the report of the stop may still arrive
    desk.state(0.2)
    assert run.end == f"ProgramStopped: {run.name} was stopped early by another client or a person"


@pytest.mark.parametrize("has_keys", [True, False])
def test_program_ends_when_its_running_flag_stays_clear(desk: Programming, has_keys: bool) -> None:
    """The limit is half a second. With key messages it is five seconds, because they might have been lost."""
    run = desk.script()
    if has_keys:
        desk.key(STARTED, "theirs")
    desk.key("PROGRAM_XXX_PAUSED", "theirs")
    run.says("started")
    for later in (0.5, 0.25, 0.1):  # exactly half a second is too short; then the report of a stop may still arrive
        desk.state(later)
        assert run.phase is Phase.RUNNING
    desk.state(0.25)
    assert (run.phase is Phase.RUNNING) == has_keys
    desk.state(4.0)
    desk.state(0.4)
    assert run.end == f"ProgramStopped: {run.name} was stopped early by another client or a person"


def test_stop_reported_after_end_is_the_cause(desk: Programming) -> None:
    run = desk.script()
    run.begins()
    desk.clock.now = 0.0
    run.stops()
    desk.state(0.3)
    assert run.phase is Phase.RUNNING
    desk.primary.deliver(slow(SafetyMode.PROTECTIVE_STOP))
    assert "protective stop" in run.end


def test_end_without_power_raises_not_running(desk: Programming) -> None:
    run = desk.script()
    run.begins()
    desk.interlock.policy = "always"  # a missing `enable()` is not the cause of an end
    run.stops()
    assert run.phase is Phase.RUNNING
    desk.state(0.4)
    assert isinstance(run.error, ProgramStopped)
    desk.interlock.policy = "never"
    run = desk.script()
    run.begins()
    desk.primary.deliver(slow(mode=RobotMode.POWER_OFF))
    assert run.phase is Phase.RUNNING  # a user's program might only be paused
    run.stops()
    assert isinstance(run.error, NotRunning)


@pytest.mark.parametrize("is_told", [True, False])
def test_script_error_ends_program_within_a_second(desk: Programming, is_told: bool) -> None:
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


def test_exception_is_assigned_to_the_right_program(desk: Programming, caplog: pytest.LogCaptureFixture) -> None:
    running = desk.script()
    running.begins()
    desk.exception("syntax_error_on_line:1:")  # caused by a text of another client
    assert "the controller reports: 1:1: syntax_error_on_line:1:" in caplog.text
    assert running.phase is Phase.RUNNING
    beside, awaited = desk.script(SEC), desk.script()
    desk.exception("compile_error")
    assert isinstance(awaited.error, CompileError)
    assert (running.phase, beside.phase) == (Phase.RUNNING, Phase.SENT)
    desk.exception("any error before the program begins")
    assert isinstance(beside.error, CompileError)
    another = desk.script(SEC)
    another.begins()
    desk.exception("no such output")
    assert isinstance(another.error, ScriptFailed)
    assert running.phase is Phase.RUNNING
    running.says("finished")
    desk.primary.deliver(RuntimeExceptionMessage(FIRMWARE, line=1, column=1, text="another"))
    running.stops()
    assert isinstance(running.error, ScriptFailed)


def test_beginning_program_ends_earlier_programs(desk: Programming) -> None:
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
    assert waits.phase is Phase.SENT  # it might have been sent after their program
    assert beside.phase is Phase.RUNNING
    waits.begins()
    later = desk.script()
    waits.stops()
    assert waits.end == f"Cancelled: {waits.name} was preempted by {later.name}"
    assert desk.stops == 0  # the preempting program has stopped it


def test_stopped_secondary_program_is_not_preempted(desk: Programming) -> None:
    beside = desk.script(SEC)
    beside.begins()
    desk.script().begins()
    beside.stops()
    assert beside.phase is Phase.RUNNING
    desk.state(0.4, runs=True)
    assert isinstance(beside.error, ProgramStopped)


@pytest.mark.parametrize("has_begun", [True, False])
def test_motion_ends_when_interlock_closes(desk: Programming, has_begun: bool) -> None:
    for packet in (slow(SafetyMode.PROTECTIVE_STOP), slow(mode=RobotMode.POWER_OFF)):
        motion, stop = desk.motion(), None
        if has_begun:
            motion.begins()
        script = desk.script(SEC)
        desk.primary.deliver(packet)
        error = motion.error
        assert script.phase is Phase.SENT
        if isinstance(error, NotRunning):
            later = "it might still move the arm" if has_begun else "it moves nothing if it begins later"
            assert str(error) == f"the robot is not running: its mode is POWER_OFF; {later}"
            stop = error
        else:
            assert isinstance(error, SafetyStop)
        desk.primary.deliver(slow())
    assert stop is not None


# -- current programs and stops --------------------------------------------------------------------------


def test_programs_lists_current_and_permitted_programs(desk: Programming) -> None:
    current = [desk.programs.current]
    motion = desk.motion()
    current.append(desk.programs.current)
    assert desk.programs.permitted == []
    motion.begins()
    free = desk.motion(asks=False)
    assert desk.programs.permitted == [motion.life, free.life]
    for source in (SEC, "movej(q)"):
        desk.script(source)
        current.append(desk.programs.current)
    # The last program is the user's own, which was sent after the motions.
    assert current == [None, motion.life, free.life, None]


def test_linked_program_gets_permission_only_after_it_has_begun(desk: Programming) -> None:
    """Otherwise a speed that is sent after it would move the arm even if the program never connects."""
    linked = desk.motion(asks=False, is_linked=True)
    assert desk.programs.permitted == []
    linked.begins()
    assert desk.programs.permitted == [linked.life]


def test_ended_motion_is_not_current_while_braking(desk: Programming) -> None:
    run = desk.motion(asks=False)
    seen: list[object] = []
    run.life.brake = lambda: seen.extend([desk.programs.current, desk.programs.permitted])
    run.cancel()
    assert seen == [None, []]


def test_only_the_newest_program_is_stopped(desk: Programming) -> None:
    one = desk.motion()
    two = desk.motion()
    one.cancel()
    assert desk.stops == 0  # the program sent after it stops it anyway
    two.cancel()
    assert desk.stops == 1
    desk.programs.stop(two.life)
    assert desk.stops == 1
    desk.interlock.policy = "on_startup"
    three = desk.motion(asks=False, is_stop=True)
    three.cancel()
    assert desk.stops == 2  # stopping the arm needs no `enable()`


def test_refused_stop_raises_safety_stop(desk: Programming) -> None:
    script = desk.script()
    script.begins()
    desk.primary.deliver(slow(SafetyMode.PROTECTIVE_STOP))
    with pytest.raises(SafetyStop, match="protective stop"):
        desk.programs.stop(script.life)


def test_ended_returns_the_time_at_which_the_last_program_ended(desk: Programming) -> None:
    """A state received before that time might still show the movement."""
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
def test_replacing_program_drops_pending_undos(
    desk: Programming, begin: Callable[[Programming], Run], pending: tuple[str, ...]
) -> None:
    """An abandoned command then needs no undo. Neither a stop nor a secondary program replaces it."""

    def undo(client: object, is_wanted: Callable[[], bool]) -> None:
        raise ConnectionLost("it is away")

    give_up(desk.undos, "play", undo)
    begin(desk)
    assert desk.undos.pending == pending
    desk.undos.close()


def test_stop_that_had_to_wait_does_not_stop_a_newer_motion(desk: Programming) -> None:
    one, others = desk.motion(), list[Any]()

    def beside() -> None:
        desk.meanwhile = lambda: None
        desk.primary.room = None
        others.append(desk.motion())  # as another thread would do

    desk.meanwhile, desk.primary.room = beside, 0
    one.cancel()
    assert len(others) == 1
    assert desk.stops == 0
    others[0].cancel()
    assert desk.stops == 1


# -- the connection ----------------------------------------------------------------------------------------


def test_silence_discards_recently_sent_text(desk: Programming) -> None:
    """The network may have failed up to half a second before the silence began."""
    for before, aborts in ((1.6, 0), (1.4, 1)):
        desk.motion()
        desk.clock.now += before
        for _, hook in desk.primary.watches:
            hook(1.0)
        assert desk.primary.aborts == aborts
        desk.primary.deliver(slow())


def test_lost_connection_ends_programs_sent_before(desk: Programming) -> None:
    script, motion = desk.script(), desk.motion(asks=False)
    for state in (ConnectionState.CONNECTING, ConnectionState.CONNECTED):
        desk.event(desk.primary, state)
    event = ConnectionEvent(
        ConnectionState.LOST, "line", ConnectionLost("pulled"), Stamp(desk.clock.now, desk.clock.now)
    )
    desk.programs.on_event(event)
    assert script.phase is motion.phase is Phase.SENT  # sent after the loss, over the next connection
    desk.clock.now += 0.1
    desk.programs.on_event(event._replace(received=Stamp(desk.clock.now, desk.clock.now)))
    lost = "the connection was lost while {} was running; {}: pulled"
    assert script.end == "ConnectionLost: " + lost.format(script.name, "it moves nothing if it begins later")
    later = "if it begins later, it might still move the arm"
    assert motion.end == "NotRunning: " + lost.format(motion.name, later)
    another = desk.script()
    another.begins()
    desk.clock.now += 0.1
    desk.programs.on_event(event._replace(received=Stamp(desk.clock.now, desk.clock.now), error=None))
    assert another.end.endswith("was running; it might still run")


@pytest.mark.parametrize(("state", "is_left"), [(s, s.name in ("IDLE", "CLOSED")) for s in ConnectionState])
def test_next_motion_subscribes_again_after_connection_gave_up(
    desk: Programming, state: ConnectionState, is_left: bool
) -> None:
    desk.motion()
    before = len(desk.primary.subscribers)
    desk.programs.on_event(ConnectionEvent(state, "line", None, Stamp(0.0, 0.0)))
    desk.motion()
    assert len(desk.primary.subscribers) == before + (2 if is_left else 0)


def test_nothing_is_sent_when_subscribing_fails(desk: Programming) -> None:
    subscribe, before = desk.primary.subscribe_inline, len(desk.primary.subscribers)

    def refuse(kind: type, callback: Callable[[Any], object], **options: object) -> Subscriber:
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
    closed = f"ConnectionLost: the robot was closed while {run.name} was running; it might still "
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
    """Another thread or a signal handler might request one just then; it would continue after the robot is closed."""
    run = desk.motion()
    failures: list[Exception] = []

    def begin() -> None:
        try:
            desk.motion()
        except LinkError as error:
            failures.append(error)

    run.life.on_end(begin)
    before = len(desk.sent)
    desk.programs.close(0.0)
    assert [type(error) for error in failures] == [Closed]
    assert not [text for text in desk.sent[before:] if "stopj" not in text]
    ended = weakref.ref(run.life)
    failures.clear()
    del run
    gc.collect()
    assert ended() is None
