"""Signal handlers that command a robot during another call: no handler waits for the interrupted call."""

from __future__ import annotations

import ast
import contextlib
import itertools
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

import linkcore.streaming.scheduling
import rhdlink
import urlink
from linkcore.clock import Stamp
from linkcore.errors import Cancelled, Closed, LinkError, LinkTimeout
from linkcore.handle import Handle, Lifecycle, Phase
from linkcore.net.undo import PendingUndos
from linkcore.recording.file import Kind, RecordingFile, RecordingWriter
from linkcore.streaming.connection_life import Backoff, ConnectionLife, LifeEvent
from linkcore.streaming.packet_queue import drop_oldest
from linkcore.streaming.scheduling import urgent
from linkcore.streaming.stream import Stream
from linkcore.threads import CallbackThread, ReentrantEvent
from rhdlink import Int32, Read, Variables
from rhdlink.host.plugins.turtle import Turtle
from rhdlink.host.world import World
from tests.fakes.link import Count, ScriptedTransport, connection_over, counts
from tests.fakes.rhd import Robot, ScriptedServer, endless
from tests.fakes.server import OneAfterAnother
from tests.handlers import Interruption, at_every_line
from tests.matrix import trials
from tests.waiting import until
from urlink.motion.stream.common_time import CommonTime
from urlink.protocol.dashboard.client import Dashboard
from urlink.protocol.firmware import Firmware
from urlink.simulator import Controller

SRC = Path(__file__).resolve().parents[1] / "src"

#: Constructors of locks that a thread cannot acquire twice, and of objects that contain such a lock.
NOT_REENTRANT = {
    "threading.Lock",
    "threading.Event",
    "threading.Semaphore",
    "threading.BoundedSemaphore",
    "threading.Barrier",
    "queue.Queue",
    "queue.LifoQueue",
    "queue.PriorityQueue",
    "concurrent.futures.ThreadPoolExecutor",
    "concurrent.futures.ProcessPoolExecutor",
}
#: Packages of simulators, which do not run within the calls of a program.
SIMULATORS = ("linkcore.simulated", "urlink.simulator")
#: For each such lock, the reason why a signal handler does not wait for it.
REASONS = {
    "linkcore.clock:Expiry": "only servers of a robot use it, and a handler only calls their `stop`",
    "linkcore.streaming.packet_queue:BoundedQueue": "the lock is acquired without waiting",
    "linkcore.streaming.flight_record:SentRecord": "the lock is acquired without waiting",
    "linkcore.recording.index:side_by_side": "only threads that read a file use it, and no handler waits for them",
    "urlink.motion.stream.common_time:CommonTime": "only threads that read streams acquire it",
    "urlink.motion.stream.common_time:CommonPace": "only threads that read streams acquire it",
    "rhdlink.client:Variables": "the lock is acquired without waiting",
    "linkcore.clock:sleep": "it belongs to one wait of a worker thread, and no signal handler runs there",
    "linkcore.clock:is_done": "it belongs to one wait of a worker thread, and no signal handler runs there",
    "linkcore.cli.progress:_Screen": "it is set when a command has ended; a handler of the command line only raises",
    "rhdlink.cli.watch_view:RateCounter": "only `rhdlink watch` uses it, and its handler only raises",
}


# -- existing locks ------------------------------------------------------------------------------------


def locks() -> dict[str, list[str]]:
    """Map "module:outermost class or function" to the places of its locks that are not re-entrant."""
    found: dict[str, list[str]] = {}
    for path in sorted(SRC.rglob("*.py")):
        module = ".".join(path.relative_to(SRC).with_suffix("").parts).removesuffix(".__init__")
        if not module.startswith(SIMULATORS):
            text = path.read_text(encoding="utf-8")
            if not any(each.rpartition(".")[2] in text for each in (*NOT_REENTRANT, "Condition")):
                continue
            tree = ast.parse(text)
            imported = _imported(tree)
            for statement in tree.body:
                name = getattr(statement, "name", "") if hasattr(statement, "body") else ""
                for line in _made(statement, imported):
                    found.setdefault(f"{module}:{name}", []).append(f"{path.relative_to(SRC.parent)}:{line}")
    return found


