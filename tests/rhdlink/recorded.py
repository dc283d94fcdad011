"""Recorded connections of the original RHD programs: bytes of both directions, and the output of the original client.

The recordings are for tests marked ``captures("rhd")``.
"""

from __future__ import annotations

import re
from typing import NamedTuple

from tests.real_captures import folder


def from_server(name: str) -> bytes:
    return (folder("rhd") / f"{name}.s2c.bin").read_bytes()


def from_client(name: str) -> bytes:
    return (folder("rhd") / f"{name}.c2s.bin").read_bytes()


class Line(NamedTuple):
    """One variable in the output of the original client."""

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
    """Return the printed tables after the handshake and after each sync."""
    tables: list[list[Line]] = []
    for text in (folder("rhd") / f"{name}.client.txt").read_text().splitlines():
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
