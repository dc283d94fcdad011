"""The words of the public surface: an argument has the name, the kind and the default of its like everywhere.

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

#: What some libraries call it, and what it is called here.
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
    """One argument of a public function."""

    of: str
    name: str
    is_keyword_only: bool
    default: Any
    type: str

    def __str__(self) -> str:
        return f"{self.of}({self.name}=)"


def functions() -> Iterator[tuple[str, Callable[..., Any]]]:
    """The public functions and methods, and what makes objects."""
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
        except (TypeError, ValueError):  # what is no function, such as an alias of types
            continue
        for each in signature.parameters.values():
            yield Argument(of, each.name, each.kind is each.KEYWORD_ONLY, each.default, str(each.annotation))


FOUND = list(arguments())


def called(name: str) -> list[Argument]:
    """The arguments of that name, of which there are some: or the rule would hold nothing."""
    found = [each for each in FOUND if each.name == name]
    assert found
    return found


def wrong(found: list[Argument], is_right: Callable[[Argument], bool]) -> list[str]:
    return [str(each) for each in found if not is_right(each)]


def test_other_words_are_not_used() -> None:
    assert {str(each): WORDS[each.name] for each in FOUND if each.name in WORDS} == {}


def test_wait_is_named_and_takes_seconds_too() -> None:
    assert wrong(called("wait"), lambda each: each.is_keyword_only and isinstance(each.default, bool)) == []
    assert wrong(called("wait"), lambda each: each.type == "bool | float") == []


def test_timeout_is_in_seconds_and_named_where_something_is_made() -> None:
    def is_right(each: Argument) -> bool:
        makes = re.search(r"\.connect(_async)?$|(Dashboard|Gripper)\.__init__$", each.of)
        return each.type in ("float", "float | None") and (each.is_keyword_only or not makes)

    assert wrong(called("timeout"), is_right) == []


def test_time_is_how_long_a_movement_takes_and_duration_how_long_something_goes_on() -> None:
    moves = [each for each in called("time") if ".move_" in each.of]
    assert wrong(moves, lambda each: each.is_keyword_only and each.default is None) == []
    assert wrong(called("duration"), lambda each: isinstance(each.default, float)) == []
    assert not [str(each) for each in called("duration") if ".move_" in each.of]


def test_an_address_names_a_robot_or_where_a_server_listens_and_a_host_has_a_port() -> None:
    with_port = {each.of for each in called("port")}
    assert wrong(called("host"), lambda each: each.of in with_port) == []
    for place in ("urlink.connect", "urlink.connect_async", "rhdlink.connect", "rhdlink.connect_async"):
        first = next(each for each in FOUND if each.of == place)
        assert (first.name, first.is_keyword_only) == ("address", False)


@pytest.mark.parametrize("place", PLACES)
def test_what_is_known_here_of_is_or_has_is_a_property(place: str) -> None:
    """What a controller is asked is a method."""
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
