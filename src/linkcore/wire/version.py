"""Versions as tuples, and the span of versions in which a field is on the wire.

A peer is made in several generations that are maintained side by side, so "since 3.10 and, in the
next generation, since 5.4" is one fact; it is written ``"3.10/5.4"``.
"""

from __future__ import annotations

from ..errors import BadVersion

__all__ = ["Since", "Version", "parse_version", "version_text"]

#: ``(major, minor, ...)``; longer tuples compare as tuples do, so any NamedTuple of integers will do.
Version = tuple[int, ...]


def parse_version(text: str | Version) -> Version:
    """``"3.10"`` -> ``(3, 10)``; a tuple is returned as it is.

    Raises:
        BadVersion: the text is not two or more dot-separated whole numbers.

    >>> parse_version("5.11.1")
    (5, 11, 1)
    """
    if not isinstance(text, str):
        return text
    parts = text.strip().split(".")
    if len(parts) < 2 or not all(part.isascii() and part.isdigit() and len(part) < 7 for part in parts):
        raise BadVersion(f"{text!r} is not a version; expected something like '5.11'")
    return tuple(int(part) for part in parts)


def version_text(version: Version) -> str:
    """``(3, 10)`` -> ``"3.10"``; versions that are more than a tuple say it themselves."""
    return ".".join(map(str, version)) if type(version) is tuple else str(version)


class Since:
    """The first version of each generation that has something, as in ``Since("3.10/5.4")``.

    A version is judged by the entry of the nearest generation at or below its own, so what one
    generation gained late is absent from the next one until that generation's own entry.

    >>> since = Since("3.10/5.4")
    >>> [version in since for version in [(1, 8), (3, 9), (3, 10), (5, 0), (5, 4), (10, 7)]]
    [False, False, True, False, True, True]
    """

    def __init__(self, text: str) -> None:
        self.text = text
        self.firsts = tuple(sorted(parse_version(part) for part in text.split("/")))

    def __contains__(self, version: Version) -> bool:
        entry = [first for first in self.firsts if first[0] <= version[0]]
        return bool(entry) and version >= entry[-1]

    def __repr__(self) -> str:
        return f"Since({self.text!r})"

    @property
    def steps(self) -> set[Version]:
        """The versions at which the answer can change."""
        return {*self.firsts, *((first[0], 0) for first in self.firsts[1:])}
