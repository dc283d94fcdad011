"""File of points: a JSON file that people can read and edit.

Each change reads the file, and replaces it by a new file. A lock file excludes other processes during this time, so no
change of another process is lost. A reader needs no lock, because the file is replaced in one step.
"""

from __future__ import annotations

import contextlib
import json
import os
import stat
import sys
from collections.abc import Iterator, Mapping
from datetime import datetime
from pathlib import Path
from typing import Any

from linkcore import clock
from linkcore.errors import BadValue, LocalError
from linkcore.text import printable, similar

from .point import Point

#: Format name and version at the beginning of a file.
_FORMAT, _VERSION = "urlink points", 1
#: Entries of a point, in the order in which they are written.
_ENTRIES = ("model", "date", "q", "pose", "tcp")
#: Maximum number of characters of a name.
_LONGEST = 100
#: Maximum time to wait for another process that changes the file, and interval at which to try again, in s.
_LOCK_TIMEOUT, _RETRY = 5.0, 0.02


class NoSuchPoint(BadValue, KeyError):
    """Error: no point has this name."""

    __module__ = "urlink"  # users import the class from `urlink`, so tracebacks show this name

    def __str__(self) -> str:
        return str(self.args[0])  # a KeyError would show the message in quotes


class PointFile:
    """JSON file of points. A file that does not exist has no points; the first change creates it.

    Args:
        path: Path of the file.

    Attributes:
        path: Path of the file.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(path)
        #: Content of the file at the last reading, and its points; replaced in one step. Comparing the content is
        #: faster than checking all points, which takes 0.1 ms for each of them.
        self._last: tuple[bytes, dict[str, Point]] = b"", {}

    def read(self) -> dict[str, Point]:
        """Return all points by name, in the order of the file.

        Raises:
            BadValue: If the file cannot be read, or is not a valid file of points. The message names the file, the
                place in it, and what was expected.
        """
        try:
            text = self.path.read_bytes()
        except FileNotFoundError:
            return {}
        except OSError as error:
            raise BadValue(f"cannot read {self.path}: {error.strerror or error}") from error
        known, points = self._last
        if text != known or not text:
            try:
                points = parse(text)
            except BadValue as error:
                raise BadValue(f"{self.path}: {error}") from None
            self._last = text, points
        return dict(points)

    def point(self, name: str) -> Point:
        """Return the point with this name.

        Raises:
            NoSuchPoint: If no point has this name.
            BadValue: See `read`.
        """
        return self._found(self.read(), name)

    def add(self, points: Mapping[str, Point], *, replace: bool) -> None:
        """Add points. If an error is raised, the file is unchanged.

        Raises:
            BadValue: If a name is invalid, or if a point exists and `replace` is False. See also `read`.
            LocalError: If another process keeps the file locked, or the file cannot be written.
        """
        for name in points:
            check_name(name)
        with self._locked():
            known = self.read()
            for name, point in points.items():
                if name in known and not replace:
                    raise BadValue(
                        f"{self.path} already has a point {name!r}, taught on {known[name].date:%Y-%m-%d}; pass "
                        "replace=True to replace it"
                    )
                known[name] = point
            self._write(known)

    def remove(self, names: tuple[str, ...]) -> list[Point]:
        """Remove points, and return them. If an error is raised, the file is unchanged.

        Raises:
            NoSuchPoint: If no point has one of the names.
            BadValue, LocalError: See `add`.
        """
        with self._locked():
            known = self.read()
            removed = [self._found(known, name) for name in names]
            for name in names:
                known.pop(name, None)
            self._write(known)
        return removed

    def _found(self, points: Mapping[str, Point], name: object) -> Point:
        if isinstance(name, str) and name in points:
            return points[name]
        hint = similar(name, points) if isinstance(name, str) else ""
        listed = ", ".join(points) or "no points"
        raise NoSuchPoint(f"{self.path} has no point {name!r}{hint or f'; it has {listed}'}")

    def _write(self, points: Mapping[str, Point]) -> None:
        # If the path is a link, replace the file behind it.
        target = self.path.resolve()
        beside = target.with_name(f".{target.name}.{os.getpid()}")
        try:
            try:
                with beside.open("wb") as file:
                    file.write(to_text(points).encode())
                    file.flush()
                    os.fsync(file.fileno())
                if target.exists():
                    beside.chmod(stat.S_IMODE(target.stat().st_mode))
                beside.replace(target)
            except BaseException:
                beside.unlink(missing_ok=True)
                raise
        except OSError as error:
            raise LocalError(f"cannot write {self.path}: {error.strerror or error}") from error

    @contextlib.contextmanager
    def _locked(self) -> Iterator[None]:
        """Exclude other processes and threads that change the file."""
        target = self.path.resolve()
        with contextlib.ExitStack() as opened:
            try:
                # The lock file remains, because removing it could let two processes lock two different files.
                number = os.open(target.with_name(f".{target.name}.lock"), os.O_RDWR | os.O_CREAT, 0o666)
                opened.callback(os.close, number)  # releases the lock
                until = clock.now() + _LOCK_TIMEOUT
                while not _try_lock(number):
                    if clock.now() >= until:
                        raise LocalError(
                            f"another program has kept {self.path} locked for {_LOCK_TIMEOUT:g} s; nothing was changed"
                        )
                    clock.sleep(_RETRY)
            except OSError as error:
                raise LocalError(f"cannot lock {self.path}: {error.strerror or error}") from error
            yield


if sys.platform == "win32":
    import msvcrt

    def _try_lock(number: int) -> bool:
        try:
            msvcrt.locking(number, msvcrt.LK_NBLCK, 1)
        except OSError:
            return False
        return True

else:
    import fcntl

    def _try_lock(number: int) -> bool:
        try:
            fcntl.flock(number, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
        return True


def check_name(name: object) -> None:
    """Raise `BadValue` unless `name` can be the name of a point."""
    if not isinstance(name, str) or not name.isprintable() or not 0 < len(name) <= _LONGEST or name != name.strip():
        raise BadValue(f"point name {name!r}; expected 1 to {_LONGEST} printable characters without blanks at the ends")


# -- format ------------------------------------------------------------------------------------------


def to_text(points: Mapping[str, Point]) -> str:
    """Return the content of a file of points. Each entry of a point is one line."""
    written = []
    for name, point in points.items():
        entries = described(point)
        rows = ",\n".join(f'   "{key}": {json.dumps(entries[key], ensure_ascii=False)}' for key in _ENTRIES)
        written.append(f"  {json.dumps(name, ensure_ascii=False)}: {{\n{rows}\n  }}")
    inner = "{\n" + ",\n".join(written) + "\n }" if written else "{}"
    return f'{{\n "format": "{_FORMAT}",\n "version": {_VERSION},\n "points": {inner}\n}}\n'


def described(point: Point) -> dict[str, Any]:
    """Return the entries of a point as values that JSON supports."""
    return {
        "model": point.model,
        "date": point.date.isoformat(),
        "q": point.q.tolist(),
        "pose": point.pose.tolist(),
        "tcp": point.tcp.tolist(),
    }


def parse(text: bytes) -> dict[str, Point]:
    """Return the points in the content of a file.

    Raises:
        BadValue: If the content is not valid. The message names the place and what was expected.
    """
    try:
        held = json.loads(text.decode(), object_pairs_hook=_once)
    except BadValue:
        raise
    except UnicodeDecodeError as error:
        raise BadValue(f"not a JSON file: byte {error.start} is not UTF-8") from None
    except (ValueError, RecursionError) as error:
        raise BadValue(f"not a JSON file: {error}") from None
    if not isinstance(held, dict) or held.get("format") != _FORMAT:
        raise BadValue(f'expected an object whose "format" is "{_FORMAT}"')
    if type(held.get("version")) is not int or held["version"] != _VERSION:
        raise BadValue(f"unknown version {printable(repr(held.get('version')))}; expected {_VERSION}")
    _check_keys(held, ("format", "version", "points"), "the file")
    if not isinstance(held["points"], dict):
        raise BadValue('"points" must be an object with a point for each name')
    points = {}
    for name, entries in held["points"].items():
        check_name(name)
        try:
            points[name] = _point(entries)
        except BadValue as error:
            raise BadValue(f"point {name!r}: {error}") from None
    return points


def _point(entries: Any) -> Point:
    if not isinstance(entries, dict):
        raise BadValue(f"expected an object with {', '.join(_ENTRIES)}")
    _check_keys(entries, _ENTRIES, "the point")
    for name in ("q", "pose", "tcp"):
        row = entries[name]
        if not isinstance(row, list) or any(type(each) not in (int, float) for each in row):
            raise BadValue(f'"{name}" must be a list of six numbers')
    try:
        # Python 3.10 does not read the suffix Z.
        date = datetime.fromisoformat(entries["date"].replace("Z", "+00:00"))
    except (AttributeError, ValueError):
        raise BadValue(
            f'"date" is {printable(repr(entries["date"]))}; expected a date such as "2026-03-01T12:00:00+00:00"'
        ) from None
    return Point(entries["q"], entries["pose"], entries["tcp"], entries["model"], date)


def _check_keys(held: Mapping[str, Any], expected: tuple[str, ...], where: str) -> None:
    """Raise `BadValue` unless an object has exactly the expected keys; a change would drop any other key."""
    missing = [key for key in expected if key not in held]
    if missing:
        raise BadValue(f'{where} has no "{missing[0]}"; expected {", ".join(expected)}')
    unknown = [key for key in held if key not in expected]
    if unknown:
        raise BadValue(f'{where} has an unknown entry "{printable(unknown[0])}"; expected {", ".join(expected)}')


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    held = dict(pairs)
    if len(held) < len(pairs):
        names = [name for name, _ in pairs]
        twice = next(name for name in names if names.count(name) > 1)
        raise BadValue(f'"{printable(twice)}" occurs twice; expected each name only once')
    return held
