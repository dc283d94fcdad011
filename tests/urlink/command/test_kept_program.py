"""A program that was given up during a stop is stopped after it: `play` at the pendant does not let it go on.

Nor does one go on that was given up after another was sent, where that one does not begin.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest

import urlink
from linkcore.errors import LinkError
from linkcore.handle import Handle, Phase
from linkcore.streaming.connection_life import ConnectionState
from tests.fakes.line import STARTED, STOPPED, Programming, Run, Subscriber, fast
from tests.waiting import until
from urlink.errors import CompileError, NotRunning
from urlink.protocol.enums import RobotMode, SafetyMode
from urlink.script.wrapping import StartPlace
from urlink.simulator import Controller, Still

pytestmark = pytest.mark.simulated_time

HOME = (0.0, -1.57, 1.57, -1.57, -1.57, 0.0)
#: it takes some 15 s to get there
TARGET = [1.5, *HOME[1:]]
#: a program of the pendant's, as long
ELSEWHERE = f"def p():\n  movej({[*HOME[:5], 1.5]}, a=20, v=0.1)\nend\n"


@pytest.fixture(params=["3.5", "5.11"])
def controller(request: pytest.FixtureRequest) -> Iterator[Controller]:
    model = "UR5" if request.param == "3.5" else "UR5e"
    with Controller(model, request.param, motion=Still(HOME), files={"/p.urp": ELSEWHERE}) as controller:
        yield controller


@pytest.fixture
def robot(controller: Controller) -> Iterator[urlink.Robot]:
    with urlink.connect(controller.address) as robot:
        yield robot


def moves(controller: Controller) -> bool:
    return max(map(abs, controller.arm.setpoint.qd)) > 0.05


def move(robot: urlink.Robot) -> Handle:
    return robot.motion.move_joints(TARGET, speed=0.1)


def script(robot: urlink.Robot) -> Handle:
    return robot.script.run(f"def p():\n  movej({TARGET}, a=20, v=0.1)\nend\n")


def during(controller: Controller, robot: urlink.Robot, handle: Handle) -> None:
    controller.faults.protective_stop()
    robot.safety.wait_for_stop(5)
    handle.cancel()


def at_once(controller: Controller, robot: urlink.Robot, handle: Handle) -> None:
    """The stop is sent before that of the robot is known here, and arrives while it holds."""
    controller.faults.protective_stop()
    handle.cancel()
    robot.safety.wait_for_stop(5)


@pytest.mark.parametrize("give_up", [during, at_once])
@pytest.mark.parametrize("begin", [move, script])
def test_it_does_not_go_on(
    controller: Controller,
    robot: urlink.Robot,
    begin: Callable[[urlink.Robot], Handle],
    give_up: Callable[[Controller, urlink.Robot, Handle], None],
) -> None:
    handle = begin(robot)
    until(lambda: moves(controller))
    give_up(controller, robot, handle)
    assert handle.done
    until(lambda: not moves(controller))
    assert controller.program_name  # paused, and still there
    controller.faults.clear()
    until(lambda: not controller.program_name)
    controller.pendant.play()
    time.sleep(1.0)
    assert not moves(controller)


def test_it_does_not_go_on_after_a_script_that_does_not_compile(controller: Controller, robot: urlink.Robot) -> None:
    """The simulated controller keeps the paused program then; whether a real one does is not known."""
    handle = move(robot)
    until(lambda: moves(controller))
    during(controller, robot, handle)
    controller.faults.clear()
    robot.safety.wait_enabled(5)
    with pytest.raises(CompileError):
        robot.script.run(REFUSED).wait(5)
    until(lambda: not controller.program_name)
    controller.pendant.play()
    time.sleep(1.0)
    assert not moves(controller)


#: Runs beside another program.
BESIDE = "sec blink():\n  set_flag(1, True)\nend"
#: Does not compile.
REFUSED = "def p():\n  no_such_function()\nend\n"


def cancel(robot: urlink.Robot, handle: Handle, script: Handle) -> None:
    handle.cancel()
    with pytest.raises(CompileError):
        script.wait(5)


def close(robot: urlink.Robot, handle: Handle, script: Handle) -> None:
    robot.close()


@pytest.mark.parametrize("give_up", [cancel, close])
def test_a_motion_is_not_left_to_a_script_that_does_not_compile(
    controller: Controller, robot: urlink.Robot, give_up: Callable[[urlink.Robot, Handle, Handle], None]
) -> None:
    handle = move(robot)
    until(lambda: moves(controller))
    give_up(robot, handle, robot.script.run(REFUSED))
    assert handle.phase is Phase.CANCELLED
    until(lambda: not controller.program_name, 0.2)
    time.sleep(1.0)
    assert not moves(controller)


def test_a_script_that_nobody_gave_up_may_go_on(controller: Controller, robot: urlink.Robot) -> None:
    script(robot)
    until(lambda: moves(controller))
    controller.faults.protective_stop()
    robot.safety.wait_for_stop(5)
    controller.faults.clear()
    robot.safety.wait_enabled(5)
    time.sleep(1.0)
    controller.pendant.play()
    until(lambda: moves(controller))


@pytest.mark.parametrize("is_first", [False, True], ids=["programs first", "safety first"])
def test_a_program_that_the_pendant_began_instead_is_left_alone(
    controller: Controller, robot: urlink.Robot, is_first: bool
) -> None:
    """Whichever listens first to the interface that tells of both."""
    if is_first:
        robot.safety.wait_enabled(5)
    move(robot)
    until(lambda: moves(controller))
    controller.faults.protective_stop()
    robot.safety.wait_for_stop(5)
    controller.pendant.stop()
    controller.faults.clear()
    controller.pendant.load("/p.urp")
    controller.pendant.play()
    until(lambda: moves(controller))
    time.sleep(1.0)
    assert moves(controller)


def test_closing_after_a_stop_that_the_controller_goes_on_from_stops_it(
    controller: Controller, robot: urlink.Robot
) -> None:
    """As after a safety mode that is in no list, which stops nothing."""
    move(robot)
    until(lambda: moves(controller))
    controller.faults.safeguard_stop(resumes=True)
    robot.safety.wait_for_stop(5)
    controller.faults.clear()
    robot.close()
    until(lambda: not controller.program_name, 5.0)
    time.sleep(1.0)
    assert not moves(controller)


@pytest.mark.parametrize(("timeout", "longest"), [(2.0, 0.31), (0.0, 0.001)])
def test_closing_during_a_stop_waits_for_three_states(
    controller: Controller, robot: urlink.Robot, timeout: float, longest: float
) -> None:
    move(robot)
    until(lambda: moves(controller))
    controller.faults.protective_stop()
    robot.safety.wait_for_stop(5)
    began = time.monotonic()
    robot._control.made._programs.close(timeout)  # type: ignore[union-attr]
    assert time.monotonic() - began <= longest


# -- state by state, without a controller ----------------------------------------------------------------


def states(desk: Programming, count: int, **shown: bool) -> None:
    """So many, each a tenth of a second after the one before."""
    for _ in range(count):
        desk.state(0.1, **shown)


def short_stop(desk: Programming) -> None:
    """It is over before the primary interface has reported it."""
    desk.realtime.tell(fast(SafetyMode.PROTECTIVE_STOP))
    desk.realtime.tell(fast())


def says_so(run: Run) -> None:
    """As on a CB2, which reports no programs by name."""
    run.says("started")


def stopped(desk: Programming, begins: Callable[[Run], None] = Run.begins) -> Run:
    """A motion that a stop has ended; the stop is over, and the next state may be the second without it."""
    run = desk.motion()
    begins(run)
    desk.state(0.1, runs=True)
    short_stop(desk)
    assert run.end.startswith("SafetyStop")
    desk.state(0.1, paused=True)
    assert desk.stops == 0
    return run


def test_it_is_stopped_by_the_second_state_without_a_stop() -> None:
    desk = Programming()
    stopped(desk)
    desk.state(0.1, paused=True)
    assert desk.stops == 1


def test_a_stop_that_is_ignored_is_sent_again_after_a_quarter_of_a_second() -> None:
    """In local control an e-Series ignores what it is sent."""
    desk = Programming()
    run = desk.motion()
    run.begins()
    desk.state(0.1, runs=True)
    run.cancel()
    assert desk.stops == 1
    desk.state(0.24, runs=True)
    desk.state(0.02, runs=True)
    assert desk.stops == 1
    desk.state(0.02, runs=True)
    assert desk.stops == 2


def test_once_it_is_gone_another_program_is_left_alone() -> None:
    """As of a person, on a controller that reports no programs by name."""
    desk = Programming(firmware="1.8")
    desk.motion(asks=False).says("started")
    desk.state(0.1, runs=True)
    short_stop(desk)
    for runs in (False, False, True, True, True):
        desk.state(0.1, runs=runs)
    assert desk.stops == 0


def test_a_program_that_was_sent_before_the_stop_and_begins_after_it_is_left_alone() -> None:
    """It asks for no permission, so a stop does not keep it from beginning."""
    desk = Programming(firmware="1.8", start_place=StartPlace(None, ()))
    desk.motion(asks=False).says("started")
    script = desk.script()
    short_stop(desk)
    states(desk, 4, runs=True)
    assert desk.stops == 0
    assert not script.done


def test_where_the_controller_takes_nothing_the_reader_does_not_wait() -> None:
    desk = Programming()
    stopped(desk)
    desk.primary.room = 0
    desk.state(0.1, paused=True)
    assert desk.waits == []
    desk.primary.room = None
    desk.state(0.1, paused=True)
    assert desk.stops == 1


def test_one_that_is_replaced_while_it_is_to_be_stopped_is_not_stopped() -> None:
    """Another thread sends the next motion between the state and the stop."""
    desk = Programming()
    stopped(desk)
    refusal = desk.monitor.refusal_to_stop
    sent: list[Run] = []

    def refuses() -> Any:
        found = refusal()
        desk.monitor.refusal_to_stop = refusal  # type: ignore[method-assign]
        sent.append(desk.motion())
        return found

    desk.monitor.refusal_to_stop = refuses  # type: ignore[method-assign]
    desk.state(0.1, paused=True)
    assert len(sent) == 1
    assert desk.stops == 0
    assert not sent[0].done


def test_two_threads_that_begin_to_listen_at_once_listen_once() -> None:
    desk = Programming()
    subscribe, before = desk.primary.subscribe_inline, len(desk.primary.subscribers)

    def meanwhile(kind: type, callback: Callable[[Any], object]) -> Subscriber:
        desk.primary.subscribe_inline = subscribe  # type: ignore[method-assign]
        desk.programs._listen()
        return subscribe(kind, callback)

    desk.primary.subscribe_inline = meanwhile  # type: ignore[method-assign]
    desk.programs._listen()
    assert len(desk.primary.subscribers) == before + 2


def test_a_lost_connection_forgets_it() -> None:
    """Which program the controller has by the next connection is not known."""
    desk = Programming()
    stopped(desk)
    desk.event(desk.primary, ConnectionState.LOST)
    desk.event(desk.primary, ConnectionState.CONNECTED)
    states(desk, 4, paused=True)
    assert desk.stops == 0


@pytest.mark.parametrize(("title", "name"), [(STOPPED, None), (STARTED, "theirs")])
def test_once_it_has_ended_or_was_replaced_what_runs_is_left_alone(title: str, name: str | None) -> None:
    desk = Programming()
    run = stopped(desk)
    desk.key(title, name or run.program)
    states(desk, 4, runs=True)
    assert desk.stops == 0


@pytest.mark.parametrize(("title", "is_its_own"), [(STOPPED, False), (STARTED, True)])
def test_what_is_reported_of_another_program_does_not_forget_it(title: str, is_its_own: bool) -> None:
    desk = Programming()
    run = stopped(desk)
    desk.key(title, run.program if is_its_own else "theirs")
    desk.state(0.1, paused=True)
    assert desk.stops == 1


def test_it_is_stopped_where_nobody_has_enabled_motions() -> None:
    desk = Programming()
    desk.interlock.policy = "always"
    desk.interlock.enable(desk.clock.now)
    stopped(desk)
    with pytest.raises(LinkError, match="enable"):
        desk.motion()
    assert desk.stops == 0  # what was not sent does not hurry it
    desk.state(0.1, paused=True)
    assert desk.stops == 1


@pytest.mark.parametrize(("firmware", "stops"), [("5.11", 2), ("1.8", 1)])
def test_its_stop_is_sent_again_where_its_end_would_be_reported(firmware: str, stops: int) -> None:
    """A CB2 reports no ends by name, so a program that runs later may be another."""
    desk = Programming(firmware=firmware)
    run = desk.motion(asks=False)
    run.begins() if firmware == "5.11" else run.says("started")
    desk.state(0.1, runs=True)
    short_stop(desk)
    states(desk, 6, runs=True)
    assert desk.stops == stops


def test_one_that_was_sent_a_stop_just_before_is_sent_it_again() -> None:
    """It may have stopped before that arrived; a CB2 reports no ends by name."""
    desk = Programming(firmware="1.8")
    run = desk.motion(asks=False)
    run.says("started")
    desk.state(0.1, runs=True)
    run.cancel()
    assert desk.stops == 1
    short_stop(desk)
    states(desk, 3, paused=True)
    assert desk.stops == 2


def test_a_script_that_is_cancelled_during_a_stop_is_stopped_after_it() -> None:
    desk = Programming(firmware="1.8")
    script = desk.script()
    script.says("started")
    desk.state(0.1, runs=True)
    desk.realtime.tell(fast(SafetyMode.PROTECTIVE_STOP))
    script.cancel()
    assert desk.stops == 0
    desk.realtime.tell(fast())
    states(desk, 3, paused=True)
    assert desk.stops == 1


def test_a_later_program_replaces_it_where_none_is_reported_by_name(caplog: pytest.LogCaptureFixture) -> None:
    """Nothing tries to stop it any more, with each state."""
    caplog.set_level("INFO", "urlink")
    desk = Programming(firmware="1.8")
    desk.motion(asks=False).says("started")
    desk.state(0.1, runs=True)
    short_stop(desk)
    desk.motion(asks=False).says("started")
    states(desk, 3, runs=True)
    assert desk.stops == 0
    assert caplog.messages == []


@pytest.mark.parametrize(("firmware", "begins"), [("5.11", Run.begins), ("1.8", says_so)])
def test_one_that_does_not_compile_does_not_replace_it(
    firmware: str, begins: Callable[[Run], None], caplog: pytest.LogCaptureFixture
) -> None:
    """It is stopped once nothing is about to replace it; until then no state reports an attempt."""
    caplog.set_level("INFO", "urlink")
    desk = Programming(firmware=firmware)
    stopped(desk, begins)
    script = desk.script("no_such_function()")
    states(desk, 3, paused=True)
    assert desk.stops == 0
    desk.exception("compile_error_name_not_found:no_such_function:")
    assert script.end.startswith("CompileError")
    assert desk.stops == 1
    assert caplog.messages == []


def test_the_next_stop_does_not_forget_it() -> None:
    """It comes before the second state without the one before."""
    desk = Programming()
    stopped(desk)
    desk.realtime.tell(fast(SafetyMode.PROTECTIVE_STOP))
    states(desk, 3, paused=True)
    assert desk.stops == 0
    desk.realtime.tell(fast())
    states(desk, 2, paused=True)
    assert desk.stops == 1


def test_one_that_begins_while_it_is_sent_a_stop_is_sent_it_again() -> None:
    """The stop was on its way before the program began, so it is no other that has begun."""
    desk = Programming()
    run = desk.motion()
    run.cancel()
    assert desk.stops == 1
    run.begins()
    states(desk, 4, runs=True)
    assert desk.stops == 2


def test_a_program_beside_it_does_not_replace_it() -> None:
    desk = Programming()
    stopped(desk)
    beside = desk.script(BESIDE)
    beside.says("started")
    desk.state(0.1, paused=True)
    assert desk.stops == 1


def test_one_that_ends_since_the_robot_does_not_run_is_not_stopped_later() -> None:
    """It was not paused: what runs once the robot runs again may be another."""
    desk = Programming(firmware="1.8")
    run = desk.motion(asks=False)
    run.says("started")
    desk.state(0.1, runs=True)
    desk.realtime.tell(fast(mode=RobotMode.POWER_OFF))
    assert run.end.startswith("NotRunning")
    desk.realtime.tell(fast())
    states(desk, 3, runs=True)
    assert desk.stops == 0


# -- given up after another was sent -------------------------------------------------------------------------


def moving(desk: Programming) -> Run:
    run = desk.motion()
    run.begins()
    desk.state(0.1, runs=True)
    return run


def refuse(desk: Programming, run: Run) -> None:
    desk.exception("compile_error_name_not_found:no_such_function:")


def give_up(desk: Programming, run: Run) -> None:
    run.cancel()


def close_all(desk: Programming, run: Run) -> None:
    desk.programs.close(0.0)


def ends_by_itself(desk: Programming, run: Run) -> None:
    """Nothing is stopped then, nor later."""
    run.says("finished")
    run.stops()
    states(desk, 3, runs=True)
    assert desk.stops == 0


@pytest.mark.parametrize("end", [refuse, give_up, close_all])
def test_it_is_stopped_once_where_the_other_ends_before_it_has_begun(
    end: Callable[[Programming, Run], None], caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level("INFO", "urlink")
    desk = Programming()
    run, script = moving(desk), desk.script()
    run.cancel()
    assert desk.stops == 0
    end(desk, script)
    assert script.done
    assert desk.stops == 1
    assert caplog.messages == []


def test_it_is_stopped_where_the_other_never_begins() -> None:
    desk = Programming(start_timeout=1.0)
    run, script = moving(desk), desk.script()
    run.cancel()
    desk.state(1.0, runs=True)
    assert (script.done, desk.stops) == (False, 0)
    desk.state(0.1, runs=True)
    assert (script.done, desk.stops) == (True, 1)


def test_where_the_other_begins_nothing_is_stopped() -> None:
    desk = Programming()
    run, script = moving(desk), desk.script()
    run.cancel()
    script.begins()
    states(desk, 3, runs=True)
    ends_by_itself(desk, script)


def test_where_the_other_has_begun_it_is_over() -> None:
    desk = Programming()
    run, script = moving(desk), desk.script()
    script.begins()
    assert run.end.startswith("Cancelled")
    desk.programs.stop(run._life)
    ends_by_itself(desk, script)


def test_nobody_stops_what_goes_on_and_was_not_given_up() -> None:
    desk = Programming()
    run, script = moving(desk), desk.script()
    refuse(desk, script)
    states(desk, 3, runs=True)
    assert (run.done, desk.stops) == (False, 0)


def test_a_program_beside_it_that_is_given_up_stops_nothing() -> None:
    desk = Programming()
    beside, script = desk.script(BESIDE), desk.script()
    beside.cancel()
    refuse(desk, script)
    states(desk, 3, runs=True)
    assert desk.stops == 0


def test_a_program_beside_it_that_ends_does_not_hurry_the_stop() -> None:
    """As a state does, it may come before the report of which program runs."""
    desk = Programming()
    beside = desk.script(BESIDE)
    stopped(desk)
    beside.says("finished")
    assert beside.done
    assert desk.stops == 0


def test_a_program_beside_it_that_is_given_up_does_not_forget_it() -> None:
    desk = Programming()
    beside = desk.script(BESIDE)
    stopped(desk)
    script = desk.script()
    beside.cancel()
    refuse(desk, script)
    assert desk.stops == 1


def test_during_a_stop_it_is_stopped_after_it(caplog: pytest.LogCaptureFixture) -> None:
    """The stop ends what waits for its permission, and takes no program."""
    caplog.set_level("INFO", "urlink")
    desk = Programming()
    run, script = moving(desk), desk.script()
    run.cancel()
    desk.realtime.tell(fast(SafetyMode.PROTECTIVE_STOP))
    assert script.end.startswith("SafetyStop")
    assert desk.stops == 0
    desk.realtime.tell(fast())
    states(desk, 2, paused=True)
    assert desk.stops == 1
    assert caplog.messages == []


def test_it_is_left_to_the_other_also_while_nothing_is_known_of_the_robot(monkeypatch: pytest.MonkeyPatch) -> None:
    """It is not asked whether it may be stopped."""

    def unknown(is_stop: bool) -> None:
        raise NotRunning("nothing is known")

    desk = Programming()
    run, script = moving(desk), desk.script()
    with monkeypatch.context() as patched:
        patched.setattr(desk.monitor, "require", unknown)
        run.cancel()
    refuse(desk, script)
    assert desk.stops == 1


# -- closed ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("is_stopped", "state", "warns"),
    [(True, {"paused": True}, True), (True, {"runs": True}, False), (False, {"paused": True}, False)],
)
def test_closing_tells_of_a_program_that_stays_paused(
    is_stopped: bool, state: dict[str, bool], warns: bool, caplog: pytest.LogCaptureFixture
) -> None:
    desk = Programming()
    moving(desk)
    if is_stopped:
        desk.realtime.tell(fast(SafetyMode.PROTECTIVE_STOP))
    desk.state(0.1, **state)
    desk.programs.close(0.0)
    assert ("is paused on the controller and might resume later" in caplog.text) is warns


def test_closing_before_a_state_has_come(caplog: pytest.LogCaptureFixture) -> None:
    desk = Programming()
    desk.motion().begins()
    desk.realtime.tell(fast(SafetyMode.PROTECTIVE_STOP))
    desk.programs._mode = None
    desk.programs.close(0.0)
    assert "closed during a stop" not in caplog.text
