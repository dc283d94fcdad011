"""Threads that use the same objects at the same time, with switches between them as often as possible.

In real time, `sys.setswitchinterval` lets threads take turns after a few instructions. On a free-threaded interpreter,
the threads run at the same time. In simulated time, `sim.preempt` lets threads take turns between two lines. Each test
ends with sums: nothing is lost, and nothing is delivered twice.
"""

from __future__ import annotations

import contextlib
import random
import sys
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest

import rhdlink
import urlink
from linkcore.clock import Stamp
from linkcore.errors import Closed, LinkError
from linkcore.handle import Lifecycle
from linkcore.streaming.connection_life import ConnectionEvent, ConnectionState
from linkcore.streaming.history import History
from linkcore.streaming.packet_queue import Policy, block, drop_oldest, latest
from linkcore.streaming.silence import SilenceMonitor
from linkcore.streaming.statistics import StreamCounters, SubscriptionStatistics
from linkcore.streaming.subscription import InlineDelivery, Subscription
from linkcore.threads import CallbackThread
from rhdlink.host.plugins.turtle import Turtle
from tests.fakes.link import BAD, Count, ScriptedTransport, counts, scripted
from tests.matrix import trials
from tests.waiting import until
from urlink.simulator import Controller, Plane

#: Maximum time in s for a test, in real time on a busy computer or in simulated time.
LONG = 120.0
LIBRARY = ("linkcore", "urlink", "rhdlink")
SEEDS = range(trials(2, 20))


@pytest.fixture
def switching() -> Iterator[None]:
    """Let threads take turns as often as possible."""
    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    yield
    sys.setswitchinterval(interval)


def together(*calls: Callable[[], object]) -> None:
    """Make calls at the same time, each in its own thread; raise the first error."""
    gate = threading.Barrier(len(calls))
    errors: list[BaseException] = []

    def make(call: Callable[[], object]) -> None:
        gate.wait(LONG)
        try:
            call()
        except BaseException as error:
            errors.append(error)

    threads = [threading.Thread(target=make, args=(call,), daemon=True) for call in calls]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(LONG)
    assert not [thread for thread in threads if thread.is_alive()]
    if errors:
        raise errors[0]


def times(count: int, call: Callable[[], object]) -> Callable[[], None]:
    def repeat() -> None:
        for _ in range(count):
            call()

    return repeat


def adds_up(stats: SubscriptionStatistics) -> bool:
    return stats.offered == stats.delivered + stats.dropped + stats.raised + stats.waiting


# -- streams ------------------------------------------------------------------------------------


class Listener:
    """Callback that keeps the numbers of its packets, and raises at every seventh number."""

    def __init__(self, policy: Policy | None) -> None:
        self.policy = policy
        self.numbers: list[int] = []

    def __call__(self, packet: Count) -> None:
        self.numbers.append(packet.number)
        if packet.number % 7 == 0:
            raise RuntimeError("on purpose")

    def check(self, subscription: Subscription) -> None:
        """Check a subscription that has ended."""
        stats = subscription.stats
        raised = sum(number % 7 == 0 for number in self.numbers)
        assert (stats.raised, stats.delivered) == (raised, len(self.numbers) - raised)
        assert stats.waiting == 0
        assert adds_up(stats), stats
        assert sorted(set(self.numbers)) == self.numbers, "a packet was delivered twice, or too late"
        if self.numbers and not stats.dropped:
            assert len(self.numbers) == self.numbers[-1] - self.numbers[0] + 1, "a packet was lost"


class Source:
    """Sends numbered packets to a stream until it is stopped.

    Attributes:
        last: Number of the last packet. The numbers begin after `BAD`, which cannot be decoded.
    """

    def __init__(self, transport: ScriptedTransport) -> None:
        self.last = BAD
        self._transport = transport
        self._is_stopped = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        while not self._is_stopped.is_set():
            for _ in range(8):
                self._transport.put(counts(self.last + 1, self.last + 2))
                self.last += 2
            time.sleep(2e-4)

    def stop(self) -> None:
        self._is_stopped.set()
        self._thread.join(LONG)


