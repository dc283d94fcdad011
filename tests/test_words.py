"""Names of public arguments: arguments with the same meaning have the same name, kind and default everywhere.

CONTRIBUTING.md, section "Names of arguments", has the table that these tests check.
"""

from __future__ import annotations

import importlib
import inspect
import re
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import pytest

PLACES = ("urlink", "urlink.motion", "urlink.rtde", "rhdlink", "rhdlink.host", "rhdlink.smrcl", "rhdlink.variables")

#: Names of arguments in other libraries, and the names in this project.
WORDS = {
    "blocking": "wait",
    "block": "wait",
    "async_": "wait",
    "hostname": "address or host",
    "ip": "address or host",
    "addr": "address",
    "freq": "frequency",
    "hz": "frequency or rate",
    "secs": "timeout, time, duration or seconds",
    "time_out": "timeout",
    "vel": "speed",
    "velocity": "speed",
    "acc": "acceleration",
    "declared": "variables",
    "filename": "path",
    "func": "function",
    "cb": "callback",
}


class Argument(NamedTuple):
    """Argument of a public function."""

    of: str
    name: str
    is_keyword_only: bool
    default: Any
    type: str

    def __str__(self) -> str:
        return f"{self.of}({self.name}=)"


def functions() -> Iterator[tuple[str, Callable[..., Any]]]:
    """Yield the public functions, methods and constructors with their names."""
    for place in PLACES:
        module = importlib.import_module(place)
        for name in vars(module)["__all__"]:
            found = getattr(module, name)
            if not inspect.isclass(found):
                yield f"{place}.{name}", found
                continue
            for attribute, value in inspect.getmembers(found, inspect.isfunction):
                if attribute == "__init__" or not attribute.startswith("_"):
                    yield f"{place}.{name}.{attribute}", value


def arguments() -> Iterator[Argument]:
    for of, function in functions():
        try:
            signature = inspect.signature(function)
        except (TypeError, ValueError):  # not a function, for example an alias of types
            continue
        for each in signature.parameters.values():
            yield Argument(of, each.name, each.kind is each.KEYWORD_ONLY, each.default, str(each.annotation))


FOUND = list(arguments())


def called(name: str) -> list[Argument]:
    """Return the arguments with this name; fail if there are none, because the rule would check nothing."""
    found = [each for each in FOUND if each.name == name]
    assert found
    return found


def wrong(found: list[Argument], is_right: Callable[[Argument], bool]) -> list[str]:
    return [str(each) for each in found if not is_right(each)]


def test_arguments_do_not_use_other_words() -> None:
    assert {str(each): WORDS[each.name] for each in FOUND if each.name in WORDS} == {}


def test_wait_is_keyword_only_and_accepts_seconds() -> None:
    assert wrong(called("wait"), lambda each: each.is_keyword_only and isinstance(each.default, bool)) == []
    assert wrong(called("wait"), lambda each: each.type == "bool | float") == []


def test_timeout_is_in_seconds_and_keyword_only_in_constructors() -> None:
    def is_right(each: Argument) -> bool:
        makes = re.search(r"\.connect(_async)?$|(Dashboard|Gripper)\.__init__$", each.of)
        return each.type in ("float", "float | None") and (each.is_keyword_only or not makes)

    assert wrong(called("timeout"), is_right) == []


def test_time_is_for_moves_and_duration_for_other_calls() -> None:
    moves = [each for each in called("time") if ".move_" in each.of]
    assert wrong(moves, lambda each: each.is_keyword_only and each.default is None) == []
    assert wrong(called("duration"), lambda each: isinstance(each.default, float)) == []
    assert not [str(each) for each in called("duration") if ".move_" in each.of]


def test_connect_takes_an_address_and_host_needs_a_port() -> None:
    with_port = {each.of for each in called("port")}
    assert wrong(called("host"), lambda each: each.of in with_port) == []
    for place in ("urlink.connect", "urlink.connect_async", "rhdlink.connect", "rhdlink.connect_async"):
        first = next(each for each in FOUND if each.of == place)
        assert (first.name, first.is_keyword_only) == ("address", False)


@pytest.mark.parametrize("place", PLACES)
def test_names_with_is_or_has_are_properties(place: str) -> None:
    """Names starting with `is_` or `has_` are properties; only `Dashboard` asks the controller with methods."""
    module = importlib.import_module(place)
    public = [getattr(module, name) for name in vars(module)["__all__"] if name != "Dashboard"]
    classes = [found for found in public if inspect.isclass(found)]
    methods = [
        f"{each.__name__}.{name}"
        for each in classes
        for name, value in inspect.getmembers(each, inspect.isfunction)
        if name.startswith(("is_", "has_")) and len(inspect.signature(value).parameters) == 1
    ]
    assert methods == []
