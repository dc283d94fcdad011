from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable, Iterator
from typing import Any

import pytest

import rhdlink.cli
from rhdlink import Host, Int32, Plugin, Read, Write
from rhdlink.plugins.turtle import Turtle

Run = Callable[..., tuple[int, str, str]]
Spawn = Callable[..., "subprocess.Popen[str]"]


class Extra(Plugin):
    """What the turtle has not: an array, one that was never set, a variable nobody has heard of, a long one."""

    linesensor = Read(Int32, 8)
    never = Read(Int32, 3)
    counter = Read(Int32)
    big = Read(Int32, 40)
    arm = Write(Int32, 4)

    def init(self, config: object) -> None:
        self.linesensor = range(8)

    def periodic(self, tick: int) -> None:
        self.counter = -tick


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str]) -> Run:
    """Run the command line in this process: exit status, stdout, stderr."""

    def run(*argv: str) -> tuple[int, str, str]:
        status = rhdlink.cli.main(argv)
        out, err = capsys.readouterr()
        return status, out, err

    return run


@pytest.fixture
def host() -> Iterator[Host]:
    with Host([Turtle(), Extra()], period=0.002, port=0) as host:
        yield host


@pytest.fixture
def address(host: Host) -> str:
    return f"127.0.0.1:{host.port}"


@pytest.fixture
def spawn() -> Iterator[Spawn]:
    """Start the command in a process of its own; ended with the test, if it has not ended by then."""
    started: list[subprocess.Popen[str]] = []

    def spawn(*argv: str, **options: Any) -> subprocess.Popen[str]:
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE} | options
        process = subprocess.Popen([sys.executable, "-m", "rhdlink.cli", *argv], text=True, **pipes)
        started.append(process)
        return process

    yield spawn
    for process in started:
        if process.poll() is None:
            process.kill()
        process.communicate()
