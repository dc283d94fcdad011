"""Commands that were given up: taken back once, at the first contact, before anything newer, and nothing after that."""

from __future__ import annotations

import contextlib
import gc
import itertools
import threading
import time
import weakref
from collections.abc import Callable, Iterator

import pytest

from linkcore.errors import Closed, ConnectFailed, LinkTimeout
from linkcore.net.undo import Recall, TakeBack
from tests.waiting import until

pytestmark = pytest.mark.simulated_time

TIMEOUT = 10.0


class Client:
    """What an attempt talks by."""

    def __init__(self) -> None:
        self.closed = threading.Event()

    def close(self) -> None:
        self.closed.set()


class Peer:
    """What takes commands back: not before `contact` is set. `undone` has what it was asked to."""

    def __init__(self) -> None:
        self.contact = threading.Event()
        self.attempts = 0
        self.undone: list[str] = []

    def undo(self, name: str) -> TakeBack[Client]:
        def take_back(client: Client, is_wanted: Callable[[], bool]) -> None:
            self.attempts += 1
            if not self.contact.is_set():
                raise ConnectFailed("nobody is there")
            if is_wanted():
                self.undone.append(name)

        return TakeBack(Client, take_back)


@pytest.fixture
def recall() -> Iterator[Recall]:
    before = set(threading.enumerate())
    recall = Recall("robot")
    yield recall
    recall.close()
    until(lambda: set(threading.enumerate()) <= before)


def fail(recall: Recall, name: str, take_back: TakeBack[Client]) -> None:
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


def test_a_peer_that_hangs_is_met_at_once_when_it_goes_on(recall: Recall) -> None:
    """Each attempt waits for its answer; between two of them is a moment, however long the peer has been hanging."""
    attempts: list[tuple[float, float]] = []

    def take_back(client: Client, is_wanted: Callable[[], bool]) -> None:
        began = time.monotonic()
        time.sleep(1.0)
        attempts.append((began, time.monotonic()))
        raise LinkTimeout("no answer")

    fail(recall, "play", TakeBack(Client, take_back))
    time.sleep(30.0)
    assert len(attempts) > 25
    assert max(late[0] - early[1] for early, late in itertools.pairwise(attempts)) < 0.15


def test_what_supersedes_it_leaves_nothing_to_take_back(recall: Recall) -> None:
    """Also where an attempt is waiting for its contact."""
    waiting, contact, undone = threading.Event(), threading.Event(), []

    def take_back(client: Client, is_wanted: Callable[[], bool]) -> None:
        waiting.set()
        assert contact.wait(TIMEOUT)
        if is_wanted():
            undone.append("play")

    fail(recall, "play", TakeBack(Client, take_back))
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


class User:
    """Who gives commands to the peer."""


def test_what_is_owed_is_kept_without_a_thread_and_taken_back_for_the_next_user() -> None:
    peer, key, user = Peer(), object(), User()

    def use_and_close() -> None:
        recall = Recall.of(key, "robot", user)
        assert not Recall.is_owed(key)
        give_up(recall, peer)
        recall.close(user)
        until(lambda: recall._thread is None)
        give_up(recall, peer, "gripper")  # a call that waits ends as its robot is closed
        assert recall._thread is None

    use_and_close()
    gc.collect()
    assert peer.undone == []
    assert Recall.is_owed(key)
    peer.contact.set()
    recall = Recall.of(key, "robot", user)
    assert recall.settle(TIMEOUT)
    assert sorted(peer.undone) == ["gripper", "play"]
    assert not Recall.is_owed(key)
    recall.close(user)


def test_nothing_is_kept_of_a_peer_that_owes_nothing() -> None:
    key, user = object(), User()
    held = weakref.ref(Recall.of(key, "robot", user))
    until(lambda: held() is None)


def test_users_share_what_is_owed_and_the_last_one_ends_the_thread() -> None:
    peer, key, first, second = Peer(), object(), User(), User()
    recall = Recall.of(key, "robot", first)
    assert Recall.of(key, "robot", second) is recall
    give_up(recall, peer)
    recall.close(first)
    recall.close(first)
    assert recall._thread is not None
    with pytest.raises(LinkTimeout), recall.command("set", 0.05):
        pytest.fail("sent")
    recall.close(second)
    until(lambda: recall._thread is None)
    Recall.of(key, "robot", first).drop()
    assert not Recall.is_owed(key)
    recall.close(first)


def test_who_uses_a_part_alone_shares_what_is_owed_with_who_uses_all() -> None:
    peer, whole, part, first, second = Peer(), object(), object(), User(), User()
    recall = Recall.of(whole, "robot", first, part)
    assert Recall.of(part, "dashboard", second) is recall
    give_up(recall, peer)
    recall.close(first)
    recall.close(second)
    assert Recall.is_owed(whole)
    assert Recall.is_owed(part)
    peer.contact.set()
    assert Recall.of(part, "dashboard", second).settle(TIMEOUT)
    assert peer.undone == ["play"]
    recall.close(second)


@pytest.mark.parametrize("is_used", [False, True])
def test_who_uses_all_takes_back_what_several_parts_owe_unless_they_do(is_used: bool) -> None:
    peer, parts, users = Peer(), [object(), object()], [User(), User(), User()]
    owed = [Recall.of(part, "part", user) for part, user in zip(parts, users[:2], strict=True)]
    for recall, name, user in zip(owed, ("play", "gripper"), users[:2], strict=True):
        give_up(recall, peer, name)
        if not is_used:
            recall.close(user)
    whole = Recall.of("whole", "robot", users[2], *parts)
    assert whole is owed[0]
    assert whole.pending == (("play",) if is_used else ("gripper", "play"))
    peer.contact.set()
    assert whole.settle(TIMEOUT)
    until(lambda: not Recall.is_owed(*parts))
    assert sorted(peer.undone) == ["gripper", "play"]
    for recall, user in zip((*owed, whole), users, strict=True):
        recall.close(user)


def test_an_attempt_that_waits_is_broken_off_by_the_last_close() -> None:
    waiting = threading.Event()

    def take_back(client: Client, is_wanted: Callable[[], bool]) -> None:
        waiting.set()
        assert client.closed.wait(TIMEOUT)
        raise Closed("closed")

    key, user = object(), User()
    recall = Recall.of(key, "robot", user)
    fail(recall, "play", TakeBack(Client, take_back))
    assert waiting.wait(TIMEOUT)
    recall.close(user)
    until(lambda: recall._thread is None)
    assert Recall.is_owed(key)
    recall.drop()


@pytest.mark.parametrize(
    "seed", [pytest.param(seed, marks=pytest.mark.simulated_time(seed=seed)) for seed in range(10)]
)
def test_two_threads_that_use_a_peer_first_at_the_same_time_get_the_same_one(seed: int) -> None:
    """In simulated time, where a thread that waited for a real lock of another one would wait for ever."""
    found: list[Recall] = []

    def use(user: object) -> None:
        recall = Recall.of(f"peer {seed}", "peer", user)
        found.append(recall)
        time.sleep(1.0)
        recall.close(user)

    threads = [threading.Thread(target=use, args=(Client(),)) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(TIMEOUT)
    assert found[0] is found[1]
