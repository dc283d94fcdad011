"""Rows of a table that the plugin `tests.matrix` selects."""

from __future__ import annotations

import pytest

pytest_plugins = ["pytester"]

TESTS = """
import pytest

rows = pytest.mark.parametrize("row", range(6))

@rows
@pytest.mark.matrix(3)
def test_some(row): pass

@pytest.mark.parametrize("row", [0, *(pytest.param(row, marks=pytest.mark.matrix(2)) for row in range(1, 5))])
def test_one_and_some(row): pass

@pytest.mark.parametrize("row", [0, 1])
@pytest.mark.matrix(7)
def test_one(row): pass

@rows
@pytest.mark.matrix
def test_all(row): pass
"""


@pytest.fixture
def tried(pytester: pytest.Pytester) -> pytest.Pytester:
    pytester.makeini("[pytest]\nmarkers = matrix")
    pytester.makepyfile(test_rows=TESTS)
    return pytester


def run(pytester: pytest.Pytester, *asked: str) -> dict[str, int]:
    result = pytester.runpytest_inprocess("-p", "tests.matrix", "-p", "no:cacheprovider", "-v", *asked)
    named = [line.partition("::")[2].partition("[")[0] for line in result.outlines if "PASSED" in line]
    return {name: named.count(name) for name in named}


@pytest.mark.parametrize("profile", ["default", "ci", None])
def test_quick_profiles_run_a_share_of_each_table(
    tried: pytest.Pytester, monkeypatch: pytest.MonkeyPatch, profile: str | None
) -> None:
    monkeypatch.delenv("HYPOTHESIS_PROFILE", raising=False)
    if profile is not None:
        monkeypatch.setenv("HYPOTHESIS_PROFILE", profile)
    assert run(tried) == {"test_some": 2, "test_one_and_some": 3, "test_one": 1, "test_all": 6}


@pytest.mark.parametrize("profile", ["fuzz", "mutants"])
def test_other_profiles_run_the_whole_table(
    tried: pytest.Pytester, monkeypatch: pytest.MonkeyPatch, profile: str
) -> None:
    monkeypatch.setenv("HYPOTHESIS_PROFILE", profile)
    assert run(tried) == {"test_some": 6, "test_one_and_some": 5, "test_one": 2, "test_all": 6}


def test_explicitly_selected_row_runs(tried: pytest.Pytester, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("HYPOTHESIS_PROFILE", raising=False)
    assert [run(tried, f"test_rows.py::test_some[{row}]") for row in range(3)] == [{"test_some": 1}] * 3
