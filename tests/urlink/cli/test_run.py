from __future__ import annotations

import io
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.spawning import interrupt
from tests.waiting import until
from urlink.simulator import Controller

from .conftest import Run

pytestmark = pytest.mark.simulated_time


Spawn = Callable[..., "subprocess.Popen[str]"]


@pytest.fixture
def program(tmp_path: Path) -> Callable[[str], str]:
    def write(text: str) -> str:
        path = tmp_path / "it.script"
        path.write_text(text, encoding="utf-8")
        return str(path)

    return write


def test_run_prints_texts_of_program(run: Run, address: str, program: Callable[[str], str]) -> None:
    text = 'def f():\n  textmsg("one")\n  sleep(0.05)\n  textmsg("two")\nend\n'
    status, out, err = run("run", address, program(text))
    assert (status, err) == (0, "")
    assert out.splitlines() == ["one", "two"]


def test_run_reads_program_from_stdin(run: Run, address: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stdin", io.StringIO('textmsg("from stdin")\n'))
    assert run("run", address, "-") == (0, "from stdin\n", "")


@pytest.mark.parametrize(
    ("text", "where"),
    [
        ("def f():\n  nothing_like_it()\nend\n", ":2:3: compile_error_name_not_found:nothing_like_it:"),
        ("def f():\n  x = [1]\n  textmsg(x[3])\nend\n", ":3:"),
    ],
)
def test_run_errors_name_file_and_line(
    run: Run, address: str, program: Callable[[str], str], text: str, where: str
) -> None:
    path = program(text)
    status, _, err = run("run", address, path)
    assert status == 1
    assert f"{path}{where}" in err


def test_run_stops_program_after_timeout(
    run: Run, controller: Controller, address: str, program: Callable[[str], str]
) -> None:
    status, _, err = run("run", address, program("while True:\n  sync()\nend\n"), "--timeout", "0.2")
    assert status == 1
    assert "did not end within 0.2 s, and was stopped" in err
    until(lambda: controller.program_name is None)


@pytest.mark.real_time
def test_ctrl_c_stops_program(
    spawn: Spawn, controller: Controller, address: str, program: Callable[[str], str]
) -> None:
    process = spawn("run", address, program('textmsg("begun")\nwhile True:\n  sync()\nend\n'))
    assert process.stdout is not None
    assert process.stdout.readline() == "begun\n"
    interrupt(process)
    assert process.wait(20) == 130
    until(lambda: controller.program_name is None)


def test_run_fails_for_missing_file(run: Run, address: str) -> None:
    status, _, err = run("run", address, "/nowhere/it.script")
    assert status == 1
    assert "cannot read /nowhere/it.script" in err


def test_run_fails_for_invalid_program(run: Run, address: str, program: Callable[[str], str]) -> None:
    status, _, err = run("run", address, program("def f():\n  sync()\n"))
    assert status == 1
    assert "end" in err
