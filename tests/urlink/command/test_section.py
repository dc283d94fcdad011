"""The critical section of a robot: re-entrant, left by who waits, refused to who delivers."""

from __future__ import annotations

import threading

import pytest

from linkcore.errors import LocalError
from urlink.command.section import Section

pytestmark = pytest.mark.simulated_time


def is_free(section: Section) -> bool:
    """Another thread would get in at once."""
    found: list[bool] = []

    def try_to_enter() -> None:
        found.append(section.lock.acquire(blocking=False))
        if found[0]:
            section.lock.release()

    thread = threading.Thread(target=try_to_enter)
    thread.start()
    thread.join()
    return found[0]


def test_who_waits_lets_others_in_however_deep() -> None:
    section = Section()
    with section.lock, section.lock:
        with section.waiting():
            assert is_free(section)
        assert not is_free(section)
    assert is_free(section)


def test_waiting_without_having_entered() -> None:
    section = Section()
    with section.waiting():
        assert is_free(section)
    assert is_free(section)


def test_a_thread_that_has_to_deliver_is_refused() -> None:
    section = Section(lambda: False, lambda: True)
    assert not section.may_wait
    with section.lock, pytest.raises(LocalError, match="inline=True"), section.waiting():
        pass
    assert is_free(section)
    assert Section(lambda: False).may_wait
