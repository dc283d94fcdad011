"""Copies of the newest values of a thread."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from linkcore.threads import Newest


@given(st.integers(1, 5), st.lists(st.integers(), max_size=30))
def test_newest_copies_the_last_values_in_their_order(count: int, values: list[int]) -> None:
    newest: Newest[int] = Newest(count)
    for number, value in enumerate(values, 1):
        newest.add(value)
        assert newest.copy() == values[:number][-count:]


def test_copy_of_newest_is_independent() -> None:
    newest: Newest[int] = Newest(2)
    newest.add(1)
    newest.copy().clear()
    assert newest.copy() == [1]