def use_stream(rounds: int) -> None:
    """Subscribe, unsubscribe, iterate, and read counters and histories in several threads while packets arrive."""
    transport = ScriptedTransport()
    stream = scripted(transport)
    whole = Listener(block)
    first = stream.subscribe(whole, policy=block)
    source = Source(transport)
    ended: list[tuple[Listener, Subscription]] = []

    def subscribe(number: int) -> None:
        chance = random.Random(number)
        for _ in range(rounds):
            listener = Listener(chance.choice([None, latest, drop_oldest(3), block]))
            subscription = stream.subscribe(listener, policy=listener.policy, inline=listener.policy is None)
            offered = 0
            for _ in range(chance.randrange(4)):
                time.sleep(1e-4)
                assert subscription.stats.offered >= offered
                offered = subscription.stats.offered
            if chance.random() < 0.5:
                subscription.close(LONG)
            else:
                assert subscription.finish(LONG)
            ended.append((listener, subscription))

    def iterate() -> None:
        for _ in range(rounds):
            last = 0
            for packet in stream.iterate(drop_oldest(5), timeout=LONG):
                assert packet.number > last
                last = packet.number
                if last % 3 == 0:
                    break

    def look() -> None:
        received, newest = 0, BAD
        with stream.history(0.01) as history:
            for _ in range(rounds):
                assert stream.stats.received >= received
                received = stream.stats.received
                numbers = history.array("number")["number"].tolist()
                assert not numbers or numbers == list(range(numbers[0], numbers[0] + len(numbers)))
                assert len(history) >= 0
                if stream.latest is not None:
                    assert stream.latest.number >= newest
                    newest = stream.latest.number

    together(*(lambda number=number: subscribe(number) for number in range(3)), iterate, look)
    source.stop()
    until(lambda: stream.stats.received == source.last - BAD, LONG)
    assert first.finish(LONG)
    assert whole.numbers == list(range(BAD + 1, source.last + 1))
    assert len(ended) == 3 * rounds
    for listener, subscription in [(whole, first), *ended]:
        listener.check(subscription)
    assert not stream._connection.fan_out._routes
    stats = stream.stats
    assert (stats.received, stats.failed, stats.skipped) == (source.last - BAD, 0, 0)
    together(*[stream.close] * 3)
    assert stream.connection is ConnectionState.CLOSED


@pytest.mark.real_time
@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:callback")
def test_stream_loses_nothing_when_threads_switch(switching: None) -> None:
    use_stream(200)


@pytest.mark.slow
@pytest.mark.matrix
@pytest.mark.parametrize("seed", SEEDS)
def test_stream_loses_nothing_when_lines_interleave(seed: int) -> None:
    with urlink.simulated_time(seed) as sim:
        sim.preempt(*LIBRARY)
        use_stream(20)


def use_sending(rounds: int) -> None:
    """Send messages in several threads; each one arrives once, and in one piece."""
    transport = ScriptedTransport()
    with contextlib.closing(scripted(transport)) as stream:
        connection = stream._connection
        messages = [[b"%d:%d\n" % (sender, number) for number in range(rounds)] for sender in range(4)]

        def send(mine: list[bytes]) -> None:
            for message in mine:
                connection.send(message, LONG)

        def make_room() -> None:
            for _ in range(rounds):
                transport.make_room(3)
                time.sleep(1e-4)
            transport.make_room(None)

        together(*(lambda mine=mine: send(mine) for mine in messages), make_room)
        arrived = b"".join(transport.sent).splitlines(keepends=True)
        assert sorted(arrived) == sorted(message for mine in messages for message in mine)
        for sender, mine in enumerate(messages):
            assert [each for each in arrived if each.startswith(b"%d:" % sender)] == mine


@pytest.mark.real_time
def test_sends_stay_whole_when_threads_switch(switching: None) -> None:
    use_sending(50)


@pytest.mark.slow
@pytest.mark.matrix
@pytest.mark.parametrize("seed", SEEDS)
def test_sends_stay_whole_when_lines_interleave(seed: int) -> None:
    with urlink.simulated_time(seed) as sim:
        sim.preempt(*LIBRARY)
        use_sending(10)


