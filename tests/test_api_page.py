"""The pages of the API show how to make what users make, and of nothing else how it is made."""

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
    """What a dotted name names."""
    module, _, attribute = name.rpartition(".")
    return getattr(importlib.import_module(module), attribute)


SHOWN = {found(name) for name, _ in BLOCKS}
#: The classes of which the page shows the arguments.
MADE_BY_USERS = [name for name, options in BLOCKS if not re.search(r":exclude-members:.*\b__init__\b", options)]


def parts(hint: Any) -> Iterator[Any]:
    """The classes in an annotation."""
    yield hint
    for each in typing.get_args(hint):
        yield from parts(each)


def internals(cls: Any) -> set[str]:
    """The classes of ours that an argument is annotated with, and that the page does not show."""
    makers = [vars(base).get(name) for base in cls.__mro__[:-1] for name in ("__init__", "__new__")]
    maker = next((each for each in makers if inspect.isfunction(each)), None)
    try:
        hints = typing.get_type_hints(maker) if maker is not None else {}
    except NameError as error:  # imported for types only, so no class that is made with what users import
        return {str(error.name)}
    hints.pop("return", None)
    classes = {each for hint in hints.values() for each in parts(hint) if inspect.isclass(each)}
    ours = {each for each in classes if each.__module__.partition(".")[0] in ("linkcore", "urlink", "rhdlink")}
    return {each.__qualname__ for each in ours - SHOWN if f"`{each.__name__}`" not in PAGE}


@pytest.mark.parametrize("name", MADE_BY_USERS)
def test_users_can_make_what_the_page_shows_how_to_make(name: str) -> None:
    assert internals(found(name)) == set()


def test_what_is_made_by_the_library_is_told_from_what_is_not() -> None:
    assert "urlink.Stream" not in MADE_BY_USERS
    assert "Connection" in internals(found("urlink.Stream"))
    assert "urlink.Backoff" in MADE_BY_USERS