def _imported(tree: ast.Module) -> dict[str, str]:
    """Map each name in a module to the full name of its import."""
    names: dict[str, str] = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names |= {each.asname or each.name: each.name for each in node.names}
        elif isinstance(node, ast.ImportFrom) and not node.level:
            names |= {each.asname or each.name: f"{node.module}.{each.name}" for each in node.names}
    return names


def _made(statement: ast.stmt, imported: dict[str, str]) -> Iterator[int]:
    for node in ast.walk(statement):
        if isinstance(node, ast.Call):
            first, dot, rest = ast.unparse(node.func).partition(".")
            name = imported.get(first, first) + dot + rest
            if name in NOT_REENTRANT or (
                name == "threading.Condition" and node.args and "lock" not in ast.unparse(node.args[0])
            ):
                yield node.lineno


def test_locks_used_by_signal_handlers_are_reentrant() -> None:
    found = locks()
    missing = [f"{place} ({key})" for key in sorted(found.keys() - REASONS) for place in found[key]]
    assert not missing, (
        f"not re-entrant: {', '.join(missing)}. A signal handler that meets such a lock, which its own thread holds, "
        "waits forever: use threading.RLock, linkcore.threads.ReentrantEvent or linkcore.threads.alone, or add the "
        f"reason why no handler waits for it to REASONS in {Path(__file__).name}"
    )
    assert not REASONS.keys() - found, "these locks no longer exist; remove them from REASONS"


# -- handlers at every line ----------------------------------------------------------------------------

pytestmark = pytest.mark.real_time


def test_use_of_a_connection_can_be_interrupted_by_a_close() -> None:
    def scenario(interruption: Interruption) -> None:
        life = ConnectionLife("script", Backoff())
        with interruption.by(lambda: life.fire(LifeEvent.CLOSE)):
            is_used = life.use(is_patient=False, received=0)
        assert life.is_closed if interruption.where is not None else is_used

    assert at_every_line(scenario) > 5


def test_urgent_can_be_entered_by_a_signal_handler() -> None:
    def enter() -> None:
        with urgent():
            pass

    def scenario(interruption: Interruption) -> None:
        with interruption.by(enter):
            enter()
        assert threading.get_native_id() not in linkcore.streaming.scheduling._threads._numbers

    assert at_every_line(scenario) > 10


@pytest.mark.parametrize("handler", ["set", "clear and set", "wait"])
def test_event_can_be_used_by_a_signal_handler(handler: str) -> None:
    def scenario(interruption: Interruption) -> None:
        event = ReentrantEvent()

        def act() -> None:
            if handler == "wait":
                event.wait(0.0)
            elif handler == "set":
                event.set()
            else:
                event.clear()
                event.set()

        with interruption.by(act):
            event.wait(0.001)
            event.set()
            assert event.wait(5.0)
        assert event.is_set()

    assert at_every_line(scenario) > 10


@pytest.mark.parametrize("inline", [False, True])
@pytest.mark.parametrize("handler", ["subscribe", "unsubscribe", "close"])
def test_subscribing_can_be_interrupted_by_a_signal(handler: str, inline: bool) -> None:
    """The subscription of the handler gets packets, and so does the interrupted subscription."""

    def scenario(interruption: Interruption) -> None:
        transport = ScriptedTransport()
        connection = connection_over(transport)
        stream = Stream(connection, Count)
        got: dict[str, list[Any]] = {"other": [], "interrupted": [], "handler": []}
        other = stream.subscribe(got["other"].append)

        def act() -> None:
            if handler == "subscribe":
                stream.subscribe(got["handler"].append, inline=inline)
            elif handler == "unsubscribe":
                other.close()
            else:
                stream.close(0.01)

        with contextlib.closing(stream):
            with contextlib.suppress(Closed), interruption.by(act):
                short = stream.subscribe(lambda packet: None, inline=inline)
                stream.subscribe(got["interrupted"].append, inline=inline)
                short.close()
            if handler == "close":
                assert interruption.where is None or stream.connection.value == "closed"
                return
            transport.put(counts(1))
            expected = {"interrupted"}
            if interruption.where is not None and handler == "subscribe":
                expected |= {"handler"}
            if interruption.where is None or handler == "subscribe":
                expected |= {"other"}
            until(lambda: {name for name, packets in got.items() if packets} == expected, 5.0)
            assert len(connection.fan_out.deliveries) == len(expected)

    assert at_every_line(scenario) > 50


