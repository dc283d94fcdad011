"""Locks that methods are called with or without, learned from worlds without a defect and stored in ``locks.tsv``.

After an intended change, ``python -m tests.worlds.learned`` learns them again. If a method was always called with a
lock of its object, this is assumed to be intended. If a method takes time (it waits, sends, acquires another lock or
calls back) and was never called with a lock, this is also assumed to be intended, because a held lock makes other
threads wait. Attributes that are assigned only with a lock are learned, too.
"""

from __future__ import annotations

import argparse
import contextlib
import functools
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import FrameType, FunctionType
from typing import Any

from linkcore import clock
from linkcore.names import StrictAttributes
from linkcore.simulated.scheduler import current

from .guarded import is_held
from .observed import replaced

__all__ = ["KNOWN", "Row", "classes", "found_locks", "watching"]

_FILE = Path(__file__).with_name("locks.tsv")
#: Packages whose classes are observed, and parts of module names that are excluded because clients do not use them.
_PACKAGES = ("linkcore", "urlink", "rhdlink")
_NOT = ("simul", ".host", ".plugins", ".smrcl", ".cli", ".view", ".acceptance", ".identification", "wire", "enums")
#: Depth of the search for locks in other objects, and minimum numbers of calls and of worlds of a method.
_DEPTH, _CALLS, _WORLDS = 3, 30, 4
#: Methods that every object has, or that are too expensive to observe.
_STRICT = StrictAttributes.__setattr__
_LEFT_OUT = {"offer", "now", "is_older", "take", "feed"}


@dataclass(frozen=True)
class Row:
    """Learned rule for a method or an attribute.

    Attributes:
        owner, name: Names of the class and of its method or attribute.
        kind: "with" or "without" for a method that is called with or without the lock, "assigned" for an attribute that
            is assigned with it, or "waits" for a method that may wait with it.
        lock: Path of the lock from the object, such as ``_section.lock``.
        caller: Name of the calling function; empty for all callers.
    """

    owner: str
    name: str
    kind: str
    lock: str
    caller: str = ""


def _read() -> tuple[Row, ...]:
    if not _FILE.exists():
        return ()
    lines = _FILE.read_text(encoding="utf-8").splitlines()
    return tuple(Row(*line.split("\t")) for line in lines if line and not line.startswith("#"))


#: Learned rules.
KNOWN = _read()


@functools.cache
def classes() -> dict[str, type]:
    """Return the classes of the packages by their names, which do not change if a module moves."""
    return {each.__name__: each for each in every_class()}


def every_class() -> Iterator[type]:
    """Yield the classes of the packages. Several classes may have the same name."""
    for name, module in sorted(sys.modules.items()):
        if module is None or name.partition(".")[0] not in _PACKAGES or any(each in name for each in _NOT):
            continue
        for each in vars(module).values():
            if isinstance(each, type) and each.__module__ == name and each is not StrictAttributes:
                yield each


def _is_lock(thing: Any) -> bool:
    return type(thing).__name__ in ("Lock", "RLock", "Condition") and hasattr(thing, "acquire")


def found_locks(thing: Any, kinds: frozenset[type], depth: int = _DEPTH) -> Iterator[str]:
    """Yield the paths of the locks of an object, including locks of its attributes."""
    for name, value in list(getattr(thing, "__dict__", {}).items()):
        if _is_lock(value):
            yield name
        elif depth > 1 and type(value) in kinds:
            for rest in found_locks(value, kinds, depth - 1):
                yield f"{name}.{rest}"


def lock_of(thing: Any, path: str) -> Any:
    """Return the lock at a path from an object, or None if there is none now."""
    for name in path.split("."):
        thing = getattr(thing, "__dict__", {}).get(name)
        if thing is None:
            return None
    return thing


