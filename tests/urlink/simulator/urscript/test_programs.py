"""Small programs and the traces of their effects, cycle by cycle.

A program may begin with settings for the stand-in: `#! firmware 3.4` and `#! peer <port> <list of data to send>`.
A trace has a line for each request to the controller. Its last line is the end of the program, or the error if the
program does not compile. The traces are golden files (`tests/golden.py`).
"""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.fakes.world import NotedWorld, run
from tests.golden import check_golden
from urlink.simulator.urscript import ProgramError

FOLDER = Path(__file__).parent / "programs"
PROGRAMS = sorted(path.stem for path in FOLDER.glob("*.script"))


def trace(name: str) -> list[str]:
    text = (FOLDER / f"{name}.script").read_text(encoding="utf-8")
    settings = [line.split(maxsplit=3) for line in text.splitlines() if line.startswith("#! ")]
    firmware = next((words[2] for words in settings if words[1] == "firmware"), "5.11")
    world = NotedWorld(firmware)
    for words in settings:
        if words[1] == "peer":
            world.sockets.peers[int(words[2])] = eval(words[3], {})
    try:
        return run(text, world).notes
    except ProgramError as error:
        return [f"does not compile: {error}"]


@pytest.mark.parametrize("name", PROGRAMS)
def test_program_matches_its_trace(name: str) -> None:
    check_golden(FOLDER / f"{name}.trace", "\n".join(trace(name)) + "\n")


def test_every_trace_has_a_program() -> None:
    assert sorted(path.stem for path in FOLDER.glob("*.trace")) == PROGRAMS
    assert len(PROGRAMS) >= 50


def test_trace_is_reproducible() -> None:
    assert trace("big_driver") == trace("big_driver")
