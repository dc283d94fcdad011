"""What is made at its first use, where another thread or a signal handler comes in between."""

from __future__ import annotations

from collections.abc import Callable

from linkcore.threads import MadeOnce


def test_what_is_made_first_is_kept_until_it_is_taken() -> None:
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


def test_a_signal_handler_uses_it_while_it_is_made() -> None:
    """What it has made holds, also for the one that it has interrupted."""
    once: MadeOnce[str] = MadeOnce()

    def make() -> str:
        assert use(lambda: "the handler's") == "the handler's"
        return "the interrupted one's"

    def use(make: Callable[[], str]) -> str:
        return once.made or once.keep(make())

    assert use(make) == "the handler's"
    assert once.made == "the handler's"
