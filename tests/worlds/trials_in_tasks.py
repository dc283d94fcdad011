"""Trials of the interface for asyncio."""

from __future__ import annotations

import asyncio
import gc
import inspect
import threading
from collections.abc import Callable
from typing import Any

import numpy as np

import urlink
from linkcore.errors import Cancelled, Closed, LinkError, LinkTimeout, RemoteError
from linkcore.handle import Phase
from linkcore.streaming.connection_life import ConnectionEvent, ConnectionState
from urlink.aio.async_group import AsyncGroup
from urlink.packets import RobotState

from .trials import NEAR, Bench, awaited, ended

_READY = np.array([0.0, -1.57, 1.57, -1.57, -1.57, 0.0])


def _stream(bench: Bench) -> tuple[Any, float]:
    return bench.chance.choice(((bench.robot.realtime, bench.cycle), (bench.robot.primary, 0.1)))


async def _in_time(bench: Bench, call: Any, within: float, what: str) -> tuple[Any, float]:
    """Await an awaitable that must end in time; return its result or error, and the time."""
    task = asyncio.ensure_future(ended(bench, call))
    done, _ = await asyncio.wait({task}, timeout=within)
    if not done:
        bench.check(False, f"{what} has not ended within {within:g} s")
        task.cancel()
        return None, bench.now
    return task.result()


async def _raises(
    bench: Bench, call: Any, *kinds: type[BaseException], after: float = 0.0, within: float = NEAR
) -> None:
    begun = bench.now
    made, at = await _in_time(bench, call, after + within + 5.0, "a call")
    bench.check(isinstance(made, kinds), f"it gave {made!r}; expected {' or '.join(kind.__name__ for kind in kinds)}")
    bench.check(
        after - 2e-3 <= at - begun <= after + within, f"{made!r} after {at - begun:.3f} s, promised {after:.3f}"
    )


@awaited
async def iterating(bench: Bench) -> None:
    """A loop gets states in order. A slow loop gets the newest, or all with `block`. Dropped states are counted."""
    policy = bench.chance.choice((None, urlink.latest, urlink.drop_oldest(4), urlink.block))
    rest = bench.chance.choice((0.0, 0.0, 5 * bench.cycle))
    times = []
    packets = bench.robot.realtime.iterate(policy=policy, timeout=2.0)
    async for state in packets:
        times.append(state.time)
        if policy in (None, urlink.latest):
            bench.check(state.received.age < bench.cycle + NEAR, f"the newest is {state.received.age:.3f} s old")
        if rest:
            await asyncio.sleep(rest)
        if len(times) == 12:
            break
    stats = packets.stats
    cycles = np.round(np.diff(times) / bench.cycle)
    bench.check(np.all(cycles >= 1), f"not in order: {times}")
    bench.check(stats.offered == stats.delivered + stats.dropped + stats.waiting, f"{stats}")
    bench.check(stats.delivered == len(times), f"{len(times)} were delivered: {stats}")
    if policy is urlink.block:
        bench.check(np.all(cycles == 1), f"states are missing: {cycles.tolist()}")
    elif rest:
        lost = int(cycles.sum()) - len(cycles)
        bench.check(stats.dropped >= lost - 2, f"{lost} states were dropped: {stats}")
        bench.check(policy is not urlink.latest or cycles.max() > 1, "a slow loop drops no states")


@awaited
async def a_lifespan(bench: Bench) -> None:
    """States older than their lifespan when taken are dropped and counted as expired."""
    packets = bench.robot.realtime.iterate(policy=urlink.drop_oldest(1000), timeout=2.0, lifespan=0.1)
    ages = []
    async for state in packets:
        ages.append(state.received.age)
        if len(ages) == 1:
            await asyncio.sleep(0.4)
        if len(ages) == 6:
            break
    bench.check(max(ages) <= 0.11, f"a state of {max(ages):.3f} s was delivered")
    bench.check(packets.stats.expired > 0.15 / bench.cycle, f"{packets.stats}")


