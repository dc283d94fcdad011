"""The topics that a robot publishes, and the decoder of their payloads.

A payload is ASCII: the wall time of the Raspberry Pi in seconds, then numbers or a text, separated by single blanks.
Additional numbers at the end are possible.

Evidence, as in the table below: "log" is the complete MQTT traffic of a robot on 2025-01-31, with the logs that the
robot wrote itself; "2026" is the source of both ends as used in 2026.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

from linkcore.errors import BadValue

from ..variables.database import TimeStamp
from ..variables.declarations import Declaration
from ..variables.value_types import Int32, Text
from .variables import RobobotVariables

#: First part of every topic that a robot publishes.
DRIVE = "robobot/drive/"
#: Maximum number of bytes in a payload.
LONGEST = 4096


@dataclass(frozen=True)
class Topic:
    """A topic that a robot publishes.

    Attributes:
        name: Name behind ``robobot/drive/``.
        variables: Names of its variables, in the order of the payload.
        least: Number of values that a payload must have. Variables of missing values keep their values.
        evidence: Source of the format.
    """

    name: str
    variables: tuple[str, ...]
    least: int
    evidence: str


def _topic(name: str, variables: str, least: int, evidence: str) -> Topic:
    return Topic(name, tuple(variables.split()), least, evidence)


_HBT = "hbtindex hbtversion hbtstate hbtvoltage hbtload hbtsupply hbtused hbtshutdown hbtcpu"
_CONF = "confradius confgear confpulses confbase confsample confreversed"

#: All known topics, by their names behind ``robobot/drive/``.
TOPICS: Mapping[str, Topic] = {
    topic.name: topic
    for topic in (
        _topic("T0/pose", "posetime posex posey heading tilt", 4, "2026; not in the log, only the header of its file"),
        _topic("T0/vel", "veltime velleft velright turnrate velocity velcount", 3, "log, 2026 (left and right only)"),
        _topic("T0/mvel", "mvel", 2, "log, 2026"),
        _topic("T0/livn", "livn livnextra", 8, "log, 2026 (without the ninth number)"),
        _topic("T0/liv", "liv", 8, "2026"),
        _topic("T0/liw", "liw", 8, "log, 2026"),
        _topic("T0/dist", "dist", 2, "log"),
        _topic("T0/ir", "dist", 2, "2026"),
        _topic("T0/ird", "dist", 2, "2026"),
        _topic("T0/gyro", "gyro", 3, "2026; the unit is assumed"),
        _topic("T0/acc", "acc", 3, "2026; the unit is assumed"),
        _topic("T0/mot", "mot", 5, "log; the meaning is assumed"),
        _topic("T0/current", "current", 2, "log"),
        _topic("T0/hbt", _HBT, 4, "log, 2026 (which requires four words)"),
        _topic("T0/conf", _CONF, 6, "log, 2026"),
        _topic("T0/dname", "dname", 1, "log, 2026"),
        _topic("T0/info", "info", 0, "log, 2026"),
        _topic("master", "master", 1, "log, 2026"),
    )
}


class Message(NamedTuple):
    """A decoded message.

    Attributes:
        topic: Name of the topic behind ``robobot/drive/``.
        stamp: Wall time of the Raspberry Pi.
        values: Values by the names of the variables, in the units of `RobobotVariables`: an int, a float or a text, or
            a tuple for a variable with several values.
    """

    topic: str
    stamp: TimeStamp
    values: Mapping[str, Any]


def decode(topic: str, payload: bytes) -> Message | None:
    """Decode a message of the robot. Return None if the topic is unknown.

    Args:
        topic: Complete topic, such as ``"robobot/drive/T0/vel"``.
        payload: Payload of the message.

    Raises:
        BadValue: If the payload is not valid. The message names the topic and the expected values.

    >>> decode("robobot/drive/T0/mvel", b"1738331987.8049 0.250 -0.125").values
    {'mvel': (0.25, -0.125)}
    """
    if not topic.startswith(DRIVE) or (known := TOPICS.get(topic[len(DRIVE) :])) is None:
        return None
    try:
        first, _, rest = payload[:LONGEST].decode("ascii").strip().partition(" ")
        stamp = _stamp(first)
        declared = [RobobotVariables.declared()[name] for name in known.variables]
        if isinstance(declared[0].type, Text):
            text = rest.strip()
            if len(text.split()) < known.least:
                raise BadValue("a text is missing")
            return Message(known.name, stamp, {known.variables[0]: text[: 4 * declared[0].length]})
        return Message(known.name, stamp, _numbers(rest.split(), declared, known.least))
    except ValueError as error:  # BadValue, or a word that is not a number
        raise BadValue(
            f"{topic}: invalid payload {payload[:60]!r} ({error}); expected the time in s, and {known.least} or more "
            f"values of {', '.join(known.variables)}"
        ) from None


def _stamp(word: str) -> TimeStamp:
    # Split the word itself, because a float cannot hold all decimals of such a time.
    whole, _, fraction = word.partition(".")
    if not (whole.isdecimal() and (fraction or "0").isdecimal()) or int(whole) >= 2**31:
        raise BadValue(f"{word!r} is not a time")
    return TimeStamp(int(whole), int(fraction[:6].ljust(6, "0")))


def _numbers(words: list[str], declared: list[Declaration[Any, Any]], least: int) -> dict[str, Any]:
    if len(words) < least:
        raise BadValue(f"got {len(words)} values")
    values: dict[str, Any] = {}
    at = 0
    for declaration in declared:
        found = words[at : at + declaration.count]
        if len(found) < declaration.count:
            break
        at += declaration.count
        numbers = tuple(map(_whole if declaration.type is Int32 else _number, found))
        values[declaration.name] = numbers if declaration.count > 1 else numbers[0]
        # Rejects a number that the variable cannot hold.
        declaration.type.packer(declaration.count, "little")(values[declaration.name])
    return values


def _number(word: str) -> float:
    value = float(word)
    if not math.isfinite(value):
        raise BadValue(f"{word!r} is not a finite number")
    return value


def _whole(word: str) -> int:
    value = _number(word)
    if value != math.floor(value):
        raise BadValue(f"{word!r} is not an integer")
    return int(value)
