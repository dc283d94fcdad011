"""The first example of each page that connects to a robot closes it again with a `with` block."""

from __future__ import annotations

import ast
import doctest
import re
import textwrap
from pathlib import Path

import pytest

_ROOT = Path(__file__).resolve().parents[1]
#: Functions and classes whose result must be closed, including `connect` and classes of other libraries.
_CONNECTS = {
    "connect",
    "connect_async",
    "Drive",
    "Host",
    "RemoteRobot",
    "RTDEControlInterface",
    "RTDEReceiveInterface",
    "RTDEIOInterface",
}
#: Pages whose first example cannot use `with`, with the reason.
_EXCEPTIONS = {
    "docs/notebooks/move-and-stop.md": "the robot stays connected from cell to cell; the last cell closes it",
    "docs/notebooks/read-and-plot.md": "the robot stays connected from cell to cell; the last cell closes it",
    "docs/packages/lerobot.md": "a robot of LeRobot has no `with`; the example disconnects in `finally`",
    "packages/lerobot/README.md": "a robot of LeRobot has no `with`; the example disconnects in `finally`",
}


def _pages() -> list[str]:
    found = [
        _ROOT / "README.md",
        *(_ROOT / "docs").rglob("*.md"),
        *(_ROOT / "packages").glob("*/README.md"),
    ]
    return sorted(path.relative_to(_ROOT).as_posix() for path in found)


def _examples(page: str) -> list[str]:
    """Return the source of each python or pycon block of a page."""
    blocks = re.findall(r"(?ms)^```(?:python|pycon)\n(.*?)^```$", page)
    parser = doctest.DocTestParser()
    return [
        "".join(example.source for example in parser.get_examples(block))
        if block.startswith(">>> ")
        else textwrap.dedent(block)
        for block in blocks
    ]


def _name(call: ast.Call) -> str:
    return call.func.attr if isinstance(call.func, ast.Attribute) else getattr(call.func, "id", "")


def _unclosed(page: str) -> list[str]:
    """Return the connections that the first connecting example opens without `with`, such as ``line 2: connect``."""
    for source in _examples(page):
        tree = ast.parse(source)
        calls = [node for node in ast.walk(tree) if isinstance(node, ast.Call) and _name(node) in _CONNECTS]
        if calls:
            closed = {
                id(item.context_expr)
                for node in ast.walk(tree)
                if isinstance(node, (ast.With, ast.AsyncWith))
                for item in node.items
            }
            return [f"line {call.lineno}: {_name(call)}" for call in calls if id(call) not in closed]
    return []


@pytest.mark.parametrize("page", sorted(set(_pages()) - set(_EXCEPTIONS)))
def test_first_example_connects_in_a_with_block(page: str) -> None:
    unclosed = _unclosed((_ROOT / page).read_text(encoding="utf-8"))
    assert not unclosed, (
        f"the first example of {page} that connects does so without `with` ({', '.join(unclosed)}); "
        f"write `with urlink.connect(...) as robot:`, so that Ctrl-C stops the arm, or add the page to _EXCEPTIONS"
    )


@pytest.mark.parametrize("page", sorted(_EXCEPTIONS))
def test_each_listed_exception_is_still_needed(page: str) -> None:
    assert _unclosed((_ROOT / page).read_text(encoding="utf-8")), f"{page} uses `with`; remove it from _EXCEPTIONS"


@pytest.mark.parametrize(
    ("example", "unclosed"),
    [
        ("robot = urlink.connect('sim://')", ["line 1: connect"]),
        ("with urlink.connect('sim://') as robot:\n    pass", []),
        ("host = Host([]).start()\nwith connect(host.address) as robot:\n    pass", ["line 1: Host"]),
        ("async def f():\n    async with urlink.connect_async('sim://') as robot:\n        pass", []),
        ("    def method(self):\n        pass", []),
        ("controller = Controller('UR5e').start()", []),
    ],
)
def test_unclosed_returns_connections_outside_a_with_block(example: str, unclosed: list[str]) -> None:
    assert _unclosed(f"# Page\n\n```python\n{example}\n```\n") == unclosed


def test_unclosed_stops_after_the_first_example_that_connects() -> None:
    first = "```pycon\n>>> with urlink.connect('sim://') as robot:\n...     print(robot.model)\nUR5e\n\n```\n"
    second = "```pycon\n>>> robot = urlink.connect('sim://')\n\n```\n"
    assert _unclosed(f"```pycon\n>>> import urlink\n\n```\n{first}{second}") == []
    assert _unclosed(second + first) == ["line 1: connect"]