@awaited
async def waiting_in_vain(bench: Bench) -> None:
    """A wait ends with `LinkTimeout` after its timeout."""
    stream, _period = _stream(bench)
    seconds = 0.15 + bench.chance.random()
    await stream.wait(2.0)
    await _raises(bench, stream.wait_until(lambda state: False, seconds), LinkTimeout, after=seconds)
    await _raises(bench, bench.robot.io.wait_digital_in(7, True, 0.3), LinkTimeout, after=0.3)
    with bench.silence():
        await asyncio.sleep(NEAR)
        await _raises(bench, stream.wait(seconds), LinkTimeout, after=seconds)

        async def each() -> None:
            async for _ in stream.iterate(timeout=seconds):
                pass

        await _raises(bench, each(), LinkTimeout, after=seconds)
    made, _at = await _in_time(bench, stream.wait(5.0), 6.0, "wait")
    bench.check(isinstance(made, (RobotState, urlink.RealtimeState)), f"{made!r}")


@awaited
async def waiting_for(bench: Bench) -> None:
    """`wait_until` returns the first state that meets the condition, when this state arrives."""
    at = bench.now + 0.1 + 0.2 * bench.chance.random()
    number = bench.chance.randrange(7)
    signals = bench.controller.signals
    has = bool(signals.digital_inputs >> number & 1)
    bench.sim.at(at, lambda: setattr(signals, "digital_inputs", signals.digital_inputs ^ 1 << number))
    if bench.chance.random() < 0.5:
        await bench.robot.realtime.wait_until(
            lambda state: bool(state.digital_input_bits >> number & 1) is not has, 5.0
        )
    else:
        await bench.robot.io.wait_digital_in(number, not has, 5.0)
    bench.check(at <= bench.now <= at + 3 * bench.cycle + NEAR, f"it took {bench.now - at:.3f} s")
    bench.check(await bench.robot.io.digital_in(number) is not has, "the input does not have the awaited value")


@awaited
async def a_deadline(bench: Bench) -> None:
    """`on_deadline` is called once for each longer silence, in the thread of the loop."""
    stream, period = _stream(bench)
    deadline = period + 0.02 + 0.1 * bench.chance.random()
    late: list[tuple[float, float, str]] = []
    came: list[float] = []
    here = threading.current_thread().name
    kind = RobotState if period > 0.05 else urlink.RealtimeState

    def on_deadline(age: float) -> None:
        late.append((age, bench.now, threading.current_thread().name))

    how: dict[str, Any] = {"deadline": deadline, "on_deadline": on_deadline}
    of = bench.chance.choice(("stream", "of", "kind"))
    if of == "of":
        subscription = await stream.of(kind).subscribe(lambda state: came.append(bench.now), **how)
    elif of == "kind":
        subscription = await stream.subscribe(lambda state: came.append(bench.now), kind, **how)
    else:
        subscription = await stream.subscribe(lambda state: came.append(bench.now), **how)
    await asyncio.sleep(0.35)
    bench.check(not late and len(came) > 1, f"{len(came)} came, but a deadline of {deadline:.3f} s was missed: {late}")
    with bench.silence():
        await asyncio.sleep(2 * deadline + 3 * NEAR)
        bench.check(subscription.stats.missed_deadlines == 1, f"{subscription.stats}")
        bench.check(len(late) == 1, f"on_deadline was called {len(late)} times in one silence")
        for age, _at, thread in late:
            bench.check(deadline <= age <= deadline + NEAR, f"on_deadline got {age:.3f} s; deadline {deadline:.3f} s")
            bench.check(thread == here, f"on_deadline was called in {thread}")
    count = len(came)
    await asyncio.sleep(0.5)
    bench.check(len(came) > count, "no state arrived after the silence")
    subscription.close()
    count = len(came)
    await asyncio.sleep(0.2)
    bench.check(len(came) == count, "the callback is called after close")


