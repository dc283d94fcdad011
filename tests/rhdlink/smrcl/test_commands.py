"""The table of commands: what each row promises, and what it takes to add one."""

from __future__ import annotations

import inspect
import json
import os
import re
import shutil
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

from rhdlink import Mission
from rhdlink.smrcl import control_functions, settings
from rhdlink.smrcl.commands import COMMANDS, MOST_PARAMETERS, ParameterKind, ScriptCommand
from rhdlink.smrcl.effects import MissionEffects
from rhdlink.smrcl.plan import Outcome
from rhdlink.smrcl.vehicle import Vehicle
from tests.rhdlink.smrcl.bench import Bench

ROOT = Path(__file__).resolve().parents[3]

#: What the function of a row may declare for a parameter of each kind.
TAKEN = {
    ParameterKind.NUMBER: {"float", "float | str"},
    ParameterKind.LENGTH: {"float"},
    ParameterKind.TEXT: {"str", "float | str"},
    ParameterKind.LABEL: {"str"},
    ParameterKind.NEW_NAME: {"str"},
    # A further parameter of which only its presence counts, or one of either kind.
    ParameterKind.ANY: {"object", "float", "float | str"},
}


@pytest.mark.parametrize("command", COMMANDS.values(), ids=COMMANDS)
def test_the_function_of_a_row_takes_the_kinds_of_its_parameters(command: ScriptCommand) -> None:
    effects, *parameters = inspect.signature(command.carry_out).parameters.values()
    assert effects.annotation == "MissionEffects"
    declared = [each.annotation for each in parameters]
    if parameters and parameters[-1].kind is inspect.Parameter.VAR_POSITIONAL:
        *declared, further = declared
        declared += [further] * (len(command.kinds) - len(declared))
    assert [found for found, kind in zip(declared, command.kinds, strict=True) if found not in TAKEN[kind]] == []


def test_the_page_has_every_command() -> None:
    page = (ROOT / "docs" / "smrcl.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| (`.*?) \|", page, re.MULTILINE)
    named = {code.split()[0] for row in rows for code in re.findall(r"`([^`]+)`", row)}
    assert COMMANDS.keys() <= named


def one_text(effects: MissionEffects, text: str) -> Outcome:
    return effects.at_once()


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"kinds": (ParameterKind.TEXT, ParameterKind.TEXT)},
        {"kinds": (ParameterKind.TEXT,), "optional": 1},
        {"kinds": (ParameterKind.TEXT,), "repeats": True},
    ],
)
def test_a_row_whose_function_does_not_take_its_parameters_is_refused(options: dict[str, object]) -> None:
    assert ScriptCommand("one", one_text, (ParameterKind.TEXT,)).most == 1
    with pytest.raises(TypeError, match=r"^one takes .*, and its function does not: "):
        ScriptCommand("one", one_text, **options)  # type: ignore[arg-type]


def test_the_count_of_parameters_in_words() -> None:
    assert [COMMANDS[name].count for name in ("stop", "fwd", "turn", "log")] == [
        "0 parameters",
        "1 parameter",
        "1 to 2 parameters",
        f"1 to {MOST_PARAMETERS} parameters",
    ]


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("fwd 1e7", "fwd: parameter 1 has to be a length or an angle of at most 1e+06, not 10000000.000000"),
        ("turnr 1 -1e7", "turnr: parameter 2 has to be a length or an angle of at most 1e+06, not -10000000.000000"),
        ("stop 1", "stop takes 0 parameters, not 1"),
        ('wait "a"', "wait: parameter 1 has to be a number or a variable, not a text"),
        ("goto 1", 'goto: parameter 1 has to be a text, as in "name"'),
        ('call "a"', 'there is no label "a"'),
        ('addwatch "a" 1', 'addwatch needs a condition, as in addwatch "name" 1 : ($odox > 1)'),
    ],
)
def test_a_mistake_in_a_command_is_found_before_the_script_runs(line: str, message: str) -> None:
    (mistake,) = Mission(f"{line}\nfwd 1\n").check()
    assert (mistake.line, mistake.column, mistake.message) == (1, 1, message)


