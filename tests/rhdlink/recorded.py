"""Connections of the original RHD programs: bytes of both directions, and what the original client printed."""

from __future__ import annotations

import re
from pathlib import Path
from typing import NamedTuple

import pytest

_FOLDER = Path("shared") / "captures" / "rhd"
#: It stands beside the repository, and not everybody has it.
_PLACES = [parent / _FOLDER for parent in Path(__file__).resolve().parents]


def folder() -> Path:
    """The folder of captures; the test is skipped where it is not."""
    for place in _PLACES:
        if place.is_dir():
            return place
    pytest.skip("the captures of the original RHD (../shared/captures/rhd beside the repository) are not here")


def from_server(name: str) -> bytes:
    return (folder() / f"{name}.s2c.bin").read_bytes()


def from_client(name: str) -> bytes:
    return (folder() / f"{name}.c2s.bin").read_bytes()


class Line(NamedTuple):
    """What the original client printed of one variable."""

    direction: str
    identity: int
    name: str
    length: int
    updated: bool
    changed: int
    seconds: int
    microseconds: int
    values: list[int]


_LINE = re.compile(r"([rw]) (\d+) (\S+) len=(\d+) upd=(\d+) chg=(\d+) ts=(\d+)\.(\d{6}) : (.*)")


def printed(name: str) -> list[list[Line]]:
    """The tables after the handshake, and after each sync."""
    tables: list[list[Line]] = []
    for text in (folder() / f"{name}.client.txt").read_text().splitlines():
        match = _LINE.fullmatch(text.strip())
        if match is not None:
            direction, identity, variable, length, updated, changed, seconds, micros, values = match.groups()
            tables[-1].append(
                Line(
                    direction,
                    int(identity),
                    variable,
                    int(length),
                    updated != "0",
                    int(changed),
                    int(seconds),
                    int(micros),
                    [int(each) for each in values.split()],
                )
            )
        else:
            tables.append([])
    return [table for table in tables if table]