@awaited
async def a_lost_connection(bench: Bench) -> None:
    """A stream reconnects on its own, keeps loops and subscriptions, and reports and counts reconnections."""
    stream, period = _stream(bench)
    events: list[ConnectionEvent] = []
    states: list[float] = []
    await stream.wait(2.0)
    await stream.subscribe(events.append, ConnectionEvent)
    await stream.subscribe(lambda state: states.append(bench.now))
    looped: list[float] = []

    async def loop() -> None:
        async for _ in stream:
            looped.append(bench.now)

    task = asyncio.ensure_future(loop())
    await asyncio.sleep(2.5 * period)
    if bench.chance.random() < 0.5:
        bench.reset()
    else:
        with bench.silence():
            await asyncio.sleep(2.5)
            bench.check(stream.connection is not ConnectionState.CONNECTED, "2.5 s of silence are not detected")
            bench.check(stream.latest is None, "an old state is returned as the latest")
    await asyncio.sleep(3.0)
    await stream.wait(2.0)
    await asyncio.sleep(NEAR)
    notified = [event.state for event in events]
    bench.check(states[-1] > bench.now - period - NEAR, "the subscription gets no more states")
    bench.check(looped[-1] > bench.now - period - NEAR, "the loop gets no more states")
    bench.check(
        ConnectionState.LOST in notified and notified[-1] is ConnectionState.CONNECTED, f"the events were {notified}"
    )
    count = notified.count(ConnectionState.CONNECTED)
    bench.check(stream.stats.reconnects == count, f"{count} connections, but {stream.stats.reconnects} counted")
    lost = next((event for event in events if event.state is ConnectionState.LOST), None)
    bench.check(lost is not None and isinstance(lost.error, RemoteError), f"it was lost because of {lost}")
    begun = bench.now
    await stream.close()
    made, at = await _in_time(bench, task, 2.0, "a loop over a closed stream")
    bench.check(made is None and at - begun < 1.0, f"the loop ended with {made!r}")


@awaited
async def closing_a_stream(bench: Bench) -> None:
    """`close` ends every loop and every wait immediately; later uses raise `Closed`."""
    stream, _period = _stream(bench)
    await stream.wait(2.0)
    calls: list[int] = []
    await stream.subscribe(lambda state: calls.append(1))

    async def loop() -> int:
        count = 0
        async for _ in stream.iterate(policy=bench.chance.choice((urlink.latest, urlink.block))):
            count += 1
        return count

    waits = {"wait_until": stream.wait_until(lambda state: False, 30.0), "loop": loop(), "join": stream.join(30.0)}
    tasks = {name: asyncio.ensure_future(ended(bench, call)) for name, call in waits.items()}
    await asyncio.sleep(0.3)
    begun = bench.now
    await stream.close()
    bench.check(bench.now - begun < 1.0, f"close took {bench.now - begun:.2f} s")
    count = len(calls)
    for name, task in tasks.items():
        done, _ = await asyncio.wait({task}, timeout=1.0)
        bench.check(done, f"{name} has not ended after close")
        if done:
            made, at = task.result()
            bench.check(isinstance(made, Closed if name == "wait_until" else int), f"{name} ended with {made!r}")
            bench.check(at - begun < 0.5, f"{name} ended {at - begun:.2f} s after close")
        task.cancel()
    await asyncio.sleep(0.2)
    bench.check(len(calls) == count and count > 1, "the callback is called after close")
    bench.check(stream.connection is ConnectionState.CLOSED, f"{stream.connection}")
    await _raises(bench, stream.wait(1.0), Closed)
    await _raises(bench, stream.start(), Closed)
    await _raises(bench, stream.subscribe(print), Closed)


@awaited
async def history(bench: Bench) -> None:
    """A history has the states of the last seconds; `join` of an open stream returns False after its timeout."""
    with await bench.robot.realtime.history(0.2) as kept:
        await asyncio.sleep(0.5)
        times = kept["time"]
        bench.check(abs(float(times[-1] - times[0]) - 0.2) < 0.03 + 2 * bench.cycle, "a history of 0.2 s is longer")
    begun = bench.now
    bench.check(await bench.robot.realtime.join(0.3) is False, "an open stream is over")
    bench.check(0.29 < bench.now - begun < 0.3 + NEAR, f"join(0.3) took {bench.now - begun:.3f} s")
    _thread, outcome = bench.ended(lambda: bench.robot.realtime.stream.wait(2.0).time)
    await asyncio.sleep(0.3)
    bench.check(outcome and isinstance(outcome[0], float), f"another thread gets {outcome}")
    await bench.robot.realtime.description()
    for name in ("realtime", "primary", "secondary"):
        stream = getattr(bench.robot, name)
        await stream.wait(2.0)
        bench.check(name in stream.name, f"{stream.name} is the stream {name}")


