"""Trials of streams: delivered, late and dropped states, and lost connections."""

from __future__ import annotations

import itertools
import os
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

import urlink
from linkcore import clock
from linkcore.errors import BadValue, Closed, LinkError, LinkTimeout, RemoteError
from linkcore.streaming.connection_life import ConnectionEvent, ConnectionState, Traffic
from urlink.packets import RobotState

from .trials import NEAR, Bench, trial


def _stream(bench: Bench) -> tuple[Any, float]:
    """Choose a stream; return it with the time between its packets, in s."""
    return bench.chance.choice(((bench.robot.realtime, bench.cycle), (bench.robot.primary, 0.1)))


@trial
def every_state(bench: Bench) -> None:
    """A fast callback gets each state once, in order, and none after `close`."""
    robot, chance = bench.robot, bench.chance
    seen: list[float] = []
    inline = chance.random() < 0.5
    policy = None if inline else chance.choice((None, urlink.drop_oldest(500), urlink.block))
    options: dict[str, Any] = {} if policy is None else {"policy": policy}
    subscription = robot.realtime.subscribe(lambda state: seen.append(state.time), inline=inline, **options)
    time.sleep(0.2 + 0.3 * chance.random())
    if chance.random() < 0.5:
        subscription.close()
        count = len(seen)
    else:
        bench.check(subscription.finish(), "finish() did not deliver the queued states")
        count = len(seen)
    time.sleep(0.05)
    bench.check(len(seen) == count, "the callback was called after its subscription was closed")
    cycles = np.round(np.diff(seen) / bench.cycle)
    bench.check(count > 0.15 / bench.cycle, f"{count} states in 0.2 s")
    bench.check(np.all(cycles == 1), f"states were missing or duplicate: {cycles.tolist()}")
    stats = subscription.stats
    bench.check(stats.delivered == count and stats.raised == 0, f"{count} calls are counted as {stats}")
    bench.check(stats.offered == stats.delivered + stats.dropped + stats.waiting, f"{stats}")
    bench.check(subscription.join(1.0), "a closed subscription has not ended")


@trial
def a_slow_callback(bench: Bench) -> None:
    """A policy keeps the newest states; all others are dropped and counted."""
    limit = bench.chance.randint(1, 4)
    policy = urlink.latest if limit == 1 else urlink.drop_oldest(limit)
    seen: list[tuple[float, float]] = []

    def slow(state: Any) -> None:
        seen.append((state.time, bench.now))
        if len(seen) == 1:
            time.sleep(0.3)

    with bench.robot.realtime.subscribe(slow, policy=policy) as subscription:
        time.sleep(0.45)
        stats = subscription.stats
    kept = [taken for taken in seen[1:] if taken[1] - seen[1][1] < 1e-3][:limit]
    first = seen[1][0] - seen[0][0]
    bench.check(first > 0.3 - (limit + 2) * bench.cycle - NEAR, f"{first:.3f} s after a call of 0.3 s: not the newest")
    bench.check(len(kept) >= 1 and len(kept) <= limit, f"{len(kept)} states were kept by {policy}")
    left_out = round(first / bench.cycle) - 1
    bench.check(
        abs(stats.dropped - left_out) <= 2 * NEAR / bench.cycle,
        f"{left_out} states were dropped, but {stats.dropped} are counted",
    )
    bench.check(stats.offered == stats.delivered + stats.dropped + stats.waiting, f"{stats}")


@trial
def a_lifespan(bench: Bench) -> None:
    """States older than their lifespan when taken are dropped and counted as expired."""
    lifespan = 0.05 + 0.1 * bench.chance.random()
    ages: list[float] = []

    def slow(state: Any) -> None:
        ages.append(state.received.age)
        if len(ages) == 1:
            time.sleep(lifespan + 0.2)

    with bench.robot.realtime.subscribe(slow, policy=urlink.drop_oldest(1000), lifespan=lifespan) as subscription:
        time.sleep(lifespan + 0.3)
        stats = subscription.stats
    bench.check(
        max(ages) <= lifespan + 1e-3, f"a state of {max(ages):.3f} s was delivered; its lifespan is {lifespan:.3f} s"
    )
    bench.check(stats.expired > 0.1 / bench.cycle, f"{stats.expired} have expired in a call of {lifespan + 0.2:.2f} s")
    bench.check(stats.expired <= stats.dropped, f"{stats}")