@contextlib.contextmanager
def watching(fault: Callable[[str], object], rows: tuple[Row, ...] = KNOWN) -> Iterator[None]:
    """Compare calls and assignments with the learned rules while the block lasts."""
    known = classes()
    methods: dict[tuple[str, str], list[Row]] = {}
    attributes: dict[str, dict[str, list[str]]] = {}
    for row in rows:
        if row.kind == "assigned":
            attributes.setdefault(row.owner, {}).setdefault(row.name, []).append(row.lock)
        elif row.kind != "waits":
            methods.setdefault((row.owner, row.name), []).append(row)
    may_wait = {(row.owner, row.name, row.lock) for row in rows if row.kind == "waits"}

    def waiting(wait: Callable[..., Any]) -> Callable[..., Any]:
        def wrapped(*arguments: Any, **options: Any) -> Any:
            for each in held_in_callers(sys._getframe(1)):
                if each not in may_wait and not _is_handler():
                    fault(f"{each[0]}.{each[1]} waits with {each[2]}")
            return wait(*arguments, **options)

        return wrapped

    def calling(found: list[Row]) -> Callable[[Any], Any]:
        checks = [(row.lock, row.kind == "with", row) for row in found]
        callers = any(row.caller for row in found)

        def around(method: Callable[..., Any]) -> Callable[..., Any]:
            def wrapped(thing: Any, *arguments: Any, **options: Any) -> Any:
                caller = sys._getframe(1).f_code.co_name if callers else ""
                for path, is_with, row in checks:
                    if row.caller and row.caller != caller:
                        continue
                    lock = lock_of(thing, path)
                    if (
                        lock is not None
                        and is_held(lock) is not is_with
                        and _counts(lock, is_with)
                        and not _is_handler()
                    ):
                        fault(f"{row.owner}.{row.name} is called {'without' if is_with else 'with'} {path}")
                return method(thing, *arguments, **options)

            return wrapped

        return around

    def assigning(names: dict[str, list[str]]) -> Callable[[Any], Any]:
        def around(setter: Callable[..., None]) -> Callable[..., None]:
            setter = _plain(setter)

            def wrapped(thing: Any, name: str, value: object) -> None:
                if name in names and name in thing.__dict__:
                    for path in names[name]:
                        lock = lock_of(thing, path)
                        if lock is not None and not is_held(lock):
                            fault(f"{type(thing).__name__}.{name} changes without {path}")
                setter(thing, name, value)

            return wrapped

        return around

    with contextlib.ExitStack() as stack:
        for (owner, name), found in methods.items():
            if isinstance(vars(known.get(owner, object)).get(name), FunctionType):
                stack.enter_context(replaced(known[owner], name, calling(found)))
        for owner, names in attributes.items():
            if owner in known:
                stack.enter_context(replaced(known[owner], "__setattr__", assigning(names)))
        if may_wait:
            stack.enter_context(replaced(clock, "wait", waiting))
            stack.enter_context(replaced(clock, "sleep", waiting))
        yield


def held_in_callers(frame: FrameType | None) -> Iterator[tuple[str, str, str]]:
    """Yield class, method and lock for each calling method whose object has a lock that this thread holds."""
    while frame is not None:
        module = frame.f_globals.get("__name__", "")
        if module.partition(".")[0] in _PACKAGES and "simul" not in module:
            names = frame.f_code.co_varnames
            thing = frame.f_locals.get("self") if names and names[0] == "self" else None
            for name, value in getattr(thing, "__dict__", {}).items():
                if type(value).__name__ in ("RLock", "Condition") and is_held(value):
                    yield type(thing).__name__, frame.f_code.co_name, name
        frame = frame.f_back


def _is_handler() -> bool:
    """Whether a signal handler makes the call; it may run while its own thread holds any lock."""
    frame: FrameType | None = sys._getframe(1)
    while frame is not None:
        if frame.f_code.co_name == "handler" and frame.f_globals.get("__name__", "").startswith("tests.worlds"):
            return True
        frame = frame.f_back
    return False


def _plain(setter: Callable[..., None]) -> Callable[..., None]:
    """Return a setter without the check of strict attributes, which would see this module as the caller."""
    return object.__setattr__ if setter is _STRICT else setter


def _counts(lock: Any, is_with: bool) -> bool:
    """Whether the state of a lock can be checked; a lock without an owner may be held by another thread."""
    return is_with or type(lock).__name__ != "Lock"


# -- learning ----------------------------------------------------------------------------------------


@dataclass
class _Seen:
    always: set[str] | None = None
    ever: set[str] = field(default_factory=set)
    places: set[str] = field(default_factory=set)
    calls: int = 0
    steps: int = 0
    worlds: set[int] = field(default_factory=set)

    def add(self, locks: tuple[str, ...], thing: Any, world: int) -> None:
        held = {path for path in locks if (lock := lock_of(thing, path)) is not None and is_held(lock)}
        self.always = held if self.always is None else self.always & held
        self.ever |= held
        self.places |= set(locks)
        self.calls += 1
        self.worlds.add(world)