@awaited
async def motions(bench: Bench) -> None:
    """An awaited motion ends when the arm is at the goal; a motion whose task is cancelled brakes."""
    robot, chance = bench.robot, bench.chance
    state = await robot.realtime.wait(2.0)
    goal = state.q_target + 0.15 * chance.choice((-1, 1))
    done: list[Any] = []
    motion = await robot.motion.move_joints(goal, speed=0.5, wait=False)
    motion.add_done_callback(done.append)
    await motion
    await asyncio.sleep(0.05)
    bench.check(np.allclose((await robot.realtime.wait(2.0)).q_actual, goal, atol=0.01), "it is not at the goal")
    bench.check(len(done) == 1 and motion.phase is Phase.DONE, f"{done}, {motion.phase}")
    how = chance.choice(("task", "cancel", "stop", "call"))
    if how == "call":
        task = asyncio.ensure_future(robot.motion.move_joints(goal + 0.5, speed=0.1, wait=True))
        await asyncio.sleep(0.4)
        task.cancel()
        await asyncio.wait({task}, timeout=5.0)
        bench.check(task.cancelled(), "the call was not cancelled")
    else:
        motion = await robot.motion.move_joints(goal + 0.5, speed=0.1, wait=False)
        await asyncio.sleep(0.3)
        begun = bench.now
        if how == "task":

            async def wait() -> None:
                await motion

            task = asyncio.ensure_future(wait())
            await asyncio.sleep(0.05)
            task.cancel()
            await asyncio.wait({task}, timeout=5.0)
        elif how == "cancel":
            motion.cancel()
        else:
            await robot.motion.stop(wait=True)
        made, at = await _in_time(bench, _awaiting(motion), 3.0, how)
        bench.check(isinstance(made, Cancelled), f"{how}: it ended with {made!r}")
        bench.check(at - begun < 2.0, f"{how}: it took {at - begun:.2f} s")
    await asyncio.sleep(0.8)
    bench.check(np.abs((await robot.realtime.wait(2.0)).qd_actual).max() < 0.02, f"it moves after {how}")
    bench.check(robot.motion.current is None, f"{how}: a motion is still the current one")


async def _awaiting(handle: Any) -> None:
    await handle


@awaited
async def blocks(bench: Bench) -> None:
    """A motion ends when its block is left in any way, and the arm brakes."""
    robot, chance = bench.robot, bench.chance
    q = (await robot.realtime.wait(2.0)).q_target
    kind = chance.choice(("servo", "jog", "stream", "force", "freedrive"))
    makes: dict[str, Callable[[], Any]] = {
        "servo": lambda: robot.motion.servo(watchdog=0.3),
        "jog": lambda: robot.motion.jog("base", timeout=1.0),
        "stream": lambda: robot.motion.stream(buffer=0.4),
        "force": lambda: robot.motion.force_mode("base", [0, 0, 1, 0, 0, 0], [0.0] * 6, [0.05] * 6),
        "freedrive": lambda: robot.freedrive(),
    }
    how = chance.choice(("end", "raise", "cancel"))
    kept: list[Any] = []

    if kind == "force":
        # The offset of the force sensor would push the arm away.
        await robot.zero_force_sensor()
        await asyncio.sleep(0.1)

    async def use() -> None:
        async with makes[kind]() as block:
            kept.append(block)
            if kind == "servo":
                for step in range(int(0.3 / bench.cycle)):
                    block.send(q + 0.0002 * step)
                    await robot.realtime.wait(2.0)
            elif kind == "jog":
                block.move([0.0, 0.0, 0.05, 0.0, 0.0, 0.0])
                await asyncio.sleep(0.3)
            elif kind == "stream":
                await block.append([urlink.TrajectoryPoint(q + 0.05, block.end + 0.5, [0.0] * 6)], wait=False)
                await block.wait_until_dry(5.0)
                bench.check(
                    np.allclose((await robot.realtime.wait(2.0)).q_target, q + 0.05, atol=0.005),
                    "it is not at the point",
                )
                await block.append([urlink.TrajectoryPoint(q - 0.05, block.end + 1.5, [0.0] * 6)], wait=False)
                await asyncio.sleep(0.3)
            else:
                await asyncio.sleep(0.3)
            if how == "raise":
                raise ZeroDivisionError
            if how == "cancel":
                await asyncio.sleep(10.0)

    task = asyncio.ensure_future(use())
    if how == "cancel":
        await asyncio.sleep(2.0)
        task.cancel()
    await asyncio.wait({task}, timeout=8.0)
    bench.check(task.done(), f"a block of {kind} has not ended")
    if task.done() and not task.cancelled():
        bench.check(isinstance(task.exception(), ZeroDivisionError) or how == "end", f"{how}: {task.exception()!r}")
    bench.check(kept and kept[0].done, f"{kind} continues after its block")
    await asyncio.sleep(0.8)
    bench.check(np.abs((await robot.realtime.wait(2.0)).qd_actual).max() < 0.02, f"it moves after {kind}")
    await asyncio.sleep(0.2)
    bench.check(not bench.controller.is_running_program, f"the program of {kind} keeps running")