@pytest.mark.parametrize("handler", ["cancel", "finish", "callback"])
def test_handle_wait_can_be_interrupted_by_a_signal(handler: str) -> None:
    callbacks = CallbackThread("callbacks of a test")

    def scenario(interruption: Interruption) -> None:
        life = Lifecycle("job", callbacks)
        handle = Handle(life)
        called: list[object] = []

        def act() -> None:
            if handler == "cancel":
                handle.cancel()
            elif handler == "finish":
                life.finish()
            else:
                handle.add_done_callback(called.append)

        with contextlib.suppress(LinkTimeout, Cancelled), interruption.by(act):
            handle.wait(0.002)
        if interruption.where is not None:
            ends = {"cancel": Phase.CANCELLED, "finish": Phase.DONE, "callback": Phase.SENT}
            assert handle.phase is ends[handler]
        handle.cancel()
        until(lambda: called or handler != "callback" or interruption.where is None, 5.0)

    try:
        assert at_every_line(scenario) > 15
    finally:
        callbacks.close(5.0)


def test_handle_cancel_can_be_interrupted_by_another_cancel() -> None:
    callbacks = CallbackThread("callbacks of a test")

    def scenario(interruption: Interruption) -> None:
        time = CommonTime()
        lives = [Lifecycle(f"motion {number}", callbacks) for number in range(2)]
        brakes: list[int] = []
        for number, life in enumerate(lives):
            life.brake = lambda number=number: brakes.append(number)  # type: ignore[misc]
            life.on_end(time.member(float, 0.002).leave)
        first, second = map(Handle, lives)

        def both() -> None:
            first.cancel()
            second.cancel()

        with interruption.by(both):
            first.cancel()
        both()
        assert sorted(set(brakes)) == [0, 1]
        assert not time._members

    try:
        assert at_every_line(scenario) > 10
    finally:
        callbacks.close(5.0)


def test_pending_undos_close_can_be_interrupted_by_a_signal() -> None:
    numbers = itertools.count()

    def scenario(interruption: Interruption) -> None:
        user = threading.Lock()  # any object that supports weak references
        undos = PendingUndos.of(("peer", next(numbers)), "peer", user)
        with interruption.by(lambda: undos.close(user)):
            undos.close(user)
        assert undos._closed.is_set()

    assert at_every_line(scenario) > 5


def test_recording_can_be_closed_by_a_signal_handler(tmp_path: Path) -> None:
    numbers = itertools.count()

    def scenario(interruption: Interruption) -> None:
        path = tmp_path / f"{next(numbers)}.urlog"
        writer = RecordingWriter(path)
        channel = writer.add_channel({"name": "a"})
        with contextlib.suppress(Closed), interruption.by(writer.close):
            writer.write(Kind.BYTES, channel, Stamp(1.0, 1.0), b"x")
            writer.close()
        assert writer._file.closed
        file = RecordingFile(path)
        assert (file.is_complete, file.left_out) == (True, 0)

    assert at_every_line(scenario) > 10


class _Dashboard(OneAfterAnother):
    """Dashboard server for several clients at the same time, each in its own thread."""

    def _talk(self, connection: Any) -> None:
        own = connection.dup()
        threading.Thread(target=self._converse, args=(own,), daemon=True).start()

    def _converse(self, connection: Any) -> None:
        with connection, contextlib.suppress(OSError):
            connection.settimeout(5.0)
            connection.sendall(b"Connected: Universal Robots Dashboard Server\n")
            for line in connection.makefile("rb"):
                connection.sendall(b"Robotmode: RUNNING\n" if line == b"robotmode\n" else b"Stopped\n")


@pytest.mark.slow
@pytest.mark.parametrize("handler", ["stop", "close"])
def test_dashboard_can_be_used_by_a_signal_handler(handler: str) -> None:
    server = _Dashboard()
    try:

        def scenario(interruption: Interruption) -> None:
            dashboard = Dashboard("127.0.0.1", server.port, lambda: Firmware(5, 11), api_port=None, timeout=5.0)
            failed: list[Exception] = []

            def act() -> None:
                try:
                    getattr(dashboard, handler)()
                except LinkError as error:
                    failed.append(error)

            expected = () if handler == "stop" else (Closed,)
            with contextlib.closing(dashboard), contextlib.suppress(*expected), interruption.by(act):
                assert dashboard.robot_mode().name == "RUNNING"
            assert not failed

        assert at_every_line(scenario) > 50
    finally:
        server.close()


