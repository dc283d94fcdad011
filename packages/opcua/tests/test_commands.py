"""Order and refusal of commands, without a server."""

from __future__ import annotations

import asyncio
import datetime
import functools
import threading
from collections.abc import Iterator

import pytest
from asyncua import ua
from asyncua.crypto.permission_rules import User, UserRole

import urlink
from tests.fakes.clock import Clock
from tests.waiting import until
from urlink_opcua.access import Operator
from urlink_opcua.commands import PROGRAMS, Outcome, RobotCommands

pytestmark = pytest.mark.real_time

OPERATOR = Operator(UserRole.User, "operator")


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def outcomes() -> list[Outcome]:
    return []


@pytest.fixture
def commands(robot: urlink.Robot, clock: Clock, outcomes: list[Outcome]) -> Iterator[RobotCommands]:
    expiry = urlink.Expiry(5.0, clock)
    expiry.tick()
    commands = RobotCommands("arm", robot, allow=True, expiry=expiry, report=outcomes.append)
    yield commands
    commands.close()


def ask(commands: RobotCommands, lane: str = "programs", user: User = OPERATOR) -> int:
    return int(asyncio.run(commands.execute("Command", user, "here", lane, lambda: None)).value)


def test_command_after_interruption_is_refused_but_not_a_stop(commands: RobotCommands, clock: Clock) -> None:
    assert ask(commands) == ua.StatusCodes.Good
    clock.now += 3.0
    assert ask(commands) == ua.StatusCodes.BadTimeout
    assert ask(commands, "registers") == ua.StatusCodes.BadTimeout
    assert ask(commands, "stops") == ua.StatusCodes.Good
    for _ in range(6):  # the server ticks while it runs
        clock.now += 1.0
        ask(commands)
    assert ask(commands) == ua.StatusCodes.Good


@pytest.mark.parametrize(
    ("error", "status"),
    [
        (urlink.BadValue("a"), ua.StatusCodes.BadInvalidArgument),
        (urlink.Cancelled("a"), ua.StatusCodes.BadOperationAbandoned),
        (urlink.LinkTimeout("a"), ua.StatusCodes.BadTimeout),
        (urlink.ConnectionLost("a"), ua.StatusCodes.BadCommunicationError),
        (urlink.LocalError("a"), ua.StatusCodes.BadNotSupported),
        (urlink.NotRunning("a"), ua.StatusCodes.BadInvalidState),
        (RuntimeError("a"), ua.StatusCodes.BadInternalError),
    ],
)
def test_error_of_robot_becomes_status_and_text(
    commands: RobotCommands, outcomes: list[Outcome], error: Exception, status: int
) -> None:
    def fail() -> None:
        raise error

    asyncio.run(commands.execute("Command", OPERATOR, "here", "programs", fail))
    assert outcomes == [Outcome("Command", "operator (here)", status, "a")]


def test_program_is_refused_by_limits_of_session() -> None:
    outcomes: list[Outcome] = []
    with urlink.connect("sim://ur5e?firmware=5.11", limits=urlink.SessionLimits(allowed=("move_joints",))) as robot:
        robot.controller.pendant.files["pick.urp"] = "def pick():\n  sleep(600)\nend"
        robot.dashboard.load("pick.urp")
        commands = RobotCommands("arm", robot, allow=True, expiry=urlink.Expiry(0.0), report=outcomes.append)
        play = functools.partial(PROGRAMS["PlayProgram"], robot)
        status = asyncio.run(commands.execute("PlayProgram", OPERATOR, "here", "programs", play))
        commands.close()
        assert not robot.dashboard.running()
    assert status.value == ua.StatusCodes.BadInvalidState
    assert "dashboard.play is not allowed" in outcomes[0].message


def test_stop_does_not_wait_for_dashboard_that_hangs() -> None:
    with urlink.connect("sim://ur5e?firmware=5.11", silence=20.0, stale_after=20.0) as robot:
        robot.controller.pendant.files["turn.urp"] = (
            "def turn():\n  movej([3.0, -1.5, 1.5, -1.5, -1.5, 0.0], a=1.4, v=0.05)\nend"
        )
        robot.dashboard.load("turn.urp")
        robot.dashboard.play()
        until(lambda: robot.realtime.wait().qd_target.any())
        robot.controller.faults.stall(30.0, "dashboard")
        commands = RobotCommands("arm", robot, allow=True, expiry=urlink.Expiry(0.0), report=lambda outcome: None)
        before = robot.realtime.wait().time
        stop = functools.partial(PROGRAMS["StopProgram"], robot)
        asyncio.run(commands.execute("StopProgram", OPERATOR, "here", "stops", stop))
        until(lambda: not robot.realtime.wait().qd_target.any())
        # A reply of the dashboard is awaited for 5 s.
        assert robot.realtime.wait().time - before < 4.5
        commands.close()


def test_certificate_that_expires_after_login_gives_no_permission(commands: RobotCommands) -> None:
    now = datetime.datetime.now(datetime.timezone.utc)
    assert ask(commands, user=Operator(UserRole.User, "a", now)) == ua.StatusCodes.BadUserAccessDenied
    later = Operator(UserRole.User, "a", now + datetime.timedelta(hours=1))
    assert ask(commands, user=later) == ua.StatusCodes.Good


def test_stop_without_credentials_is_refused(commands: RobotCommands, outcomes: list[Outcome]) -> None:
    assert ask(commands, "stops", User(UserRole.User, "reader")) == ua.StatusCodes.BadUserAccessDenied
    assert outcomes == []


def test_queued_command_is_not_executed_after_stop(commands: RobotCommands, outcomes: list[Outcome]) -> None:
    begun, release = threading.Event(), threading.Event()
    done: list[str] = []

    def first() -> None:
        begun.set()
        release.wait(60.0)

    async def main() -> None:
        tasks = [
            asyncio.create_task(commands.execute(name, OPERATOR, "here", "programs", call))
            for name, call in (("first", first), ("second", lambda: done.append("second")))
        ]
        await asyncio.to_thread(begun.wait, 60.0)
        stop = await commands.execute("stop", OPERATOR, "here", "stops", lambda: done.append("stop"))
        assert stop.value == ua.StatusCodes.Good
        release.set()
        await asyncio.gather(*tasks)
        last = await commands.execute("last", OPERATOR, "here", "programs", lambda: done.append("last"))
        assert last.value == ua.StatusCodes.Good

    asyncio.run(main())
    assert done == ["stop", "last"]
    assert ("second", ua.StatusCodes.BadOperationAbandoned) in [(each.name, each.status) for each in outcomes]


def test_too_many_pending_commands_are_refused(commands: RobotCommands) -> None:
    release = threading.Event()

    async def main() -> list[int]:
        calls = [commands.execute("wait", OPERATOR, "here", "programs", lambda: release.wait(60.0)) for _ in range(40)]
        statuses = await asyncio.gather(*calls)
        release.set()
        return [int(each.value) for each in statuses]

    statuses = asyncio.run(main())
    assert statuses.count(int(ua.StatusCodes.GoodCompletesAsynchronously)) == 32
    assert statuses.count(int(ua.StatusCodes.BadTooManyOperations)) == 8


def test_command_is_refused_after_close(commands: RobotCommands) -> None:
    commands.close()
    assert ask(commands) == ua.StatusCodes.BadServerHalted
    assert ask(commands, "stops") == ua.StatusCodes.BadServerHalted
