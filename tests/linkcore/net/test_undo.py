"""Commands that were given up: undone once, at the first contact, before anything newer, and nothing after that."""

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
from linkcore.net.undo import PendingUndos, Undo
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

    def undo(self, name: str) -> Undo[Client]:
        def undo(client: Client, is_wanted: Callable[[], bool]) -> None:
            self.attempts += 1
            if not self.contact.is_set():
                raise ConnectFailed("nobody is there")
            if is_wanted():
                self.undone.append(name)

        return Undo(Client, undo)


@pytest.fixture
def undos() -> Iterator[PendingUndos]:
    before = set(threading.enumerate())
    undos = PendingUndos("robot")
    yield undos
    undos.close()
    until(lambda: set(threading.enumerate()) <= before)


def fail(undos: PendingUndos, name: str, undo: Undo[Client]) -> None:
    with contextlib.suppress(LinkTimeout), undos.command(name, TIMEOUT, undo) as given_up:
        given_up()
        raise LinkTimeout("no reply")


def give_up(undos: PendingUndos, peer: Peer, name: str = "play") -> None:
    fail(undos, name, peer.undo(name))


def test_what_is_answered_is_not_taken_back(undos: PendingUndos) -> None:
    peer = Peer()
    with undos.command("play", 0.0, peer.undo("play")):
        pass
    assert undos.pending == ()
    assert undos.settle(0.0)
    assert peer.attempts == 0


def test_it_is_taken_back_at_the_first_contact_and_once(undos: PendingUndos) -> None:
    peer = Peer()
    give_up(undos, peer)
    until(lambda: peer.attempts > 1)
    until(lambda: undos.pending == ("play",))
    peer.contact.set()
    assert undos.settle(TIMEOUT)
    assert undos.pending == ()
    until(lambda: undos._thread is None)
    assert peer.undone == ["play"]
    # It works again for the next.
    give_up(undos, peer)
    assert undos.settle(TIMEOUT)
    assert peer.undone == ["play", "play"]


def test_a_newer_command_waits_for_it_or_is_not_sent(undos: PendingUndos) -> None:
    peer = Peer()
    give_up(undos, peer)
    with (
        pytest.raises(LinkTimeout, match="'set' was not sent, because the abandoned command 'play' might still"),
        undos.command("set", 0.05),
    ):
        pytest.fail("sent")
    peer.contact.set()
    with undos.command("set", TIMEOUT):
        assert peer.undone == ["play"]


def test_a_peer_that_hangs_is_met_at_once_when_it_goes_on(undos: PendingUndos) -> None:
    """Each attempt waits for its answer; between two of them is a moment, however long the peer has been hanging."""
    attempts: list[tuple[float, float]] = []

    def undo(client: Client, is_wanted: Callable[[], bool]) -> None:
        began = time.monotonic()
        time.sleep(1.0)
        attempts.append((began, time.monotonic()))
        raise LinkTimeout("no answer")

    fail(undos, "play", Undo(Client, undo))
    time.sleep(30.0)
    assert len(attempts) > 25
    assert max(late[0] - early[1] for early, late in itertools.pairwise(attempts)) < 0.15


def test_what_supersedes_it_leaves_nothing_to_take_back(undos: PendingUndos) -> None:
    """Also where an attempt is waiting for its contact."""
    waiting, contact, undone = threading.Event(), threading.Event(), []

    def undo(client: Client, is_wanted: Callable[[], bool]) -> None:
        waiting.set()
        assert contact.wait(TIMEOUT)
        if is_wanted():
            undone.append("play")

    fail(undos, "play", Undo(Client, undo))
    assert waiting.wait(TIMEOUT)
    undos.drop()
    contact.set()
    until(lambda: undos._thread is None)
    assert undone == []


def test_of_several_each_is_taken_back_by_itself(undos: PendingUndos) -> None:
    deaf, peer = Peer(), Peer()
    peer.contact.set()
    give_up(undos, deaf, "gripper")
    with undos._lock:
        undos._pending["play"] = peer.undo("play")
    until(lambda: undos.pending == ("gripper",))
    assert peer.undone == ["play"]


def test_nothing_is_taken_back_after_the_close(undos: PendingUndos) -> None:
    peer = Peer()
    give_up(undos, peer)
    undos.close()
    attempts = peer.attempts
    peer.contact.set()
    give_up(undos, peer)
    assert undos.settle(0.0)
    until(lambda: undos._thread is None)
    assert peer.undone == []
    assert peer.attempts <= attempts + 1


class User:
    """Who gives commands to the peer."""


