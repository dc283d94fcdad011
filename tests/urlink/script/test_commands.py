"""Text of every command for one firmware of each kind, compared with reviewed files (`tests/golden.py`)."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from linkcore.errors import BadValue
from tests.golden import check_golden
from urlink.protocol.firmware import Firmware
from urlink.script import commands

GOLDEN = Path(__file__).parent / "golden"
FIRMWARES = ("1.8", "3.1", "3.4", "5.0", "5.11")

CASES: dict[str, Callable[[Firmware], str]] = {
    **{
        f"{bank.name} digital_out {number}": lambda fw, bank=bank, number=number: commands.digital_out(  # type: ignore[misc]
            fw, bank, number, number % 2 == 0
        )
        for bank in (commands.STANDARD, commands.CONFIGURABLE, commands.TOOL)
        for number in range(bank.size)
    },
    "analog_out 0": lambda fw: commands.analog_out(fw, 0, 0.25),
    "analog_out 1": lambda fw: commands.analog_out(fw, 1, 1),
    "tool_voltage": lambda fw: commands.tool_voltage(24),
    "flag": lambda fw: commands.flag(31, True),
    "payload mass": lambda fw: commands.payload(fw, 1.5),
    "payload cog": lambda fw: commands.payload(fw, 1.5, np.array([0.0, 0.01, 0.1])),  # type: ignore[arg-type]
    "payload inertia": lambda fw: commands.payload(fw, 1.5, (0, 0.01, 0.1), (0.1, 0.1, 0.1, 0, 0, -1e-9)),
    "tcp": lambda fw: commands.tcp((0, 0, 0.1234567891, 0, 1 / 3, 0)),
    "speed_slider": lambda fw: commands.speed_slider(0.42),
    "popup": lambda fw: commands.popup("Prêt: 100 % #1", "urlink", True, False),
    "secondary": lambda fw: commands.secondary(commands.flag(0, False), commands.tool_voltage(0)),
}


def table(firmware: str) -> str:
    lines = []
    for name, build in CASES.items():
        try:
            text = build(Firmware.parse(firmware))
        except BadValue as error:
            text = f"refused: {error}"
        lines += [f"-- {name}", text.rstrip("\n")]
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize("firmware", FIRMWARES)
def test_commands_equal_golden_files(firmware: str) -> None:
    check_golden(GOLDEN / f"commands_{firmware}.txt", table(firmware))


NEW = Firmware(5, 11)


@pytest.mark.parametrize(
    ("build", "match"),
    [
        (lambda: commands.digital_out(NEW, commands.STANDARD, 8, True), "0 to 7"),
        (lambda: commands.digital_out(NEW, commands.TOOL, -1, True), "tool digital output is -1.*0 to 1"),
        (lambda: commands.digital_out(NEW, commands.STANDARD, 1.0, True), "whole number"),  # type: ignore[arg-type]
        (lambda: commands.digital_out(NEW, commands.STANDARD, True, True), "whole number"),
        (lambda: commands.digital_out(NEW, commands.STANDARD, 0, 1), "True or False"),  # type: ignore[arg-type]
        (lambda: commands.analog_out(NEW, 2, 0.5), "0 to 1"),
        (lambda: commands.analog_out(NEW, 0, 1.001), "0 to 1"),
        (lambda: commands.analog_out(NEW, 0, float("nan")), "finite"),
        (lambda: commands.tool_voltage(5), "0, 12 or 24"),
        (lambda: commands.tool_voltage(True), "0, 12 or 24"),
        (lambda: commands.flag(32, True), "0 to 31"),
        (lambda: commands.payload(NEW, -0.1), "payload mass"),
        (lambda: commands.payload(NEW, 1500), "payload mass"),
        (lambda: commands.payload(NEW, 1, (0, 0)), "payload cog has 2 values; expected 3"),
        (lambda: commands.payload(NEW, 1, None, (1,) * 5), "payload inertia"),
        (lambda: commands.tcp((0, 0, 0)), "3 values; expected 6"),
        (lambda: commands.tcp("abcdef"), "expected 6 numbers"),  # type: ignore[arg-type]
        (lambda: commands.speed_slider(1.5), "0 to 1"),
        (lambda: commands.speed_slider("0.5"), "expected a number"),  # type: ignore[arg-type]
        (lambda: commands.popup('a"b', "t", False, False), "contain quotes"),
        (lambda: commands.popup("a", "t\n", False, False), "title contains"),
        (lambda: commands.popup("a", "t", 1, False), "True or False"),  # type: ignore[arg-type]
    ],
)
def test_commands_reject_invalid_arguments(build: Callable[[], str], match: str) -> None:
    with pytest.raises(BadValue, match=match):
        build()