@trial
def a_deadline(bench: Bench) -> None:
    """`on_deadline` is called once for each longer silence, with the seconds since the last packet."""
    stream, period = _stream(bench)
    deadline = period + 0.02 + 0.1 * bench.chance.random()
    late: list[tuple[float, float]] = []
    came: list[float] = []
    inline = bench.chance.random() < 0.5
    on_deadline = (lambda age: late.append((age, bench.now))) if bench.chance.random() < 0.8 else None
    how: dict[str, Any] = {"inline": inline, "deadline": deadline, "on_deadline": on_deadline}
    of = bench.chance.random() < 0.4
    made = stream.of(RobotState if period > 0.05 else urlink.RealtimeState).subscribe if of else stream.subscribe
    subscription = made(lambda state: came.append(bench.now), **how)
    time.sleep(0.35)
    bench.check(
        not late and not subscription.stats.missed_deadlines, f"a deadline of {deadline:.3f} s was missed: {late}"
    )
    with bench.silence():
        time.sleep(deadline + 3 * NEAR)
        missed = subscription.stats.missed_deadlines
        bench.check(missed == 1, f"{missed} deadlines were missed in one silence")
        time.sleep(deadline)
        missed = subscription.stats.missed_deadlines
        bench.check(missed == 1, f"{missed} deadlines were missed in one silence")
        if on_deadline is not None:
            bench.check(len(late) == 1, f"on_deadline was called {len(late)} times in one silence")
            for age, at in late:
                bench.check(deadline <= age <= deadline + NEAR, f"on_deadline got {age:.3f} s; deadline {deadline:.3f}")
                bench.check(abs(at - came[-1] - age) < NEAR, "on_deadline got a time that does not match its call")
    begun = len(came)
    time.sleep(0.4)
    bench.check(len(came) > begun, "no packet arrived after the silence")
    subscription.close()
    count = len(late)
    with bench.silence():
        time.sleep(2 * deadline)
    bench.check(len(late) == count, "on_deadline was called after close")


@trial
def waiting_in_vain(bench: Bench) -> None:
    """A wait ends with `LinkTimeout` after its timeout."""
    stream, period = _stream(bench)
    seconds = 0.15 + bench.chance.random()
    stream.wait(2.0)
    with bench.raises(LinkTimeout, after=seconds):
        stream.wait_until(lambda state: False, seconds)
    with bench.silence():
        time.sleep(NEAR)
        with bench.raises(LinkTimeout, after=seconds):
            stream.wait(seconds)
        with bench.raises(LinkTimeout, after=seconds):
            for _ in stream.iterate(timeout=seconds):
                pass
    begun = bench.now
    stream.wait(5.0)
    bench.check(bench.now - begun < period + 1.0, f"a state took {bench.now - begun:.3f} s")


@trial
def waiting_for(bench: Bench) -> None:
    """`wait_until` returns the first state that meets the condition, when this state arrives."""
    at = bench.now + 0.1 + 0.2 * bench.chance.random()
    number = bench.chance.randrange(8)
    signals = bench.controller.signals
    has = bool(signals.digital_inputs >> number & 1)
    bench.sim.at(at, lambda: setattr(signals, "digital_inputs", signals.digital_inputs ^ 1 << number))
    if bench.chance.random() < 0.5:
        state = bench.robot.realtime.wait_until(
            lambda state: bool(state.digital_input_bits >> number & 1) is not has, 5.0
        )
        bench.check(bool(state.digital_input_bits >> number & 1) is not has, "the state does not meet the condition")
    else:
        bench.robot.io.wait_digital_in(number, not has, 5.0)
    bench.check(at <= bench.now <= at + 3 * bench.cycle + NEAR, f"it took {bench.now - at:.3f} s")
    bench.check(bench.robot.io.digital_in(number) is not has, "the input does not have the awaited value")
    with bench.raises(LinkTimeout, after=0.2):
        bench.robot.io.wait_digital_in(number, has, 0.2)


