"""Find the name under which the API reference documents a name in a docstring or on a page."""

from __future__ import annotations

import contextlib
import importlib
import inspect
import re
import sys
import types
import typing
from collections.abc import Iterable, Iterator
from typing import Any

import signatures

#: What a variable of the examples is.
_VARIABLES = {
    False: {"robot": "urlink.Robot", "motion": "urlink.Motion", "state": "urlink.RealtimeState"},
    True: {"robot": "rhdlink.Variables", "host": "rhdlink.Host", "mission": "rhdlink.Mission"},
}

#: Kinds of objects that have one documented name.
_UNIQUE = (type, types.FunctionType)


class Names:
    """Names that the API reference documents, with the objects that they name.

    Args:
        documented: Full names, for example `urlink.motion.Motions.stop`.
    """

    def __init__(self, documented: Iterable[str]) -> None:
        self._documented = frozenset(documented)
        #: Object -> name under which it is documented.
        self._by_object: dict[object, str] = {}
        #: Last part of a name -> full names, except members of classes.
        self._by_name: dict[str, list[str]] = {}
        for name in sorted(self._documented, key=lambda name: (name.count("."), name)):
            owner, _, last = name.rpartition(".")
            found = _imported(name)
            if found is None or owner in self._documented:
                continue
            if isinstance(found, _UNIQUE):
                self._by_object.setdefault(found, name)
            self._by_name.setdefault(last, []).append(name)

    def of_object(self, found: Any) -> str | None:
        """Name under which an object is documented, if it is."""
        return self._by_object.get(found) if isinstance(found, _UNIQUE) else None

    def in_docstring(self, text: str, module: str | None, owner: str | None) -> str | None:
        """Name that a docstring means.

        Args:
            text: Name in the docstring.
            module: Public module of the documented object.
            owner: Class of the documented object, within the module.
        """
        cls = _imported(f"{module}.{owner}") if module and owner else None
        parts = text.split(".")
        if isinstance(cls, type):
            found = self._member(cls, parts)
            if found is not None and (len(parts) > 1 or found != self.of_object(cls)):
                return found
            scope = vars(sys.modules[cls.__module__]).get(parts[0])
            found = None if scope is None else self._within(scope, parts[1:])
            if found is not None:
                return found
        return self.public(text, bool(module and module.startswith("rhdlink")))

    def public(self, text: str, is_rhdlink: bool) -> str | None:
        """Name that a text means anywhere: a full name, a public name, or one that starts at a variable."""
        if text in self._documented:
            return text
        first, *rest = text.split(".")
        if rest and first in _VARIABLES[is_rhdlink]:
            return self._within(_imported(_VARIABLES[is_rhdlink][first]), rest)
        if rest and re.fullmatch(r"linkcore|rhdlink|urlink\w*", first):
            owner, _, last = text.rpartition(".")
            return self.of_object(_imported(text)) or self._within(_imported(owner), [last])
        # The errors and the streams are the same in both libraries. The packages have names of other libraries.
        for package in ("rhdlink" if is_rhdlink else "urlink", "linkcore", "urlink", ""):
            candidates = [name for name in self._by_name.get(first, ()) if package in ("", name.partition(".")[0])]
            objects = {id(_imported(name)): name for name in reversed(candidates)}
            if len(objects) == 1:
                (name,) = objects.values()
                return self._within(_imported(name), rest) if rest else name
            if objects:
                return None
        return None

    def _within(self, found: Any, parts: list[str]) -> str | None:
        """Name of a member of an object."""
        if not parts:
            return self.of_object(found)
        if isinstance(found, type):
            return self._member(found, parts)
        if isinstance(found, types.ModuleType):
            return self._within(getattr(found, parts[0], None), parts[1:])
        return None

    def _member(self, cls: type, parts: list[str]) -> str | None:
        """Name of a member of a class, or of a member of the member's type."""
        first, *rest = parts
        if rest:
            kind = _type_of(cls, first)
            return None if kind is None else self._member(kind, rest)
        for base in cls.__mro__:
            name = f"{self.of_object(base)}.{first}"
            if name in self._documented:
                return name
        # The fields of a packet are described with their class.
        return self.of_object(cls) if _has(cls, first) else None


def _has(cls: type, name: str) -> bool:
    return inspect.getattr_static(cls, name, None) is not None or any(
        name in vars(base).get("__annotations__", ()) for base in cls.__mro__
    )


def _imported(name: str) -> Any:
    """Object of a full name; None if there is none."""
    parts = name.split(".")
    for count in range(len(parts), 0, -1):
        try:
            found: Any = importlib.import_module(".".join(parts[:count]))
        except ImportError:
            continue
        for part in parts[count:]:
            found = getattr(found, part, None)
        return found
    return None


def _type_of(cls: type, name: str) -> type | None:
    """Class of the object that an attribute of a class is, according to its annotation."""
    member = inspect.getattr_static(cls, name, None)
    getter = getattr(member, "fget", None) or getattr(member, "func", None)
    annotation: Any = None
    if getter is not None:
        with contextlib.suppress(AttributeError, KeyError):
            annotation = signatures.types_of(getter).get("return")
    else:
        with contextlib.suppress(Exception):
            annotation = typing.get_type_hints(cls).get(name)
    return next(_classes(annotation), None)


def _classes(annotation: Any) -> Iterator[type]:
    """Yield the classes of a union or of a generic type."""
    if typing.get_origin(annotation) in (typing.Union, types.UnionType):
        for each in typing.get_args(annotation):
            yield from _classes(each)
    else:
        found = typing.get_origin(annotation) or annotation
        if isinstance(found, type) and found is not types.NoneType:
            yield found
