"""What becomes of each kind of motion and call when something fails, with both ends in processes of their own.

The table is `table.py`, which the page on reliability shows. By default each column is tried with a few rows; `nox -s
fuzz` goes through all of it.
"""

from __future__ import annotations

import ast
import contextlib
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.urlink.afterwards.table import (
    BACK,
    BRAKES,
    CALLED,
    COLUMNS,
    ENDS,
    FIRMWARES,
    GOES_ON,
    LATE,
    NOT,
    ROWS,
    cells,
    page,
)

_PAGE = Path(__file__).resolve().parents[3] / "docs" / "reliability.md"
#: s in which a process answers.
TIMEOUT = 40.0
#: s for which a process is suspended, and the network is silent: longer than a robot may be (`stale_after`).
HOLD = 2.5
#: s of the robot's time that a motion is watched beyond the time in which one would brake.
LONGER = 1.0
#: rad, and counts of the gripper, by which what is taken back may have begun to move.
BEGUN = 0.1, 60
MODULE = "tests.urlink.afterwards"


class Process:
    """One that is asked line by line."""

    def __init__(self, *command: str) -> None:
        self.process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, cwd=Path(__file__).parents[3]
        )

    def line(self) -> str:
        """The next line that it prints."""
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        assert line, f"{self.process.args!r} has ended with {self.process.wait(TIMEOUT)}"
        return line.strip()

    def say(self, line: str) -> None:
        assert self.process.stdin is not None
        self.process.stdin.write(f"{line}\n")
        self.process.stdin.flush()

    def ask(self, *words: object) -> Any:
        self.say(" ".join(map(str, words)))
        return ast.literal_eval(self.line())

    def send(self, number: int) -> None:
        os.kill(self.process.pid, number)

    def suspend(self) -> None:
        """Returns once all of its threads stand still."""
        os.kill(self.process.pid, signal.SIGSTOP)
        os.waitpid(self.process.pid, os.WUNTRACED)

    def close(self) -> None:
        with contextlib.suppress(OSError):
            self.process.kill()
            self.process.communicate()


class Rig:
    """Both ends, with the arm at rest and the call not made yet."""

    def __init__(self, firmware: str, row: str, *, is_alone: bool) -> None:
        self._block = contextlib.ExitStack()
        python = [sys.executable, "-u", "-m"]
        with self._block as block:
            unshared = ["unshare", "--net"] if is_alone else []
            shell = ["sh", "-c", 'ip link set lo up && exec "$@"', "sh"] if is_alone else []
            self.controller = Process(*unshared, *shell, *python, f"{MODULE}.controller", FIRMWARES[firmware], firmware)
            block.callback(self.controller.close)
            self.inside = ["nsenter", f"--net=/proc/{self.controller.process.pid}/ns/net"] if is_alone else []
            address = self.controller.line()
            self.client = Process(*self.inside, *python, f"{MODULE}.client", row, address)
            block.callback(self.client.close)
            assert self.client.line() == "ready"
            self._block = block.pop_all()

    def network(self, state: str) -> None:
        subprocess.run([*self.inside, "ip", "link", "set", "lo", state], check=True, timeout=TIMEOUT)

    def close(self) -> None:
        self._block.close()


@pytest.fixture
def rig() -> Iterator[Callable[..., Rig]]:
    with contextlib.ExitStack() as block:

        def make(*arguments: Any, **options: Any) -> Rig:
            made = Rig(*arguments, **options)
            block.callback(made.close)
            return made

        yield make


# -- what happens ---------------------------------------------------------------------------------------------------


def cut(rig: Rig) -> None:
    rig.controller.ask("cut")


def silence(rig: Rig) -> None:
    rig.network("down")
    rig.controller.ask("after", HOLD)
    rig.network("up")


def suspended_controller(rig: Rig) -> None:
    rig.controller.suspend()
    time.sleep(HOLD)  # until the client has given it up
    rig.controller.send(signal.SIGCONT)


def suspended_client(rig: Rig) -> None:
    rig.client.suspend()


def killed_client(rig: Rig) -> None:
    rig.client.send(signal.SIGKILL)


def reboot(rig: Rig) -> None:
    rig.controller.ask("reboot")


EVENTS = dict(zip(COLUMNS, (cut, silence, suspended_controller, suspended_client, killed_client, reboot), strict=False))


def tried() -> list[tuple[str, str, str]]:
    """All cells, or one of each column, of different rows and firmwares."""
    whole = list(cells())
    if os.environ.get("HYPOTHESIS_PROFILE") == "fuzz":
        return whole
    some = [[each for each in whole if each[2] == column] for column in COLUMNS]
    return [column[(7 * number + 5) % len(column)] for number, column in enumerate(some)]


# -- the table ------------------------------------------------------------------------------------------------------


def test_the_page_has_this_table() -> None:
    text = _PAGE.read_text(encoding="utf-8")
    assert page(text) == text, "python -m tests.urlink.afterwards.table writes it anew"


@pytest.mark.matrix
@pytest.mark.timeout(120)
@pytest.mark.skipif(not hasattr(signal, "SIGSTOP"), reason="a process is suspended by SIGSTOP, which is of POSIX")
@pytest.mark.parametrize(("firmware", "name", "column"), tried())
def test_what_becomes_of_it(rig: Callable[..., Rig], firmware: str, name: str, column: str) -> None:
    is_alone = column == "silence"
    if is_alone and (os.geteuid() != 0 or not all(map(shutil.which, ("unshare", "nsenter", "ip")))):
        pytest.skip("a network that falls silent takes root on Linux, with unshare, nsenter and ip")
    row = ROWS[name]
    both = rig(firmware, name, is_alone=is_alone)
    if column == CALLED:
        called_meanwhile(both, row.called, is_answered=name == "send_line")
        return
    if name in ("freedrive", "teach", "force_mode"):
        both.controller.ask("push", 1)
    both.client.say("go")
    both.client.say("stay")
    assert both.client.line() == "made"
    deadline = time.monotonic() + TIMEOUT
    while not both.controller.ask("moves"):
        assert time.monotonic() < deadline
        time.sleep(0.01)
    both.controller.ask("after", 0.3)
    EVENTS[column](both)
    lasted = both.controller.ask("rest", row.within + LONGER)
    expected = row.becomes(column)
    if expected == GOES_ON:
        assert lasted == row.within + LONGER
    else:
        assert expected in (BRAKES, ENDS)
        assert lasted < row.within


def called_meanwhile(rig: Rig, expected: str, *, is_answered: bool) -> None:
    q, fingers, mode, outputs = rig.controller.ask("state")
    rig.controller.suspend()
    try:
        rig.client.say("go")
        rig.client.say("wait")
        failed = rig.client.line()
        time.sleep(0.5)
    finally:
        rig.controller.send(signal.SIGCONT)
    rig.controller.ask("after", 2.0)
    now, position, later, switched = rig.controller.ask("state")
    way = max(abs(a - b) for a, b in zip(now, q, strict=True))
    is_same = (later, switched) == (mode, outputs)
    if expected == NOT:
        assert (way, position) == (pytest.approx(0.0, abs=1e-6), fingers)
        assert is_same
    elif expected == BACK:
        assert "may still be carried out" in failed
        assert is_same
        assert way < BEGUN[0]
        assert position - fingers < BEGUN[1]
        assert not rig.controller.ask("moves")
    else:
        assert expected == LATE
        assert not is_same or rig.controller.ask("moves")
        assert failed == "made" if is_answered else "may still" in failed