@trial
def a_lost_connection(bench: Bench) -> None:
    """A stream reconnects on its own, keeps its subscriptions, and reports and counts reconnections."""
    stream, period = _stream(bench)
    events: list[ConnectionEvent] = []
    states: list[float] = []
    stream.wait(2.0)
    before = stream.stats
    with stream.subscribe(events.append, ConnectionEvent), stream.subscribe(lambda state: states.append(bench.now)):
        time.sleep(2.5 * period)
        is_reset = bench.chance.random() < 0.5
        at = bench.now
        if is_reset:
            bench.reset()
        else:
            with bench.silence():
                time.sleep(2.5)
                bench.check(stream.connection is not ConnectionState.CONNECTED, "2.5 s of silence are not detected")
                bench.check(stream.latest is None, "an old state is returned as the latest")
        time.sleep(3.0)
        stream.wait(2.0)
        time.sleep(NEAR)
        after = stream.stats
        notified = [event.state for event in events]
        bench.check(states[-1] > bench.now - period - NEAR, "the subscription gets no more states")
        bench.check(stream.connection is ConnectionState.CONNECTED, f"it is {stream.connection}")
        bench.check(notified[-1:] == [ConnectionState.CONNECTED], f"the events were {notified}")
        bench.check(ConnectionState.LOST in notified, f"the events were {notified}")
        bench.check(all(a is not b for a, b in itertools.pairwise(notified)), f"a state was reported twice: {notified}")
        bench.check(all(event.stream == stream.name for event in events), f"an event names another stream: {events}")
        count = notified.count(ConnectionState.CONNECTED)
        bench.check(after.reconnects - before.reconnects == count, f"{count} connections, counted {after.reconnects}")
        bench.check(events[0].received.monotonic is not None and bench.now > at, "an event has no time")
        lost = next(event for event in events if event.state is ConnectionState.LOST)
        bench.check(isinstance(lost.error, RemoteError), f"it was lost because of {lost.error!r}")


@trial
def history(bench: Bench) -> None:
    """A history has the states of the last seconds, and no older ones."""
    seconds = 0.1 + 0.3 * bench.chance.random()
    with bench.robot.realtime.history(seconds) as kept:
        time.sleep(seconds + 0.2)
        times = kept["time"]
        span = float(times[-1] - times[0])
        bench.check(abs(span - seconds) < 0.03 + 2 * bench.cycle, f"a history of {seconds:.2f} s has {span:.2f} s")
        bench.check(np.all(np.round(np.diff(times) / bench.cycle) == 1), "states are missing in the history")
        count = len(kept)
        bench.check(abs(count - len(times)) <= 3, f"{count} states, {len(times)} rows")
        rows = kept.array("q_actual")
        bench.check(len(rows) >= len(times) - 1, "the array has fewer rows")
    time.sleep(0.05)
    bench.check(abs(len(kept) - count) <= 3, "it continues after it was closed")


@trial
def closing_a_stream(bench: Bench) -> None:
    """`close` ends every loop and every wait immediately; later uses raise `Closed`."""
    stream, _period = _stream(bench)
    stream.wait(2.0)
    calls = [0]
    how = bench.chance.choice(("wait_until", "iterate", "join"))
    if how == "wait_until":
        thread, outcome = bench.ended(lambda: stream.wait_until(lambda state: False, 30.0))
    elif how == "iterate":
        thread, outcome = bench.ended(lambda: sum(1 for _ in stream.iterate(policy=urlink.block)))
    else:
        thread, outcome = bench.ended(lambda: stream.join(30.0))
    subscription = stream.subscribe(lambda state: calls.append(1), inline=bench.chance.random() < 0.5)
    time.sleep(0.3)
    begun = bench.now
    stream.close()
    bench.check(bench.now - begun < 1.0, f"close took {bench.now - begun:.2f} s")
    count = len(calls)
    if bench.joined(thread, 1.0):
        expected = Closed if how == "wait_until" else int
        bench.check(isinstance(outcome[0], expected), f"{how} ended with {outcome[0]!r}")
        bench.check(outcome[1] - begun < 0.8, f"{how} ended {outcome[1] - begun:.2f} s after close")
    time.sleep(0.2)
    bench.check(len(calls) == count and count > 1, "the callback is called after close")
    bench.check(stream.connection is ConnectionState.CLOSED, f"it is {stream.connection}")
    for use in (
        lambda: stream.wait(1.0),
        stream.start,
        lambda: stream.subscribe(print),
        lambda: next(stream.iterate()),
    ):
        with bench.raises(Closed):
            use()
    bench.check(subscription.join(0.5), "its subscription has not ended")


@trial
def a_robot_that_is_away(bench: Bench) -> None:
    """Connecting without a controller fails in time, and leaves no sockets or threads."""
    sockets, threads = bench.sim.open_sockets, len(bench.sim.threads)
    seconds = 0.3 + bench.chance.random()
    case = bench.chance.choice(("nobody", "silent", "cut"))
    if case == "nobody":
        with bench.raises(urlink.ConnectFailed, LinkTimeout, within=seconds + 1.5):
            urlink.connect("192.168.0.77", timeout=seconds)
    else:
        with bench.silence(), bench.raises(urlink.ConnectFailed, LinkTimeout, RemoteError, within=seconds + 1.5):
            urlink.connect(bench.host, timeout=seconds)
        time.sleep(3.0)
    time.sleep(0.2)
    bench.check(bench.sim.open_sockets <= sockets + 3, f"{bench.sim.open_sockets - sockets} sockets are left")
    bench.check(len(bench.sim.threads) <= threads + 3, "threads are left")


