from __future__ import annotations

import io
import os
import re
import subprocess
import sys
from collections.abc import Callable, Iterator

import pytest

from tests import platforms
from tests.waiting import until
from urlink.simulator import Controller

from .conftest import Run

pty = pytest.importorskip("pty", reason=platforms.TERMINALS)


@pytest.fixture
def terminal() -> Iterator[tuple[int, int]]:
    """Both ends of a terminal: the end of the user, and the end of the program."""
    ends: tuple[int, int] = pty.openpty()
    yield ends
    for end in ends:
        os.close(end)


@pytest.mark.slow
@pytest.mark.real_time
def test_keys_move_the_arm(spawn: Callable[..., subprocess.Popen[str]], terminal: tuple[int, int]) -> None:
    hand, screen = terminal
    with Controller("UR5", "3.15") as controller:
        process = spawn("jog", controller.address, "--speed", "0.5", "--hold", "5", stdin=screen)
        assert process.stdout is not None
        lines = iter(process.stdout.readline, "")
        assert next(lines) == "joints: 0.525 rad/s\n"
        os.write(hand, b"6")
        until(lambda: controller.arm.setpoint.qd[5] == pytest.approx(0.525))
        os.write(hand, b"+w")
        assert next(lines) == "joints: 0.788 rad/s\n"
        until(lambda: controller.arm.setpoint.qd == pytest.approx([0, -0.7875, 0, 0, 0, 0], abs=1e-9))
        for key, line in ((b" f", "base: 0.188 m/s\n"), (b"f", "tool: 0.188 m/s\n")):
            os.write(hand, key)
            assert next(lines) == line
        os.write(hand, b"x")
        assert re.fullmatch(r"q: (-?\d\.\d{4}, ){5}-?\d\.\d{4}\n", next(lines))
        assert process.wait(20) == 0
        until(lambda: not any(controller.arm.setpoint.qd))
    assert process.stderr is not None
    assert process.stderr.read() == ""


def test_jog_fails_without_terminal(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stdin", io.StringIO("6"))
    status, out, err = run("jog", "sim://")
    assert (status, out) == (1, "")
    assert "stdin is not a terminal" in err


@pytest.mark.parametrize(
    ("option", "message"),
    [
        ("--speed=3", "3 is out of range; expected 0.01 to 1"),
        ("--hold=60", "60 s is out of range; expected 0.05 to 10 s"),
    ],
)
def test_jog_rejects_values_out_of_range(run: Run, option: str, message: str) -> None:
    status, _, err = run("jog", "sim://", option)
    assert status == 2
    assert message in err
