"""Objects that are made at their first use, possibly by another thread or a signal handler at the same time."""

from __future__ import annotations

from collections.abc import Callable

from linkcore.threads import MadeOnce


def test_made_once_returns_the_first_object_until_it_is_taken() -> None:
    once: MadeOnce[list[int]] = MadeOnce()
    assert not once.made
    assert once.take() is None
    first: list[int] = []
    assert once.keep(first) is first
    assert once.keep([]) is first
    assert once.made is first
    assert once.take() is first
    assert not once.made
    second: list[int] = []
    assert once.keep(second) is second


def test_object_made_by_a_signal_handler_is_kept() -> None:
    """The interrupted code then uses the object of the signal handler, too."""
    once: MadeOnce[str] = MadeOnce()

    def make() -> str:
        assert use(lambda: "the handler's") == "the handler's"
        return "the interrupted one's"

    def use(make: Callable[[], str]) -> str:
        return once.made or once.keep(make())

    assert use(make) == "the handler's"
    assert once.made == "the handler's"