# -- handles and first uses ------------------------------------------------------------------------


def end_lives(rounds: int) -> None:
    """End each of many motions in several threads at the same time; only one end counts."""
    callbacks = CallbackThread("callbacks")
    released: list[int] = []
    called: list[int] = []
    for number in range(rounds):
        life = Lifecycle(f"motion {number}", callbacks)
        ends: list[bool] = []

        def watch(life: Lifecycle = life, number: int = number) -> None:
            life.on_end(lambda: released.append(number))
            life.call_back(lambda: called.append(number))

        together(
            watch,
            lambda life=life, ends=ends: ends.append(life.finish()),  # type: ignore[misc]
            lambda life=life, ends=ends: ends.append(life.cancel("cancelled")),  # type: ignore[misc]
            lambda life=life, ends=ends: ends.append(life.fail(LinkError("failed"))),  # type: ignore[misc]
        )
        assert sorted(ends) == [False, False, True]
        assert life.is_over
    callbacks.close(LONG)
    assert released == list(range(rounds))
    assert called == list(range(rounds))


@pytest.mark.real_time
def test_life_ends_once_when_threads_switch(switching: None) -> None:
    end_lives(50)


@pytest.mark.slow
@pytest.mark.matrix
@pytest.mark.parametrize("seed", SEEDS)
def test_life_ends_once_when_lines_interleave(seed: int) -> None:
    with urlink.simulated_time(seed) as sim:
        sim.preempt(*LIBRARY)
        end_lives(10)


def use_first() -> None:
    """Let several threads be the first to use something; all of them get the same object, or only one succeeds."""
    host = rhdlink.Host([Turtle()], port=0)
    outcomes: list[str] = []

    def start() -> None:
        try:
            host.start()
            outcomes.append("started")
        except Closed:
            outcomes.append("refused")

    together(start, start, start)
    assert sorted(outcomes) == ["refused", "refused", "started"]
    together(host.close, host.close)

    with Controller("UR5e", "5.25") as controller:
        robot = urlink.connect(controller.address)
        found: list[tuple[object, ...]] = []
        together(*[lambda: found.append((robot.realtime, robot.rtde, robot.registers, robot.motion))] * 3)
        assert len({tuple(map(id, each[:3])) for each in found}) == 1

        world = controller.world
        planes = [Plane((0.0, 0.0, -float(number)), (0.0, 0.0, 1.0)) for number in range(1, 5)]
        together(*(lambda plane=plane: world.add(plane) for plane in planes))
        assert sorted(map(id, world.contacts)) == sorted(map(id, planes))
        together(*(lambda plane=plane: world.remove(plane) for plane in planes))
        assert world.contacts == ()

        silence = robot.realtime._connection.silence
        wait = silence.wait
        together(*[times(3, lambda: silence.watch(0.5, lambda seconds: None)())] * 3)
        assert silence._watches == ()
        assert silence.limit == wait
        together(*[robot.close] * 3)


@pytest.mark.real_time
@pytest.mark.slow
def test_first_use_happens_once_when_threads_switch(switching: None) -> None:
    times(5, use_first)()


@pytest.mark.slow
@pytest.mark.matrix
@pytest.mark.parametrize("seed", SEEDS)
def test_first_use_happens_once_when_lines_interleave(seed: int) -> None:
    with urlink.simulated_time(seed) as sim:
        sim.preempt(*LIBRARY)
        use_first()


def change_shared(rounds: int) -> None:
    """Change a list of contacts and of watches in several threads, and copy a history while it grows."""
    world = Controller("UR5e", "5.25").world
    silence = SilenceMonitor("stream", 2.0)
    history = History(
        Count, 0.01, lambda keep: Subscription(InlineDelivery(keep, StreamCounters(), bool, name="history"), bool, None)
    )

    def change(number: int) -> None:
        plane = Plane((0.0, 0.0, -float(number)), (0.0, 0.0, 1.0))
        for _ in range(rounds):
            world.add(plane)
            remove = silence.watch(0.5, lambda seconds: None)
            assert silence.wait == 0.5
            remove()
            world.remove(plane)  # raises an error if it was lost

    def keep() -> None:
        for number in range(rounds * 4):
            count = Count(number=number)
            count._stamp = Stamp(number * 1e-4, 0.0)
            history._keep(count)

    def copy() -> None:
        for _ in range(rounds):
            numbers = history.array("number")["number"].tolist()
            assert not numbers or numbers == list(range(numbers[0], numbers[-1] + 1))
            assert len(numbers) <= 101

    together(*(lambda number=number: change(number) for number in range(1, 4)), keep, copy)
    assert (world.contacts, silence._watches) == ((), ())
    assert history.array("number")["number"].tolist()[-1] == rounds * 4 - 1


