"""Abandoned commands: each is undone once, at the first contact with the peer, before any newer command."""

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
from tests.waiting import threads_named, until

pytestmark = pytest.mark.simulated_time

TIMEOUT = 10.0


class Client:
    """Client of one attempt to undo a command."""

    def __init__(self) -> None:
        self.closed = threading.Event()

    def close(self) -> None:
        self.closed.set()


class Peer:
    """Peer that undoes commands once `contact` is set; `undone` holds the names of the undone commands."""

    def __init__(self) -> None:
        self.contact = threading.Event()
        self.attempts = 0
        self.undone: list[str] = []

    def undo(self, name: str) -> Undo[Client]:
        def undo(client: Client, is_wanted: Callable[[], bool]) -> None:
            self.attempts += 1
            if not self.contact.is_set():
                raise ConnectFailed("the peer is not reachable")
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


def has_rested() -> bool:
    """Whether no thread undoes commands."""
    return not threads_named("robot undo")


def test_answered_command_is_not_undone(undos: PendingUndos) -> None:
    peer = Peer()
    with undos.command("play", 0.0, peer.undo("play")):
        pass
    assert undos.pending == ()
    assert undos.settle(0.0)
    assert peer.attempts == 0


def test_abandoned_command_is_undone_once_at_first_contact(undos: PendingUndos) -> None:
    peer = Peer()
    give_up(undos, peer)
    until(lambda: peer.attempts > 1)
    until(lambda: undos.pending == ("play",))
    peer.contact.set()
    assert undos.settle(TIMEOUT)
    assert undos.pending == ()
    until(has_rested)
    assert peer.undone == ["play"]
    # The next abandoned command is undone in the same way.
    give_up(undos, peer)
    assert undos.settle(TIMEOUT)
    assert peer.undone == ["play", "play"]


def test_newer_command_waits_for_the_undo_or_is_not_sent(undos: PendingUndos) -> None:
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


def test_next_undo_attempt_starts_soon_after_the_last_one(undos: PendingUndos) -> None:
    """Each attempt waits for its answer, and the next one starts shortly after, however long the peer hangs."""
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


def test_drop_removes_the_undo_even_during_an_attempt(undos: PendingUndos) -> None:
    """Even an attempt that is waiting for the peer does not undo the command then."""
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
    until(has_rested)
    assert undone == []


def test_pending_commands_are_undone_independently(undos: PendingUndos) -> None:
    deaf, peer = Peer(), Peer()
    peer.contact.set()
    with undos.command("play", 0.0, peer.undo("play")) as sent:
        give_up(undos, deaf, "gripper")  # as another thread does meanwhile
    sent()
    until(lambda: undos.pending == ("gripper",))
    assert peer.undone == ["play"]


def test_no_command_is_undone_after_close(undos: PendingUndos) -> None:
    peer = Peer()
    give_up(undos, peer)
    undos.close()
    attempts = peer.attempts
    peer.contact.set()
    give_up(undos, peer)
    assert undos.settle(0.0)
    until(has_rested)
    assert peer.undone == []
    assert peer.attempts <= attempts + 1


class User:
    """User of the peer, who gives commands to it."""


def test_pending_undos_are_kept_for_the_next_user() -> None:
    peer, key, user = Peer(), object(), User()

    def use_and_close() -> None:
        undos = PendingUndos.of(key, "robot", user)
        assert not PendingUndos.is_owed(key)
        give_up(undos, peer)
        undos.close(user)
        until(has_rested)
        give_up(undos, peer, "gripper")  # a waiting call ends because its robot is closed
        assert has_rested()

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


def test_peer_without_pending_undos_is_freed() -> None:
    key, user = object(), User()
    held = weakref.ref(PendingUndos.of(key, "robot", user))
    until(lambda: held() is None)


def test_users_share_undos_and_the_last_close_ends_the_thread() -> None:
    peer, key, first, second = Peer(), object(), User(), User()
    undos = PendingUndos.of(key, "robot", first)
    assert PendingUndos.of(key, "robot", second) is undos
    give_up(undos, peer)
    undos.close(first)
    undos.close(first)
    assert not has_rested()
    with pytest.raises(LinkTimeout), undos.command("set", 0.05):
        pytest.fail("sent")
    undos.close(second)
    until(has_rested)
    PendingUndos.of(key, "robot", first).drop()
    assert not PendingUndos.is_owed(key)
    undos.close(first)


def test_robot_and_dashboard_share_pending_undos() -> None:
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
def test_robot_undoes_commands_of_closed_parts(is_used: bool) -> None:
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


def test_last_close_aborts_a_waiting_attempt() -> None:
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
    until(has_rested)
    assert PendingUndos.is_owed(key)
    undos.drop()


@pytest.mark.parametrize(
    "seed", [pytest.param(seed, marks=pytest.mark.simulated_time(seed=seed)) for seed in range(10)]
)
def test_concurrent_first_users_get_the_same_object(seed: int) -> None:
    """In simulated time, a thread would wait forever for a real lock that another thread holds."""
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