def test_what_is_owed_is_kept_without_a_thread_and_taken_back_for_the_next_user() -> None:
    peer, key, user = Peer(), object(), User()

    def use_and_close() -> None:
        undos = PendingUndos.of(key, "robot", user)
        assert not PendingUndos.is_owed(key)
        give_up(undos, peer)
        undos.close(user)
        until(lambda: undos._thread is None)
        give_up(undos, peer, "gripper")  # a call that waits ends as its robot is closed
        assert undos._thread is None

    use_and_close()
    gc.collect()
    assert peer.undone == []
    assert PendingUndos.is_owed(key)
    peer.contact.set()
    undos = PendingUndos.of(key, "robot", user)
    assert undos.settle(TIMEOUT)
    assert sorted(peer.undone) == ["gripper", "play"]
    assert not PendingUndos.is_owed(key)
    undos.close(user)


def test_nothing_is_kept_of_a_peer_that_owes_nothing() -> None:
    key, user = object(), User()
    held = weakref.ref(PendingUndos.of(key, "robot", user))
    until(lambda: held() is None)


def test_users_share_what_is_owed_and_the_last_one_ends_the_thread() -> None:
    peer, key, first, second = Peer(), object(), User(), User()
    undos = PendingUndos.of(key, "robot", first)
    assert PendingUndos.of(key, "robot", second) is undos
    give_up(undos, peer)
    undos.close(first)
    undos.close(first)
    assert undos._thread is not None
    with pytest.raises(LinkTimeout), undos.command("set", 0.05):
        pytest.fail("sent")
    undos.close(second)
    until(lambda: undos._thread is None)
    PendingUndos.of(key, "robot", first).drop()
    assert not PendingUndos.is_owed(key)
    undos.close(first)


def test_who_uses_a_part_alone_shares_what_is_owed_with_who_uses_all() -> None:
    peer, whole, part, first, second = Peer(), object(), object(), User(), User()
    undos = PendingUndos.of(whole, "robot", first, part)
    assert PendingUndos.of(part, "dashboard", second) is undos
    give_up(undos, peer)
    undos.close(first)
    undos.close(second)
    assert PendingUndos.is_owed(whole)
    assert PendingUndos.is_owed(part)
    peer.contact.set()
    assert PendingUndos.of(part, "dashboard", second).settle(TIMEOUT)
    assert peer.undone == ["play"]
    undos.close(second)


@pytest.mark.parametrize("is_used", [False, True])
def test_who_uses_all_takes_back_what_several_parts_owe_unless_they_do(is_used: bool) -> None:
    peer, parts, users = Peer(), [object(), object()], [User(), User(), User()]
    owed = [PendingUndos.of(part, "part", user) for part, user in zip(parts, users[:2], strict=True)]
    for undos, name, user in zip(owed, ("play", "gripper"), users[:2], strict=True):
        give_up(undos, peer, name)
        if not is_used:
            undos.close(user)
    whole = PendingUndos.of("whole", "robot", users[2], *parts)
    assert whole is owed[0]
    assert whole.pending == (("play",) if is_used else ("gripper", "play"))
    peer.contact.set()
    assert whole.settle(TIMEOUT)
    until(lambda: not PendingUndos.is_owed(*parts))
    assert sorted(peer.undone) == ["gripper", "play"]
    for undos, user in zip((*owed, whole), users, strict=True):
        undos.close(user)


def test_an_attempt_that_waits_is_broken_off_by_the_last_close() -> None:
    waiting = threading.Event()

    def undo(client: Client, is_wanted: Callable[[], bool]) -> None:
        waiting.set()
        assert client.closed.wait(TIMEOUT)
        raise Closed("closed")

    key, user = object(), User()
    undos = PendingUndos.of(key, "robot", user)
    fail(undos, "play", Undo(Client, undo))
    assert waiting.wait(TIMEOUT)
    undos.close(user)
    until(lambda: undos._thread is None)
    assert PendingUndos.is_owed(key)
    undos.drop()


@pytest.mark.parametrize(
    "seed", [pytest.param(seed, marks=pytest.mark.simulated_time(seed=seed)) for seed in range(10)]
)
def test_two_threads_that_use_a_peer_first_at_the_same_time_get_the_same_one(seed: int) -> None:
    """In simulated time, where a thread that waited for a real lock of another one would wait for ever."""
    found: list[PendingUndos] = []

    def use(user: object) -> None:
        undos = PendingUndos.of(f"peer {seed}", "peer", user)
        found.append(undos)
        time.sleep(1.0)
        undos.close(user)

    threads = [threading.Thread(target=use, args=(Client(),)) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(TIMEOUT)
    assert found[0] is found[1]
