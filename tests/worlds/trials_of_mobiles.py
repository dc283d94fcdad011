"""Trials of mobile robots: variables, subscribers, recordings, `Drive`, and the sensors of a simulated robot."""

from __future__ import annotations

import asyncio
import contextlib
import math
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

import rhdlink
from linkcore.errors import BadValue, Cancelled, Closed, LinkError
from linkcore.handle import Phase
from rhdlink.host.plugins.turtle import SmrTurtle, Turtle
from rhdlink.host.scene import Scene, Tape
from rhdlink.host.world import World, save

from .trials import NEAR, Bench, mobile

_PORT = 24902


@contextlib.contextmanager
def _host(bench: Bench, plugin: Any) -> Iterator[str]:
    """Run a host of the mobile robot, and yield its address."""
    address = bench.there.address
    with bench.sim.on(bench.there):
        host = rhdlink.Host([plugin], port=_PORT, address=address).start()
    try:
        yield f"{address}:{_PORT}"
    finally:
        with bench.sim.on(bench.there):
            host.close()


@contextlib.contextmanager
def _connected(bench: Bench, **options: Any) -> Iterator[tuple[Any, Any]]:
    """Connect to a robot that accepts speeds of its wheels; yield the robot and its plugin."""
    plugin = SmrTurtle()
    with _host(bench, plugin) as address:
        options = {"access": "w", "timeout": 1.0, **options}
        with rhdlink.connect(address, rhdlink.robots.Smr, **options) as robot:
            yield robot, plugin


def _synced(robot: Any, times: int = 3) -> None:
    for _ in range(times):
        robot.sync()


@mobile
def values(bench: Bench) -> None:
    """Synced values arrive at the robot, values of the robot are read, and flags show new values."""
    chance = bench.chance
    with _connected(bench) as (robot, plugin):
        left, right = chance.randrange(-50, 50), chance.randrange(-50, 50)
        robot.speedl, robot["speedr"] = left, right
        bench.check(robot.speedl == left, "a set value is not read")
        _synced(robot)
        bench.check(
            (plugin.speedl, plugin.speedr) == (left, right), f"{left}, {right}: {plugin.speedl} {plugin.speedr}"
        )
        before = robot.tick
        time.sleep(0.05)
        robot.sync()
        robot.sync()
        bench.check(robot.tick > before, "the tick does not advance")
        bench.check(robot.updated("tick") and robot.fresh("tick") and robot.changed("tick"), "the tick is not new")
        bench.check(not robot.changed("speedl") or robot.speedl != left, "an unchanged value is marked as changed")
        rows = {row.name: row for row in robot.variables}
        bench.check(rows["tick"].value == robot.tick and rows["tick"].direction.startswith("r"), f"{rows['tick']}")
        bench.check("tick" in robot and "nothing" not in robot and "speedl" in set(robot), "names")
        bench.check(
            robot.access == "w" and robot.connection is rhdlink.ConnectionState.CONNECTED, f"{robot.connection}"
        )
        bench.check(robot.received.age < NEAR, f"it arrived {robot.received.age:.3f} s ago")
        with bench.raises(LinkError):
            robot["nothing"]
        with bench.raises(LinkError):
            robot.stamp("nothing")
        robot.speedl = robot.speedr = 0
        _synced(robot)
        bench.check(robot.discarded == 0, f"{robot.discarded} values were discarded")
    with bench.raises(Closed):
        robot.sync()
    with bench.raises(Closed):
        robot.subscribe(print)
    with bench.raises(Closed):
        robot.background()


@mobile
def masters(bench: Bench) -> None:
    """A robot has one master: a second one is refused, or falls back to reading; the next one is accepted."""
    with _connected(bench) as (robot, _plugin):
        address = robot.address
        with bench.raises(LinkError, within=1.5):
            rhdlink.connect(address, rhdlink.robots.Smr, access="w", timeout=1.0)
        with rhdlink.connect(address, rhdlink.robots.Smr, access="w", fallback="r", timeout=1.0) as other:
            bench.check(other.access == "r", f"a second writer has access {other.access}")
            with bench.raises(LinkError):
                other.speedl = 5
            robot.speedl = 11
            _synced(robot)
            for _ in range(3):
                other.sync()
            bench.check(other["tick"] > 0, "a reader reads nothing")
        address = robot.address
        robot.close()
        time.sleep(0.1)
        with rhdlink.connect(address, access="w", timeout=1.0) as third:
            bench.check(third.access == "w", "a disconnected master blocks other clients")


