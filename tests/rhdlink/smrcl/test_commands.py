"""The table of commands: every row must be consistent with its function and the documentation."""

from __future__ import annotations

import inspect
import re
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

#: Annotations that the function of a row may have for a parameter of each kind.
TAKEN = {
    ParameterKind.NUMBER: {"float", "float | str"},
    ParameterKind.LENGTH: {"float"},
    ParameterKind.TEXT: {"str", "float | str"},
    ParameterKind.LABEL: {"str"},
    ParameterKind.NEW_NAME: {"str"},
    # Only the presence of the parameter matters, or it may have either kind.
    ParameterKind.ANY: {"object", "float", "float | str"},
}


@pytest.mark.parametrize("command", COMMANDS.values(), ids=COMMANDS)
def test_function_of_each_command_accepts_its_parameters(command: ScriptCommand) -> None:
    effects, *parameters = inspect.signature(command.execute).parameters.values()
    assert effects.annotation == "MissionEffects"
    declared = [each.annotation for each in parameters]
    if parameters and parameters[-1].kind is inspect.Parameter.VAR_POSITIONAL:
        *declared, further = declared
        declared += [further] * (len(command.kinds) - len(declared))
    assert [found for found, kind in zip(declared, command.kinds, strict=True) if found not in TAKEN[kind]] == []


def test_smrcl_page_documents_every_command() -> None:
    page = (ROOT / "docs" / "smrcl.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| (`.*?) \|", page, re.MULTILINE)
    named = {code.split()[0] for row in rows for code in re.findall(r"`([^`]+)`", row)}
    missing = sorted(COMMANDS.keys() - named)
    assert not missing, f"add a row to docs/smrcl.md for {', '.join(missing)}"


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
def test_script_command_rejects_a_function_with_other_parameters(options: dict[str, object]) -> None:
    assert ScriptCommand("one", one_text, (ParameterKind.TEXT,)).most == 1
    with pytest.raises(TypeError, match=r"^one takes .*, but its function does not: "):
        ScriptCommand("one", one_text, **options)  # type: ignore[arg-type]


def test_number_of_parameters_is_described_in_words() -> None:
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
def test_errors_in_commands_are_found_before_the_run(line: str, message: str) -> None:
    (mistake,) = Mission(f"{line}\nfwd 1\n").check()
    assert (mistake.line, mistake.column, mistake.message) == (1, 1, message)


def test_mrc_profile_accepts_large_numbers() -> None:
    assert Mission("fwd 1e7\nstop\n", compat="mrc").check() == []


def test_every_setting_and_route_sets_an_existing_attribute() -> None:
    """A misspelt path would set an attribute that no code reads."""
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
    """Return the names of the attributes of all objects that settings change."""
    return [set(vars(each)) for each in (vehicle, vehicle.odometry, vehicle.odometry.pose, vehicle.covariance)]
