"""Test that options of motions change the program that is sent."""

from __future__ import annotations

import contextlib
import inspect
import re
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

import urlink
from linkcore.errors import LinkError
from linkcore.handle import Lifecycle
from urlink.command.programs import Programs
from urlink.motion import Motions
from urlink.robot import Robot
from urlink.script.wrapping import Wrapped

pytestmark = pytest.mark.simulated_time

#: Name of a method -> its required arguments.
_REQUIRED: dict[str, tuple[Any, ...]] = {
    "force_mode": ("base", [0, 0, 1, 0, 0, 0], [0.0] * 6, [0.05] * 6),
}
#: Name of a method that is not a block -> options that make it short.
_SHORT: dict[str, dict[str, float]] = {"measure_payload_by_hand": {"rest": 0.1, "posture_timeout": 1.0}}
#: Methods that take `watchdog`.
_WATCHED = [
    (cls, name)
    for cls in (Motions, Robot)
    for name, method in sorted(inspect.getmembers(cls, inspect.isfunction))
    if not name.startswith("_") and "watchdog" in inspect.signature(method).parameters
]


@pytest.fixture
def sent(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Provide the texts of the sent programs, without names and numbers that differ between programs."""
    texts: list[str] = []
    start = Programs.start

    def noting(programs: Programs, text: Wrapped, life: Lifecycle, **how: Any) -> None:
        texts.append(re.sub(r"urlink_\w+|\b\d{4,}\b", "#", text.text))
        start(programs, text, life, **how)

    monkeypatch.setattr(Programs, "start", noting)
    return texts


def _robot() -> contextlib.AbstractContextManager[Robot]:
    return urlink.connect("sim://?firmware=10.12")


def _texts(sent: list[str], cls: type, name: str, watchdog: float) -> Iterator[str]:
    with _robot() as robot:
        q = robot.realtime.wait().q_target
        required = _REQUIRED.get(name, ())
        if name == "follow":
            required = (urlink.Trajectory.from_arrays([0.0, 0.5, 1.0], np.array([q] * 3)),)
        part = robot if cls is Robot else robot.motion
        sent.clear()
        with contextlib.suppress(LinkError), getattr(part, name)(*required, watchdog=watchdog, **_SHORT.get(name, {})):
            pass
    yield from sent


@pytest.mark.parametrize(("cls", "name"), _WATCHED, ids=lambda each: each if isinstance(each, str) else "")
def test_watchdog_option_changes_the_program(sent: list[str], cls: type, name: str) -> None:
    short, long = (list(_texts(sent, cls, name, seconds)) for seconds in (0.21, 0.43))
    assert short != long