@mobile
def syncing_in_vain(bench: Bench) -> None:
    """A sync ends after its timeout; unsent values are discarded or sent by the next sync, depending on `unsent`."""
    unsent = bench.chance.choice(("discard", "send"))
    seconds = 0.3 + 0.4 * bench.chance.random()
    with _connected(bench, unsent=unsent) as (robot, plugin):
        events: list[Any] = []
        robot.subscribe_connection(lambda event: events.append(event.state))
        robot.speedl = 3
        _synced(robot)
        with bench.silence():
            robot.speedl = 44
            begun = bench.now
            with bench.raises(LinkError, after=0.0, within=seconds + 0.3):
                robot.sync(seconds)
            bench.check(
                bench.now - begun > 0.5 * seconds, f"it timed out after {bench.now - begun:.2f} s of {seconds:.2f}"
            )
            thread, outcome = bench.ended(lambda: robot.sync(seconds))
            time.sleep(0.05)
            with bench.raises(LinkError, within=0.4):
                robot.sync(0.1)
            bench.joined(thread, seconds + 1.0)
            bench.check(outcome and isinstance(outcome[0], LinkError), f"a sync in silence gave {outcome}")
        bench.sim.network.reset(bench.here, bench.there)
        robot.speedr = 12
        for _ in range(8):
            with contextlib.suppress(LinkError):
                robot.sync()
            time.sleep(0.1)
        robot.sync()
        bench.check(robot.connection is rhdlink.ConnectionState.CONNECTED, f"{robot.connection}")
        reported = events
        bench.check(reported[-1:] == [rhdlink.ConnectionState.CONNECTED], f"the events were {reported}")
        bench.check(
            robot.reconnects == reported.count(rhdlink.ConnectionState.CONNECTED), f"{robot.reconnects} {reported}"
        )
        if unsent == "send":
            bench.check(plugin.speedr == 12, f"the kept value was not sent: {plugin.speedr}")
        robot.speedl = 7
        _synced(robot)
        bench.check(plugin.speedl == 7, "no value is set after the connection was lost")


@mobile
def subscribers(bench: Bench) -> None:
    """A subscriber gets each update of its names once, in order; dropped and expired updates are counted."""
    chance = bench.chance
    with _connected(bench) as (robot, _plugin):
        seen: list[Any] = []
        every: list[Any] = []
        slow: list[Any] = []
        late: list[float] = []
        subscription = robot.subscribe(seen.append, "encl")
        all_of = robot.subscribe(every.append)
        lifespan = chance.choice((None, 0.1))

        def take(update: Any) -> None:
            slow.append((update, update.received.age))
            if len(slow) == 1:
                time.sleep(0.3)

        limited = robot.subscribe(take, "tick", policy=rhdlink.drop_oldest(2), lifespan=lifespan)
        watching = robot.subscribe(lambda update: None, "tick", deadline=0.15, on_deadline=late.append)
        robot.speedl = robot.speedr = 20
        for _ in range(40):
            robot.sync()
            time.sleep(0.01)
        time.sleep(0.05)
        bench.check(late == [], f"a deadline was missed: {late}")
        bench.check(all(set(update.changes) == {"encl"} for update in seen), "updates of other names are delivered")
        values = [update.changes["encl"].value for update in seen]
        bench.check(len(values) > 5 and len({*map(str, seen)}) == len(seen), f"{len(values)} updates")
        moments = [update.received.monotonic for update in every]
        bench.check(moments == sorted(moments) and len(every) >= 30, f"{len(every)} updates, not in order")
        bench.check(any("tick" in update.changes for update in every), "an update of all names lacks some")
        stats = limited.stats
        bench.check(stats.offered == stats.delivered + stats.dropped + stats.waiting, f"{stats}")
        bench.check(stats.dropped > 0, f"{stats}")
        if lifespan is not None:
            bench.check(all(age <= lifespan + 1e-3 for _, age in slow), f"{[age for _, age in slow][:5]}")
        time.sleep(0.4)
        bench.check(len(late) == 1 and 0.15 <= late[0] < 0.15 + NEAR, f"on_deadline: {late}")
        bench.check(watching.stats.missed_deadlines == 1, f"{watching.stats}")
        subscription.close()
        count = len(seen)
        _synced(robot, 5)
        time.sleep(0.05)
        bench.check(len(seen) == count, "a closed subscription gets updates")
        with bench.raises(LinkError):
            robot.subscribe(print, "nothing")
        count = len(every)
        robot.sync()
    bench.check(len(every) > count, "queued updates were not delivered by close")
    bench.check(all_of.join(0.5) and limited.join(0.5), "subscriptions have not ended after close")


