"""Check that guarded attributes change only in a thread that holds their lock.

A lock that is released one statement too early goes unnoticed unless two threads meet between two lines. In every
world, each assignment to a guarded attribute and each call of a guarded method is compared with the state of the lock.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Mapping
from threading import Condition
from typing import Any

import pytest

from linkcore.streaming.connection import Connection
from linkcore.streaming.connection_life import ConnectionLife
from linkcore.streaming.fanout import FanOut
from linkcore.streaming.packet_queue import BoundedQueue
from linkcore.streaming.silence import SilenceMonitor
from linkcore.streaming.subscription import InlineDelivery
from rhdlink.drive import _Motions
from rhdlink.sync.replica import Replica
from urlink.motion.servo.jog import _Holding
from urlink.motion.stream.common_time import CommonPace, CommonTime
from urlink.rtde.client import Rtde

from .observed import replaced

__all__ = ["ATTRIBUTES", "METHODS", "guards", "watching"]

#: Lock and attributes of each class; after the construction, the attributes are assigned only under the lock.
ATTRIBUTES: Mapping[type, tuple[str, frozenset[str]]] = {
    FanOut: ("_lock", frozenset({"_offers", "taps"})),
    BoundedQueue: ("_discarding", frozenset({"_discarded"})),
    InlineDelivery: ("_closing", frozenset({"_is_closed"})),
    _Motions: ("_lock", frozenset({"_error", "_next"})),
    CommonTime: ("_lock", frozenset({"_local", "_time", "began", "rate"})),
    CommonPace: ("_lock", frozenset({"_holds", "_local", "_rate", "_wanted"})),
    SilenceMonitor: ("_changing", frozenset({"_watches", "wait"})),
    Rtde: ("_lock", frozenset({"_is_closed", "_open"})),
    _Holding: ("_section", frozenset({"_began", "_duration", "_speeds", "is_over"})),
}
#: Lock and methods of each class; the methods are called only under the lock of their object.
METHODS: Mapping[type, tuple[str, tuple[str, ...]]] = {
    FanOut: ("_lock", ("_update",)),
    Connection: ("_changed", ("_begin",)),
    Replica: ("lock", ("_note_discarded",)),
}
#: Methods of `ConnectionLife` that are called only under the lock of the connection.
_OF_LIFE = ("fire", "use", "end", "lose")


def is_held(lock: Any) -> bool:
    """Whether the calling thread holds a lock; for a lock without an owner, whether any thread holds it."""
    if isinstance(lock, Condition):
        return bool(lock._is_owned())  # type: ignore[attr-defined]
    owned: Callable[[], bool] | None = getattr(lock, "_is_owned", None)
    if owned is not None:
        return bool(owned())
    inner = getattr(lock, "_lock", None)
    return bool(lock.locked()) if hasattr(lock, "locked") else inner is None or is_held(inner)


@contextlib.contextmanager
def watching(fault: Callable[[str], object]) -> Iterator[None]:
    """Compare guarded attributes and methods with their locks while the block lasts."""
    lives: dict[int, Connection] = {}

    def check(owner: Any, lock_name: str, what: str) -> None:
        lock = vars(owner).get(lock_name) if hasattr(owner, "__dict__") else getattr(owner, lock_name, None)
        if lock is not None and not is_held(lock):
            fault(f"{type(owner).__name__}: {what} without {lock_name}")

    def assigning(lock_name: str, names: frozenset[str]) -> Callable[[Any], Any]:
        def around(assign: Callable[[Any, str, object], None]) -> Callable[[Any, str, object], None]:
            def wrapped(owner: Any, name: str, value: object) -> None:
                if name in names and hasattr(owner, name):
                    check(owner, lock_name, f"{name} is assigned")
                assign(owner, name, value)

            return wrapped

        return around

    def calling(lock_name: str, name: str) -> Callable[[Any], Any]:
        def around(method: Callable[..., Any]) -> Callable[..., Any]:
            def wrapped(owner: Any, *arguments: Any, **options: Any) -> Any:
                check(owner, lock_name, f"{name} is called")
                return method(owner, *arguments, **options)

            return wrapped

        return around

    def of_life(name: str) -> Callable[[Any], Any]:
        def around(method: Callable[..., Any]) -> Callable[..., Any]:
            def wrapped(life: Any, *arguments: Any, **options: Any) -> Any:
                connection = lives.get(id(life))
                if connection is not None and connection._life is life:
                    check(connection, "_changed", f"{name} of its life is called")
                return method(life, *arguments, **options)

            return wrapped

        return around

    def made(init: Callable[..., None]) -> Callable[..., None]:
        def wrapped(connection: Any, *arguments: Any, **options: Any) -> None:
            init(connection, *arguments, **options)
            lives[id(connection._life)] = connection

        return wrapped

    with contextlib.ExitStack() as stack:
        for cls, (lock_name, names) in ATTRIBUTES.items():
            stack.enter_context(replaced(cls, "__setattr__", assigning(lock_name, names)))
        for cls, (lock_name, methods) in METHODS.items():
            for name in methods:
                stack.enter_context(replaced(cls, name, calling(lock_name, name)))
        for name in _OF_LIFE:
            stack.enter_context(replaced(ConnectionLife, name, of_life(name)))
        stack.enter_context(replaced(Connection, "__init__", made))
        yield


@pytest.fixture(autouse=True)
def guards() -> Iterator[None]:
    """Compare guarded attributes and methods with their locks, in each test of a folder with this fixture."""
    faults: list[str] = []
    with watching(faults.append):
        yield
    assert faults == []