@pytest.mark.real_time
@pytest.mark.slow
def test_shared_lists_lose_nothing_when_threads_switch(switching: None) -> None:
    change_shared(1000)


@pytest.mark.slow
@pytest.mark.matrix
@pytest.mark.parametrize("seed", SEEDS)
def test_shared_lists_lose_nothing_when_lines_interleave(seed: int) -> None:
    with urlink.simulated_time(seed) as sim:
        sim.preempt(*LIBRARY)
        change_shared(20)


# -- robots --------------------------------------------------------------------------------------


def use_robot(rounds: int) -> None:
    """Command a simulated arm in several threads: programs, stops, claims, outputs, subscriptions and counters."""
    with urlink.connect("sim://ur5e?firmware=5.25") as robot:
        handles: list[urlink.Handle] = []
        called: list[urlink.Handle] = []
        states: list[tuple[list[float], Subscription]] = []
        robot.realtime.wait(LONG)

        def begun(begin: Callable[[], urlink.Handle]) -> None:
            # Another thread stops the robot, or replaces this program.
            with contextlib.suppress(LinkError):
                handle = begin()
                handles.append(handle)
                handle.add_done_callback(called.append)

        def move() -> None:
            for _ in range(rounds):
                begun(lambda: robot.motion.move_joints([0.1, -1.5, 1.5, -1.5, -1.5, 0.0], speed=0.2))
                time.sleep(1e-3)

        def run() -> None:
            for _ in range(rounds):
                begun(lambda: robot.script.run('def lines():\n  textmsg("one")\n  sync()\n  textmsg("two")\nend'))
                assert all(text in ("one", "two") for handle in handles for text in getattr(handle, "texts", ()))

        def stop() -> None:
            for _ in range(rounds):
                time.sleep(1e-3)
                with contextlib.suppress(LinkError):
                    robot.motion.stop()

        def write(number: int) -> None:
            for value in range(1, rounds + 1):
                robot.registers.write_integer(number, value)
                robot.io.set_digital_out(number - 24, bool(value % 2))

        def subscribe() -> None:
            for _ in range(rounds):
                times: list[float] = []
                subscription = robot.realtime.subscribe(lambda state: times.append(state.time), policy=block)  # noqa: B023
                states.append((times, subscription))
                time.sleep(1e-3)
                assert subscription.finish(LONG)

        together(move, run, stop, lambda: write(24), lambda: write(25), subscribe, subscribe)
        with contextlib.suppress(LinkError):
            robot.motion.stop().wait(LONG)
        until(lambda: all(handle.done for handle in handles), LONG)
        until(lambda: len(called) >= len(handles), LONG)
        assert sorted(map(id, called)) == sorted(map(id, handles))
        assert len(handles) > 0
        until(lambda: robot.realtime.stats.rate > 0, LONG)
        for times, subscription in states:
            assert sorted(set(times)) == times
            stats = subscription.stats
            assert (stats.offered, stats.delivered, stats.dropped) == (len(times), len(times), 0)
        names = ("input_int_register_24", "input_int_register_25", "actual_digital_output_bits")
        with robot.rtde.outputs(*names) as outputs:
            last = rounds % 2
            wanted = [rounds, rounds, last | last << 1]
            until(lambda: [getattr(outputs.wait(LONG), name) for name in names] == wanted, LONG)
        for stream in (robot.realtime, robot.primary):
            until(lambda stream=stream: stream.stats.received == stream.stats.decoded)  # type: ignore[misc]
            assert (stream.stats.failed, stream.stats.skipped, stream.stats.reconnects) == (0, 0, 0)
        together(*[robot.close] * 3)