@mobile
def background(bench: Bench) -> None:
    """A thread keeps a robot in sync, reconnects on its own, and is closed with the robot."""
    chance = bench.chance
    period = chance.choice((None, 0.05, 0.1))
    with _connected(bench) as (robot, plugin):
        syncing = robot.background(period)
        time.sleep(0.5)
        count = syncing.syncs
        if period is not None:
            bench.check(abs(count - 0.5 / period) <= 2, f"{count} syncs in 0.5 s of {period} s")
        bench.check(count > 3 and syncing.is_running, f"{count} syncs")
        with bench.raises(LinkError):
            robot.background()
        robot.speedl = 9
        time.sleep(0.3)
        bench.check(plugin.speedl == 9, "a set value is not sent")
        bench.sim.network.reset(bench.here, bench.there)
        time.sleep(2.0)
        before = syncing.syncs
        time.sleep(0.3)
        bench.check(syncing.syncs > before, "it does not sync after the connection was lost")
        robot.speedl = 10
        time.sleep(0.3)
        bench.check(plugin.speedl == 10, "a set value is not sent after the connection was lost")
        bench.check(robot.reconnects == 1, f"{robot.reconnects} reconnects")
        if chance.random() < 0.5:
            syncing.close()
            bench.check(not syncing.is_running, "it runs after close")
            count = syncing.syncs
            time.sleep(0.2)
            bench.check(syncing.syncs == count, "it syncs after close")
            again = robot.background(0.05)
            time.sleep(0.2)
            bench.check(again.syncs > 1, "another one does not sync")
            syncing = again
        begun = bench.now
    bench.check(bench.now - begun < 2.0, f"close took {bench.now - begun:.2f} s")
    bench.check(not syncing.is_running, "it runs after its robot was closed")