@trial
def the_truth(bench: Bench) -> None:
    """The values of a state equal the values of the controller."""
    controller, state = bench.controller, bench.robot.realtime.wait(2.0)
    bench.check(np.allclose(state.q_target, controller.arm.setpoint.q, atol=0.02), "q_target")
    bench.check(state.digital_input_bits == controller.signals.digital_inputs, "digital inputs")
    bench.check(abs(controller.time - state.time) < NEAR + 2 * bench.cycle, f"time {state.time} {controller.time}")
    bench.check(0.0 <= state.received.age < NEAR, f"it arrived {state.received.age:.3f} s ago")
    board = bench.robot.primary.wait(2.0).masterboard_data
    if board is not None:
        bench.check(board.digital_output_bits == controller.signals.digital_outputs, "digital outputs")
    for stream in (bench.robot.realtime, bench.robot.primary):
        stats = stream.stats
        bench.check(stats.received == stats.decoded + stats.failed, f"{stats}")
        bench.check(stats.failed == 0 and stats.skipped == 0, f"{stats}")
        bench.check(stats.age is not None and stats.age < 0.15 + NEAR, f"the age is {stats.age}")


@trial
def ports(bench: Bench) -> None:
    """Each interface has its own connection: cutting one does not affect the others."""
    names = ("realtime", "primary", "secondary")
    notified: dict[str, list[Any]] = {name: [] for name in names}
    for name in names:
        stream = getattr(bench.robot, name)
        stream.wait(2.0)
        stream.subscribe(notified[name].append, ConnectionEvent)
        bench.check(name in stream.name, f"{stream.name} is the stream {name}")
    cut = bench.chance.choice(names)
    bench.controller.faults.cut(cut)
    time.sleep(0.3)
    lost = [name for name in names if notified[name]]
    bench.check(lost == [cut], f"{cut} was cut, but events came from {lost}")


@trial
def two_clocks(bench: Bench) -> None:
    """`Robot.clock` converts the controller's time to the time of this computer, within its bound."""
    bench.robot.realtime.wait(2.0)
    time.sleep(1.5)
    relation = bench.robot.clock
    state = bench.robot.realtime.wait(2.0)
    local = relation.to_local(state.time)
    error = clock.now() - local
    bench.check(-bench.cycle - 2e-3 <= error <= NEAR, f"a new state is {error:.4f} s old")
    bench.check(abs(relation.to_controller(local) - state.time) < 1e-4, "converting there and back changes the time")
    bench.check(abs(relation.drift) < 2e-3, f"the drift is {relation.drift}")


@trial
def iterating(bench: Bench) -> None:
    """A loop gets each state once, in order; a slow loop gets the newest, or all of them with `block`."""
    policy = bench.chance.choice((None, urlink.latest, urlink.drop_oldest(4), urlink.block))
    rest = bench.chance.choice((0.0, 0.0, 3 * bench.cycle))
    times = []
    for state in bench.robot.realtime.iterate(policy=policy, timeout=2.0):
        times.append(state.time)
        age = state.received.age
        if policy in (None, urlink.latest):
            bench.check(age < bench.cycle + NEAR, f"the newest state is {age:.3f} s old")
        if rest:
            time.sleep(rest)
        if len(times) == 12:
            break
    cycles = np.round(np.diff(times) / bench.cycle)
    bench.check(np.all(cycles >= 1), f"not in order: {times}")
    if policy is urlink.block:
        bench.check(np.all(cycles == 1), f"states are missing with {policy}: {cycles.tolist()}")
    elif rest:
        bench.check(cycles.max() > 1, "a slow loop drops no states")


@trial
def bytes_of_a_stream(bench: Bench) -> None:
    """A subscription to `Traffic` gets every byte and every change of the connection."""
    stream, _period = _stream(bench)
    stream.wait(2.0)
    seen: list[Any] = []
    with stream.subscribe(seen.append, Traffic):
        received = stream.stats
        time.sleep(0.25)
        bench.reset()
        time.sleep(2.5)
    total = sum(len(each.data) for each in seen if hasattr(each, "data"))
    states = [each.state for each in seen if isinstance(each, ConnectionEvent)]
    bench.check(total > 1000 and stream.stats.received > received.received, f"{total} bytes")
    bench.check(ConnectionState.LOST in states and states[-1] is ConnectionState.CONNECTED, f"{states}")


