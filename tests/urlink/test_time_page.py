"""The tables in docs/timeouts.md and docs/speed-scaling.md match the code."""

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
#: What is no part of the way to a robot.
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
    """The numbers of modules whose names say that they are time-outs."""
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


def test_every_time_out_is_on_the_page_with_its_value() -> None:
    shown = listed()
    wanted = arguments() | constants()
    assert {name: shown.get(name) for name in wanted} == wanted
    for name, seconds in shown.items():
        if name not in wanted:  # others whose names say less
            module, _, constant = name.rpartition(".")
            assert getattr(importlib.import_module(module), constant) == seconds, name


def in_order(name: str) -> int:
    """Where a motion is in the table: in the order of the methods, `freedrive` of the robot last."""
    method = name.partition(",")[0]
    names = [each for each in vars(Motions) if each[0] != "_"]
    return names.index(method) if method in names else len(names)


def test_what_the_slider_does_to_each_motion_is_on_the_page() -> None:
    rows = [
        f"| `{name}` | {EFFECTS[name][1].half} | {EFFECTS[name][1].zero} |" for name in sorted(EFFECTS, key=in_order)
    ]
    table = "\n".join(["| Motion | slider at 50 % | at 0 |", "| --- | --- | --- |", *rows])
    assert f"\n\n{table}\n\n" in SCALING.read_text(), f"put this table into {SCALING.relative_to(ROOT)}:\n{table}"


def test_each_class_of_motions_states_what_the_slider_does_to_it() -> None:
    waiting, silent = [Motion], set()
    stated = {kind for kind, _ in EFFECTS.values()}
    while waiting:
        kind = waiting.pop()
        waiting += kind.__subclasses__()
        if kind.__module__.startswith("urlink.") and kind not in stated:
            silent.add(kind)
    # The first is the base class of blocks; the motions of groups are made of others.
    silent -= {BlockMotion, GroupMotion, GroupStream}
    assert not silent, f"decorate with @slider of urlink.motion.slider: {[str(kind) for kind in silent]}"