class _Smr(Variables):
    tick = Read(Int32)


@pytest.mark.slow
@pytest.mark.parametrize("handler", ["sync", "close", "subscribe"])
def test_rhd_sync_can_be_interrupted_by_a_signal(handler: str) -> None:
    def scenario(interruption: Interruption) -> None:
        with contextlib.ExitStack() as ending:
            if handler == "close":
                ending.enter_context(contextlib.suppress(AssertionError))  # the server fails if its client leaves early
            server = ending.enter_context(ScriptedServer(endless(Robot())))
            use(rhdlink.connect(server.address, _Smr, timeout=5.0), interruption)

    def use(robot: _Smr, interruption: Interruption) -> None:
        updates: list[Any] = []
        robot.subscribe(updates.append, policy=drop_oldest(100))

        def act() -> None:
            if handler == "sync":
                with contextlib.suppress(LinkTimeout):
                    robot.sync()
            elif handler == "close":
                robot.close()
            else:
                robot.subscribe(updates.append).close()

        began = time.monotonic()
        with robot:
            with contextlib.suppress(Closed), interruption.by(act):
                robot.sync()
            if handler != "close":
                robot.sync()
                until(lambda: updates, 5.0)
        if time.monotonic() - began > 4.0:
            raise TimeoutError("a call has waited until its timeout")

    assert at_every_line(scenario, step=7) > 10


@pytest.mark.slow
@pytest.mark.parametrize("handler", ["stop", "cancel", "close"])
def test_drive_can_be_stopped_by_a_signal_handler(handler: str) -> None:
    """If the handler interrupts the call that starts a motion, the motion does not start after the stop."""

    def scenario(interruption: Interruption) -> None:
        turtle = Turtle(World(1000.0))
        with rhdlink.Drive(turtle) as drive:
            before = drive.forward(5.0)
            until(lambda: turtle.cmdtransvel > 0)

            def act() -> None:
                {"stop": drive.stop, "cancel": before.cancel, "close": drive.close}[handler]()

            with contextlib.suppress(Closed), interruption.by(act, within="_begin"):
                drive.forward(1000.0)
            if interruption.where is not None and handler == "stop":
                until(lambda: turtle.cmdtransvel == turtle.cmdrotvel == 0, 5.0)

    # The first lines number the request; a stop in these lines would be older than the request.
    assert at_every_line(scenario, first=3) > 20


def _stop(robot: urlink.Robot) -> None:
    robot.motion.stop(wait=2.0)


def _cancel(robot: urlink.Robot) -> None:
    current = robot.motion.current
    if current is not None:
        current.cancel()


def _set_output(robot: urlink.Robot) -> None:
    robot.io.set_digital_out(1, True)


@pytest.mark.slow
@pytest.mark.matrix
@pytest.mark.parametrize("command", ["move", "output", "jog"])
@pytest.mark.parametrize("handler", [_stop, _cancel, _set_output, urlink.Robot.close])
def test_commands_can_be_interrupted_by_a_signal(command: str, handler: Callable[[urlink.Robot], object]) -> None:
    """The handler runs in simulated time, at some of the thousands of lines of a command."""

    def scenario(interruption: Interruption) -> None:
        with urlink.simulated_time(seed=1) as simulation:
            with simulation.on(simulation.computer("cell", "192.168.0.100")):
                controller = Controller("UR5e", host="192.168.0.100", ports="standard").start()
            with contextlib.closing(controller), urlink.connect("192.168.0.100") as robot:
                goal = robot.realtime.wait().q_target + 0.5
                took: list[float] = []

                def act() -> None:
                    began = time.monotonic()
                    with contextlib.suppress(LinkError):
                        handler(robot)
                    took.append(time.monotonic() - began)

                with contextlib.suppress(LinkError), interruption.by(act):
                    if command == "move":
                        robot.motion.move_joints(goal, speed=0.5)
                    elif command == "output":
                        robot.io.set_digital_out(0, True)
                    else:
                        with robot.motion.jog() as jog:
                            jog.move([0.1] * 6)
                assert not took or took[0] < 3.0, f"at {interruption.where} the handler took {took[0]:.1f} s"

    assert at_every_line(scenario, step=trials(211, 71), is_threaded=False) > 1
