"""Critical section of a robot: it is re-entrant, released while waiting, and refuses waits in the reader thread."""

from __future__ import annotations

import threading

import pytest

from linkcore.errors import LocalError
from urlink.command.section import Section

pytestmark = pytest.mark.simulated_time


def is_free(section: Section) -> bool:
    """Whether another thread can enter immediately."""
    found: list[bool] = []

    def try_to_enter() -> None:
        found.append(section.lock.acquire(blocking=False))
        if found[0]:
            section.lock.release()

    thread = threading.Thread(target=try_to_enter)
    thread.start()
    thread.join()
    return found[0]


def test_waiting_releases_nested_lock() -> None:
    section = Section()
    with section.lock, section.lock:
        with section.waiting():
            assert is_free(section)
        assert not is_free(section)
    assert is_free(section)


def test_waiting_works_without_holding_the_lock() -> None:
    section = Section()
    with section.waiting():
        assert is_free(section)
    assert is_free(section)


def test_wait_in_the_reader_thread_raises_local_error() -> None:
    section = Section(lambda: False, lambda: True)
    assert not section.may_wait
    with section.lock, pytest.raises(LocalError, match="inline=True"), section.waiting():
        pass
    assert is_free(section)
    assert Section(lambda: False).may_wait