@trial
def a_recording(bench: Bench) -> None:
    """A recording has each received state once; it can be loaded and played."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.urlog"
        interfaces: list[Any] = ["realtime"] + ["primary"] * (bench.chance.random() < 0.5)
        outputs = None
        if bench.chance.random() < 0.5 and bench.controller.firmware.is_cb2 is False:
            outputs = bench.robot.rtde.outputs("timestamp", "actual_q")
            interfaces.append(outputs)
        seen: list[float] = []
        subscription = bench.robot.realtime.subscribe(lambda state: seen.append(state.time))
        with bench.robot.record(path, interfaces):
            time.sleep(0.3)
        subscription.close()
        if outputs is not None:
            outputs.close()
        bench.check(os.path.getsize(path) > 1000, "the recording is empty")
        with bench.raises(LinkError):
            bench.robot.record(path, ["realtime"])
        with urlink.connect(path) as played:
            times = [state.time for state in played.realtime.iterate(policy=urlink.block)]
            bench.check(len(times) >= 0.2 / bench.cycle, f"{len(times)} states were recorded")
            bench.check(set(times) - {times[0]} <= {*seen, *times[-2:]}, "the recorded states differ from the received")
            bench.check(np.all(np.round(np.diff(times) / bench.cycle) == 1), "states are missing")
            bench.check(played.rtde.is_recorded is (outputs is not None) or outputs is None, "RTDE is not in it")
            if outputs is not None:
                rows = list(played.rtde.outputs("timestamp", "actual_q").iterate(policy=urlink.block))
                bench.check(len(rows) >= 0.2 / bench.cycle, f"{len(rows)} rows of RTDE were recorded")
            with bench.raises(LinkError):
                played.motion.stop()
        with bench.raises(BadValue):
            bench.robot.record(Path(folder) / "x.urlog", ["realtime", "realtime"])


@trial
def read_only(bench: Bench) -> None:
    """A connection with `read_only` shows the same states, and rejects commands."""
    with urlink.connect(bench.host, read_only=True, timeout=3.0) as other:
        bench.check(
            abs(other.realtime.wait(2.0).time - bench.controller.time) < NEAR + 2 * bench.cycle, "it shows other states"
        )
        other.primary.wait(2.0)
        for command in (
            lambda: other.motion.stop(),
            lambda: other.io.set_digital_out(0, True),
            lambda: other.script.send_line("set_digital_out(0, True)"),
            lambda: other.set_payload(1.0),
            lambda: other.rtde.inputs("speed_slider_fraction"),
        ):
            with bench.raises(LinkError):
                command()


@trial
def a_closed_robot(bench: Bench) -> None:
    """`Robot.close` ends in time and ends every waiting call; later uses raise an error."""
    other = urlink.connect(bench.host, timeout=3.0)
    waits = {
        "wait_digital_in": lambda: other.io.wait_digital_in(7, True, 20.0),
        "wait_until": lambda: other.realtime.wait_until(lambda state: False, 20.0),
        "wait_for_stop": lambda: other.safety.wait_for_stop(20.0),
        "motion": lambda: other.motion.move_joints([0.3, -1.5, 1.5, -1.5, -1.5, 0.0], speed=0.05, wait=20.0),
        "script": lambda: other.script.run("sleep(10)", wait=20.0),
    }
    name = bench.chance.choice(sorted(waits))
    other.realtime.wait(2.0)
    thread, outcome = bench.ended(waits[name])
    time.sleep(0.3 + 0.3 * bench.chance.random())
    begun = bench.now
    other.close()
    bench.check(bench.now - begun < 2.0 + NEAR, f"close took {bench.now - begun:.2f} s")
    if bench.joined(thread, 2.0):
        if name != "wait_for_stop":
            bench.check(isinstance(outcome[0], LinkError), f"{name} ended with {outcome[0]!r}")
        bench.check(outcome[1] < bench.now + 0.1, f"{name} ended {outcome[1] - begun:.2f} s after close")
    for use in (
        lambda: other.realtime.wait(1.0),
        lambda: other.motion.stop(),
        lambda: other.io.set_digital_out(0, True),
        lambda: other.script.run("sleep(0)"),
    ):
        with bench.raises(LinkError, within=0.5):
            use()
    other.close()


@trial
def closing_a_callback(bench: Bench) -> None:
    """`Subscription.close` waits `timeout` seconds for a running callback, but not within the callback."""
    state: dict[str, Any] = {"running": False, "calls": 0}

    def slow(_: Any) -> None:
        state["running"], state["calls"] = True, state["calls"] + 1
        time.sleep(0.3)
        state["running"] = False

    inline = bench.chance.random() < 0.5
    subscription = bench.robot.realtime.subscribe(slow, inline=inline)
    time.sleep(0.1)
    begun = bench.now
    if bench.chance.random() < 0.5:
        subscription.close(1.0)
        bench.check(not state["running"], "close returns while the callback is running")
    else:
        subscription.close(0.05)
        bench.check(bench.now - begun < 0.05 + NEAR, f"close(0.05) took {bench.now - begun:.2f} s")
    calls = state["calls"]
    time.sleep(0.5)
    bench.check(state["calls"] == calls, "the callback is called after close")
    bench.robot.realtime.wait(5.0)
    made: list[Any] = []

    def once(_: Any) -> None:
        made.append(bench.now)
        kept[0].close()

    kept = [bench.robot.realtime.subscribe(once, inline=inline)]
    bench.robot.realtime.wait(5.0)
    time.sleep(0.3)
    bench.check(
        len(made) == 1 or (inline and not made), f"a callback that closes its subscription was called {len(made)} times"
    )

    def wrong(_: Any) -> None:
        raise SystemExit("planted")

    bench.robot.realtime.wait(5.0)
    with bench.quiet(), bench.robot.realtime.subscribe(wrong, inline=inline) as failing:
        time.sleep(0.2)
        # The controller drops a connection that is not read for too long, because an inline callback blocks the reader.
        bench.check(failing.stats.raised > 10 or inline, f"{failing.stats}")
        bench.check(failing.stats.delivered == 0, f"{failing.stats}")


@trial
def a_reboot(bench: Bench) -> None:
    """After a reboot of the controller, streams continue, its new clock is detected, and its identity is read again."""
    bench.robot.realtime.wait(2.0)
    time.sleep(1.0)
    relation = bench.robot.clock
    before = relation.restarts
    bench.controller.faults.reboot(downtime=0.5 + bench.chance.random())
    time.sleep(4.0)
    state = bench.robot.realtime.wait(5.0)
    time.sleep(1.0)
    state = bench.robot.realtime.wait(5.0)
    late = clock.now() - relation.to_local(state.time)
    bench.check(-2e-3 - bench.cycle <= late <= NEAR, f"a new state is {late:.4f} s old")
    bench.check(relation.restarts == before + 1, f"{relation.restarts - before} restarts are counted")
    bench.check(bench.robot.firmware == bench.controller.firmware, f"{bench.robot.firmware}")
    bench.check(bench.robot.realtime.stats.reconnects == 1, f"{bench.robot.realtime.stats.reconnects} reconnects")


@trial
def counters(bench: Bench) -> None:
    """Counters only grow, across reconnections and lost boundaries, and their values are correct."""
    stream, period = _stream(bench)
    name = "realtime" if period < 0.05 else "primary"
    stream.wait(2.0)
    growing = ("received", "decoded", "failed", "bytes", "skipped", "resyncs", "reconnects", "gaps")
    looks: list[Any] = []
    for step in range(4):
        if step == 1:
            bench.controller.faults.garbage(40 + int(100 * bench.chance.random()), name)
        if step == 2:
            bench.reset()
        time.sleep(1.6)
        stream.wait(3.0)
        looks.append(stream.stats)
    for one, other in itertools.pairwise(looks):
        less = [field for field in growing if getattr(other, field) < getattr(one, field)]
        bench.check(not less, f"{less} decreased: {one}, {other}")
    first, last = looks[0], looks[-1]
    bench.check(first.skipped == 0 and first.reconnects == 0, f"{first}")
    bench.check(last.reconnects >= 1, f"{last}")
    bench.check(
        looks[1].skipped > 0 or looks[1].failed > 0 or looks[1].reconnects > 0, f"garbage is not counted: {looks[1]}"
    )
    for each in (first, last):
        bench.check(abs(each.rate - 1.0 / period) < 0.5 / period, f"{1.0 / period} packets a second: {each}")
    bench.check(last.received == last.decoded + last.failed, f"{last}")
