"""Tests that the tables in docs/timeouts.md and docs/speed-scaling.md match the code."""

from __future__ import annotations

import ast
import importlib
import inspect
import re
from collections.abc import Callable
from pathlib import Path

import urlink
from linkcore.handle import Motion
from urlink.motion.motions import Motions
from urlink.motion.servo.block_motion import BlockMotion
from urlink.motion.slider import EFFECTS
from urlink.motion.stream.group_motion import GroupMotion, GroupStream
from urlink.robot import Robot

ROOT = Path(__file__).parents[2]
TIMEOUTS = ROOT / "docs" / "timeouts.md"
SCALING = ROOT / "docs" / "speed-scaling.md"
#: Packages that are not used to reach a robot.
ELSEWHERE = ("simulator", "cli", "data")
CALLS: dict[str, Callable[..., object]] = {
    "urlink.connect": urlink.connect,
    "robot.freedrive": Robot.freedrive,
    **{
        f"robot.motion.{name}": getattr(Motions, name)
        for name in ("follow", "servo", "jog", "stream", "force_mode", "torque", "impedance")
    },
}
ARGUMENTS = ("timeout", "silence", "stale_after", "start_timeout", "watchdog", "goal_time")


def listed() -> dict[str, float]:
    found = re.findall(r"^\| `([A-Za-z_.]+(?:\([a-z_]+=\))?)` \| ([0-9.]+) \|", TIMEOUTS.read_text(), re.MULTILINE)
    return {name: float(seconds) for name, seconds in found if "." in name}


def arguments() -> dict[str, float]:
    values = {}
    for call, function in CALLS.items():
        for name, parameter in inspect.signature(function).parameters.items():
            if name in ARGUMENTS:
                values[f"{call}({name}=)"] = parameter.default
    return values


def constants() -> dict[str, float]:
    """Return the constants of all modules with the name of a timeout."""
    values = {}
    for path in sorted((ROOT / "src" / "urlink").rglob("*.py")):
        parts = path.relative_to(ROOT / "src").with_suffix("").parts
        if parts[1] in ELSEWHERE:
            continue
        for node in ast.parse(path.read_text()).body:
            if not isinstance(node, ast.Assign):
                continue
            names = [each.id for each in ast.walk(node) if isinstance(each, ast.Name)]
            for name in names:
                if re.search("TIMEOUT|SILENCE|WATCHDOG|STALE", name):
                    value = getattr(importlib.import_module(".".join(parts)), name)
                    values[".".join((*parts, name))] = value
    return values


def test_page_lists_every_timeout_with_its_value() -> None:
    shown = listed()
    wanted = arguments() | constants()
    assert {name: shown.get(name) for name in wanted} == wanted
    for name, seconds in shown.items():
        if name not in wanted:  # constants without TIMEOUT or similar in their name
            module, _, constant = name.rpartition(".")
            assert getattr(importlib.import_module(module), constant) == seconds, name


def in_order(name: str) -> int:
    """Return the position of a motion in the table: in the order of the methods, with `freedrive` of the robot last."""
    method = name.partition(",")[0]
    names = [each for each in vars(Motions) if each[0] != "_"]
    return names.index(method) if method in names else len(names)


def test_page_lists_the_slider_effect_on_each_motion() -> None:
    rows = [
        f"| `{name}` | {EFFECTS[name][1].half} | {EFFECTS[name][1].zero} |" for name in sorted(EFFECTS, key=in_order)
    ]
    table = "\n".join(["| Motion | slider at 50 % | at 0 |", "| --- | --- | --- |", *rows])
    assert f"\n\n{table}\n\n" in SCALING.read_text(), f"put this table into {SCALING.relative_to(ROOT)}:\n{table}"


def test_motion_classes_state_the_slider_effect() -> None:
    waiting, silent = [Motion], set()
    stated = {kind for kind, _ in EFFECTS.values()}
    while waiting:
        kind = waiting.pop()
        waiting += kind.__subclasses__()
        if kind.__module__.startswith("urlink.") and kind not in stated:
            silent.add(kind)
    # `BlockMotion` is the base class of blocks, and motions of groups consist of other motions.
    silent -= {BlockMotion, GroupMotion, GroupStream}
    assert not silent, f"decorate with @slider of urlink.motion.slider: {[str(kind) for kind in silent]}"
