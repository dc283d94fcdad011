"""Classes of the objects that users get: public names, and the results of their methods and properties."""

from __future__ import annotations

import collections.abc
import importlib
import inspect
import pkgutil
import sys
import typing
from collections.abc import Iterator, Mapping
from functools import cache
from typing import Any

_PACKAGES = ("linkcore", "urlink", "rhdlink")
#: Modules whose public names users import.
_PLACES = (
    "urlink",
    "urlink.aio.parts",
    "urlink.arm.kinematics",
    "urlink.motion",
    "urlink.packets",
    "urlink.rtde",
    "rhdlink",
    "rhdlink.host",
    "rhdlink.robots",
    "rhdlink.smrcl",
    "rhdlink.variables",
)


def _is_ours(value: Any) -> bool:
    return isinstance(value, type) and value.__module__.partition(".")[0] in _PACKAGES


@cache
def public_classes() -> Mapping[type, str]:
    """Map each class to the place where it was found first, such as "urlink" or "Robot.motion"."""
    for package in _PACKAGES:
        for module in pkgutil.walk_packages(importlib.import_module(package).__path__, f"{package}."):
            # Import all modules, because annotations name classes that are otherwise imported for type checkers only.
            if not module.name.endswith("__main__"):
                importlib.import_module(module.name)
    found: dict[type, str] = {}
    waiting: list[tuple[Any, str]] = []
    for place in _PLACES:
        names = vars(importlib.import_module(place)).get("__all__", ())
        waiting += [(getattr(sys.modules[place], name), f"{place}.{name}") for name in names]
    while waiting:
        value, place = waiting.pop(0)
        if inspect.isfunction(value):
            waiting += [(kind, place) for kind in _returned(value)]
        elif _is_ours(value) and value not in found:
            found[value] = place
            for name in dir(value):
                if not name.startswith("_"):
                    waiting += [(each, f"{value.__name__}.{name}") for each in _functions(value, name)]
    return found


def _functions(kind: type, name: str) -> Iterator[Any]:
    value = inspect.getattr_static(kind, name)
    for part in (value, *(getattr(value, each, None) for each in ("__func__", "fget", "func"))):
        if inspect.isfunction(part):
            yield part


@cache
def _all_names() -> dict[str, Any]:
    names: dict[str, Any] = {}
    for module in list(sys.modules.values()):
        if getattr(module, "__name__", "").partition(".")[0] in _PACKAGES:
            for name, value in vars(module).items():
                if isinstance(value, type) or typing.get_origin(value) is not None:
                    names.setdefault(name, value)
    return {**vars(typing), **{name: getattr(collections.abc, name) for name in collections.abc.__all__}, **names}


def _returned(function: Any) -> Iterator[type]:
    """Yield the classes of this project that are named in the annotation of the result."""
    function = inspect.unwrap(function)
    result = function.__annotations__.get("return")
    if isinstance(result, str):
        try:
            result = eval(result, {**_all_names(), **function.__globals__})
        except NameError:
            return  # a class of another library
    yield from _named(result)


def _named(annotation: Any) -> Iterator[type]:
    for each in (annotation, typing.get_origin(annotation)):
        if _is_ours(each):
            yield each
    for argument in typing.get_args(annotation):
        for each in argument if isinstance(argument, list) else [argument]:
            yield from _named(each)
