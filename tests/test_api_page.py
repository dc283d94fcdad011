"""The API pages document the constructor of a class only if users call it."""

from __future__ import annotations

import importlib
import inspect
import re
import typing
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

PAGES = sorted((Path(__file__).resolve().parents[1] / "docs" / "api").glob("*.md"))
PAGE = "\n".join(page.read_text(encoding="utf-8") for page in PAGES)
BLOCKS = re.findall(r"^\.\. autoclass:: (\S+)\n((?:   .*\n)*)", PAGE, re.MULTILINE)


def found(name: str) -> Any:
    """Return the object with a dotted name."""
    module, _, attribute = name.rpartition(".")
    return getattr(importlib.import_module(module), attribute)


SHOWN = {found(name) for name, _ in BLOCKS}
#: Classes for which the page shows the arguments of the constructor.
MADE_BY_USERS = [name for name, options in BLOCKS if not re.search(r":exclude-members:.*\b__init__\b", options)]


def parts(hint: Any) -> Iterator[Any]:
    """Yield the parts of an annotation, including all classes."""
    yield hint
    for each in typing.get_args(hint):
        yield from parts(each)


def internals(cls: Any) -> set[str]:
    """Return the names of our classes in annotations of the arguments that the page does not show."""
    makers = [vars(base).get(name) for base in cls.__mro__[:-1] for name in ("__init__", "__new__")]
    maker = next((each for each in makers if inspect.isfunction(each)), None)
    try:
        hints = typing.get_type_hints(maker) if maker is not None else {}
    except NameError as error:  # imported for type checkers only, so users cannot import this class
        return {str(error.name)}
    hints.pop("return", None)
    classes = {each for hint in hints.values() for each in parts(hint) if inspect.isclass(each)}
    ours = {each for each in classes if each.__module__.partition(".")[0] in ("linkcore", "urlink", "rhdlink")}
    return {each.__qualname__ for each in ours - SHOWN if f"`{each.__name__}`" not in PAGE}


@pytest.mark.parametrize("name", MADE_BY_USERS)
def test_page_documents_classes_of_constructor_arguments(name: str) -> None:
    assert internals(found(name)) == set()


def test_page_shows_constructors_of_user_made_classes_only() -> None:
    assert "urlink.Stream" not in MADE_BY_USERS
    assert "Connection" in internals(found("urlink.Stream"))
    assert "urlink.Backoff" in MADE_BY_USERS
