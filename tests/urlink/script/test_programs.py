"""Programs that move an arm, compared word by word for each firmware (`tests/golden.py`)."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from linkcore.errors import BadValue
from tests.golden import check_golden
from urlink.protocol.firmware import Firmware
from urlink.script import commands, waypoints
from urlink.script.links import ReverseSocket
from urlink.script.streaming import streaming

#: Joint speeds in rad/s, which belong to no real arm.
SPEEDS = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]
GOLDEN = Path(__file__).parent / "golden"

PROGRAMS: dict[str, Callable[[Firmware], list[str]]] = {
    "move_joints": lambda firmware: commands.move_joints([0, -1.5, 0.25, 0, 1e-12, 3], 1.05, 1.4),
    "move_linear": lambda firmware: commands.move_linear([0.1, -0.2, 0.3, 0, 3.14, 0], 0.25, 1.2, 4),
    "speed_joints": lambda firmware: commands.speed_joints(firmware, [0.1, 0, 0, 0, 0, -0.5], 1.4, 0.5),
    "speed_linear": lambda firmware: commands.speed_linear(firmware, [0.1, 0, 0, 0, 0, -0.5], 1.2, 0.5),
    "stop": lambda firmware: commands.stop(2),
    "streaming": lambda firmware: streaming(firmware, ReverseSocket("192.168.56.1", 50001, 123456789), speeds=SPEEDS),
}
WAYPOINTS: dict[str, Callable[[Firmware], list[str]]] = {
    "waypoints_cubic": lambda firmware: waypoints.interpolating(
        firmware, "192.168.56.1", 50001, 123456789, is_quintic=False
    ),
    "waypoints_quintic": lambda firmware: waypoints.interpolating(
        firmware, "192.168.56.1", 50001, 123456789, is_quintic=True
    ),
}
#: Firmware versions whose texts differ from each other.
CASES = [(version, name) for version in ("1.8", "3.1", "3.4", "5.11") for name in PROGRAMS] + [
    (version, name) for version in ("3.4", "5.11") for name in WAYPOINTS
]


@pytest.mark.parametrize(("version", "name"), CASES)
def test_programs_equal_golden_files(version: str, name: str) -> None:
    text = "\n".join((PROGRAMS | WAYPOINTS)[name](Firmware.parse(version))) + "\n"
    check_golden(GOLDEN / f"{name}_{version}.script", text)


@pytest.mark.parametrize(("version", "name"), CASES)
def test_program_blocks_are_closed_and_indented(version: str, name: str) -> None:
    depth = 0
    for line in (PROGRAMS | WAYPOINTS)[name](Firmware.parse(version)):
        word = line.split()[0].rstrip(":")
        if word in ("end", "else", "elif"):
            depth -= 1
        assert (len(line) - len(line.lstrip())) == 2 * depth, line
        if word in ("if", "while", "def", "thread", "else", "elif"):
            depth += 1
    assert depth == 0


def test_programs_for_cb2_use_only_its_functions() -> None:
    for name, program in PROGRAMS.items():
        text = "\n".join(program(Firmware.parse("1.8")))
        for word in ("lookahead", "gain", "timeout", "global", "local", "to_str", "str_cat"):
            assert word not in text, name


@pytest.mark.parametrize("version", ["3.1", "3.2", "3.2.19171"])
def test_speed_joints_without_time_argument_sleeps(version: str) -> None:
    assert commands.speed_joints(Firmware.parse(version), [0] * 6, 1, 2) == [
        "speedj([0.0, 0.0, 0.0, 0.0, 0.0, 0.0], 1.0)",
        "sleep(2.0)",
        "stopj(1.0)",
    ]


def test_watchdog_counts_cycles() -> None:
    assert "elif missed < 50:" in "\n".join(
        streaming(Firmware(5, 11), ReverseSocket("h", 1, 0), speeds=SPEEDS, watchdog=0.1)
    )
    assert "elif missed < 13:" in "\n".join(
        streaming(Firmware(3, 4), ReverseSocket("h", 1, 0), speeds=SPEEDS, watchdog=0.1)
    )
    assert "elif missed < 2:" in "\n".join(
        streaming(Firmware(3, 4), ReverseSocket("h", 1, 0), speeds=SPEEDS, watchdog=0.001)
    )


@pytest.mark.parametrize(
    "call",
    [
        lambda: commands.move_joints([0] * 5, 1, 1),
        lambda: commands.move_linear([float("nan")] * 6, 1, 1),
        lambda: streaming(Firmware(5, 11), ReverseSocket('h"', 1, 0), speeds=SPEEDS),
        lambda: streaming(Firmware(5, 11), ReverseSocket("h", 0, 0), speeds=SPEEDS),
        lambda: streaming(Firmware(5, 11), ReverseSocket("h", 1, 1 << 31), speeds=SPEEDS),
        lambda: streaming(Firmware(5, 11), ReverseSocket("h", 1, 0), speeds=SPEEDS, gain=5000),
        lambda: waypoints.interpolating(Firmware(5, 11), "h", 1, 0, is_quintic=True, lookahead_time=0.001),
    ],
)
def test_programs_reject_invalid_arguments(call: Callable[[], object]) -> None:
    with pytest.raises(BadValue):
        call()
