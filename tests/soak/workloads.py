"""Workloads of the long runs: each repeats one round, in its own process."""

from __future__ import annotations

import itertools
import socket
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path

import numpy as np

import rhdlink
import urlink
from rhdlink.host.plugins.turtle import Turtle
from urlink.simulator import Controller, Demonstration

#: Time limit for an expected event on a busy machine, in s.
TIMEOUT = 120.0

HOME = [0.0, -1.57, 1.57, -1.57, -1.57, 0.0]

Round = Callable[[], None]
Workload = Callable[[], AbstractContextManager[Round]]


def until(condition: Callable[[], object]) -> None:
    end = time.monotonic() + TIMEOUT
    while not condition():
        if time.monotonic() > end:
            raise TimeoutError(f"the condition was not met within {TIMEOUT:g} s")
        time.sleep(0.01)


@contextmanager
def streams() -> Iterator[Round]:
    """Subscribe with every policy to streams that are read continuously, and close the subscriptions."""
    with Controller("UR5e", "5.11", motion=Demonstration()) as controller, urlink.connect(controller.address) as robot:
        policies = [urlink.latest, urlink.drop_oldest(8), urlink.block]

        def listen() -> None:
            seen: list[urlink.packets.RealtimeState] = []
            subscriptions = [robot.realtime.subscribe(seen.append, policy=policy) for policy in policies]
            subscriptions.append(robot.primary.subscribe(lambda state: None, urlink.packets.RobotModeData))
            until(lambda: len(seen) > 300)
            for subscription in subscriptions:
                subscription.close()
            for _, state in zip(range(100), robot.realtime, strict=False):
                assert np.isfinite(state.q_actual).all()

        yield listen


@contextmanager
def reconnects() -> Iterator[Round]:
    """Cut connections, let them lose their frame boundary, and open and close further ones."""
    with Controller("UR10", "3.4") as controller, urlink.connect(controller.address) as robot:
        robot.realtime.wait(TIMEOUT)

        def lose() -> None:
            before = robot.realtime.stats.reconnects
            controller.faults.cut()
            until(lambda: robot.realtime.stats.reconnects > before)
            controller.faults.garbage(200)
            received = robot.realtime.stats.received
            until(lambda: robot.realtime.stats.received > received + 50)
            with urlink.connect(controller.address) as other:
                other.realtime.wait(TIMEOUT)
                other.primary.wait(TIMEOUT)

        yield lose


@contextmanager
def motions() -> Iterator[Round]:
    """Move an arm in several ways, and cancel and stop its motions."""
    # On a busy machine, the simulated controller can be delayed for longer than a real one may be silent.
    with (
        Controller("UR5e", "5.11") as controller,
        urlink.connect(controller.address, stale_after=20.0, silence=30.0) as robot,
    ):
        robot.motion.move_joints(HOME).wait(TIMEOUT)
        turns = itertools.cycle([0.2, -0.2])

        def move() -> None:
            goal = [*HOME[:5], next(turns)]
            robot.motion.move_joints(goal, speed=1.0, acceleration=4.0).wait(TIMEOUT)
            path = urlink.Trajectory.from_arrays([0.0, 0.5, 1.0], [goal, HOME, goal])
            robot.motion.follow(path, watchdog=5.0).wait(TIMEOUT)
            robot.motion.speed_joints([0, 0, 0, 0, 0, 0.1], duration=0.2).wait(TIMEOUT)
            with robot.motion.move_joints(HOME, speed=0.3):
                robot.realtime.wait(TIMEOUT)
            robot.motion.stop().wait(TIMEOUT)
            robot.script.run("textmsg(1)").wait(TIMEOUT)

        yield move


@contextmanager
def recordings() -> Iterator[Round]:
    """Make recordings and replay them."""
    with Controller("UR3e", "5.4") as controller, tempfile.TemporaryDirectory() as folder:

        def record() -> None:
            path = Path(folder) / "run.urlog"
            with urlink.connect(controller.address) as robot, robot.record(path):
                until(lambda: robot.realtime.stats.received > 200)
            with urlink.connect(f"replay://{path}?rate=max") as robot:
                count = sum(1 for _ in robot.realtime.of(urlink.packets.RealtimeState))
            assert count >= 200
            path.unlink()

        yield record


@contextmanager
def robots() -> Iterator[Round]:
    """Run a host with a writer, readers that come and go, a client that never reads, and one that sends nothing."""
    with rhdlink.Host([Turtle()], period=0.01, port=0) as host:
        address = f"127.0.0.1:{host.port}"

        def drive() -> None:
            idle = socket.create_connection(("127.0.0.1", host.port), TIMEOUT)
            deaf = socket.create_connection(("127.0.0.1", host.port), TIMEOUT)
            deaf.sendall(b"ar" + b"rree" * 200)
            with rhdlink.connect(address, rhdlink.robots.VelocityOmega, access="w", timeout=TIMEOUT) as writer:
                for _ in range(5):
                    with rhdlink.connect(address, rhdlink.robots.VelocityOmega, timeout=TIMEOUT) as reader:
                        for speed in np.linspace(0.0, 0.1, 20):
                            writer.cmdtransvel = float(speed)
                            writer.sync()
                            reader.sync()
            idle.close()
            deaf.close()

        yield drive


WORKLOADS: tuple[Workload, ...] = (streams, reconnects, motions, recordings, robots)
