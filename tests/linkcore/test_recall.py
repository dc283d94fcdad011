"""Commands that were given up: taken back once, at the first contact, before anything newer, and nothing after that."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Iterator

import pytest

from linkcore.errors import ConnectFailed, LinkTimeout
from linkcore.net.recall import Recall, TakeBack
from tests.waiting import until

TIMEOUT = 10.0


class Peer:
    """What takes commands back: not before `contact` is set. `asked` has what it was asked to."""

    def __init__(self) -> None:
        self.contact = threading.Event()
        self.attempts = 0
        self.undone: list[str] = []

    def undo(self, name: str) -> Callable[[Callable[[], bool]], None]:
        def take_back(is_wanted: Callable[[], bool]) -> None:
            self.attempts += 1
            if not self.contact.is_set():
                raise ConnectFailed("nobody is there")
            if is_wanted():
                self.undone.append(name)

        return take_back


@pytest.fixture
def recall() -> Iterator[Recall]:
    before = set(threading.enumerate())
    recall = Recall("robot")
    yield recall
    recall.close()
    until(lambda: set(threading.enumerate()) <= before)


def fail(recall: Recall, name: str, take_back: TakeBack) -> None:
    with contextlib.suppress(LinkTimeout), recall.command(name, TIMEOUT, take_back) as given_up:
        given_up()
        raise LinkTimeout("no reply")


def give_up(recall: Recall, peer: Peer, name: str = "play") -> None:
    fail(recall, name, peer.undo(name))


def test_what_is_answered_is_not_taken_back(recall: Recall) -> None:
    peer = Peer()
    with recall.command("play", 0.0, peer.undo("play")):
        pass
    assert recall.pending == ()
    assert recall.settle(0.0)
    assert peer.attempts == 0


def test_it_is_taken_back_at_the_first_contact_and_once(recall: Recall) -> None:
    peer = Peer()
    give_up(recall, peer)
    until(lambda: peer.attempts > 1)
    until(lambda: recall.pending == ("play",))
    peer.contact.set()
    assert recall.settle(TIMEOUT)
    assert recall.pending == ()
    until(lambda: recall._thread is None)
    assert peer.undone == ["play"]
    # It works again for the next.
    give_up(recall, peer)
    assert recall.settle(TIMEOUT)
    assert peer.undone == ["play", "play"]


def test_a_newer_command_waits_for_it_or_is_not_sent(recall: Recall) -> None:
    peer = Peer()
    give_up(recall, peer)
    with (
        pytest.raises(LinkTimeout, match="'set' was not sent: 'play' was given up before, it may still be carried out"),
        recall.command("set", 0.05),
    ):
        pytest.fail("sent")
    peer.contact.set()
    with recall.command("set", TIMEOUT):
        assert peer.undone == ["play"]


def test_what_supersedes_it_leaves_nothing_to_take_back(recall: Recall) -> None:
    """Also where an attempt is waiting for its contact."""
    waiting, contact, undone = threading.Event(), threading.Event(), []

    def take_back(is_wanted: Callable[[], bool]) -> None:
        waiting.set()
        assert contact.wait(TIMEOUT)
        if is_wanted():
            undone.append("play")

    fail(recall, "play", take_back)
    assert waiting.wait(TIMEOUT)
    recall.drop()
    contact.set()
    until(lambda: recall._thread is None)
    assert undone == []


def test_of_several_each_is_taken_back_by_itself(recall: Recall) -> None:
    deaf, peer = Peer(), Peer()
    peer.contact.set()
    give_up(recall, deaf, "gripper")
    with recall._lock:
        recall._pending["play"] = peer.undo("play")
    until(lambda: recall.pending == ("gripper",))
    assert peer.undone == ["play"]


def test_nothing_is_taken_back_after_the_close(recall: Recall) -> None:
    peer = Peer()
    give_up(recall, peer)
    recall.close()
    attempts = peer.attempts
    peer.contact.set()
    give_up(recall, peer)
    assert recall.settle(0.0)
    until(lambda: recall._thread is None)
    assert peer.undone == []
    assert peer.attempts <= attempts + 1