@awaited
async def commands(bench: Bench) -> None:
    """Confirmed settings are the values of the controller; programs and statements are executed."""
    robot, controller, chance = bench.robot, bench.controller, bench.chance
    number, on = chance.randrange(8), chance.random() < 0.5
    await robot.io.set_digital_out(number, on)
    bench.check(bool(controller.signals.digital_outputs >> number & 1) is on, f"output {number} is not {on}")
    bench.check(await robot.io.digital_out(number) is on, "digital_out")
    fraction = 0.3 + 0.7 * chance.random()
    await robot.set_speed_slider(fraction)
    bench.check(abs(controller.speed_fraction - fraction) < 0.01, "the slider")
    texts: list[str] = []
    program = await robot.script.run(
        'def p():\n textmsg("a")\n sleep(0.2)\n textmsg("b")\nend\n', on_text=texts.append, wait=False
    )
    await program
    await asyncio.sleep(0.1)
    bench.check(texts == ["a", "b"], f"{texts}")
    bench.check(await robot.safety.wait_for_stop(0.1) is None, "a stop")
    notified: list[Any] = []
    subscribed = robot.safety.on_stop(notified.append)
    if inspect.isawaitable(subscribed):
        await subscribed
    task = asyncio.ensure_future(ended(bench, robot.safety.wait_for_stop(5.0)))
    await asyncio.sleep(0.1)
    at = bench.now
    controller.faults.protective_stop()
    done, _ = await asyncio.wait({task}, timeout=1.5)
    bench.check(done and task.result()[0] is not None, "wait_for_stop does not report the stop")
    bench.check(done and task.result()[1] - at < 0.3, "wait_for_stop reports the stop late")
    await asyncio.sleep(0.2)
    bench.check(len(notified) == 1, f"on_stop was called {len(notified)} times")
    controller.faults.clear()
    await robot.safety.wait_until_clear(5.0)
    if not controller.firmware.is_cb2:
        register = chance.randrange(24, 48)
        await robot.registers.write_integer(register, 42)
        await asyncio.sleep(0.1)
        bench.check(controller.registers.inputs.integers[register] == 42, "write_integer")
        async with robot.rtde.outputs("timestamp", "actual_q", frequency=25.0) as stream:
            times = []
            async for state in stream:
                times.append(state.timestamp)
                if len(times) == 5:
                    break
            bench.check(np.allclose(np.diff(times), 0.04, atol=1e-3), f"25 Hz: {np.diff(times)}")
        async with robot.rtde.inputs("speed_slider_fraction") as inputs:
            sent = inputs.send(speed_slider_fraction=0.55)
            if asyncio.iscoroutine(sent):
                await sent
            await asyncio.sleep(0.1)
            bench.check(abs(controller.speed_fraction - 0.55) < 0.01, "inputs.send")


@awaited
async def statements(bench: Bench) -> None:
    """Statements are executed in order, until they are aborted."""
    from urlink.protocol.firmware import Firmware

    if bench.controller.firmware < Firmware.parse("5.10"):
        return
    async with bench.robot.interpreter() as mode:
        first = await mode.execute("set_digital_out(1, True)", wait=3.0)
        second = await mode.execute("set_digital_out(2, True)")
        await mode.wait_executed(3.0)
        bench.check(second > first, f"{first}, {second}")
        bench.check(bench.controller.signals.digital_outputs >> 1 & 3 == 3, "they are not executed")
        await mode.execute("sleep(2)")
        await _raises(bench, mode.wait_executed(0.3), LinkTimeout, after=0.3, within=0.3)
        await mode.abort()
    bench.check(mode.done, "it continues after its block")