class Learning:
    """Recorder of the locks that are held in each call and each assignment."""

    def __init__(self) -> None:
        self.methods: dict[tuple[str, str, str], _Seen] = {}
        self.waits: dict[tuple[str, str, str], int] = {}
        self.attributes: dict[tuple[str, str], _Seen] = {}
        self.world = 0
        self._kinds = frozenset(classes().values())
        self._locks: dict[type, tuple[str, ...]] = {}
        self._looks: dict[type, int] = {}

    def _of(self, thing: Any) -> tuple[str, ...]:
        kind, looks = type(thing), self._looks.get(type(thing), 0)
        if looks < 20:  # an attribute may get its object later
            self._looks[kind] = looks + 1
            self._locks[kind] = tuple({*self._locks.get(kind, ()), *found_locks(thing, self._kinds)})
        return self._locks[kind]

    @contextlib.contextmanager
    def watching(self) -> Iterator[None]:
        with contextlib.ExitStack() as stack:
            for owner, cls in classes().items():
                for name, member in list(vars(cls).items()):
                    if isinstance(member, FunctionType) and not name.startswith("__") and name not in _LEFT_OUT:
                        stack.enter_context(replaced(cls, name, self._calling(owner, name)))
                if "__dict__" in dir(cls) and not issubclass(cls, (tuple, BaseException)):
                    with contextlib.suppress(TypeError):
                        stack.enter_context(replaced(cls, "__setattr__", self._assigning(owner)))
            stack.enter_context(replaced(clock, "wait", self._waiting))
            stack.enter_context(replaced(clock, "sleep", self._waiting))
            yield

    def _waiting(self, wait: Callable[..., Any]) -> Callable[..., Any]:
        def wrapped(*arguments: Any, **options: Any) -> Any:
            for each in held_in_callers(sys._getframe(1)):
                self.waits[each] = self.waits.get(each, 0) + 1
            return wait(*arguments, **options)

        return wrapped

    def _calling(self, owner: str, name: str) -> Callable[[Any], Any]:
        def around(method: Callable[..., Any]) -> Callable[..., Any]:
            def wrapped(*arguments: Any, **options: Any) -> Any:
                thing, scheduler = arguments[0], current()
                before = 0 if scheduler is None else scheduler.steps
                caller = sys._getframe(1).f_code.co_name
                both = [self.methods.setdefault((owner, name, each), _Seen()) for each in ("", caller)]
                for seen in both:
                    seen.add(self._of(thing), thing, self.world)
                try:
                    return method(*arguments, **options)
                finally:
                    if scheduler is not None and scheduler.steps > before:
                        for seen in both:
                            seen.steps += 1

            return wrapped

        return around

    def _assigning(self, owner: str) -> Callable[[Any], Any]:
        def around(setter: Callable[..., None]) -> Callable[..., None]:
            setter = _plain(setter)

            def wrapped(thing: Any, name: str, value: object) -> None:
                if type(thing).__name__ == owner and name in thing.__dict__:
                    seen = self.attributes.setdefault((owner, name), _Seen())
                    seen.add(self._of(thing), thing, self.world)
                setter(thing, name, value)

            return wrapped

        return around

    def rows(self) -> Iterator[Row]:
        for owner, name, lock in self.waits:
            yield Row(owner, name, "waits", lock)
        known: set[Row] = set()
        for (owner, name, caller), seen in sorted(self.methods.items()):  # rows for all callers come first
            if seen.calls < _CALLS or len(seen.worlds) < _WORLDS:
                continue
            rows = [Row(owner, name, "with", lock, caller) for lock in _shortest(seen.always or set())]
            if seen.steps:
                rows += [Row(owner, name, "without", lock, caller) for lock in _shortest(seen.places - seen.ever)]
            yield from (row for row in rows if replace(row, caller="") not in known)
            known |= set(rows)
        for (owner, name), seen in sorted(self.attributes.items()):
            if seen.calls >= 10 and len(seen.worlds) >= _WORLDS:
                for lock in _shortest(seen.always or set()):
                    yield Row(owner, name, "assigned", lock)


def _shortest(locks: set[str]) -> list[str]:
    """Return at most two locks, the ones with the shortest paths."""
    return sorted(locks, key=lambda path: (path.count("."), path))[:2]


def learned(seeds: range) -> set[Row]:
    """Return the rules learned from these worlds."""
    from .drawn import draw
    from .running import run

    learning = Learning()
    with learning.watching():
        for seed in seeds:
            learning.world = seed
            run(draw(seed))
    return set(learning.rows())


def agreed(parts: list[set[Row]]) -> set[Row]:
    """Return the rules that all parts have learned, and all rules for waits."""
    every = set().union(*parts)
    return set.intersection(*parts) | {row for row in every if row.kind == "waits"}


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.worlds.learned", description=__doc__)
    parser.add_argument("--seeds", type=int, default=800, help="number of worlds (default: %(default)d)")
    parser.add_argument("--jobs", type=int, default=2, help="parallel processes; a rule must be learned by all of them")
    given = parser.parse_args()
    _FILE.unlink(missing_ok=True)
    each = given.seeds // given.jobs
    with ProcessPoolExecutor(given.jobs) as pool:
        parts = pool.map(learned, [range(number * each, (number + 1) * each) for number in range(given.jobs)])
        found = agreed(list(parts))
    lines = ["# class, method or attribute, how, lock, caller: learned by python -m tests.worlds.learned"]
    lines += [
        "\t".join((row.owner, row.name, row.kind, row.lock, row.caller)).rstrip() for row in sorted(found, key=str)
    ]
    _FILE.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
