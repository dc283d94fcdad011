from __future__ import annotations

import subprocess
from collections.abc import Callable, Iterator

import pytest

import rhdlink.cli
from rhdlink import Host, Int32, Plugin, Read, Write
from rhdlink.host.plugins.turtle import Turtle
from tests.spawning import spawning

Run = Callable[..., tuple[int, str, str]]
Spawn = Callable[..., "subprocess.Popen[str]"]


class Extra(Plugin):
    """Plugin with variables that the turtle lacks: an array, one never set, an undeclared name, and a long one."""

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
def run(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Run:
    """Function that runs the command line in this process; it returns the exit status, stdout and stderr."""
    # On a busy computer, a short command might take so long that it would print its progress.
    monkeypatch.setattr("linkcore.cli.progress._FIRST", 600.0)

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
    """Function that starts the command in a separate process, which is ended with the test at the latest."""
    yield from spawning("rhdlink.cli")