@awaited
async def a_robot_that_is_away(bench: Bench) -> None:
    """Connecting without a controller fails in time; a cancelled connect leaves no sockets."""
    sockets = bench.sim.open_sockets
    seconds = 0.3 + bench.chance.random()

    async def connect(host: str) -> None:
        async with urlink.connect_async(host, timeout=seconds):
            await asyncio.sleep(5.0)

    await _raises(bench, connect("192.168.0.77"), LinkError, within=seconds + 1.5)
    with bench.silence():
        await _raises(bench, connect(bench.host), LinkError, within=seconds + 1.5)
    await asyncio.sleep(2.5)
    task = asyncio.ensure_future(connect(bench.host))
    await asyncio.sleep(0.002 * bench.chance.random())
    task.cancel()
    await asyncio.wait({task}, timeout=4.0)
    bench.check(task.done(), "a cancelled connect continues")
    await asyncio.sleep(1.0)
    bench.check(bench.sim.open_sockets <= sockets + 2, f"{bench.sim.open_sockets - sockets} sockets are left")


@awaited
async def a_closed_robot(bench: Bench) -> None:
    """`close` ends in time and ends every waiting call; later uses raise an error."""
    robot = await urlink.connect_async(bench.host, timeout=3.0)
    await robot.realtime.wait(2.0)
    waits = [
        robot.io.wait_digital_in(7, True, 20.0),
        robot.realtime.wait_until(lambda state: False, 20.0),
        robot.motion.move_joints(_READY + 0.5, speed=0.05, wait=True),
    ]
    tasks = [asyncio.ensure_future(ended(bench, call)) for call in waits]
    await asyncio.sleep(0.4)
    begun = bench.now
    with_timeout = bench.chance.choice((0.5, 2.0))
    await robot.close(with_timeout)
    bench.check(bench.now - begun < 2.0 + NEAR, f"close took {bench.now - begun:.2f} s")
    done, pending = await asyncio.wait(tasks, timeout=2.0)
    bench.check(not pending, f"{len(pending)} calls continue after close")
    for task in done:
        bench.check(isinstance(task.result()[0], LinkError), f"a call ended with {task.result()[0]!r}")
    for call in (lambda: robot.realtime.wait(1.0), lambda: robot.motion.stop(), lambda: robot.script.run("sleep(0)")):
        await _raises(bench, call(), LinkError, within=0.5)
    await robot.close()
    for task in pending:
        task.cancel()


@awaited
async def a_lost_block(bench: Bench) -> None:
    """A task in a block gets an error when its program is stopped."""
    robot = bench.robot
    async with robot.motion.jog("joints", timeout=5.0) as jog:
        jog.move([0.1] * 6)
        await asyncio.sleep(0.3)
        bench.call(bench.controller.pendant.stop)
        made, _at = await _in_time(bench, _awaiting(jog), 3.0, "a jog whose program was stopped")
        bench.check(isinstance(made, LinkError) and not isinstance(made, Cancelled), f"it ended with {made!r}")
        bench.check(jog.phase is Phase.FAILED, f"{jog.phase}")


@awaited
async def a_group(bench: Bench) -> None:
    """Arms of a group move together, and stop together."""
    from .trials_of_motions import second_controller

    with second_controller(bench) as controller:
        async with urlink.connect_async(controller.host, timeout=3.0) as other:
            both = AsyncGroup(bench.robot, other)
            goals = [(await robot.realtime.wait(2.0)).q_target + 0.15 for robot in (bench.robot, other)]
            begun = bench.now
            motion = await both.move_joints(goals, time=1.0, wait=False)
            await motion
            bench.check(0.95 < bench.now - begun < 2.0, f"a motion of 1 s took {bench.now - begun:.2f} s")
            for robot, goal in zip((bench.robot, other), goals, strict=True):
                bench.check(
                    np.allclose((await robot.realtime.wait(2.0)).q_actual, goal, atol=0.01), "an arm is not at its goal"
                )
            motion = await both.move_joints([goal - 0.3 for goal in goals], time=3.0, wait=False)
            await asyncio.sleep(0.6)
            motion.cancel()
            made, _ = await _in_time(bench, _awaiting(motion), 3.0, "a group")
            bench.check(isinstance(made, Cancelled), f"it ended with {made!r}")
            await asyncio.sleep(0.8)
            for robot in (bench.robot, other):
                bench.check(
                    np.abs((await robot.realtime.wait(2.0)).qd_actual).max() < 0.02, "an arm moves after cancel"
                )
    del both, motion, made
    gc.collect()  # a group has no close: its thread ends when the group is collected
