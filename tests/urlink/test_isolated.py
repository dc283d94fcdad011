"""Tests of robots whose states are read by another process."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import urlink
from linkcore.net.isolated_transport import IsolatedTransport
from tests import platforms
from tests.waiting import until
from urlink import BadValue, Robot
from urlink.simulator import Controller

pytestmark = [
    pytest.mark.real_time,
    platforms.needs_shared_descriptors,
]


@pytest.fixture(scope="module")
def controller() -> Iterator[Controller]:
    with Controller("UR5e", "5.11") as controller:
        yield controller


def reader_of(robot: Robot) -> int:
    """Return the id of the process that reads."""
    transport = robot.realtime._connection._transport
    assert isinstance(transport, IsolatedTransport)
    assert transport._process is not None
    return transport._process.pid


def is_there(pid: int) -> bool:
    """Return whether the process is running. A zombie is not running."""
    try:
        return "Z" not in Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except FileNotFoundError:
        if Path("/proc").is_dir():
            return False
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


def test_latest_stays_current_while_the_reader_thread_is_blocked(controller: Controller) -> None:
    goes_on, is_held = threading.Event(), threading.Event()

    def hold(state: urlink.packets.RealtimeState) -> None:
        is_held.set()
        assert goes_on.wait(30)

    with urlink.connect(controller.address, isolate=True, timeout=60.0) as robot:
        states = robot.realtime.iterate(urlink.block, timeout=10)
        times = [next(states).time for _ in range(10)]
        holding = robot.realtime.subscribe(hold, inline=True)
        assert is_held.wait(10)
        # The reading thread is blocked, and the other process continues.
        seen = robot.realtime.latest
        assert seen is not None
        until(lambda: (newest := robot.realtime.latest) is not None and newest.time > seen.time + 0.2)
        goes_on.set()
        holding.close()
        times += [next(states).time for _ in range(150)]
        assert np.allclose(np.diff(times), 0.002)  # and nothing is lost
        newest = robot.realtime.latest
        assert newest is not None
        assert newest.received is not None

        # If the process ends, the connection is lost. It is restored with a new process.
        first = reader_of(robot)
        os.kill(first, signal.SIGKILL)
        until(lambda: robot.realtime.stats.reconnects == 1)
        robot.realtime.wait(10)
        second = reader_of(robot)
        assert second != first
        robot.motion.move_joints(robot.realtime.wait().q_actual + 0.02).wait()
    assert not is_there(second)
    assert robot.realtime.latest is None


@pytest.mark.slow
def test_reader_process_ends_with_its_parent(controller: Controller) -> None:
    program = (
        "import sys, urlink\n"
        "robot = urlink.connect(sys.argv[1], isolate=True, timeout=60.0)\n"
        "robot.realtime.wait(20)\n"
        "print(robot.realtime._connection._transport._process.pid, flush=True)\n"
        "sys.stdin.read()\n"
    )
    command = [sys.executable, "-c", program, controller.address]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as parent:
        assert parent.stdout is not None
        reader = int(parent.stdout.readline())
        assert is_there(reader)
        parent.kill()
    until(lambda: not is_there(reader))


def test_isolation_refuses_closed_ports_and_recordings(tmp_path: Path) -> None:
    boundary = "urlink.protocol.realtime.protocol:RealtimeBoundary"
    transport = IsolatedTransport("127.0.0.1", 1, silence=1.0, boundary=boundary, decode=lambda data, stamp: None)
    with pytest.raises(urlink.ConnectFailed, match="refused"):
        transport.open(5.0)
    assert transport.newest() is None
    with pytest.raises(urlink.LocalError, match="cannot send to it"):
        transport.send(b"stop", 1.0)
    with pytest.raises(BadValue, match="not supported for the recording"):
        urlink.connect(tmp_path / "run.urlog", isolate=True)