@mobile
def a_recording(bench: Bench) -> None:
    """A recording has each batch; its columns equal the read values."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "drive.urlog"
        ticks = []
        with _connected(bench, record=path) as (robot, _plugin):
            robot.speedl = robot.speedr = 20
            for _ in range(15):
                robot.sync()
                ticks.append(int(robot.tick))
                time.sleep(0.02)
            lost = bench.chance.random() < 0.5
            if lost:
                bench.sim.network.reset(bench.here, bench.there)
                for _ in range(5):
                    with contextlib.suppress(LinkError):
                        robot.sync()
                    time.sleep(0.1)
            with bench.raises(LinkError):
                rhdlink.connect(robot.address, record=path, timeout=1.0)
        table = rhdlink.load(path, rhdlink.robots.Smr)
        column = [int(value) for value in table["tick"]]
        bench.check(set(ticks) <= set(column), f"{sorted(set(ticks) - set(column))} are not in the recording")
        bench.check(np.all(np.diff(table.time) >= 0.0), "its times go backwards")
        bench.check(len(table["linesensor"][0]) == 8, "a variable does not have its eight words")
        plain = rhdlink.load(path)
        bench.check([int(value) for value in plain["tick"]] == column, "without a class it has other values")
        bench.check(lost is bool(table.missing), f"{table.missing}")
        out = table.export(Path(folder) / "drive.csv", ["tick"])
        text = Path(out).read_text(encoding="utf-8")
        bench.check(str(ticks[-1]) in text and "tick" in text, "the .csv lacks values")


@mobile
def nobody(bench: Bench) -> None:
    """Connecting to no robot, a silent robot or another kind of robot fails in time, and leaves no sockets."""
    sockets = bench.sim.open_sockets
    seconds = 0.3 + bench.chance.random()
    with bench.raises(LinkError, within=seconds + 0.5):
        rhdlink.connect("192.168.0.77:24902", timeout=seconds)
    with bench.raises(BadValue):
        rhdlink.connect("192.168.0.77", timeout=-1.0)
    with _host(bench, Turtle()) as address:
        with bench.raises(LinkError, within=seconds + 0.5):
            rhdlink.connect(address, rhdlink.robots.Smr, timeout=seconds)
        with bench.silence(), bench.raises(LinkError, within=seconds + 0.7):
            rhdlink.connect(address, rhdlink.robots.VelocityOmega, timeout=seconds)
        time.sleep(1.0)
    bench.check(bench.sim.open_sockets <= sockets, f"{bench.sim.open_sockets - sockets} sockets are left")


@mobile
def closing(bench: Bench) -> None:
    """`close` ends a waiting sync, is the last event of the connection, and may be called twice."""
    with _connected(bench) as (robot, _plugin):
        events: list[Any] = []
        robot.subscribe_connection(lambda event: events.append(event.state))
        _synced(robot)
        with bench.silence():
            thread, outcome = bench.ended(lambda: robot.sync(20.0))
            time.sleep(0.2)
            begun = bench.now
            robot.close()
            bench.check(bench.now - begun < 2.0, f"close took {bench.now - begun:.2f} s")
            if bench.joined(thread, 1.0):
                bench.check(isinstance(outcome[0], Closed), f"sync ended with {outcome[0]!r}")
                bench.check(outcome[1] - begun < 1.0, "sync ended late")
        robot.close()
        bench.check(events[-1:] == [rhdlink.ConnectionState.CLOSED], f"{events}")
        bench.check(events.count(rhdlink.ConnectionState.CLOSED) == 1, f"{events}")
        bench.check(robot.connection is rhdlink.ConnectionState.CLOSED, f"{robot.connection}")


@mobile
def tasks(bench: Bench) -> None:
    """Waiting syncs, ordered updates, and the end of both by `close`, in the asyncio interface."""

    async def use(address: str, plugin: Any) -> None:
        async with rhdlink.connect_async(address, rhdlink.robots.Smr, access="w", timeout=1.0) as robot:
            robot.variables.speedl = 13
            await asyncio.gather(*(robot.sync() for _ in range(4)))
            bench.check(plugin.speedl == 13, f"{plugin.speedl}")
            ticks = []
            async for each in robot.updates(0.5):
                ticks.append(int(each.tick))
                if len(ticks) == 6:
                    break
            bench.check(ticks == sorted(ticks), f"{ticks}")
            with bench.silence():
                with bench.raises(LinkError, within=0.8):
                    await robot.sync(0.3)
                task = asyncio.ensure_future(robot.sync(20.0))
                await asyncio.sleep(0.1)
                begun = bench.now
                if bench.chance.random() < 0.5:
                    task.cancel()
                    await asyncio.wait({task}, timeout=1.0)
                    bench.check(task.cancelled(), "a cancelled sync has not ended")
                await robot.close()
                bench.check(bench.now - begun < 2.2, f"close took {bench.now - begun:.2f} s")
                await asyncio.wait({task}, timeout=1.0)
                bench.check(task.done(), "a sync has not ended after close")
                if task.done() and not task.cancelled():
                    bench.check(isinstance(task.exception(), LinkError), f"it ended with {task.exception()!r}")
            with bench.raises(Closed):
                await robot.sync()
        with bench.raises(LinkError, within=1.5):
            await rhdlink.connect_async("192.168.0.77:24902", timeout=0.5)

    plugin = SmrTurtle()
    with _host(bench, plugin) as address:
        asyncio.run(use(address, plugin))


@mobile
def driving(bench: Bench) -> None:
    """A motion ends after its distance; when it is cancelled or replaced, it ends and the robot comes to rest."""
    chance = bench.chance
    plugin: Any = chance.choice((SmrTurtle, Turtle))()
    kind = rhdlink.robots.Smr if isinstance(plugin, SmrTurtle) else rhdlink.robots.VelocityOmega

    def place() -> tuple[float, float, float]:
        return plugin.world.pose.x, plugin.world.pose.y, plugin.world.pose.theta

    def speed() -> float:
        before, at = place(), bench.now
        time.sleep(0.1)
        return math.hypot(place()[0] - before[0], place()[1] - before[1]) / (bench.now - at)

    with _host(bench, plugin) as address:
        robot = rhdlink.connect(address, kind, access="w", timeout=1.0)
        with rhdlink.Drive(robot, speed=0.4, acceleration=0.8) as drive:
            way = chance.choice((-1, 1)) * (0.2 + 0.3 * chance.random())
            begin = place()
            done: list[Any] = []
            motion = drive.forward(way)
            motion.add_done_callback(done.append)
            parts: list[Any] = []
            while not motion.done and len(parts) < 500:
                time.sleep(0.02)
                parts.append(motion.progress)
            motion.wait(1.0)
            time.sleep(0.1)
            moved = math.hypot(place()[0] - begin[0], place()[1] - begin[1])
            bench.check(abs(moved - abs(way)) < 0.06, f"forward({way:.2f}) went {moved:.2f} m")
            bench.check(len(done) == 1 and motion.phase is Phase.DONE, f"{done}, {motion.phase}")
            known = [part for part in parts if part is not None]
            bench.check(all(0.0 <= part <= 1.001 for part in known), f"progress {known}")
            pose = drive.pose
            bench.check(abs(math.hypot(pose.x, pose.y) - abs(way)) < 0.08, f"pose {pose} after {way:.2f} m")
            angle = chance.choice((-90.0, 60.0))
            begin = place()
            drive.turn(angle).wait(15.0)
            time.sleep(0.2)
            turned = math.degrees(place()[2] - begin[2])
            turned = (turned + 180.0) % 360.0 - 180.0
            bench.check(abs(turned - angle) < 12.0, f"turn({angle}) turned {turned:.1f} degrees")
            first = drive.forward(3.0)
            time.sleep(0.6)
            how = chance.choice(("cancel", "replace", "stop", "lost", "wheels"))
            bench.check(0.15 < abs(drive.velocity) < 0.6, f"its velocity is {drive.velocity}")
            if how == "cancel":
                first.cancel()
            elif how == "replace":
                drive.turn(10.0).wait(10.0)
            elif how == "stop":
                drive.stop().wait(5.0)
            elif how == "wheels":
                drive.wheels(0.2, 0.2).wait(2.0)
                time.sleep(0.7)
                bench.check(speed() > 0.1, "the wheels do not turn")
                drive.stop().wait(5.0)
            else:
                bench.sim.network.reset(bench.here, bench.there)
            with bench.raises(LinkError, within=4.0):
                first.wait(6.0)
            bench.check(first.done and first.error is not None, f"{first.phase}")
            bench.check(how == "lost" or isinstance(first.error, Cancelled), f"{how}: {first.error!r}")
            if how == "lost":
                bench.check(drive.error is not None, "no error")
                with bench.raises(LinkError):
                    drive.forward(1.0)
            time.sleep(1.2)
            bench.check(speed() < 0.02, f"it moves at {speed():.3f} m/s after {how}")
            if how != "lost":
                with bench.raises(BadValue):
                    drive.forward(float("nan"))
                with bench.raises(BadValue):
                    drive.forward(1.0, speed=-1.0)
                left = drive.forward(2.0)
                time.sleep(0.4)
                begun = bench.now
        if how != "lost":
            bench.check(bench.now - begun < 6.0, f"leaving took {bench.now - begun:.2f} s")
            bench.check(left.done and left.phase is not Phase.DONE, f"{left.phase} after its block")
        time.sleep(1.2)
        bench.check(speed() < 0.02, "it moves after its block")
        with bench.raises(Closed):
            drive.forward(1.0)
        robot.close()


@mobile
def reaching(bench: Bench) -> None:
    """Motions to a pose and along curves end where they should."""
    chance = bench.chance
    plugin = SmrTurtle()
    with _host(bench, plugin) as address, rhdlink.Drive(address, speed=0.5, acceleration=1.0) as drive:
        begin = plugin.world.pose
        how = chance.choice(("arc", "to", "along"))
        if how == "arc":
            radius, angle = 0.3 + 0.2 * chance.random(), chance.choice((-90.0, 90.0))
            drive.arc(radius, angle).wait(20.0)
            time.sleep(0.2)
            turned = math.degrees(plugin.world.pose.theta - begin.theta)
            bench.check(
                abs((turned - angle + 180) % 360 - 180) < 15.0, f"arc({radius:.2f}, {angle}) turned {turned:.0f}"
            )
        elif how == "to":
            drive.to(0.6, 0.3, 45.0).wait(30.0)
            time.sleep(0.2)
            pose = drive.pose
            bench.check(math.hypot(pose.x - 0.6, pose.y - 0.3) < 0.12, f"to(0.6, 0.3) ended at {pose}")
        else:
            motion = drive.along(0.0, 0.3, 0.0)
            time.sleep(5.0)
            pose = drive.pose
            bench.check(not motion.done and pose.x > 0.5, f"along() is at {pose}")
            bench.check(abs(pose.y - 0.3) < 0.1, f"it is {pose.y:.2f} m aside; commanded 0.3 m")
            motion.cancel()
        drive.stop().wait(5.0)


@mobile
def floors(bench: Bench) -> None:
    """Sensors see a scene at its drawn position, and saved pictures can be read again."""
    chance = bench.chance
    x, y = 2.0 + 5.0 * chance.random(), 2.0 + 5.0 * chance.random()
    far = 1.0 + chance.random()
    scene = Scene([Tape(((x - 1, y), (x + 1, y)), 0.05, 0.0)], [((x, y + far), (x + 2, y + far))])
    on, off = scene.brightness(np.array([[x, y], [x, y + 0.5]]))
    bench.check(on < 0.1 and off > 0.9, f"the tape has brightness {on:.2f}, and the floor {off:.2f}")
    bench.check(
        abs(scene.wall(x + 1, y, math.pi / 2) - far) < 1e-6, f"the wall is {scene.wall(x + 1, y, 1.5708)} m away"
    )
    bench.check(math.isinf(scene.wall(x + 1, y, -math.pi / 2)), "a wall is seen without a wall")
    commands = chance.choice(
        (
            f"M {x} {11 - y} L {x + 1} {11 - y} L {x + 1} {11 - y - 1}",
            f"m {x} {11 - y} l 1 0 l 0 -1",
            f"m {x} {11 - y} 1 0 0 -1",
            f"M {x} {11 - y} H {x + 1} V {11 - y - 1}",
            f"m {x} {11 - y} h 1 v -1",
            f"M {x} {11 - y} {x + 1} {11 - y} {x + 1} {11 - y - 1} z",
        )
    )
    shape = chance.choice(
        (
            f'<path d="{commands}" stroke="black" stroke-width="0.05" fill="none"/>',
            f'<polyline points="{x},{11 - y} {x + 1},{11 - y} {x + 1},{10 - y}" stroke="#000" stroke-width="0.05"/>',
            f'<g><line x1="{x}" y1="{11 - y}" x2="{x + 1}" y2="{11 - y}" style="stroke:black;stroke-width:0.05"/>'
            f'<line x1="{x + 1}" y1="{11 - y}" x2="{x + 1}" y2="{10 - y}" style="stroke:black;stroke-width:0.05"/></g>',
        )
    )
    wall = f'<line class="wall" x1="{x}" y1="{9 - y}" x2="{x + 1}" y2="{9 - y}" stroke="black"/>'
    text = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 11 11">{shape}{wall}</svg>'
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "floor.svg"
        path.write_text(text, encoding="utf-8")
        drawn = Scene.from_svg(path)
        seen = drawn.brightness(np.array([[x + 0.5, y], [x + 1, y + 0.5], [x + 0.5, y + 0.3], [x - 0.5, y]]))
        bench.check(seen[0] < 0.2 and seen[1] < 0.2, f"drawn tape has brightness {seen[:2]}: {commands}")
        bench.check((seen[2] > 0.8 and seen[3] > 0.8) or "z" in commands, f"the floor has brightness {seen[2:]}")
        bench.check(abs(drawn.wall(x + 0.5, y + 1, math.pi / 2) - 1.0) < 1e-6, f"the wall: {drawn.walls}")
        for wrong in ("<html></html>", "<svg"):
            path.write_text(wrong, encoding="utf-8")
            with bench.raises(BadValue):
                Scene.from_svg(path)
        world = World(11.0, (x, y, 0.0), scene=drawn)
        for _ in range(20):
            moved = world.step(0.5, 0.1, 0.1)
        bench.check(moved is not None and world.pose.x > x + 0.5, f"it has not moved: {world.pose}")
        save(world, Path(folder) / "world.svg", "title")
        picture = (Path(folder) / "world.svg").read_text(encoding="utf-8")
        bench.check("<svg" in picture and "title" in picture and "polyline" in picture, "the picture is empty")
        with bench.raises(BadValue):
            save(world, Path(folder) / "world.gif")
        bench.check(len(world.path) > 1, "no path")
