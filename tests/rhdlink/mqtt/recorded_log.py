"""The MQTT log of a robot of 2025-01-31, and the logs that the robot wrote itself.

For tests marked ``captures("mqtt")``.
"""

from __future__ import annotations

import gzip
import re
from typing import NamedTuple

from tests.real_captures import folder

_ROBOT = re.compile(r"(\S+) (\S+) '([^']*)' (.*)")
_MASTER = re.compile(r"(\S+) Rx 0 drive (\S+) (.*)")


class Logged(NamedTuple):
    """A message of the log.

    Attributes:
        time: Wall time in s.
        topic: Complete topic.
        payload: Payload.
    """

    time: float
    topic: str
    payload: str


def _lines(name: str) -> list[str]:
    text = gzip.decompress((folder("mqtt") / f"robobot_2025-01-31_{name}.txt.gz").read_bytes()).decode("ascii")
    return [line for line in text.split("\n") if line and not line.startswith("%")]


def _matching(pattern: re.Pattern[str], has_quality: bool) -> list[Logged]:
    found = []
    for line in _lines("log_mqtt"):
        if match := pattern.fullmatch(line):
            words = match.groups()
            found.append(Logged(float(words[0]), words[2 if has_quality else 1], words[-1]))
    return found


def from_robot() -> list[Logged]:
    """Messages that the robot published."""
    return _matching(_ROBOT, True)


def from_master() -> list[Logged]:
    """Commands that the robot received."""
    return _matching(_MASTER, False)


def count_of_lines() -> int:
    return len(_lines("log_mqtt"))


def rows(name: str) -> list[list[float]]:
    """Rows of a log that the robot wrote itself."""
    return [[float(word) for word in line.split()] for line in _lines(name)]
