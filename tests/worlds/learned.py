"""Which locks methods are called with: learned from worlds without a defect, and kept in ``locks.tsv``.

``python -m tests.worlds.learned`` learns anew, after a change that was meant. A method that was always
called with a lock of its object is called with it for a reason; and a method that takes steps of its own (it waits,
sends, takes another lock or calls back) and was never called with a lock is called without it for a reason: who holds
a lock keeps others waiting. Attributes that are assigned only with a lock are learned too.
"""

from __future__ import annotations

import argparse
import contextlib
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from types import FunctionType
from typing import Any

from linkcore.attributes import StrictAttributes
from linkcore.simulated.scheduler import current

from .guarded import is_held
from .observed import replaced

__all__ = ["KNOWN", "Row", "classes", "found_locks", "watching"]

_FILE = Path(__file__).with_name("locks.tsv")
#: Packages whose classes are looked at, and those of their modules that are not: they are no part of a client.
_PACKAGES = ("linkcore", "urlink", "rhdlink")
_NOT = ("simul", ".host", ".plugins", ".smrcl", ".cli", ".view", ".acceptance", ".identification", "wire", "enums")
#: How deep locks of other objects are looked for, and how often a method must have been called.
_DEPTH, _CALLS, _WORLDS = 3, 30, 4
#: Methods that every object has, or that cost too much to look at.
_STRICT = StrictAttributes.__setattr__
_LEFT_OUT = {"offer", "now", "is_older", "take", "feed"}


@dataclass(frozen=True)
class Row:
    """What is known of a method, or of an attribute.

    Attributes:
        owner, name: class and method, or attribute.
        kind: "with" a lock or "without" it, "assigned" with it.
        lock: where the object has the lock: ``_section.lock``.
    """

    owner: str
    name: str
    kind: str
    lock: str


def _read() -> tuple[Row, ...]:
    if not _FILE.exists():
        return ()
    lines = _FILE.read_text(encoding="utf-8").splitlines()
    return tuple(Row(*line.split("\t")) for line in lines if line and not line.startswith("#"))


#: What was learned.
KNOWN = _read()


def classes() -> dict[str, type]:
    """The classes of the packages, by their names, which do not change when a module moves."""
    found: dict[str, type] = {}
    for name, module in sorted(sys.modules.items()):
        if module is None or name.partition(".")[0] not in _PACKAGES or any(each in name for each in _NOT):
            continue
        for each in vars(module).values():
            if isinstance(each, type) and each.__module__ == name and each is not StrictAttributes:
                found[each.__name__] = each
    return found


def _is_lock(thing: Any) -> bool:
    return type(thing).__name__ in ("Lock", "RLock", "Condition") and hasattr(thing, "acquire")


def found_locks(thing: Any, kinds: frozenset[type], depth: int = _DEPTH) -> Iterator[str]:
    """Where an object has locks, itself or in objects that it has."""
    for name, value in list(getattr(thing, "__dict__", {}).items()):
        if _is_lock(value):
            yield name
        elif depth > 1 and type(value) in kinds:
            for rest in found_locks(value, kinds, depth - 1):
                yield f"{name}.{rest}"


def lock_of(thing: Any, path: str) -> Any:
    """The lock at a place of an object; None where there is none now."""
    for name in path.split("."):
        thing = getattr(thing, "__dict__", {}).get(name)
        if thing is None:
            return None
    return thing


@contextlib.contextmanager
def watching(fault: Callable[[str], object], rows: tuple[Row, ...] = KNOWN) -> Iterator[None]:
    """Compare calls and assignments with what was learned, for as long as the block lasts."""
    known = classes()
    methods: dict[tuple[str, str], list[Row]] = {}
    attributes: dict[str, dict[str, list[str]]] = {}
    for row in rows:
        if row.kind == "assigned":
            attributes.setdefault(row.owner, {}).setdefault(row.name, []).append(row.lock)
        else:
            methods.setdefault((row.owner, row.name), []).append(row)

    def calling(found: list[Row]) -> Callable[[Any], Any]:
        checks = [(row.lock, row.kind == "with", row) for row in found]

        def around(method: Callable[..., Any]) -> Callable[..., Any]:
            def wrapped(thing: Any, *arguments: Any, **options: Any) -> Any:
                for path, is_with, row in checks:
                    lock = lock_of(thing, path)
                    if lock is not None and is_held(lock) is not is_with and _counts(lock, is_with):
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
        yield


def _plain(setter: Callable[..., None]) -> Callable[..., None]:
    """The setter of strict attributes asks which module calls it, which is this one."""
    return object.__setattr__ if setter is _STRICT else setter


def _counts(lock: Any, is_with: bool) -> bool:
    """A lock that does not know who holds it may be held by another thread."""
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
    """Notes which locks are held in each call and each assignment."""

    def __init__(self) -> None:
        self.methods: dict[tuple[str, str], _Seen] = {}
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
            yield

    def _calling(self, owner: str, name: str) -> Callable[[Any], Any]:
        seen = self.methods.setdefault((owner, name), _Seen())

        def around(method: Callable[..., Any]) -> Callable[..., Any]:
            def wrapped(*arguments: Any, **options: Any) -> Any:
                thing, scheduler = arguments[0], current()
                before = 0 if scheduler is None else scheduler.steps
                seen.add(self._of(thing), thing, self.world)
                try:
                    return method(*arguments, **options)
                finally:
                    seen.steps += scheduler is not None and scheduler.steps > before

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
        for (owner, name), seen in sorted(self.methods.items()):
            if seen.calls < _CALLS or len(seen.worlds) < _WORLDS:
                continue
            for lock in _shortest(seen.always or set()):
                yield Row(owner, name, "with", lock)
            if seen.steps:
                for lock in _shortest(seen.places - seen.ever):
                    yield Row(owner, name, "without", lock)
        for (owner, name), seen in sorted(self.attributes.items()):
            if seen.calls >= 10 and len(seen.worlds) >= _WORLDS:
                for lock in _shortest(seen.always or set()):
                    yield Row(owner, name, "assigned", lock)


def _shortest(locks: set[str]) -> list[str]:
    """Two at most: the nearest places say it all."""
    return sorted(locks, key=lambda path: (path.count("."), path))[:2]


def learned(seeds: range) -> set[Row]:
    """What these worlds teach."""
    from .drawn import draw
    from .running import run

    learning = Learning()
    with learning.watching():
        for seed in seeds:
            learning.world = seed
            run(draw(seed))
    return set(learning.rows())


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.worlds.learned", description=__doc__)
    parser.add_argument("--seeds", type=int, default=800, help="how many worlds")
    parser.add_argument("--jobs", type=int, default=2, help="processes; what is kept is what each of them has learned")
    given = parser.parse_args()
    _FILE.unlink(missing_ok=True)
    each = given.seeds // given.jobs
    with ProcessPoolExecutor(given.jobs) as pool:
        parts = pool.map(learned, [range(number * each, (number + 1) * each) for number in range(given.jobs)])
        found = set.intersection(*parts)
    lines = ["# class, method or attribute, how, lock: learned by python -m tests.worlds.learned"]
    lines += ["\t".join((row.owner, row.name, row.kind, row.lock)) for row in sorted(found, key=str)]
    _FILE.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
