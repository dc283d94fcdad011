"""A program abandoned during a stop is stopped after the stop, so `play` on the pendant does not resume it.

A program that was abandoned after another program was sent is stopped too, if the other program does not begin.
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
#: Target of a motion that takes about 15 s.
TARGET = [1.5, *HOME[1:]]
#: A program of the pendant that takes equally long.
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
    """The stop is sent before the protective stop is received here, and arrives while that stop is active."""
    controller.faults.protective_stop()
    handle.cancel()
    robot.safety.wait_for_stop(5)


@pytest.mark.parametrize("give_up", [during, at_once])
@pytest.mark.parametrize("begin", [move, script])
def test_program_cancelled_in_stop_does_not_resume(
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
    assert controller.program_name  # paused, but still loaded
    controller.faults.clear()
    until(lambda: not controller.program_name)
    controller.pendant.play()
    time.sleep(1.0)
    assert not moves(controller)


def test_cancelled_program_does_not_resume_after_compile_error(controller: Controller, robot: urlink.Robot) -> None:
    """The simulated controller then keeps the paused program; the behaviour of a real controller is unknown."""
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


#: Runs in addition to another program.
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
def test_motion_is_stopped_when_later_script_does_not_compile(
    controller: Controller, robot: urlink.Robot, give_up: Callable[[urlink.Robot, Handle, Handle], None]
) -> None:
    handle = move(robot)
    until(lambda: moves(controller))
    give_up(robot, handle, robot.script.run(REFUSED))
    assert handle.phase is Phase.CANCELLED
    until(lambda: not controller.program_name, 0.2)
    time.sleep(1.0)
    assert not moves(controller)


def test_script_that_was_not_cancelled_can_resume(controller: Controller, robot: urlink.Robot) -> None:
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
def test_program_started_on_pendant_is_not_stopped(controller: Controller, robot: urlink.Robot, is_first: bool) -> None:
    """The result does not depend on whether the programs or the safety monitor subscribe first."""
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


def test_close_after_stop_stops_resumed_program(controller: Controller, robot: urlink.Robot) -> None:
    """The same happens after a safety mode that is in no list, which stops nothing."""
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
def test_close_during_stop_waits_for_three_states(
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
    """Send `count` states, one every 0.1 s."""
    for _ in range(count):
        desk.state(0.1, **shown)


def short_stop(desk: Programming) -> None:
    """Simulate a stop that ends before the primary interface reports it."""
    desk.realtime.deliver(fast(SafetyMode.PROTECTIVE_STOP))
    desk.realtime.deliver(fast())


def says_so(run: Run) -> None:
    """Begin as on a CB2, which does not report programs by name."""
    run.says("started")


def stopped(desk: Programming, begins: Callable[[Run], None] = Run.begins) -> Run:
    """Return a motion that was ended by a stop; the stop has ended, and the next state is the second without it."""
    run = desk.motion()
    begins(run)
    desk.state(0.1, runs=True)
    short_stop(desk)
    assert run.end.startswith("SafetyStop")
    desk.state(0.1, paused=True)
    assert desk.stops == 0
    return run


def test_kept_program_is_stopped_at_second_state_after_stop() -> None:
    desk = Programming()
    stopped(desk)
    desk.state(0.1, paused=True)
    assert desk.stops == 1


def test_ignored_stop_is_repeated_after_quarter_second() -> None:
    """An e-Series in local control ignores all texts that it is sent."""
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


def test_other_program_is_not_stopped_after_kept_program_ended() -> None:
    """For example a program that a person started, on a controller that does not report programs by name."""
    desk = Programming(firmware="1.8")
    desk.motion(asks=False).says("started")
    desk.state(0.1, runs=True)
    short_stop(desk)
    for runs in (False, False, True, True, True):
        desk.state(0.1, runs=runs)
    assert desk.stops == 0


def test_program_sent_before_stop_is_not_stopped_when_it_begins() -> None:
    """The program asks for no permission, so a stop does not prevent it from beginning."""
    desk = Programming(firmware="1.8", start_place=StartPlace(None, ()))
    desk.motion(asks=False).says("started")
    script = desk.script()
    short_stop(desk)
    states(desk, 4, runs=True)
    assert desk.stops == 0
    assert not script.done


def test_reader_thread_does_not_wait_if_send_buffer_is_full() -> None:
    desk = Programming()
    stopped(desk)
    desk.primary.room = 0
    desk.state(0.1, paused=True)
    assert desk.waits == []
    desk.primary.room = None
    desk.state(0.1, paused=True)
    assert desk.stops == 1


def test_no_stop_is_sent_after_the_kept_program_was_replaced() -> None:
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


#: A script that preempts no other one.
BESIDE = "sec blink():\n  set_flag(1, True)\nend"


def test_concurrent_listen_subscribes_once() -> None:
    desk = Programming()
    subscribe, before = desk.primary.subscribe_inline, len(desk.primary.subscribers)

    def meanwhile(kind: type, callback: Callable[[Any], object], **options: object) -> Subscriber:
        desk.primary.subscribe_inline = subscribe  # type: ignore[method-assign]
        desk.script(BESIDE)
        return subscribe(kind, callback)

    desk.primary.subscribe_inline = meanwhile  # type: ignore[method-assign]
    desk.script(BESIDE)
    assert len(desk.primary.subscribers) == before + 2


def test_lost_connection_forgets_kept_program() -> None:
    """After a reconnection, it is unknown which program the controller runs."""
    desk = Programming()
    stopped(desk)
    desk.event(desk.primary, ConnectionState.LOST)
    desk.event(desk.primary, ConnectionState.CONNECTED)
    states(desk, 4, paused=True)
    assert desk.stops == 0


@pytest.mark.parametrize(("title", "name"), [(STOPPED, None), (STARTED, "theirs")])
def test_other_program_is_not_stopped_after_end_or_replacement(title: str, name: str | None) -> None:
    desk = Programming()
    run = stopped(desk)
    desk.key(title, name or run.program)
    states(desk, 4, runs=True)
    assert desk.stops == 0


@pytest.mark.parametrize(("title", "is_its_own"), [(STOPPED, False), (STARTED, True)])
def test_report_about_another_program_does_not_end_kept_program(title: str, is_its_own: bool) -> None:
    desk = Programming()
    run = stopped(desk)
    desk.key(title, run.program if is_its_own else "theirs")
    desk.state(0.1, paused=True)
    assert desk.stops == 1


def test_kept_program_is_stopped_without_enable() -> None:
    desk = Programming()
    desk.interlock.policy = "always"
    desk.interlock.enable(desk.clock.now)
    stopped(desk)
    with pytest.raises(LinkError, match="enable"):
        desk.motion()
    assert desk.stops == 0  # a refused motion does not bring the stop forward
    desk.state(0.1, paused=True)
    assert desk.stops == 1


@pytest.mark.parametrize(("firmware", "stops"), [("5.11", 2), ("1.8", 1)])
def test_stop_is_repeated_only_if_firmware_reports_program_ends(firmware: str, stops: int) -> None:
    """A CB2 does not report ends by name, so a program that runs later may be a different one."""
    desk = Programming(firmware=firmware)
    run = desk.motion(asks=False)
    run.begins() if firmware == "5.11" else run.says("started")
    desk.state(0.1, runs=True)
    short_stop(desk)
    states(desk, 6, runs=True)
    assert desk.stops == stops


def test_stop_sent_just_before_safety_stop_is_repeated() -> None:
    """The robot may have stopped before the sent stop arrived; a CB2 does not report ends by name."""
    desk = Programming(firmware="1.8")
    run = desk.motion(asks=False)
    run.says("started")
    desk.state(0.1, runs=True)
    run.cancel()
    assert desk.stops == 1
    short_stop(desk)
    states(desk, 3, paused=True)
    assert desk.stops == 2


def test_script_cancelled_during_stop_is_stopped_afterwards() -> None:
    desk = Programming(firmware="1.8")
    script = desk.script()
    script.says("started")
    desk.state(0.1, runs=True)
    desk.realtime.deliver(fast(SafetyMode.PROTECTIVE_STOP))
    script.cancel()
    assert desk.stops == 0
    desk.realtime.deliver(fast())
    states(desk, 3, paused=True)
    assert desk.stops == 1


def test_later_program_replaces_kept_program_on_cb2(caplog: pytest.LogCaptureFixture) -> None:
    """After the replacement, no state tries to stop the program."""
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
def test_script_with_compile_error_keeps_kept_program(
    firmware: str, begins: Callable[[Run], None], caplog: pytest.LogCaptureFixture
) -> None:
    """The kept program is stopped when no other program is about to replace it; until then nothing is logged."""
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


def test_next_stop_does_not_forget_kept_program() -> None:
    """The next stop comes before the second state without the previous stop."""
    desk = Programming()
    stopped(desk)
    desk.realtime.deliver(fast(SafetyMode.PROTECTIVE_STOP))
    states(desk, 3, paused=True)
    assert desk.stops == 0
    desk.realtime.deliver(fast())
    states(desk, 2, paused=True)
    assert desk.stops == 1


def test_stop_is_repeated_for_program_that_begins_late() -> None:
    """The stop was sent before the program began, so the program that began is the abandoned one."""
    desk = Programming()
    run = desk.motion()
    run.cancel()
    assert desk.stops == 1
    run.begins()
    states(desk, 4, runs=True)
    assert desk.stops == 2


def test_secondary_program_does_not_replace_kept_program() -> None:
    desk = Programming()
    stopped(desk)
    beside = desk.script(BESIDE)
    beside.says("started")
    desk.state(0.1, paused=True)
    assert desk.stops == 1


def test_program_ended_by_power_off_is_not_stopped_later() -> None:
    """The program was not paused, so a program that runs after power-on may be a different one."""
    desk = Programming(firmware="1.8")
    run = desk.motion(asks=False)
    run.says("started")
    desk.state(0.1, runs=True)
    desk.realtime.deliver(fast(mode=RobotMode.POWER_OFF))
    assert run.end.startswith("NotRunning")
    desk.realtime.deliver(fast())
    states(desk, 3, runs=True)
    assert desk.stops == 0


# -- abandoned after another program was sent ----------------------------------------------------------------


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
    """End the program normally; nothing is stopped then or later."""
    run.says("finished")
    run.stops()
    states(desk, 3, runs=True)
    assert desk.stops == 0


@pytest.mark.parametrize("end", [refuse, give_up, close_all])
def test_program_is_stopped_once_when_later_script_ends_early(
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


def test_program_is_stopped_when_later_script_never_begins() -> None:
    desk = Programming(start_timeout=1.0)
    run, script = moving(desk), desk.script()
    run.cancel()
    desk.state(1.0, runs=True)
    assert (script.done, desk.stops) == (False, 0)
    desk.state(0.1, runs=True)
    assert (script.done, desk.stops) == (True, 1)


def test_nothing_is_stopped_when_later_script_begins() -> None:
    desk = Programming()
    run, script = moving(desk), desk.script()
    run.cancel()
    script.begins()
    states(desk, 3, runs=True)
    ends_by_itself(desk, script)


def test_program_has_ended_when_later_script_begins() -> None:
    desk = Programming()
    run, script = moving(desk), desk.script()
    script.begins()
    assert run.end.startswith("Cancelled")
    desk.programs.stop(run.life)
    ends_by_itself(desk, script)


def test_running_program_that_was_not_cancelled_is_not_stopped() -> None:
    desk = Programming()
    run, script = moving(desk), desk.script()
    refuse(desk, script)
    states(desk, 3, runs=True)
    assert (run.done, desk.stops) == (False, 0)


def test_cancelled_secondary_program_stops_nothing() -> None:
    desk = Programming()
    beside, script = desk.script(BESIDE), desk.script()
    beside.cancel()
    refuse(desk, script)
    states(desk, 3, runs=True)
    assert desk.stops == 0


def test_end_of_secondary_program_does_not_trigger_pending_stop() -> None:
    """Like a state, it may arrive before the report of the running program."""
    desk = Programming()
    beside = desk.script(BESIDE)
    stopped(desk)
    beside.says("finished")
    assert beside.done
    assert desk.stops == 0


def test_cancelled_secondary_program_keeps_kept_program() -> None:
    desk = Programming()
    beside = desk.script(BESIDE)
    stopped(desk)
    script = desk.script()
    beside.cancel()
    refuse(desk, script)
    assert desk.stops == 1


def test_program_cancelled_before_stop_is_stopped_after_stop(caplog: pytest.LogCaptureFixture) -> None:
    """The safety stop ends programs that wait for permission; during it, the controller accepts no program."""
    caplog.set_level("INFO", "urlink")
    desk = Programming()
    run, script = moving(desk), desk.script()
    run.cancel()
    desk.realtime.deliver(fast(SafetyMode.PROTECTIVE_STOP))
    assert script.end.startswith("SafetyStop")
    assert desk.stops == 0
    desk.realtime.deliver(fast())
    states(desk, 2, paused=True)
    assert desk.stops == 1
    assert caplog.messages == []


def test_unknown_robot_state_ends_no_program_during_a_script(monkeypatch: pytest.MonkeyPatch) -> None:
    """The interlock is not asked whether the program may be stopped."""

    def unknown(is_stop: bool) -> None:
        raise NotRunning("the state is unknown")

    desk = Programming()
    run, script = moving(desk), desk.script()
    with monkeypatch.context() as patched:
        patched.setattr(desk.monitor, "require", unknown)
        run.cancel()
    refuse(desk, script)
    assert desk.stops == 1


# -- closing ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("is_stopped", "state", "warns"),
    [(True, {"paused": True}, True), (True, {"runs": True}, False), (False, {"paused": True}, False)],
)
def test_close_warns_about_program_that_stays_paused(
    is_stopped: bool, state: dict[str, bool], warns: bool, caplog: pytest.LogCaptureFixture
) -> None:
    desk = Programming()
    moving(desk)
    if is_stopped:
        desk.realtime.deliver(fast(SafetyMode.PROTECTIVE_STOP))
    desk.state(0.1, **state)
    desk.programs.close(0.0)
    assert ("is paused on the controller and might resume later" in caplog.text) is warns


def test_close_before_first_state_does_not_warn(caplog: pytest.LogCaptureFixture) -> None:
    desk = Programming()
    desk.motion().begins()
    desk.realtime.deliver(fast(SafetyMode.PROTECTIVE_STOP))
    desk.programs.close(0.0)
    assert "closed during a stop" not in caplog.text