def test_under_mrc_s_profile_a_number_is_no_mistake() -> None:
    assert Mission("fwd 1e7\nstop\n", compat="mrc").check() == []


def test_what_settings_and_routes_set_is_there() -> None:
    """A path that is misspelt would set an attribute that nothing reads."""
    vehicle = Bench().controller.vehicle
    before = attributes(vehicle)
    effects = Bench(profile="mrc").controller.effects
    for setting in settings._SETTINGS.values():
        setting(effects, 1.0)
    assert attributes(effects.vehicle) == before
    for module, function, name in control_functions._INPUTS:
        assert vehicle.functions.route_input(module, function, name, 0)
    for owner, attribute, _ in (*vehicle.functions._sensed.values(), *vehicle.functions._acted.values()):
        assert isinstance(getattr(owner, attribute), float), attribute
    for attribute in control_functions._PARAMETERS.values():
        assert isinstance(getattr(vehicle.control.parameters, attribute), float), attribute


def attributes(vehicle: Vehicle) -> list[set[str]]:
    """The names of what settings set, and of what stands beside it."""
    return [set(vars(each)) for each in (vehicle, vehicle.odometry, vehicle.odometry.pose, vehicle.covariance)]


# -- adding one ------------------------------------------------------------------------------------------------


def steps() -> list[str]:
    """The code of the steps in CONTRIBUTING: a function, and a row."""
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    section = text.partition("## Adding a command of SMR-CL\n")[2].partition("\n## ")[0]
    return [
        textwrap.dedent(code) for code in re.findall(r"^ *```python\n(.*?)^ *```$", section, re.MULTILINE | re.DOTALL)
    ]


#: Prints what a script with the new command does, or why it cannot.
SCRIPT = """
import json
from rhdlink.smrcl.mission import Mission
from rhdlink.host.plugins.turtle import Turtle
mistakes = [str(each) for each in Mission('speed "a"\\nspeed 1 2\\nspeed = 1\\n').check()]
run = Mission("speed 0.125\\nwait 0.1\\n", Turtle()).run()
print(json.dumps([mistakes, run._execution.controller.vehicle.control.speed]))
"""


@pytest.mark.slow
@pytest.mark.real_time
def test_a_command_is_added_by_the_steps_that_the_page_gives(tmp_path: Path) -> None:
    function, row = steps()
    for package in ("rhdlink", "linkcore"):
        shutil.copytree(ROOT / "src" / package, tmp_path / package, ignore=shutil.ignore_patterns("__pycache__"))
    table, module = (tmp_path / "rhdlink" / "smrcl" / name for name in ("commands.py", "driving.py"))

    def run() -> subprocess.CompletedProcess[str]:
        environment = {**os.environ, "PYTHONPATH": str(tmp_path), "PYTHONDONTWRITEBYTECODE": "1"}
        return subprocess.run(
            [sys.executable, "-c", SCRIPT], env=environment, capture_output=True, text=True, check=False, timeout=60.0
        )

    before = table.read_text(encoding="utf-8")
    assert before.count("_TABLE = (\n") == 1
    table.write_text(before.replace("_TABLE = (\n", f"_TABLE = (\n    {row}"), encoding="utf-8")
    # Without its function the table cannot be imported.
    assert "has no attribute 'set_speed'" in run().stderr
    with module.open("a", encoding="utf-8") as file:
        file.write(f"\n\n{function}")
    done = run()
    assert done.returncode == 0, done.stderr
    mistakes, speed = json.loads(done.stdout)
    assert speed == 0.125
    assert [text.partition(": ")[2] for text in mistakes] == [
        "speed: parameter 1 has to be a number or a variable, not a text",
        "speed takes 1 parameter, not 2",
        "expected the end of the line after the parameters, found '='",
    ]