@pytest.mark.real_time
@pytest.mark.slow
def test_robot_loses_nothing_when_threads_switch(switching: None) -> None:
    use_robot(20)


@pytest.mark.slow
@pytest.mark.matrix
@pytest.mark.parametrize("seed", SEEDS)
def test_robot_loses_nothing_when_lines_interleave(seed: int) -> None:
    with urlink.simulated_time(seed) as sim:
        sim.preempt(*LIBRARY)
        use_robot(4)


def use_mobile_robot(rounds: int) -> None:
    """Sync, set values, subscribe and unsubscribe in several threads; each sync delivers one update."""
    with rhdlink.Host([Turtle()], port=0, period=0.002) as host:
        robot = rhdlink.connect(host.address, access="w", timeout=LONG)
        events: list[ConnectionEvent] = []
        ticks: list[int] = []
        changes = robot.subscribe_connection(events.append)
        whole = robot.subscribe(lambda update: ticks.append(update["tick"]), "tick", policy=block)
        syncs: list[int] = []
        others: list[tuple[list[Any], Subscription]] = []

        def sync() -> None:
            for number in range(rounds):
                robot["cmdrotvel"] = number
                robot.sync()
                syncs.append(number)

        def subscribe() -> None:
            for _ in range(rounds):
                updates: list[Any] = []
                subscription = robot.subscribe(updates.append, policy=drop_oldest(4))
                others.append((updates, subscription))
                time.sleep(1e-3)
                subscription.close(LONG)

        together(sync, sync, sync, subscribe, subscribe)
        assert whole.finish(LONG)
        assert len(ticks) == len(syncs) == 3 * rounds
        assert sorted(set(ticks)) == ticks
        for updates, subscription in others:
            stats = subscription.stats
            assert adds_up(stats)
            assert (stats.delivered, stats.waiting) == (len(updates), 0)
        background = robot.background()
        until(lambda: background.syncs >= 3, LONG)
        together(*[robot.close] * 3, lambda: _sync(robot))
        assert robot.connection is ConnectionState.CLOSED
        assert [event.state for event in events].count(ConnectionState.CLOSED) == 1
        assert events[-1].state is ConnectionState.CLOSED
        assert adds_up(changes.stats)


def _sync(robot: rhdlink.Variables) -> None:
    with contextlib.suppress(LinkError):
        robot.sync()


@pytest.mark.real_time
@pytest.mark.slow
def test_mobile_robot_loses_nothing_when_threads_switch(switching: None) -> None:
    use_mobile_robot(30)


@pytest.mark.slow
@pytest.mark.matrix
@pytest.mark.parametrize("seed", SEEDS)
def test_mobile_robot_loses_nothing_when_lines_interleave(seed: int) -> None:
    with urlink.simulated_time(seed) as sim:
        sim.preempt(*LIBRARY)
        use_mobile_robot(6)


def use_drive(rounds: int) -> None:
    """Request motions of a mobile robot in several threads; each of them ends once."""
    handles: list[urlink.Handle] = []
    called: list[urlink.Handle] = []
    with rhdlink.Drive(Turtle()) as drive:

        def turn() -> None:
            for _ in range(rounds):
                handle = drive.turn(1.0)
                handle.add_done_callback(called.append)
                handles.append(handle)

        together(turn, turn, turn)
        drive.stop().wait(LONG)
        until(lambda: all(handle.done for handle in handles), LONG)
    assert len(handles) == 3 * rounds
    assert sorted(map(id, called)) == sorted(map(id, handles))


@pytest.mark.real_time
def test_drive_loses_nothing_when_threads_switch(switching: None) -> None:
    use_drive(50)


@pytest.mark.slow
@pytest.mark.matrix
@pytest.mark.parametrize("seed", SEEDS)
def test_drive_loses_nothing_when_lines_interleave(seed: int) -> None:
    with urlink.simulated_time(seed) as sim:
        sim.preempt(*LIBRARY)
        use_drive(10)
