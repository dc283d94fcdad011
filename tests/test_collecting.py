"""Sharing the collection between processes, and skipping modules without examples or marks, loses no tests."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.collecting import in_turn, selected_marks
from tests.matrix import IS_WHOLE

pytest_plugins = ["pytester"]

ROOT = Path(__file__).parents[1]

MODULE = '''
def one():
    """
    {prompt} 1
    2
    """
'''


@pytest.mark.parametrize("count", [1, 2, 3, 4])
def test_in_turn_gives_each_process_different_first_modules(count: int) -> None:
    modules = [f"module{number}" for number in range(11)]
    orders = [in_turn(modules, number, count) for number in range(count)]
    assert all(sorted(order) == sorted(modules) for order in orders)
    starts = [*(modules.index(order[0]) for order in orders), len(modules)]
    shares = [order[: starts[number + 1] - starts[number]] for number, order in enumerate(orders)]
    assert [module for share in shares for module in share] == modules


@pytest.mark.parametrize(("prompt", "failed"), [(">>>", 1), ("...", 0)])
def test_doctests_are_collected_from_modules_with_examples(pytester: pytest.Pytester, prompt: str, failed: int) -> None:
    pytester.makepyfile(module=MODULE.format(prompt=prompt))
    pytester.runpytest_inprocess("-p", "tests.collecting", "--doctest-modules").assert_outcomes(failed=failed)


@pytest.mark.parametrize(
    ("expression", "marks"),
    [
        ("slow", ("slow",)),
        ("slow or captures", ("slow", "captures")),
        ("", ()),
        ("not slow", ()),
        ("slow or not captures", ()),
        ("slow and captures", ()),
        ("(slow)", ()),
    ],
)
def test_selected_marks_reads_alternatives_only(expression: str, marks: tuple[str, ...]) -> None:
    assert selected_marks(expression) == marks


@pytest.mark.parametrize(("expression", "passed"), [("slow", 1), ("not slow", 1), ("", 2), ("slow or other", 1)])
def test_modules_without_the_selected_marks_are_skipped(
    pytester: pytest.Pytester, expression: str, passed: int
) -> None:
    pytester.makeini("[pytest]\nmarkers =\n    slow\n    other\npythonpath = .")
    pytester.makepyfile(
        test_marked="import pytest\n\n@pytest.mark.slow\ndef test_it(): pass\n", test_plain="def test_it(): pass\n"
    )
    result = pytester.runpytest_inprocess("-p", "tests.collecting", "-m", expression, "-v")
    result.assert_outcomes(passed=passed, deselected=0 if expression in ("", "slow", "slow or other") else 1)


@pytest.mark.slow
@pytest.mark.matrix
@pytest.mark.real_time
@pytest.mark.skipif(not IS_WHOLE, reason="pytest-xdist compares the processes of each run; nox -f nightly.py -s fuzz")
def test_collection_has_the_same_order_in_every_process() -> None:
    """pytest-xdist refuses to run if two processes differ, for example if the cases of a test come from a set."""
    orders = []
    for seed in "12":
        command = [sys.executable, "-m", "pytest", "--collect-only", "-q", "-p", "no:cacheprovider", "-m", "", "tests"]
        environment = {**os.environ, "PYTHONHASHSEED": seed}
        listed = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=250)
        assert listed.returncode == 0, listed.stdout[-2000:]
        orders.append([line for line in listed.stdout.splitlines() if "::" in line])
    assert len(orders[0]) > 1000
    assert orders[0] == orders[1]
