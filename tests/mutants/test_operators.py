"""Mutations of all kinds are found, and can be made one at a time."""

from __future__ import annotations

import ast

import pytest

from tests.mutants.defects import defects
from tests.mutants.engine import codes
from tests.mutants.equivalent import equivalents
from tests.mutants.operators import Function, mutated, mutations
from tests.mutants.targets import GROUPS, ROOT


def changes(source: str) -> list[tuple[str, str]]:
    return [(each.before, each.after) for each in mutations(source)]


@pytest.mark.parametrize(
    ("source", "expected"),
    [
        ("a < b", [("a < b", "a <= b")]),
        ("a == b", [("a == b", "a != b")]),
        ("x = a if b >= c else d", [("b >= c", "b > c"), ("b >= c", "not b >= c")]),
        ("while a is None: f = g", [("a is None", "not a is None")]),
        ("x = a and b", [("a and b", "a or b")]),
        ("x = not a", [("not a", "a")]),
        ("x = [a for a in b if not a]", [("not a", "a")]),
        ("x = -a + b", [("-a", "a"), ("-a + b", "-a - b")]),
        ("x += a", [("x += a", "x -= a")]),
        ("x = (1, 0.5, True)", [("1", "2"), ("0.5", "1.0"), ("True", "False")]),
        ("x = 0.0", [("0.0", "1.0")]),
        ("f()", [("f()", "pass")]),
        ("def f():\n    a.b = c", [("a.b = c", "pass")]),
        ("def f():\n    return a", [("return a", "return None")]),
        ("raise a", [("raise a", "pass")]),
        ("del a[b]", [("del a[b]", "pass")]),
        ("while a:\n    break", [("a", "not a"), ("break", "pass")]),
        ("while a:\n    continue", [("a", "not a"), ("continue", "pass")]),
        ("x = {a: f(b=c)}", []),
        ('"text"', []),
        ('x = f"{1} is {a < b}"', []),
        ('x = "text" + y', []),
        ("log.warning(a, 1)", []),
        ("x: Literal[1] = a", []),
        ("assert a < 1", []),
        ("x = zip(a, b[1], strict=True)", [("1", "2")]),
        ("x = f(a, strict=True)", [("True", "False")]),
        ("@f(1)\nclass C:\n    pass", []),
        ("if TYPE_CHECKING:\n    x = 1", []),
        ("def __repr__(self):\n    return a + 1", []),
        ("def f():\n    return None", []),
    ],
)
def test_mutations_of_a_source_are_the_expected_ones(source: str, expected: list[tuple[str, str]]) -> None:
    assert changes(source) == expected


SOURCE = """\
LIMIT = 2

class C:
    @property
    def f(self, a=3):
        def g():
            return a + 1
        return g() < LIMIT
"""


def test_mutations_have_the_name_and_line_of_their_function() -> None:
    """A function is named by the line of its first decorator, as in code objects. Defaults are evaluated outside."""
    f = Function("f", 4)
    assert [(each.line, each.function) for each in mutations(SOURCE)] == [
        (1, None),
        (5, None),
        *[(7, f)] * 3,
        *[(8, f)] * 2,
    ]
    assert [(code.co_name, code.co_firstlineno) for code in codes(compile(SOURCE, "", "exec"))][1:2] == [f]


def test_mutated_module_differs_in_one_line() -> None:
    original = ast.unparse(ast.parse(SOURCE)).splitlines()
    for each in mutations(SOURCE):
        changed = ast.unparse(mutated(SOURCE, each.number)).splitlines()
        assert sum(one != other for one, other in zip(original, changed, strict=True)) == 1


@pytest.mark.parametrize("name", GROUPS)
def test_every_group_pattern_matches_a_file(name: str) -> None:
    """A pattern that matches nothing after a module was renamed would silently leave out the module."""
    assert GROUPS[name].missing() == []


@pytest.mark.slow
@pytest.mark.parametrize("name", GROUPS)
def test_each_equivalent_mutant_row_matches_the_source(name: str) -> None:
    found = {
        path.relative_to(ROOT / "src").as_posix(): (defects if name == "drawn" else mutations)(
            path.read_text(encoding="utf-8")
        )
        for path in GROUPS[name].files()
    }
    for row in equivalents(name):
        assert any(row.matches(row.path, each) for each in found[row.path]), row
        assert len(row.why) > 10, row
